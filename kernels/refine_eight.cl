/* Centroids, edge points and EDGE_LINES of refine.cl in one kernel for CPUs, eight corners at a
 * time: a vector holds one number of each. Lanes past the last corner repeat it, in rows that
 * nobody reads. */

#if LANES != 8
#error "LANES must be 8"
#endif

#define EACH(F) (F(0), F(1), F(2), F(3), F(4), F(5), F(6), F(7))
#define OF_LANE(v, lane) ((int *)&(v))[lane]

float8 floats_of(const int8 v) {
  return (float8)(v.s0, v.s1, v.s2, v.s3, v.s4, v.s5, v.s6, v.s7);
}

int8 ints_of(const float8 v) {
  return (int8)((int)v.s0, (int)v.s1, (int)v.s2, (int)v.s3, (int)v.s4, (int)v.s5, (int)v.s6,
                (int)v.s7);
}

/* Sixteen pixels of a row, from any one on, and the same memory as pairs and as fours. */
#if PIXEL_BITS == 8
typedef uchar16 PIXELS;
#define AS_PAIRS(v) as_ushort8(v)
#define AS_FOURS(v) as_uint4(v)
#define PAIRS ushort8
#define FOURS uint4
#else
typedef ushort16 PIXELS;
#define AS_PAIRS(v) as_uint8(v)
#define AS_FOURS(v) as_ulong4(v)
#define PAIRS uint8
#define FOURS ulong4
#endif
typedef PIXELS __attribute__((aligned(PIXEL_BITS / 8))) PIXELS_ANYWHERE;

#if !SCALED

/* Eight rows of sixteen pixels to the first twelve columns of eight, two in a vector: rows are
 * merged by pixels, then by pairs, then by fours. */
#define MERGE_PIXELS(a, b)                                                          \
  AS_PAIRS((PIXELS)(a.s0, b.s0, a.s1, b.s1, a.s2, b.s2, a.s3, b.s3, a.s4, b.s4, a.s5, b.s5, \
                    a.s6, b.s6, a.s7, b.s7)),                                       \
      AS_PAIRS((PIXELS)(a.s8, b.s8, a.s9, b.s9, a.sa, b.sa, a.sb, b.sb, a.sc, b.sc, a.sd, b.sd, \
                        a.se, b.se, a.sf, b.sf))
#define MERGE_PAIRS(a, b)                                                           \
  AS_FOURS((PAIRS)(a.s0, b.s0, a.s1, b.s1, a.s2, b.s2, a.s3, b.s3)),                \
      AS_FOURS((PAIRS)(a.s4, b.s4, a.s5, b.s5, a.s6, b.s6, a.s7, b.s7))
void columns_of(const PIXELS *row, FOURS *column) {
  const PAIRS a[] = {MERGE_PIXELS(row[0], row[1])}, b[] = {MERGE_PIXELS(row[2], row[3])};
  const PAIRS c[] = {MERGE_PIXELS(row[4], row[5])}, d[] = {MERGE_PIXELS(row[6], row[7])};
  const FOURS upper[] = {MERGE_PAIRS(a[0], b[0]), MERGE_PAIRS(a[1], b[1])};
  const FOURS lower[] = {MERGE_PAIRS(c[0], d[0]), MERGE_PAIRS(c[1], d[1])};
  column[0] = (FOURS)(upper[0].s0, lower[0].s0, upper[0].s1, lower[0].s1);
  column[1] = (FOURS)(upper[0].s2, lower[0].s2, upper[0].s3, lower[0].s3);
  column[2] = (FOURS)(upper[1].s0, lower[1].s0, upper[1].s1, lower[1].s1);
  column[3] = (FOURS)(upper[1].s2, lower[1].s2, upper[1].s3, lower[1].s3);
  column[4] = (FOURS)(upper[2].s0, lower[2].s0, upper[2].s1, lower[2].s1);
  column[5] = (FOURS)(upper[2].s2, lower[2].s2, upper[2].s3, lower[2].s3);
}

#define EDGE_GREY(k, dx, dy) EIGHT_OF(float8, window + (((dy) + 5) * 12 + (dx) + 5) * LANES)

#else

/* Two neighbouring pixels. */
#if PIXEL_BITS == 8
typedef ushort PAIR;
#else
typedef uint PAIR;
#endif
#define PIXEL_MASK ((1u << PIXEL_BITS) - 1)
typedef PAIR __attribute__((aligned(PIXEL_BITS / 8))) PAIR_ANYWHERE;

#define INSIDE(v, count) SMALLER(LARGER(v, (int8)(0)), (int8)((int)(count) - 1))

float8 pixels_at(__global const PIXEL *frame, const int8 at) {
#define PIXEL_AT(lane) (float)frame[at.s##lane]
  return (float8)EACH(PIXEL_AT);
}

/* The greys of a sample around eight starts. */
float8 greys_of(const float8 sample, __global const PIXEL *frame, const uint rows,
                const uint columns, const uint step, const int8 from_x, const int8 from_y) {
  const int8 left = from_x + (int)sample.s4, top = from_y + (int)sample.s5;
  const int8 x0 = INSIDE(left, columns), x1 = INSIDE(left + 1, columns);
  const int8 upper = INSIDE(top, rows) * (int)step, lower = INSIDE(top + 1, rows) * (int)step;
  const float8 a0 = pixels_at(frame, upper + x0), a1 = pixels_at(frame, upper + x1);
  const float8 b0 = pixels_at(frame, lower + x0), b1 = pixels_at(frame, lower + x1);
  return BETWEEN(sample, a0, a1, b0, b1);
}

/* The same where no sample lies outside the image. */
float8 greys_inside(const float8 sample, __global const PIXEL *frame, const uint step,
                    const uint8 at) {
  __global const PIXEL *first = frame + (int)sample.s5 * (int)step + (int)sample.s4;
  __global const PIXEL *second = first + step;
#define UPPER(lane) *(__global const PAIR_ANYWHERE *)(first + at.s##lane)
#define LOWER(lane) *(__global const PAIR_ANYWHERE *)(second + at.s##lane)
  const uint8 upper = (uint8)EACH(UPPER), lower = (uint8)EACH(LOWER);
  const float8 a0 = floats_of(as_int8(upper & PIXEL_MASK));
  const float8 a1 = floats_of(as_int8(upper >> PIXEL_BITS));
  const float8 b0 = floats_of(as_int8(lower & PIXEL_MASK));
  const float8 b1 = floats_of(as_int8(lower >> PIXEL_BITS));
  return BETWEEN(sample, a0, a1, b0, b1);
}

#define RING_GREY(sample)                                                           \
  (inside ? greys_inside(sample, frame, full_step, at)                              \
          : greys_of(sample, frame, full_rows, full_columns, full_step, from_x, from_y))

#endif

/* The edge point after the sample whose bit is set. */
void edge_point(const float8 *d, RING_TABLE *ring, const uint8 bit, float8 *x, float8 *y) {
  /* The exponent. */
  const uint8 number = (as_uint8(floats_of(as_int8(bit))) >> 23 & 255) - 127;
#define HERE(lane) ((const float *)(d + number.s##lane))[lane]
#define NEXT(lane) ((const float *)(d + number.s##lane + 1))[lane]
  const float8 f = crossing((float8)EACH(HERE), (float8)EACH(NEXT));
#if SCALED
#define X_OF(lane) ring[number.s##lane].s0
#define Y_OF(lane) ring[number.s##lane].s1
#define BY_X_OF(lane) ring[number.s##lane].s2
#define BY_Y_OF(lane) ring[number.s##lane].s3
  *x = (float8)EACH(X_OF) + f * (float8)EACH(BY_X_OF);
  *y = (float8)EACH(Y_OF) + f * (float8)EACH(BY_Y_OF);
#else
#define WAY_OF(lane) as_uint(ring[number.s##lane])
  const uint8 ways = (uint8)EACH(WAY_OF);
  const int8 to_x = as_int8(ways << 24) >> 24, to_y = as_int8(ways << 16) >> 24;
  const int8 by_x = as_int8(ways << 8) >> 24, by_y = as_int8(ways) >> 24;
  *x = floats_of(to_x) + f * floats_of(by_x);
  *y = floats_of(to_y) + f * floats_of(by_y);
#endif
}

/* Responses in row dy around a maximum, from two columns before it on; 0 outside the image. */
#define RESPONSES(dy)                                                               \
  (pixel.y + (dy) >= 0 && pixel.y + (dy) < (int)rows                                \
       ? EIGHT_OF(int8, response + ROW(p, pixel.y + (dy)) + PAD + pixel.x - 2)      \
       : (int8)(0))

/* The maxima of a frame in (y, x) order: of the words of bits the one that is looked at, and what
 * is left of it. */
typedef struct {
  __global const uint *words;
  uint word, left;
} Maxima;

/* From maximum n on. */
Maxima maxima_from(uint n, __global const uint *words, __global const uint *row_counts,
                   const uint width) {
  uint row = 0;
  for (; n >= row_counts[row]; ++row) n -= row_counts[row];
  Maxima maxima = {words, row * width, words[row * width]};
  for (uint bits; n >= (bits = bits_set(maxima.left)); n -= bits)
    maxima.left = words[++maxima.word];
  for (; n > 0; --n) maxima.left &= maxima.left - 1;
  return maxima;
}

int2 next_maximum(Maxima *maxima, const uint width) {
  while (maxima->left == 0) maxima->left = maxima->words[++maxima->word];
  const uint x = maxima->word % width * 32 + lowest_bit(maxima->left);
  maxima->left &= maxima->left - 1;
  return (int2)((int)x - PAD, (int)(maxima->word / width));
}

/* A work-item takes its share of the corners, eight at a time. */
__kernel void refine_eight(__global const RESPONSE *restrict response,
                           __global const PIXEL *restrict image,
                           __global const uint *restrict all_maxima,
                           __global const uint *restrict row_counts,
                           __global uint *restrict totals, const uint rows,
                           const uint step, const uint room, const uint place,
                           const uint length, const float max_shift,
#if SCALED
                           const float scale, const uint full_rows, const uint full_columns,
                           const uint full_step, const uint reach,
                           __global const float8 *restrict ring_samples,
#endif
#if EDGE_STEP
                           __global float *restrict start, __global float *restrict lines,
#endif
                           __global float *restrict result) {
  const size_t p = get_global_id(1);
  __global const uint *counts = row_counts + p * rows;
  const uint width = step / 32;
  uint total = 0;
  for (uint y = 0; y < rows; ++y) total += counts[y];
  RESULT_OF_FRAME(total)
  if (get_global_id(0) == 0) {
    totals[place + p] = total;
    write_head(own, totals, place, p);
  }
  const uint shares = get_global_size(0), eights = (places / LANES + shares - 1) / shares;
  const uint first = get_global_id(0) * eights * LANES;
  const uint end = SMALLER(SMALLER(total, room), first + eights * LANES);
  if (first >= end) return;
  Maxima maxima = maxima_from(first, all_maxima + p * rows * width, counts, width);
  for (uint n = first; n < end; n += LANES) {
    int8 pixel_x, pixel_y, height, sum, sum_x, sum_y;
    int2 pixel;
    for (uint lane = 0; lane < LANES; ++lane) {
      if (n + lane < end) pixel = next_maximum(&maxima, width);
      const int8 above_2 = RESPONSES(-2), above = RESPONSES(-1), middle = RESPONSES(0);
      const int8 below = RESPONSES(1), below_2 = RESPONSES(2);
      const int8 columns = above_2 + above + middle + below + below_2;
      const int8 slopes = 2 * (below_2 - above_2) + below - above;
      OF_LANE(pixel_x, lane) = pixel.x;
      OF_LANE(pixel_y, lane) = pixel.y;
      OF_LANE(height, lane) = middle.s2;
      OF_LANE(sum, lane) = columns.s0 + columns.s1 + columns.s2 + columns.s3 + columns.s4;
      OF_LANE(sum_x, lane) = 2 * (columns.s4 - columns.s0) + columns.s3 - columns.s1;
      OF_LANE(sum_y, lane) = slopes.s0 + slopes.s1 + slopes.s2 + slopes.s3 + slopes.s4;
    }
    const REAL total_response = floats_of(sum);
    const REAL offset_x = floats_of(sum_x) / total_response;
    const REAL offset_y = floats_of(sum_y) / total_response;
#if SCALED
    const REAL centroid_x = (floats_of(pixel_x) + offset_x + 0.5f) / scale - 0.5f;
    const REAL centroid_y = (floats_of(pixel_y) + offset_y + 0.5f) / scale - 0.5f;
    const int8 from_x = INSIDE(ints_of(centroid_x + 0.5f), full_columns);
    const int8 from_y = INSIDE(ints_of(centroid_y + 0.5f), full_rows);
#else
    const REAL centroid_x = floats_of(pixel_x) + offset_x;
    const REAL centroid_y = floats_of(pixel_y) + offset_y;
    const int8 from_x = pixel_x + as_int8(NEAREST(sum_x));
    const int8 from_y = pixel_y + as_int8(NEAREST(sum_y));
#endif
    STORE(RESULT_RESPONSE, floats_of(height))
    STORE_PAIRS(RESULT_PIXEL, AS_REAL(pixel_x), AS_REAL(pixel_y))
    STORE(RESULT_VARIANCE, (REAL)(NAN))

#if SCALED
    const int8 outside = (from_x < (int)reach) | (from_x + (int)reach >= (int)full_columns) |
                         (from_y < (int)reach) | (from_y + (int)reach >= (int)full_rows);
    const int4 any = outside.lo | outside.hi;
    const int inside = !(any.x | any.y | any.z | any.w);
    __global const PIXEL *frame = image + ((size_t)p * full_rows + 1) * full_step + PAD;
    const uint8 at = as_uint8(from_y) * full_step + as_uint8(from_x);
#else
    FOURS pixels[11 * 6]; /* 11 rows of 12 columns of eight corners */
    const PIXEL *window = (const PIXEL *)pixels;
    __global const PIXEL *frame = image + ROW(p, 0) + PAD - 5;
    for (int dy = -5; dy <= 5; ++dy) {
      const int8 y = SMALLER(LARGER(from_y + dy, (int8)(0)), (int8)((int)rows - 1));
      const uint8 at = as_uint8(y) * step + as_uint8(from_x);
#define SIXTEEN(k) *(__global const PIXELS_ANYWHERE *)(frame + at.s##k)
      const PIXELS lines[] = {SIXTEEN(0), SIXTEEN(1), SIXTEEN(2), SIXTEEN(3),
                              SIXTEEN(4), SIXTEEN(5), SIXTEEN(6), SIXTEEN(7)};
      columns_of(lines, pixels + (dy + 5) * 6);
    }
#endif
    EDGE_RINGS
    MATCH_RINGS
    const REAL start_x = floats_of(from_x), start_y = floats_of(from_y);
    EDGE_LINES(start_x, start_y, centroid_x, centroid_y)
#if EDGE_STEP
    const size_t row = p * room + n;
    LANE(start, 0) = start_x;
    LANE(start, 1) = start_y;
    STORE_LINES
#endif
  }
}
