/* Refinement (section 3.5, Fig. 9): the corner is where the edges between its sectors meet.
 * One work-item per corner; positions are relative to the pixel they start from, so that
 * float32 is exact enough on an image of any size.
 *
 * Corner n of plane p has row starts[p] + n of every array. Arrays have `length` rows, a
 * multiple of the work-group, of which the last ones hold no corner and are never used.
 * `result` has a column per field. */

#define FIELD(k) result[(size_t)(k) * length + row]
#define RESULT_X 0
#define RESULT_Y 1
#define RESULT_EDGES 2
#define RESULT_RESPONSE 6
#define RESULT_PIXEL_X 7
#define RESULT_PIXEL_Y 8
#define RESULT_METHOD 9
#define RESULT_SIGMA 10
#define RESULT_DOUBTFUL 11

#define CENTROID 0
#define METHOD_EDGE_LINES 1
#define METHOD_EDGE_STEP 2
#define METHOD_MIDLINE 3
#define METHOD_CUSP 4
#define METHOD_KEPT 5

/* The response-weighted centroid of the 5 x 5 pixels around a maximum, and the pixel next to
 * it, where refinement starts; both at full size where the detector works on a scaled image. */
__kernel void centroid(__global const RESPONSE *restrict response,
                       __global const int2 *restrict list, __global const uint *restrict totals,
                       __global const uint *restrict starts, const uint rows, const uint step,
                       const uint room, const uint place, const uint length,
                       const float scale,
                       __global int4 *restrict start, __global float *restrict result) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  if (n >= totals[place + p]) return;
  const size_t row = starts[p] + n;
  const int2 pixel = list[p * room + n];
  int sum = 0, sum_x = 0, sum_y = 0;
  for (int dy = -2; dy <= 2; ++dy) {
    const int y = pixel.y + dy;
    if (y < 0 || y >= (int)rows) continue;
    for (int dx = -2; dx <= 2; ++dx) {
      const int r = (int)response[ROW(p, y) + PAD + pixel.x + dx];
      sum += r;
      sum_x += r * dx;
      sum_y += r * dy;
    }
  }
  const float offset_x = (float)sum_x / (float)sum, offset_y = (float)sum_y / (float)sum;
#if SCALED
  const float x = ((float)pixel.x + offset_x + 0.5f) / scale - 0.5f;
  const float y = ((float)pixel.y + offset_y + 0.5f) / scale - 0.5f;
  start[row] = (int4)((int)floor(x + 0.5f), (int)floor(y + 0.5f), (int)p, 0);
  const int2 full = (int2)((int)floor(((float)pixel.x + 0.5f) / scale),
                           (int)floor(((float)pixel.y + 0.5f) / scale));
#else
  const float x = (float)pixel.x + offset_x, y = (float)pixel.y + offset_y;
  /* floor((2 sum_x + sum) / (2 sum)) lies in -2 .. 2. */
  const int twice_x = 2 * sum_x + sum, twice_y = 2 * sum_y + sum;
  start[row] = (int4)(pixel.x - 2 + (twice_x >= -2 * sum) + (twice_x >= 0) +
                          (twice_x >= 2 * sum) + (twice_x >= 4 * sum),
                      pixel.y - 2 + (twice_y >= -2 * sum) + (twice_y >= 0) +
                          (twice_y >= 2 * sum) + (twice_y >= 4 * sum),
                      (int)p, 0);
  const int2 full = pixel;
#endif
  FIELD(RESULT_X) = x;
  FIELD(RESULT_Y) = y;
  FIELD(RESULT_RESPONSE) = (float)response[ROW(p, pixel.y) + PAD + pixel.x];
  FIELD(RESULT_PIXEL_X) = as_float(full.x);
  FIELD(RESULT_PIXEL_Y) = as_float(full.y);
  FIELD(RESULT_METHOD) = (float)(REFINED ? METHOD_KEPT : CENTROID);
  FIELD(RESULT_SIGMA) = NAN;
  FIELD(RESULT_DOUBTFUL) = 0;
  for (int k = 0; k < 4; ++k) FIELD(RESULT_EDGES + k) = NAN;
}

#if REFINED

/* The edge points: on each of three rings the four boundaries of black and white, e0 to e3
 * clockwise, e0 from white to black. A ring has nine columns of `points`: x and y of each, and
 * whether it has four boundaries. */
#define POINT(ring, k) points[(size_t)((ring) * 9 + (k)) * length + row]
#define RINGS 3

#define ONES_2(v) ((v) - ((v) >> 1 & 0x55555555u))
#define ONES_4(v) (((v) & 0x33333333u) + ((v) >> 2 & 0x33333333u))
#define ONES_8(v) (((v) + ((v) >> 4)) & 0x0f0f0f0fu)
#define NEXT_SAMPLE(v, count) (((v) >> 1 | (v) << ((count) - 1)) & ALL(count))
#define LAST_SAMPLE(v, count) (((v) << 1 | (v) >> ((count) - 1)) & ALL(count))
#define ALL(count) (0xffffffffu >> (32 - (count)))

uint ones(const uint v) {
  const uint twos = ONES_2(v), fours = ONES_4(twos);
  return ONES_8(fours) * 0x01010101u >> 24;
}

/* Where the ring's samples change colour, after one pass of majority of three where there are
 * not four places; `black` becomes the colours that were used. */
uint changes(uint *black, const uint count) {
  const uint last = LAST_SAMPLE(*black, count), next = NEXT_SAMPLE(*black, count);
  const uint majority = (*black & last) | (*black & next) | (last & next);
  *black = ones(*black ^ next) == 4 ? *black : majority;
  return *black ^ NEXT_SAMPLE(*black, count);
}

/* Bits of the changes that are e0, e1, e2 and e3. */
#define FIRST_BIT(v) ((v) & (0u - (v)))
#define BOUNDARIES                                                                  \
  const uint to_black = change & ~black, to_white = change & black;                 \
  const uint e0 = FIRST_BIT(to_black), e2 = to_black ^ e0;                          \
  const uint first_white = FIRST_BIT(to_white), other_white = to_white ^ first_white; \
  const uint e1 = (black & 1) ? other_white : first_white, e3 = to_white ^ e1;

/* The share of the way from one sample to the next at which the grey crosses the threshold. */
float crossing(const float here, const float next) {
  const float f = here / (here - next);
  const float clipped = f < 0 ? 0.0f : f > 1 ? 1.0f : f;
  return here == next ? 0.5f : clipped;
}

/* Row y of the plane a corner lies in, y held inside the image. */
#define CLAMPED_ROW(y) \
  (((size_t)(SMALLER(LARGER(y, 0), (int)rows - 1) + frame * (int)rows) + 1) * step + PAD)

#if !SCALED

#define GREY_AT(dx, dy) \
  (float)image[CLAMPED_ROW(y + (dy)) + (size_t)(x + (dx))]
#define SAMPLE(k, dx, dy, next, next_x, next_y) const float d##k = GREY_AT(dx, dy) - threshold;
#define COLOUR(k, dx, dy, next, next_x, next_y) \
  black = (black | (uint)(d##k < 0) << (k)) ^ zero;
#define EDGE_POINT(k, dx, dy, next, next_x, next_y)                                 \
  {                                                                                 \
    const float f = crossing(d##k, d##next);                                        \
    const float px = (float)(dx) + f * (float)((next_x) - (dx));                    \
    const float py = (float)(dy) + f * (float)((next_y) - (dy));                    \
    x0 += (e0 >> (k) & 1) ? px : 0.0f;                                              \
    y0 += (e0 >> (k) & 1) ? py : 0.0f;                                              \
    x1 += (e1 >> (k) & 1) ? px : 0.0f;                                              \
    y1 += (e1 >> (k) & 1) ? py : 0.0f;                                              \
    x2 += (e2 >> (k) & 1) ? px : 0.0f;                                              \
    y2 += (e2 >> (k) & 1) ? py : 0.0f;                                              \
    x3 += (e3 >> (k) & 1) ? px : 0.0f;                                              \
    y3 += (e3 >> (k) & 1) ? py : 0.0f;                                              \
  }
#define EDGE_RING(ring, SAMPLES, count)                                             \
  {                                                                                 \
    SAMPLES(SAMPLE)                                                                 \
    uint black = 0;                                                                 \
    SAMPLES(COLOUR)                                                                 \
    const uint change = changes(&black, count);                                     \
    BOUNDARIES                                                                      \
    float x0 = 0, y0 = 0, x1 = 0, y1 = 0, x2 = 0, y2 = 0, x3 = 0, y3 = 0;           \
    SAMPLES(EDGE_POINT)                                                             \
    POINT(ring, 0) = x0;                                                            \
    POINT(ring, 1) = y0;                                                            \
    POINT(ring, 2) = x1;                                                            \
    POINT(ring, 3) = y1;                                                            \
    POINT(ring, 4) = x2;                                                            \
    POINT(ring, 5) = y2;                                                            \
    POINT(ring, 6) = x3;                                                            \
    POINT(ring, 7) = y3;                                                            \
    POINT(ring, 8) = ones(change) == 4 ? 1.0f : 0.0f;                               \
  }

/* The threshold: mean of the means of the lowest and of the highest quarter, from a sorting
 * network (Batcher's) on the inner ring. */
#define IN_ORDER(i, j)                                                              \
  {                                                                                 \
    const float a = s##i, b = s##j;                                                 \
    s##i = a < b ? a : b;                                                           \
    s##j = a < b ? b : a;                                                           \
  }
#define SORT_16                                                                     \
  IN_ORDER(0, 1) IN_ORDER(2, 3) IN_ORDER(0, 2) IN_ORDER(1, 3) IN_ORDER(1, 2)        \
  IN_ORDER(4, 5) IN_ORDER(6, 7) IN_ORDER(4, 6) IN_ORDER(5, 7) IN_ORDER(5, 6)        \
  IN_ORDER(0, 4) IN_ORDER(2, 6) IN_ORDER(2, 4) IN_ORDER(1, 5) IN_ORDER(3, 7)        \
  IN_ORDER(3, 5) IN_ORDER(1, 2) IN_ORDER(3, 4) IN_ORDER(5, 6) IN_ORDER(8, 9)        \
  IN_ORDER(10, 11) IN_ORDER(8, 10) IN_ORDER(9, 11) IN_ORDER(9, 10) IN_ORDER(12, 13) \
  IN_ORDER(14, 15) IN_ORDER(12, 14) IN_ORDER(13, 15) IN_ORDER(13, 14) IN_ORDER(8, 12) \
  IN_ORDER(10, 14) IN_ORDER(10, 12) IN_ORDER(9, 13) IN_ORDER(11, 15) IN_ORDER(11, 13) \
  IN_ORDER(9, 10) IN_ORDER(11, 12) IN_ORDER(13, 14) IN_ORDER(0, 8) IN_ORDER(4, 12)  \
  IN_ORDER(4, 8) IN_ORDER(2, 10) IN_ORDER(6, 14) IN_ORDER(6, 10) IN_ORDER(2, 4)     \
  IN_ORDER(6, 8) IN_ORDER(10, 12) IN_ORDER(1, 9) IN_ORDER(5, 13) IN_ORDER(5, 9)     \
  IN_ORDER(3, 11) IN_ORDER(7, 15) IN_ORDER(7, 11) IN_ORDER(3, 5) IN_ORDER(7, 9)     \
  IN_ORDER(11, 13) IN_ORDER(1, 2) IN_ORDER(3, 4) IN_ORDER(5, 6) IN_ORDER(7, 8)      \
  IN_ORDER(9, 10) IN_ORDER(11, 12) IN_ORDER(13, 14)
#define SORTED(k, dx, dy, next, next_x, next_y) float s##k = GREY_AT(dx, dy);

__kernel void edge_points(__global const PIXEL *restrict image,
                          __global const int4 *restrict start, const uint rows,
                          const uint columns, const uint step, const uint length,
                          const float scale, const uint zero, __global float *restrict points) {
  const size_t row = get_global_id(0);
  const int x = start[row].x, y = start[row].y, frame = start[row].z;
  EDGE_RING_3(SORTED)
  SORT_16
  const float threshold = (s0 + s1 + s2 + s3 + s12 + s13 + s14 + s15) * 0.125f;
  EDGE_RING(0, EDGE_RING_3, 16)
  EDGE_RING(1, EDGE_RING_4, 24)
  EDGE_RING(2, EDGE_RING_5, 28)
}

#else

/* The same at full size for a detector that works on a scaled image: rings of 32 bilinear
 * samples, their radii divided by the scale. */
#define SAMPLES 32

float grey_between(__global const PIXEL *restrict image, const uint rows, const uint columns,
                   const uint step, const int frame, const float x, const float y) {
  const float left = floor(x), top = floor(y);
  const float fx = x - left, fy = y - top;
  const int x0 = clamp((int)left, 0, (int)columns - 1);
  const int x1 = clamp((int)left + 1, 0, (int)columns - 1);
  __global const PIXEL *upper = image + CLAMPED_ROW((int)top);
  __global const PIXEL *lower = image + CLAMPED_ROW((int)top + 1);
  const float above = (float)upper[x0] + fx * ((float)upper[x1] - (float)upper[x0]);
  const float below = (float)lower[x0] + fx * ((float)lower[x1] - (float)lower[x0]);
  return above + fy * (below - above);
}

__kernel void edge_points(__global const PIXEL *restrict image,
                          __global const int4 *restrict start, const uint rows,
                          const uint columns, const uint step, const uint length,
                          const float scale, const uint zero, __global float *restrict points) {
  const size_t row = get_global_id(0);
  const int4 from = start[row];
  float threshold = 0;
  for (int ring = 0; ring < RINGS; ++ring) {
    const float radius = (float)(3 + ring) / scale;
    float px[SAMPLES], py[SAMPLES], d[SAMPLES];
    for (int k = 0; k < SAMPLES; ++k) {
      px[k] = radius * sinpi((float)k / 16);
      py[k] = -radius * cospi((float)k / 16);
      d[k] = grey_between(image, rows, columns, step, from.z, (float)from.x + px[k],
                          (float)from.y + py[k]);
    }
    if (ring == 0) {
      float sorted[SAMPLES];
      for (int k = 0; k < SAMPLES; ++k) {
        int j = k;
        for (; j > 0 && sorted[j - 1] > d[k]; --j) sorted[j] = sorted[j - 1];
        sorted[j] = d[k];
      }
      for (int k = 0; k < SAMPLES / 4; ++k) threshold += sorted[k] + sorted[SAMPLES - 1 - k];
      threshold /= SAMPLES / 2;
    }
    uint black = 0;
    for (int k = 0; k < SAMPLES; ++k) {
      d[k] -= threshold;
      black |= (uint)(d[k] < 0) << k;
    }
    const uint change = changes(&black, SAMPLES);
    BOUNDARIES
    const uint edges[4] = {e0, e1, e2, e3};
    for (int e = 0; e < 4; ++e) {
      const int k = edges[e] ? 31 - (int)clz(FIRST_BIT(edges[e])) : 0;
      const int next = (k + 1) % SAMPLES;
      const float f = crossing(d[k], d[next]);
      POINT(ring, 2 * e) = px[k] + f * (px[next] - px[k]);
      POINT(ring, 2 * e + 1) = py[k] + f * (py[next] - py[k]);
    }
    POINT(ring, 8) = ones(change) == 4 ? 1.0f : 0.0f;
  }
}

#endif

/* The edge points of a corner in the order of the smallest valid ring: a ring whose first
 * black sector lies on the other side swaps its pairs of boundaries. */
#define LOAD_RING(r)                                                                \
  float valid##r = POINT(r, 8);                                                     \
  float x##r##0 = POINT(r, 0), y##r##0 = POINT(r, 1), x##r##1 = POINT(r, 2);        \
  float y##r##1 = POINT(r, 3), x##r##2 = POINT(r, 4), y##r##2 = POINT(r, 5);        \
  float x##r##3 = POINT(r, 6), y##r##3 = POINT(r, 7);                               \
  const float ax##r = x##r##0 + x##r##1 - x##r##2 - x##r##3;                        \
  const float ay##r = y##r##0 + y##r##1 - y##r##2 - y##r##3;
#define EXCHANGE(a, b, when)                                                        \
  {                                                                                 \
    const float first = a, second = b;                                              \
    a = (when) ? second : first;                                                    \
    b = (when) ? first : second;                                                    \
  }
#define MATCH_RING(r, from_x, from_y)                                               \
  {                                                                                 \
    const int turned = ax##r * (from_x) + ay##r * (from_y) < 0;                     \
    EXCHANGE(x##r##0, x##r##2, turned)                                              \
    EXCHANGE(y##r##0, y##r##2, turned)                                              \
    EXCHANGE(x##r##1, x##r##3, turned)                                              \
    EXCHANGE(y##r##1, y##r##3, turned)                                              \
  }
#define MATCHED_RINGS                                                               \
  LOAD_RING(0) LOAD_RING(1) LOAD_RING(2)                                            \
  const float valid_rings = valid0 + valid1 + valid2;                               \
  MATCH_RING(1, valid0 > 0 ? ax0 : ax1, valid0 > 0 ? ay0 : ay1)                     \
  MATCH_RING(2, valid0 > 0 ? ax0 : valid1 > 0 ? ax1 : ax2,                          \
             valid0 > 0 ? ay0 : valid1 > 0 ? ay1 : ay2)

/* atan2 to 3e-7 rad, without a call. */
float angle_of(const float y, const float x) {
  const float ax = x < 0 ? -x : x, ay = y < 0 ? -y : y;
  const float large = ax > ay ? ax : ay, small = ax > ay ? ay : ax;
  const float q = large > 0 ? small / large : 0.0f;
  /* atan q = pi/4 + atan((q - 1) / (q + 1)) for q above tan(pi/8). */
  const int above = q > 0.41421357f;
  const float t = above ? (q - 1) / (q + 1) : q;
  const float z = t * t;
  const float series = t + t * z * (-0.333333234f + z * (0.199985147f + z * (-0.142353371f +
                       z * (0.106387258f - z * 0.0676628f))));
  const float octant = (above ? 0.785398185f : 0.0f) + series;
  const float quadrant = ay > ax ? 1.57079637f - octant : octant;
  const float half_plane = x < 0 ? 3.14159274f - quadrant : quadrant;
  return y < 0 ? -half_plane : half_plane;
}

/* Direction of boundary e: the sum of the unit vectors to its points on all rings. */
#define UNIT(r, e)                                                                  \
  {                                                                                 \
    const float norm = sqrt(x##r##e * x##r##e + y##r##e * y##r##e);                 \
    const float weight = norm > 0 ? valid##r / norm : 0.0f;                         \
    ux += weight * x##r##e;                                                         \
    uy += weight * y##r##e;                                                         \
  }
#define EDGE_ANGLE(e)                                                               \
  {                                                                                 \
    float ux = 0, uy = 0;                                                           \
    UNIT(0, e) UNIT(1, e) UNIT(2, e)                                                \
    FIELD(RESULT_EDGES + e) = valid_rings >= 2 ? angle_of(uy, ux) : NAN;            \
  }

/* The unit direction of the total-least-squares line with these central moments: half the
 * angle of (sxx - syy, 2 sxy), from the half whose root does not cancel. */
#define LINE_DIRECTION(cx, cy, sxx, sxy, syy)                                       \
  {                                                                                 \
    const float difference = (sxx) - (syy), twice = 2 * (sxy);                      \
    const float length_2 = sqrt(difference * difference + twice * twice);           \
    const float cosine = length_2 > 0 ? difference / length_2 : 1.0f;               \
    const float sine = length_2 > 0 ? twice / length_2 : 0.0f;                      \
    const float larger = sqrt(0.5f + 0.5f * (cosine < 0 ? -cosine : cosine));       \
    const float smaller = sine / (2 * larger);                                      \
    cx = cosine < 0 ? (smaller < 0 ? -smaller : smaller) : larger;                  \
    cy = cosine < 0 ? (sine < 0 ? -larger : larger) : smaller;                      \
  }

#define MOMENTS(r, e)                                                               \
  mx += valid##r * x##r##e;                                                         \
  my += valid##r * y##r##e;                                                         \
  sxx += valid##r * x##r##e * x##r##e;                                              \
  sxy += valid##r * x##r##e * y##r##e;                                              \
  syy += valid##r * y##r##e * y##r##e;
/* The line through the points of boundaries e and f on all rings: unit normal and distance. */
#define EDGE_LINE(e, f, nx, ny, distance)                                           \
  {                                                                                 \
    float mx = 0, my = 0, sxx = 0, sxy = 0, syy = 0, cx, cy;                        \
    MOMENTS(0, e) MOMENTS(1, e) MOMENTS(2, e)                                       \
    MOMENTS(0, f) MOMENTS(1, f) MOMENTS(2, f)                                       \
    const float weight = valid_rings > 0 ? 0.5f / valid_rings : 0.0f;               \
    mx *= weight;                                                                   \
    my *= weight;                                                                   \
    LINE_DIRECTION(cx, cy, sxx * weight - mx * mx, sxy * weight - mx * my,          \
                   syy * weight - my * my)                                          \
    nx = -cy;                                                                       \
    ny = cx;                                                                        \
    distance = nx * mx + ny * my;                                                   \
  }

/* EDGE_LINES: the intersection of the line through e0 and e2 and the line through e1 and e3.
 * `normals` gets the unit normals, n1 towards e1 and n2 towards e0. */
__kernel void edge_lines(__global const float *restrict points,
                         __global const int4 *restrict start, const uint length,
                         const float max_shift, __global float *restrict normals,
                         __global float *restrict result) {
  const size_t row = get_global_id(0);
  MATCHED_RINGS
  EDGE_ANGLE(0)
  EDGE_ANGLE(1)
  EDGE_ANGLE(2)
  EDGE_ANGLE(3)
  float n1x, n1y, h1, n2x, n2y, h2;
  EDGE_LINE(0, 2, n1x, n1y, h1)
  EDGE_LINE(1, 3, n2x, n2y, h2)
  const float sine = n1x * n2y - n1y * n2x;
  const float x = (h1 * n2y - h2 * n1y) / sine, y = (h2 * n1x - h1 * n2x) / sine;
  const int good = (sine < 0 ? -sine : sine) > 0.17f && valid_rings >= 2 &&
                   x * x + y * y <= max_shift * max_shift;
  FIELD(RESULT_X) = good ? (float)start[row].x + x : FIELD(RESULT_X);
  FIELD(RESULT_Y) = good ? (float)start[row].y + y : FIELD(RESULT_Y);
  FIELD(RESULT_METHOD) = good ? METHOD_EDGE_LINES : METHOD_KEPT;
#if EDGE_STEP
  const float side1 = n1x * (valid0 * x01 + valid1 * x11 + valid2 * x21) +
                      n1y * (valid0 * y01 + valid1 * y11 + valid2 * y21) - valid_rings * h1;
  const float side2 = n2x * (valid0 * x00 + valid1 * x10 + valid2 * x20) +
                      n2y * (valid0 * y00 + valid1 * y10 + valid2 * y20) - valid_rings * h2;
  normals[row] = side1 < 0 ? -n1x : n1x;
  normals[length + row] = side1 < 0 ? -n1y : n1y;
  normals[2 * (size_t)length + row] = side2 < 0 ? -n2x : n2x;
  normals[3 * (size_t)length + row] = side2 < 0 ? -n2y : n2y;
  normals[4 * (size_t)length + row] = x;
  normals[5 * (size_t)length + row] = y;
#endif
}

#if MIDLINES

typedef struct {
  float2 mean, direction, normal;
} Line;

/* The total-least-squares line through the points of the valid rings. */
Line fit_line(const float2 *point, const float *valid) {
  float2 mean = 0;
  float count = 0, sxx = 0, sxy = 0, syy = 0;
  for (int r = 0; r < RINGS; ++r) {
    mean += valid[r] * point[r];
    count += valid[r];
  }
  mean /= count;
  for (int r = 0; r < RINGS; ++r) {
    const float2 d = point[r] - mean;
    sxx += valid[r] * d.x * d.x;
    sxy += valid[r] * d.x * d.y;
    syy += valid[r] * d.y * d.y;
  }
  float cx, cy;
  LINE_DIRECTION(cx, cy, sxx, sxy, syy)
  Line line = {mean, (float2)(cx, cy), (float2)(-cy, cx)};
  return line;
}

float cross_product(const float2 a, const float2 b) { return a.x * b.y - a.y * b.x; }

/* Where a.p = h and b.p = k. */
float2 solve(const float2 a, const float h, const float2 b, const float k) {
  return (float2)(h * b.y - k * a.y, k * a.x - h * b.x) / cross_product(a, b);
}

float2 intersection(const Line *a, const Line *b) {
  return solve(a->normal, dot(a->normal, a->mean), b->normal, dot(b->normal, b->mean));
}

#if QUADRATIC

/* Coefficients a, b, c of v = a + b u + c u u through three points in the frame of a line. */
float3 fit_parabola(const float2 *point, const Line *line) {
  float u[RINGS], v[RINGS];
  for (int r = 0; r < RINGS; ++r) {
    u[r] = dot(line->direction, point[r] - line->mean);
    v[r] = dot(line->normal, point[r] - line->mean);
  }
  const float slope = (v[1] - v[0]) / (u[1] - u[0]);
  const float c = ((v[2] - v[1]) / (u[2] - u[1]) - slope) / (u[2] - u[0]);
  const float b = slope - c * (u[0] + u[1]);
  return (float3)(v[0] - u[0] * (b + c * u[0]), b, c);
}

/* How far a point lies off a parabola, and the gradient of that. */
float off_parabola(const float3 fit, const Line *line, const float2 p, float2 *gradient) {
  const float u = dot(line->direction, p - line->mean);
  *gradient = line->normal - (fit.y + 2 * fit.z * u) * line->direction;
  return dot(line->normal, p - line->mean) - (fit.x + u * (fit.y + u * fit.z));
}

#endif

/* MIDLINE: the intersection of the centrelines of the black sectors e0 e1 and e2 e3. Where they
 * are nearly one line or meet too far away, CUSP: per black sector the intersection of its own
 * two edge lines, and the midpoint of the two cusps. */
__kernel void midlines(__global const float *restrict points, __global const int4 *restrict start,
                       const uint length, const float max_shift,
                       __global float *restrict normals, __global float *restrict result) {
  const size_t row = get_global_id(0);
  MATCHED_RINGS
  EDGE_ANGLE(0)
  EDGE_ANGLE(1)
  EDGE_ANGLE(2)
  EDGE_ANGLE(3)
  if (valid_rings < 2) return;
  const float valid[] = {valid0, valid1, valid2};
  const float2 edge[4][RINGS] = {{(float2)(x00, y00), (float2)(x10, y10), (float2)(x20, y20)},
                                 {(float2)(x01, y01), (float2)(x11, y11), (float2)(x21, y21)},
                                 {(float2)(x02, y02), (float2)(x12, y12), (float2)(x22, y22)},
                                 {(float2)(x03, y03), (float2)(x13, y13), (float2)(x23, y23)}};
  Line centre[2], side[4];
  float2 middle[2][RINGS];
  for (int s = 0; s < 2; ++s) {
    for (int r = 0; r < RINGS; ++r) middle[s][r] = (edge[2 * s][r] + edge[2 * s + 1][r]) / 2;
    centre[s] = fit_line(middle[s], valid);
  }
  float2 position = intersection(&centre[0], &centre[1]);
#if QUADRATIC
  if (valid_rings == RINGS) {
    const float3 first = fit_parabola(middle[0], &centre[0]);
    const float3 second = fit_parabola(middle[1], &centre[1]);
    for (int k = 0; k < 4; ++k) {
      float2 a, b;
      const float h = off_parabola(first, &centre[0], position, &a);
      const float g = off_parabola(second, &centre[1], position, &b);
      position -= solve(a, h, b, g);
    }
  }
#endif
  int method = METHOD_MIDLINE;
  if (!(fabs(cross_product(centre[0].direction, centre[1].direction)) > 0.17f &&
        dot(position, position) <= max_shift * max_shift)) {
    for (int e = 0; e < 4; ++e) side[e] = fit_line(edge[e], valid);
    position = (intersection(&side[0], &side[1]) + intersection(&side[2], &side[3])) / 2;
    const int open = fabs(cross_product(side[0].direction, side[1].direction)) > 0.17f &&
                     fabs(cross_product(side[2].direction, side[3].direction)) > 0.17f;
    if (!(open && dot(position, position) <= max_shift * max_shift)) return;
    method = METHOD_CUSP;
  }
  FIELD(RESULT_X) = (float)start[row].x + position.x;
  FIELD(RESULT_Y) = (float)start[row].y + position.y;
  FIELD(RESULT_METHOD) = method;
}

#endif

#if EDGE_STEP

/* EDGE_STEP: one weighted least-squares step from EDGE_LINES' result, in the corner model
 * I = m + c P, P = f(a) f(b), f(a) = a / sqrt(1 + a a), a and b the distances from the two
 * edges in units of the blur. */
#define BLUR 1.2f
#define LARGEST_STEP 0.3f
#define SMALL 1e-3f

/* The model at offset u from the corner: weight (0 outside), P, and its slopes A and B. */
#define CORNER_MODEL(ux, uy)                                                        \
  const float r2 = (ux) * (ux) + (uy) * (uy);                                       \
  const float w = fmax(0.0f, 1 - r2 * inverse_radius_2) * fmin(1.0f, r2 * inverse_core_2); \
  const float a = (n1x * (ux) + n1y * (uy)) / BLUR, b = (n2x * (ux) + n2y * (uy)) / BLUR; \
  const float qa = rsqrt(1 + a * a), qb = rsqrt(1 + b * b);                         \
  const float f = a * qa, g = b * qb, P = f * g;

__kernel void edge_step(__global const PIXEL *restrict image, __global const int4 *restrict start,
                        const uint rows, const uint columns, const uint step,
                        const uint length, const float radius, const float scale,
                        __global const float *restrict normals, __global float *restrict result) {
  const size_t row = get_global_id(0);
  if (FIELD(RESULT_METHOD) != METHOD_EDGE_LINES) return;
  const int4 from = start[row];
  const int frame = from.z;
  const float n1x = normals[row], n1y = normals[length + row];
  const float n2x = normals[2 * (size_t)length + row], n2y = normals[3 * (size_t)length + row];
  const float x = normals[4 * (size_t)length + row], y = normals[5 * (size_t)length + row];
  const float core = fmin(4.0f, radius / 2);
  const float inverse_radius_2 = 1 / (radius * radius), inverse_core_2 = 1 / (core * core);
  const int left = (int)ceil(x - radius), right = (int)floor(x + radius);
  const int top = (int)ceil(y - radius), bottom = (int)floor(y + radius);
#define GREY_NEAR(i, j)                                                             \
  ((float)image[CLAMPED_ROW(from.y + (j)) + (size_t)clamp(from.x + (i), 0, (int)columns - 1)] - \
   centre)
  const float centre =
      (float)image[CLAMPED_ROW(from.y) + (size_t)clamp(from.x, 0, (int)columns - 1)];

  float s1 = 0, sp = 0, spp = 0, si = 0, spi = 0, sii = 0, sa = 0, sb = 0, saa = 0, sab = 0;
  float sbb = 0, sap = 0, sbp = 0, sai = 0, sbi = 0;
  for (int j = top; j <= bottom; ++j) {
    const float uy = (float)j - y;
    for (int i = left; i <= right; ++i) {
      const float ux = (float)i - x;
      CORNER_MODEL(ux, uy)
      const float A = qa * qa * qa * g / BLUR, B = f * qb * qb * qb / BLUR;
      const float I = GREY_NEAR(i, j);
      const float wP = w * P, wA = w * A, wB = w * B, wI = w * I;
      s1 += w;
      sp += wP;
      spp += wP * P;
      si += wI;
      spi += wP * I;
      sii += wI * I;
      sa += wA;
      sb += wB;
      saa += wA * A;
      sab += wA * B;
      sbb += wB * B;
      sap += wA * P;
      sbp += wB * P;
      sai += wA * I;
      sbi += wB * I;
    }
  }
  const float spread = s1 * spp - sp * sp;
  const float c = (s1 * spi - sp * si) / spread, m = (si - c * sp) / s1;
  const float ba = sai - m * sa - c * sap, bb = sbi - m * sb - c * sbp;
  const float d = saa * sbb - sab * sab;
  const float ha = -(sbb * ba - sab * bb) / (d * c), hb = -(saa * bb - sab * ba) / (d * c);
  const float sine = n1x * n2y - n1y * n2x;
  const float tx = (ha * n2y - hb * n1y) / sine, ty = (hb * n1x - ha * n2x) / sine;
  const float largest = LARGEST_STEP / scale, farthest = 2 / scale;
  if (!(fabs(c) > SMALL && d > SMALL * saa * sbb && spread > SMALL * s1 * spp &&
        tx * tx + ty * ty <= largest * largest &&
        (x + tx) * (x + tx) + (y + ty) * (y + ty) <= farthest * farthest))
    return;

  /* Autocorrelation of what the model leaves, between horizontal neighbours. */
  float products = 0, weights = 0;
  for (int j = top; j <= bottom; ++j) {
    const float uy = (float)j - y;
    float before = 0, weight_before = 0;
    for (int i = left; i <= right; ++i) {
      const float ux = (float)i - x;
      CORNER_MODEL(ux, uy)
      const float residual = (GREY_NEAR(i, j) - m - c * P) / c;
      const int inside = r2 < radius * radius;
      products += inside ? weight_before * before * residual : 0.0f;
      weights += inside ? weight_before : 0.0f;
      before = residual;
      weight_before = inside ? w : 0.0f;
    }
  }
  FIELD(RESULT_X) = (float)from.x + (x + tx);
  FIELD(RESULT_Y) = (float)from.y + (y + ty);
  FIELD(RESULT_METHOD) = METHOD_EDGE_STEP;
  const float trace = (saa + sbb + 2 * sab * (n1x * n2x + n1y * n2y)) / (d * sine * sine);
  FIELD(RESULT_SIGMA) = 0.25f * trace * (sii - m * si - c * spi) / (s1 * c * c);
  FIELD(RESULT_DOUBTFUL) = products / weights;
}

#endif

#endif
