#include "cpu/vectors.clh"
#include "edges.clh"

/* EDGE_LINES for CPUs, eight corners at a time: a vector holds one number of each. Lanes past
 * the last corner hold leftovers of an earlier frame; their rows are not read. */

#if LANES != 8
#error "LANES must be 8"
#endif

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

float8 pixels_at(__global const PIXEL *frame, const int8 at) {
#define PIXEL_AT(lane) (float)frame[at.s##lane]
  return (float8)EACH(PIXEL_AT);
}

/* The grey levels of a sample around eight starts. */
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
  (inside ? greys_inside(sample, frame, step, at)                              \
          : greys_of(sample, frame, rows, columns, step, from_x, from_y))

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

/* The work-items take turns, eight corners at a time. */
__kernel void refine_eight(__global const PIXEL *restrict image,
                           __global const int *restrict corners,
                           __global const uint *restrict counts, const uint rows,
                           const uint columns, const uint step, const uint capacity,
                           const uint count_offset, const uint length, const float max_shift,
#if SCALED
                           const float scale, const uint reach,
                           __global const float8 *restrict ring_samples,
#endif
#if EDGE_STEP
                           __global float *restrict start, __global float *restrict lines,
#endif
                           __global float *restrict result) {
  const size_t p = get_global_id(1);
  const uint total = SMALLER(counts[count_offset + p], capacity);
  RESULT_OF_FRAME(counts[count_offset + p])
  if (get_global_id(0) == 0) write_head(own, counts, count_offset, p);
#if SCALED
  const uint full_rows = rows, full_columns = columns;
#endif
  for (uint n = get_global_id(0) * LANES; n < total; n += get_global_size(0) * LANES) {
    const size_t row = p * capacity + n;
    START
#if SCALED
    const int8 outside = (from_x < (int)reach) | (from_x + (int)reach >= (int)full_columns) |
                         (from_y < (int)reach) | (from_y + (int)reach >= (int)full_rows);
    const int4 any = outside.lo | outside.hi;
    const int inside = !(any.x | any.y | any.z | any.w);
    __global const PIXEL *frame = image + ROW(p, 0) + PAD;
    const uint8 at = as_uint8(from_y) * step + as_uint8(from_x);
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
    LANE(start, 0) = start_x;
    LANE(start, 1) = start_y;
    STORE_LINES
#endif
  }
}
