/* Refinement (section 3.5, Fig. 9): the corner is where the edges between its sectors meet.
 * One work-item per corner; positions are relative to the pixel they start from, so that
 * float32 is exact enough on an image of any size.
 *
 * Corner n of frame p has row p * room + n of every array in between; a column has `length` rows.
 * There are totals[place + p] corners, or as many as there is room for.
 *
 * `result` holds what a host hands out as it is. Of each frame: the number of corners, that of
 * the candidates of each mask, and, HEAD numbers from the beginning on, field after field, each
 * with `places` corners, so many that vectors of eight end within. Pixels are integers of the
 * working image; variance and correlation are those of EDGE_STEP. */

#define COLUMN_OF(array, k) array[(size_t)(k) * length + row]

#define HEAD 16
#define RESULT_FIELDS 12
#define RESULT_OF_FRAME(total)                                                      \
  const uint places = (SMALLER(total, room) + 7) / 8 * 8;                           \
  __global float *own = result + p * (HEAD + RESULT_FIELDS * (size_t)room) + HEAD;
#define RESULT_POSITION (own + 2 * n)
#define RESULT_PIXEL (own + 2 * places + 2 * n)
#define RESULT_EDGES (own + 4 * places + 4 * n)
#define RESULT_RESPONSE (own + 8 * places + n)
#define RESULT_METHOD (own + 9 * places + n)
#define RESULT_VARIANCE (own + 10 * places + n)
#define RESULT_CORRELATION (own + 11 * places + n)

void write_head(__global float *own, __global const uint *totals, const uint place,
                const size_t p) {
  __global uint *head = (__global uint *)(own - HEAD);
  head[0] = totals[place + p];
  for (uint mask = 0; mask < MASKS; ++mask) head[1 + mask] = totals[p * MASKS + mask];
}

#define CENTROID 0
#define METHOD_EDGE_LINES 1
#define METHOD_EDGE_STEP 2
#define METHOD_MIDLINE 3
#define METHOD_CUSP 4
#define METHOD_KEPT 5

/* A work-item takes LANES corners: one, or with refine_eight.cl the eight that a vector holds.
 * LANE(array, k) is their part of column k; STORE writes a field of the result. */
#if LANES == 1
typedef float REAL;
typedef uint BITS;
#define AS_BITS(v) as_uint(v)
#define AS_REAL(v) as_float(v)
#define WHERE(condition) (0u - (uint)(condition))
#define STORE_PAIRS(field, a, b) *(__global float2 *)(field) = (float2)(a, b);
#define STORE_FOURS(field, a, b, c, d) *(__global float4 *)(field) = (float4)(a, b, c, d);
#elif LANES == 8
typedef float8 REAL;
typedef uint8 BITS;
#define AS_BITS(v) as_uint8(v)
#define AS_REAL(v) as_float8(v)
#define WHERE(condition) as_uint8(condition)
#define TWO(k, a, b) (a).s##k, (b).s##k
#define STORE_PAIRS(field, a, b)                                                    \
  *(__global float16 *)(field) = (float16)(TWO(0, a, b), TWO(1, a, b), TWO(2, a, b), \
                                           TWO(3, a, b), TWO(4, a, b), TWO(5, a, b), \
                                           TWO(6, a, b), TWO(7, a, b));
#define FOUR(k, a, b, c, d) TWO(k, a, b), TWO(k, c, d)
#define STORE_FOURS(field, a, b, c, d)                                              \
  *(__global float16 *)(field) = (float16)(FOUR(0, a, b, c, d), FOUR(1, a, b, c, d), \
                                           FOUR(2, a, b, c, d), FOUR(3, a, b, c, d)); \
  *(__global float16 *)((field) + 16) =                                             \
      (float16)(FOUR(4, a, b, c, d), FOUR(5, a, b, c, d), FOUR(6, a, b, c, d),      \
                FOUR(7, a, b, c, d));
#else
#error "LANES must be 1 or 8"
#endif
#define LANE(array, k) *(__global REAL *)(array + (size_t)(k) * length + row)
#define STORE(field, v) *(__global REAL *)(field) = v;
#define CHOOSE(mask, a, b) AS_REAL((AS_BITS(a) & (mask)) | (AS_BITS(b) & ~(mask)))

/* A vector of eight elements, whatever their type: vload8 and convert_float8 are calls of 30 ns
 * on PoCL 3.0. */
#define EIGHT_OF(T, p) (T)((p)[0], (p)[1], (p)[2], (p)[3], (p)[4], (p)[5], (p)[6], (p)[7])

/* s / sum, of -2 .. 2, to the nearest integer, halves up. */
#define REACHES(s, thirds) (WHERE(2 * (s) >= (thirds) * sum) & 1)
#define NEAREST(s) (REACHES(s, -3) + REACHES(s, -1) + REACHES(s, 1) + REACHES(s, 3) - 2)

#if LANES == 1

/* The response-weighted centroid of the 5 x 5 pixels around a maximum, and the pixel next to
 * it, where refinement starts; both at full size where the detector works on a scaled image. */
__kernel void centroid(__global const RESPONSE *restrict response,
                       __global const int2 *restrict list, __global const uint *restrict totals,
                       const uint rows, const uint step,
                       const uint room, const uint place, const uint length,
                       const float scale, const uint full_rows, const uint full_columns,
                       __global float *restrict start, __global float *restrict result) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  RESULT_OF_FRAME(totals[place + p])
  if (n == 0) write_head(own, totals, place, p);
  if (n >= totals[place + p]) return;
  const size_t row = p * room + n;
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
  const int2 from = (int2)(clamp((int)floor(x + 0.5f), 0, (int)full_columns - 1),
                           clamp((int)floor(y + 0.5f), 0, (int)full_rows - 1));
#else
  const float x = (float)pixel.x + offset_x, y = (float)pixel.y + offset_y;
  const int2 from = pixel + (int2)((int)NEAREST(sum_x), (int)NEAREST(sum_y));
#endif
  start[row] = (float)from.x;
  start[length + row] = (float)from.y;
  STORE_PAIRS(RESULT_POSITION, x, y)
  STORE_PAIRS(RESULT_PIXEL, as_float(pixel.x), as_float(pixel.y))
  STORE_FOURS(RESULT_EDGES, NAN, NAN, NAN, NAN)
  STORE(RESULT_RESPONSE, (float)response[ROW(p, pixel.y) + PAD + pixel.x])
  STORE(RESULT_METHOD, (float)(REFINED ? METHOD_KEPT : CENTROID))
  STORE(RESULT_VARIANCE, NAN)
}

#endif

#if REFINED

/* The edge points: on each of three rings the four boundaries of black and white, e0 to e3
 * clockwise, e0 from white to black: x0, y0 to x3, y3, and `valid`, 1 where there are four. */
#define RINGS 3

#define ONES_2(v) ((v) - ((v) >> 1 & 0x55555555u))
#define ONES_4(v) (((v) & 0x33333333u) + ((v) >> 2 & 0x33333333u))
#define ONES_8(v) (((v) + ((v) >> 4)) & 0x0f0f0f0fu)
#define NEXT_SAMPLE(v, count) (((v) >> 1 | (v) << ((count) - 1)) & ALL(count))
#define LAST_SAMPLE(v, count) (((v) << 1 | (v) >> ((count) - 1)) & ALL(count))
#define ALL(count) (0xffffffffu >> (32 - (count)))

BITS ones(const BITS v) {
  const BITS twos = ONES_2(v), fours = ONES_4(twos);
  return ONES_8(fours) * 0x01010101u >> 24;
}

/* Where the ring's samples change colour, after one pass of majority of three where there are
 * not four places; `black` becomes the colours that were used. */
BITS changes(BITS *black, const uint count) {
  const BITS last = LAST_SAMPLE(*black, count), next = NEXT_SAMPLE(*black, count);
  const BITS majority = (*black & last) | (*black & next) | (last & next);
  const BITS four = WHERE(ones(*black ^ next) == 4);
  *black = (*black & four) | (majority & ~four);
  return *black ^ NEXT_SAMPLE(*black, count);
}

/* Bits of the changes that are e0, e1, e2 and e3. */
#define FIRST_BIT(v) ((v) & (0u - (v)))
#define BOUNDARIES                                                                  \
  const BITS to_black = change & ~black, to_white = change & black;                 \
  const BITS e0 = FIRST_BIT(to_black), e2 = to_black ^ e0;                          \
  const BITS first_white = FIRST_BIT(to_white), other_white = to_white ^ first_white; \
  const BITS swap = 0u - (black & 1);                                               \
  const BITS e1 = (other_white & swap) | (first_white & ~swap), e3 = to_white ^ e1;

/* The share of the way from one sample to the next at which the grey crosses the threshold. */
REAL crossing(const REAL here, const REAL next) {
  const REAL f = here / (here - next);
  const REAL raised = CHOOSE(WHERE(f < 0), (REAL)(0.0f), f);
  const REAL clipped = CHOOSE(WHERE(raised > 1), (REAL)(1.0f), raised);
  return CHOOSE(WHERE(here == next), (REAL)(0.5f), clipped);
}

/* The pixels of row y of frame p, y held inside the image. */
#define CLAMPED_ROW(y) (ROW(p, SMALLER(LARGER(y, 0), (int)rows - 1)) + PAD)

/* The threshold: mean of the means of the lowest and of the highest quarter of the inner ring.
 * Of two sorted fours, the first of each pair (first, last), (second, third), ... is one of the
 * lowest four; these rise and fall, and so do the highest four. */
#define IN_ORDER(i, j)                                                              \
  {                                                                                 \
    const REAL a = s##i, b = s##j;                                                  \
    s##i = a < b ? a : b;                                                           \
    s##j = a < b ? b : a;                                                           \
  }
#define SORT_4(a, b, c, d) \
  IN_ORDER(a, b) IN_ORDER(c, d) IN_ORDER(a, c) IN_ORDER(b, d) IN_ORDER(b, c)
#define SORT_RISE_AND_FALL(a, b, c, d) \
  IN_ORDER(a, c) IN_ORDER(b, d) IN_ORDER(a, b) IN_ORDER(c, d)
#define PART_8(a, b, c, d, e, f, g, h)                                              \
  SORT_4(a, b, c, d) SORT_4(e, f, g, h)                                             \
  IN_ORDER(a, h) IN_ORDER(b, g) IN_ORDER(c, f) IN_ORDER(d, e)
#define SORTED(k, dx, dy, next, next_x, next_y) REAL s##k = EDGE_GREY(k, dx, dy);
#define THRESHOLD                                                                   \
  EDGE_RING_3(SORTED)                                                               \
  PART_8(0, 1, 2, 3, 4, 5, 6, 7)                                                    \
  PART_8(8, 9, 10, 11, 12, 13, 14, 15)                                              \
  SORT_RISE_AND_FALL(0, 1, 2, 3) SORT_RISE_AND_FALL(4, 5, 6, 7)                     \
  SORT_RISE_AND_FALL(8, 9, 10, 11) SORT_RISE_AND_FALL(12, 13, 14, 15)               \
  IN_ORDER(0, 11) IN_ORDER(1, 10) IN_ORDER(2, 9) IN_ORDER(3, 8)                     \
  IN_ORDER(4, 15) IN_ORDER(5, 14) IN_ORDER(6, 13) IN_ORDER(7, 12)                   \
  const REAL threshold = (s0 + s1 + s2 + s3 + s12 + s13 + s14 + s15) * 0.125f;

#if SCALED

/* With a working scale the rings have 32 samples and radii divided by the scale; greys are
 * interpolated. A sample: x and y from the start, the way to the next one, and the pixel to the
 * upper left with the shares of the ones right and below. */
#define RING_32 32
#define BETWEEN_TWO(f, a, b) (a + (f) * (b - a))
#define BETWEEN(sample, a0, a1, b0, b1)                                             \
  BETWEEN_TWO(sample.s7, BETWEEN_TWO(sample.s6, a0, a1), BETWEEN_TWO(sample.s6, b0, b1))

/* The threshold of the ring's greys, sorted by merging longer and longer parts, the second one
 * of each pair from its end; the last merge need not go below quarters. */
REAL threshold_of(const REAL *grey) {
  REAL s[RING_32], sum = 0;
  for (int k = 0; k < RING_32; ++k) s[k] = grey[k];
  for (int part = 2; part <= RING_32; part *= 2)
    for (int apart = part - 1, next = part / 4; apart > (part < RING_32 ? 0 : RING_32 / 8);
         apart = next, next /= 2)
      for (int k = 0; k < RING_32; ++k)
        if ((k ^ apart) > k) {
          const REAL a = s[k], b = s[k ^ apart];
          s[k] = a < b ? a : b;
          s[k ^ apart] = a < b ? b : a;
        }
  for (int k = 0; k < RING_32 / 4; ++k) sum += s[k] + s[RING_32 - 1 - k];
  return sum / (RING_32 / 2);
}

#define RING_TABLE __global const float8
/* d: grey minus threshold, the first one again behind the last. RING_GREY is that of a sample. */
#define EDGE_RING(ring)                                                             \
  for (uint k = 0; k < RING_32; ++k) {                                              \
    const float8 sample = ring_samples[ring * RING_32 + k];                         \
    d[k] = RING_GREY(sample);                                                       \
  }                                                                                 \
  if (ring == 0) threshold = threshold_of(d);                                       \
  for (uint k = 0; k < RING_32; ++k) d[k] -= threshold;                             \
  d[RING_32] = d[0];                                                                \
  EDGE_POINTS(ring, RING_32, ring_samples + ring * RING_32)
#define EDGE_RINGS                                                                  \
  REAL d[RING_32 + 1], threshold;                                                   \
  EDGE_RING(0)                                                                      \
  EDGE_RING(1)                                                                      \
  EDGE_RING(2)

#else

/* A ring's samples: x, y and the way to the next one; EDGE_GREY is the grey of one. */
#define WAY(k, dx, dy, next, next_x, next_y) \
  (char4)(dx, dy, (next_x) - (dx), (next_y) - (dy)),
__constant char4 way_3[] = {EDGE_RING_3(WAY)};
__constant char4 way_4[] = {EDGE_RING_4(WAY)};
__constant char4 way_5[] = {EDGE_RING_5(WAY)};

#define RING_TABLE __constant const char4
#define MOST_SAMPLES 28
#define KEEP(k, dx, dy, next, next_x, next_y) d[k] = EDGE_GREY(k, dx, dy) - threshold;
#define EDGE_RING(ring, SAMPLES, count, table)                                      \
  SAMPLES(KEEP)                                                                     \
  d[count] = d[0];                                                                  \
  EDGE_POINTS(ring, count, table)
#define EDGE_RINGS                                                                  \
  THRESHOLD                                                                         \
  REAL d[MOST_SAMPLES + 1];                                                         \
  EDGE_RING(0, EDGE_RING_3, 16, way_3)                                              \
  EDGE_RING(1, EDGE_RING_4, 24, way_4)                                              \
  EDGE_RING(2, EDGE_RING_5, 28, way_5)

#endif

/* The edge points of a ring of `count` samples from d, and whether there are four. */
#define EDGE_POINTS(ring, count, table)                                             \
  REAL x##ring##0, y##ring##0, x##ring##1, y##ring##1;                              \
  REAL x##ring##2, y##ring##2, x##ring##3, y##ring##3, valid##ring;                 \
  {                                                                                 \
    BITS black = 0;                                                                 \
    for (uint k = 0; k < count; ++k) black |= WHERE(d[k] < 0) & (1u << k);          \
    const BITS change = changes(&black, count);                                     \
    BOUNDARIES                                                                      \
    const BITS four = WHERE(ones(change) == 4);                                     \
    const BITS other = ~four & 1;                                                   \
    edge_point(d, table, (e0 & four) | other, &x##ring##0, &y##ring##0);            \
    edge_point(d, table, (e1 & four) | other, &x##ring##1, &y##ring##1);            \
    edge_point(d, table, (e2 & four) | other, &x##ring##2, &y##ring##2);            \
    edge_point(d, table, (e3 & four) | other, &x##ring##3, &y##ring##3);            \
    valid##ring = CHOOSE(four, (REAL)(1.0f), (REAL)(0.0f));                         \
  }

#if LANES == 1

/* The edge point after the sample whose bit is set. */
void edge_point(const float *d, RING_TABLE *ring, const uint bit, float *x, float *y) {
  const uint k = 31 - clz(bit);
  const float f = crossing(d[k], d[k + 1]);
#if SCALED
  *x = ring[k].s0 + f * ring[k].s2;
  *y = ring[k].s1 + f * ring[k].s3;
#else
  *x = (float)ring[k].s0 + f * (float)ring[k].s2;
  *y = (float)ring[k].s1 + f * (float)ring[k].s3;
#endif
}

#if SCALED

/* The grey of a sample around (x, y). */
float ring_grey(const float8 sample, __global const PIXEL *image, const size_t p, const uint rows,
                const uint columns, const uint step, const int x, const int y) {
  const int left = x + (int)sample.s4, top = y + (int)sample.s5;
  __global const PIXEL *upper = image + CLAMPED_ROW(top), *lower = image + CLAMPED_ROW(top + 1);
  const int x0 = clamp(left, 0, (int)columns - 1), x1 = clamp(left + 1, 0, (int)columns - 1);
  const float a0 = (float)upper[x0], a1 = (float)upper[x1];
  const float b0 = (float)lower[x0], b1 = (float)lower[x1];
  return BETWEEN(sample, a0, a1, b0, b1);
}

#define RING_GREY(sample) ring_grey(sample, image, p, rows, columns, step, from_x, from_y)
#define LINES_OF_IMAGE

#else

#define EDGE_GREY(k, dx, dy) (float)image[line[(dy) + 5] + (size_t)(from_x + (dx))]
#define LINES_OF_IMAGE                                                              \
  const size_t line[] = {CLAMPED_ROW(from_y - 5), CLAMPED_ROW(from_y - 4),          \
                         CLAMPED_ROW(from_y - 3), CLAMPED_ROW(from_y - 2),          \
                         CLAMPED_ROW(from_y - 1), CLAMPED_ROW(from_y),              \
                         CLAMPED_ROW(from_y + 1), CLAMPED_ROW(from_y + 2),          \
                         CLAMPED_ROW(from_y + 3), CLAMPED_ROW(from_y + 4),          \
                         CLAMPED_ROW(from_y + 5)};

#endif

/* The edge points around the start of a corner. */
#define EDGES_OF_CORNER                                                             \
  const int from_x = (int)COLUMN_OF(start, 0), from_y = (int)COLUMN_OF(start, 1);   \
  LINES_OF_IMAGE                                                                    \
  EDGE_RINGS                                                                        \
  MATCH_RINGS

#endif

/* The edge points of a corner in the order of the smallest valid ring: a ring whose first
 * black sector lies on the other side swaps its pairs of boundaries. */
#define EXCHANGE(a, b, when)                                                        \
  {                                                                                 \
    const REAL one = a, other = b;                                                  \
    a = CHOOSE(when, other, one);                                                   \
    b = CHOOSE(when, one, other);                                                   \
  }
#define SECTORS_OF(r)                                                               \
  const REAL ax##r = x##r##0 + x##r##1 - x##r##2 - x##r##3;                         \
  const REAL ay##r = y##r##0 + y##r##1 - y##r##2 - y##r##3;
#define MATCH_RING(r, from_x, from_y)                                               \
  {                                                                                 \
    const BITS turned = WHERE(ax##r * (from_x) + ay##r * (from_y) < 0);             \
    EXCHANGE(x##r##0, x##r##2, turned)                                              \
    EXCHANGE(y##r##0, y##r##2, turned)                                              \
    EXCHANGE(x##r##1, x##r##3, turned)                                              \
    EXCHANGE(y##r##1, y##r##3, turned)                                              \
  }
#define MATCH_RINGS                                                                 \
  SECTORS_OF(0) SECTORS_OF(1) SECTORS_OF(2)                                         \
  const REAL valid_rings = valid0 + valid1 + valid2;                                \
  const BITS has0 = WHERE(valid0 > 0), has1 = WHERE(valid1 > 0);                    \
  MATCH_RING(1, CHOOSE(has0, ax0, ax1), CHOOSE(has0, ay0, ay1))                     \
  MATCH_RING(2, CHOOSE(has0, ax0, CHOOSE(has1, ax1, ax2)),                          \
             CHOOSE(has0, ay0, CHOOSE(has1, ay1, ay2)))

#define MAGNITUDE(v) AS_REAL(AS_BITS(v) & 0x7fffffffu)
#define SIGN_OF(v) (AS_BITS(v) & 0x80000000u)

/* atan2 to 3e-7 rad, without a call. */
REAL angle_of(const REAL y, const REAL x) {
  const REAL ax = MAGNITUDE(x), ay = MAGNITUDE(y);
  const BITS steep = WHERE(ay > ax);
  const REAL large = CHOOSE(steep, ay, ax), small = CHOOSE(steep, ax, ay);
  /* atan q = pi/4 + atan((q - 1) / (q + 1)) for q = small / large above tan(pi/8). */
  const BITS above = WHERE(small > 0.41421357f * large);
  const REAL over = CHOOSE(above, small - large, small);
  const REAL under = CHOOSE(above, small + large, large) + FLT_MIN;
  const REAL t = over / under;
  const REAL z = t * t;
  const REAL series = t + t * z * (-0.333333234f + z * (0.199985147f + z * (-0.142353371f +
                      z * (0.106387258f - z * 0.0676628f))));
  const REAL octant = CHOOSE(above, 0.785398185f + series, series);
  const REAL quadrant = CHOOSE(steep, 1.57079637f - octant, octant);
  const REAL half_plane = CHOOSE(WHERE(x < 0), 3.14159274f - quadrant, quadrant);
  return AS_REAL(AS_BITS(half_plane) | SIGN_OF(y));
}

/* Direction of boundary e: the sum of the unit vectors to its points on all rings. */
#define UNIT(r, e)                                                                  \
  {                                                                                 \
    const REAL norm = sqrt(x##r##e * x##r##e + y##r##e * y##r##e);                  \
    const REAL weight = CHOOSE(WHERE(norm > 0), valid##r / norm, (REAL)(0.0f));     \
    ux += weight * x##r##e;                                                         \
    uy += weight * y##r##e;                                                         \
  }
#define EDGE_ANGLE(e)                                                               \
  REAL angle##e;                                                                    \
  {                                                                                 \
    REAL ux = 0, uy = 0;                                                            \
    UNIT(0, e) UNIT(1, e) UNIT(2, e)                                                \
    angle##e = CHOOSE(WHERE(valid_rings >= 2), angle_of(uy, ux), (REAL)(NAN));      \
  }
#define EDGE_ANGLES                                                                 \
  EDGE_ANGLE(0)                                                                     \
  EDGE_ANGLE(1)                                                                     \
  EDGE_ANGLE(2)                                                                     \
  EDGE_ANGLE(3)                                                                     \
  STORE_FOURS(RESULT_EDGES, angle0, angle1, angle2, angle3)

/* The unit direction of the total-least-squares line with these central moments: half the
 * angle of (sxx - syy, 2 sxy), from the half whose root does not cancel. */
#define LINE_DIRECTION(T, cx, cy, sxx, sxy, syy)                                    \
  {                                                                                 \
    const T difference = (sxx) - (syy), twice = 2 * (sxy);                          \
    const T norm = sqrt(difference * difference + twice * twice) + FLT_MIN;         \
    const T cosine = difference / norm, sine = twice / norm;                        \
    const T larger = sqrt(0.5f + 0.5f * fabs(cosine));                              \
    const T smaller = 0.5f * fabs(sine) / larger;                                   \
    cx = cosine < 0 ? smaller : larger;                                             \
    cy = copysign(cosine < 0 ? larger : smaller, sine);                             \
  }

#define MOMENTS(r, e)                                                               \
  mx += valid##r * x##r##e;                                                         \
  my += valid##r * y##r##e;                                                         \
  sxx += valid##r * x##r##e * x##r##e;                                              \
  sxy += valid##r * x##r##e * y##r##e;                                              \
  syy += valid##r * y##r##e * y##r##e;
/* The line through the points of boundaries e and f on all rings: unit normal, distance, and the
 * mean of the points' squared distances from it. */
#define EDGE_LINE(e, f, nx, ny, distance, apart)                                    \
  {                                                                                 \
    REAL mx = 0, my = 0, sxx = 0, sxy = 0, syy = 0, cx, cy;                         \
    MOMENTS(0, e) MOMENTS(1, e) MOMENTS(2, e)                                       \
    MOMENTS(0, f) MOMENTS(1, f) MOMENTS(2, f)                                       \
    const REAL weight = CHOOSE(WHERE(valid_rings > 0), 0.5f / valid_rings, (REAL)(0.0f)); \
    mx *= weight;                                                                   \
    my *= weight;                                                                   \
    const REAL vxx = sxx * weight - mx * mx, vxy = sxy * weight - mx * my;          \
    const REAL vyy = syy * weight - my * my;                                        \
    LINE_DIRECTION(REAL, cx, cy, vxx, vxy, vyy)                                     \
    nx = -cy;                                                                       \
    ny = cx;                                                                        \
    distance = nx * mx + ny * my;                                                   \
    apart = nx * nx * vxx + 2 * nx * ny * vxy + ny * ny * vyy;                      \
  }

#if !MIDLINES

/* px: what bent edges, shading and sampling add to the noise of a position on perfect prints. */
#define LINES_ERROR 0.02f
#define STEP_ERROR 0.01f

/* EDGE_LINES: the intersection of the line through e0 and e2 and the line through e1 and e3. The
 * result, its variance per axis and, for EDGE_STEP, the unit normals and the intersection relative to the start, which
 * lies at (from_x, from_y); the centroid is kept where a guard refuses. */
#define EDGE_LINES(from_x, from_y, kept_x, kept_y)                                  \
  EDGE_ANGLES                                                                       \
  REAL n1x, n1y, h1, n2x, n2y, h2, apart1, apart2;                                  \
  EDGE_LINE(0, 2, n1x, n1y, h1, apart1)                                             \
  EDGE_LINE(1, 3, n2x, n2y, h2, apart2)                                             \
  const REAL sine = n1x * n2y - n1y * n2x;                                          \
  const REAL x = (h1 * n2y - h2 * n1y) / sine, y = (h2 * n1x - h1 * n2x) / sine;    \
  const BITS good = WHERE(MAGNITUDE(sine) > 0.17f) & WHERE(valid_rings >= 2) &      \
                    WHERE(x * x + y * y <= max_shift * max_shift);                  \
  const REAL at_x = CHOOSE(good, from_x + x, kept_x), at_y = CHOOSE(good, from_y + y, kept_y); \
  STORE_PAIRS(RESULT_POSITION, at_x, at_y)                                          \
  STORE(RESULT_METHOD, CHOOSE(good, (REAL)(METHOD_EDGE_LINES), (REAL)(METHOD_KEPT))) \
  const REAL spread = MAGNITUDE(apart1 + apart2);                                   \
  const REAL variance = LINES_ERROR * LINES_ERROR +                                 \
                        spread / (4 * (valid_rings - 1) * sine * sine);             \
  STORE(RESULT_VARIANCE, CHOOSE(good, variance, (REAL)(NAN)))

#define STORE_LINES                                                                 \
  LANE(lines, 0) = n1x;                                                             \
  LANE(lines, 1) = n1y;                                                             \
  LANE(lines, 2) = n2x;                                                             \
  LANE(lines, 3) = n2y;                                                             \
  LANE(lines, 4) = x;                                                               \
  LANE(lines, 5) = y;

#if LANES == 1

__kernel void edge_lines(__global const PIXEL *restrict image,
                         __global const float *restrict start,
                         __global const uint *restrict totals, const uint rows,
                         const uint columns, const uint step, const uint room,
                         const uint place, const uint length, const float max_shift,
#if SCALED
                         __global const float8 *restrict ring_samples,
#endif
#if EDGE_STEP
                         __global float *restrict lines,
#endif
                         __global float *restrict result) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  if (n >= totals[place + p]) return;
  const size_t row = p * room + n;
  EDGES_OF_CORNER
  RESULT_OF_FRAME(totals[place + p])
  const float kept_x = RESULT_POSITION[0], kept_y = RESULT_POSITION[1];
  EDGE_LINES((float)from_x, (float)from_y, kept_x, kept_y)
#if EDGE_STEP
  STORE_LINES
#endif
}

#endif

#else

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
  LINE_DIRECTION(float, cx, cy, sxx, sxy, syy)
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

/* The point of a parabola at u, and its tangent there. */
float2 on_parabola(const float3 fit, const Line *line, const float u, float2 *tangent) {
  *tangent = line->direction + (fit.y + 2 * fit.z * u) * line->normal;
  return line->mean + u * line->direction + (fit.x + u * (fit.y + u * fit.z)) * line->normal;
}

#endif

/* MIDLINE: the intersection of the centrelines of the black sectors e0 e1 and e2 e3. Where they
 * are nearly one line or meet too far away, CUSP: per black sector the intersection of its own
 * two edge lines, and the midpoint of the two cusps. */
__kernel void midlines(__global const PIXEL *restrict image,
                       __global const float *restrict start,
                       __global const uint *restrict totals, const uint rows,
                       const uint columns, const uint step, const uint room,
                       const uint place, const uint length, const float max_shift,
#if SCALED
                       __global const float8 *restrict ring_samples,
#endif
                       __global float *restrict result) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  if (n >= totals[place + p]) return;
  const size_t row = p * room + n;
  EDGES_OF_CORNER
  RESULT_OF_FRAME(totals[place + p])
  EDGE_ANGLES
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
    float u = dot(centre[0].direction, position - centre[0].mean);
    float v = dot(centre[1].direction, position - centre[1].mean);
    float2 a, b;
    for (int k = 0; k < 4; ++k) { /* Newton's steps */
      const float2 from = on_parabola(first, &centre[0], u, &a);
      const float2 gap = on_parabola(second, &centre[1], v, &b) - from;
      const float sine = cross_product(a, b);
      u += cross_product(gap, b) / sine;
      v += cross_product(gap, a) / sine;
    }
    position = on_parabola(first, &centre[0], u, &a);
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
  position += (float2)((float)from_x, (float)from_y);
  STORE_PAIRS(RESULT_POSITION, position.x, position.y)
  STORE(RESULT_METHOD, method)
}

#endif

#if EDGE_STEP

/* EDGE_STEP: one weighted least-squares step from EDGE_LINES' result, in the corner model
 * I = m + c P, P = f(a) f(b), f(a) = a / sqrt(1 + a a), a and b the distances from the two
 * edges in units of the blur; A and B are its slopes along a and b. */
#define BLUR 1.2f
#define LARGEST_STEP 0.3f
#define SMALL 1e-3f
#define TINY 1e-20f
#define EIGHT (float8)(0, 1, 2, 3, 4, 5, 6, 7)

typedef float8 __attribute__((aligned(4))) FLOATS_ANYWHERE;
#define LOAD_8(array, k) *(const FLOATS_ANYWHERE *)(array + (k))
#define STORE_8(array, k, v) *(FLOATS_ANYWHERE *)(array + (k)) = v

/* 1 / sqrt(v) to 1.3e-6: a first guess from the exponent and two of Newton's steps, scaled so
 * that neither halves v; their first summands halve the largest error. They cost less than a
 * root and a division. */
float8 inverse_root(const float8 v) {
  float8 q = as_float8(0x5eff1108u - (as_uint8(v) >> 1));
  q = q * (1.6214961f - v * q * q);
  return q * (1.8898832f - v * q * q);
}

/* The model where (ux, uy) from the corner: weights (1 - r2 / R2) min(1, r2 / r02) in units of
 * 1 / (R2 r02), 0 only outside, P and what its slopes are made of. */
#define CORNER_MODEL(uy_2)                                                          \
  const float8 r2 = ux * ux + (uy_2), rim = radius_2 - r2, core = r2 + TINY;        \
  const float8 w = (rim > 0 ? rim : (float8)(0.0f)) * (core < core_2 ? core : (float8)(core_2)); \
  const float8 a = a_x * ux + a_y * uy, b = b_x * ux + b_y * uy;                    \
  const float8 a2 = 1 + a * a, b2 = 1 + b * b, q = inverse_root(a2 * b2), q2 = q * q; \
  const float8 aq = a * q, bq = b * q, P = a * bq;
#define SLOPES const float8 A = bq * (b2 * q2), B = aq * (a2 * q2);

float sum_of_eight(const float8 v) {
  const float4 four = v.lo + v.hi;
  const float2 two = four.lo + four.hi;
  return two.x + two.y;
}

/* The step from the sums of the weighted products with the slopes: ra and rb with what the
 * model leaves. */
#define SOLVE_STEP                                                                  \
  const float d = saa * sbb - sab * sab;                                            \
  const float ha = -(sbb * ra - sab * rb) * BLUR / (d * c);                         \
  const float hb = -(saa * rb - sab * ra) * BLUR / (d * c);                         \
  const float sine = n1x * n2y - n1y * n2x;                                         \
  const float tx = (ha * n2y - hb * n1y) / sine, ty = (hb * n1x - ha * n2x) / sine; \
  const float to_x = x + tx, to_y = y + ty;                                         \
  const float largest = LARGEST_STEP / scale, farthest = 2 / scale;                 \
  const int sound = c * c > SMALL * SMALL && d > SMALL * saa * sbb &&               \
                    spread > SMALL * s1 * spp &&                                    \
                    tx * tx + ty * ty <= largest * largest &&                       \
                    to_x * to_x + to_y * to_y <= farthest * farthest;

/* The result; `products` sum the rest's pairs of neighbours, `weights` their weights. */
#define STORE_STEP                                                                  \
  RESULT_POSITION[0] = (float)from_x + to_x;                                        \
  RESULT_POSITION[1] = (float)from_y + to_y;                                        \
  *RESULT_METHOD = METHOD_EDGE_STEP;                                                \
  const float trace = BLUR * BLUR * (saa + sbb + 2 * sab * (n1x * n2x + n1y * n2y)) * \
                      radius_2 * core_2 / (d * sine * sine);                        \
  const float residual = fmax(sii - m * si - c * spi, 0.0f) / (s1 * c * c);         \
  *RESULT_VARIANCE = STEP_ERROR * STEP_ERROR + 0.25f * trace * residual;            \
  *RESULT_CORRELATION = sum_of_eight(products) / (c * c * sum_of_eight(weights));

#define REST(I, P) (I - m - c * P)

#if LANES == 1

/* One work-item per corner, eight pixels of a row at a time. */
#define MOST_EIGHTS 57 /* 19 rows of 24 pixels hold a radius of 9 */

/* Greys of eight pixels from (i, j) of the start on, the border repeated. */
#define GREY_NEAR(i, j) \
  (float)image[CLAMPED_ROW(from_y + (j)) + (size_t)clamp(from_x + (i), 0, (int)columns - 1)]
#if SCALED
#define EIGHT_GREYS(i, j)                                                           \
  (float8)(GREY_NEAR(i, j), GREY_NEAR(i + 1, j), GREY_NEAR(i + 2, j), GREY_NEAR(i + 3, j), \
           GREY_NEAR(i + 4, j), GREY_NEAR(i + 5, j), GREY_NEAR(i + 6, j), GREY_NEAR(i + 7, j))
#else /* the pads repeat the border */
#define EIGHT_GREYS(i, j) \
  EIGHT_OF(float8, image + CLAMPED_ROW(from_y + (j)) + (size_t)(from_x + (i)))
#endif

/* Row j of the disc: from the middle on, as many times eight pixels as hold its chord. */
#define DISC_ROW(j)                                                                 \
  const float uy = (float)(j) - y, uy_2 = uy * uy;                                  \
  int eights = 1;                                                                   \
  while ((float)(16 * eights * eights) < radius_2 - uy_2) ++eights;                 \
  const int left = (int)floor(x) + 1 - 4 * eights, right = left + 8 * eights;

__kernel void edge_step(__global const PIXEL *restrict image,
                        __global const float *restrict start,
                        __global const float *restrict lines,
                        __global const uint *restrict totals, const uint rows,
                        const uint columns, const uint step, const uint room,
                        const uint place, const uint length, const float radius,
                        const float scale, __global float *restrict result) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  if (n >= totals[place + p]) return;
  const size_t row = p * room + n;
  RESULT_OF_FRAME(totals[place + p])
  if (*RESULT_METHOD != METHOD_EDGE_LINES) return;
  const int from_x = (int)COLUMN_OF(start, 0), from_y = (int)COLUMN_OF(start, 1);
  const float n1x = COLUMN_OF(lines, 0), n1y = COLUMN_OF(lines, 1);
  const float n2x = COLUMN_OF(lines, 2), n2y = COLUMN_OF(lines, 3);
  const float x = COLUMN_OF(lines, 4), y = COLUMN_OF(lines, 5);
  const float core_radius = fmin(4.0f, radius / 2), radius_2 = radius * radius;
  const float core_2 = core_radius * core_radius;
  const float a_x = n1x / BLUR, a_y = n1y / BLUR, b_x = n2x / BLUR, b_y = n2y / BLUR;
  const int top = (int)ceil(y - radius), bottom = (int)floor(y + radius);
  const float centre = GREY_NEAR(0, 0);

#if !SCALED
  float weight_of[8 * MOST_EIGHTS + 1], model_of[8 * MOST_EIGHTS + 1];
  float grey_of[8 * MOST_EIGHTS + 1];
  int k = 0;
#endif
  float8 v1 = 0, vp = 0, vpp = 0, vi = 0, vpi = 0, vii = 0, va = 0, vb = 0;
  float8 vaa = 0, vab = 0, vbb = 0, vap = 0, vbp = 0, vai = 0, vbi = 0;
  for (int j = top; j <= bottom; ++j) {
    DISC_ROW(j)
    for (int i = left; i < right; i += 8) {
      const float8 ux = (float)i - x + EIGHT;
      CORNER_MODEL(uy_2)
      SLOPES
      const float8 I = EIGHT_GREYS(i, j) - centre;
      const float8 wP = w * P, wA = w * A, wB = w * B, wI = w * I;
      v1 += w;
      vp += wP;
      vpp += wP * P;
      vi += wI;
      vpi += wP * I;
      vii += wI * I;
      va += wA;
      vb += wB;
      vaa += wA * A;
      vab += wA * B;
      vbb += wB * B;
      vap += wA * P;
      vbp += wB * P;
      vai += wA * I;
      vbi += wB * I;
#if !SCALED
      STORE_8(weight_of, k, r2 + 2 * ux + 1 < radius_2 ? w : (float8)(0.0f));
      STORE_8(model_of, k, P);
      STORE_8(grey_of, k, I);
      k += 8;
#endif
    }
  }
  const float s1 = sum_of_eight(v1), sp = sum_of_eight(vp), spp = sum_of_eight(vpp);
  const float si = sum_of_eight(vi), spi = sum_of_eight(vpi), sii = sum_of_eight(vii);
  const float sa = sum_of_eight(va), sb = sum_of_eight(vb), saa = sum_of_eight(vaa);
  const float sab = sum_of_eight(vab), sbb = sum_of_eight(vbb), sap = sum_of_eight(vap);
  const float sbp = sum_of_eight(vbp), sai = sum_of_eight(vai), sbi = sum_of_eight(vbi);

  const float spread = s1 * spp - sp * sp;
  const float c = (s1 * spi - sp * si) / spread, m = (si - c * sp) / s1;
  const float ra = sai - m * sa - c * sap, rb = sbi - m * sb - c * sbp;
  SOLVE_STEP
  if (!sound) return;

  /* Autocorrelation of what the model leaves, between each pixel and the next of its row. */
  float8 products = 0, weights = 0;
#if SCALED
  for (int j = top; j <= bottom; ++j) {
    DISC_ROW(j)
    float last = 0, last_weight = 0;
    for (int i = left; i < right; i += 8) {
      const float8 ux = (float)i - x + EIGHT;
      CORNER_MODEL(uy_2)
      const float8 r = REST((EIGHT_GREYS(i, j) - centre), P);
      const float8 before = (float8)(last, r.s0123, r.s456);
      const float8 weight = (float8)(last_weight, w.s0123, w.s456);
      const float8 both = r2 < radius_2 ? weight : (float8)(0.0f);
      products += both * before * r;
      weights += both;
      last = r.s7;
      last_weight = w.s7;
    }
  }
#else
  weight_of[k] = model_of[k] = grey_of[k] = 0;
  for (int n = 0; n < k; n += 8) {
    const float8 w = LOAD_8(weight_of, n);
    const float8 r = REST(LOAD_8(grey_of, n), LOAD_8(model_of, n));
    const float8 next = REST(LOAD_8(grey_of, n + 1), LOAD_8(model_of, n + 1));
    products += w * r * next;
    weights += w;
  }
#endif
  STORE_STEP
}

#endif

#endif

#endif
