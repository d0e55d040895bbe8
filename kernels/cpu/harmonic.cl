#include "decide.clh"
#include "pixel.clh"
#include "cpu/halve.clh"

/* From an image to the lists of its maxima, for CPUs: one launch takes bands of rows from the image
 * to the maxima of both responses in all octaves, and the last band of a frame to finish decides
 * for it, because a launch of its own costs as much as half of the decision. kernels/harmonic.clh
 * has the rule.
 *
 * A band goes over its rows once; every step keeps a ring buffer of as many rows as the later
 * steps need, and all of them stay in the cache. Two bands share the rows between them: one goes
 * down from the first row, the other goes up from the last, and they take a few rows at a time
 * until none is left. So both end together, even if one of them starts late or runs on a slower
 * core. The small octaves come first, so that the frame evens out what they leave. Each loop over a
 * row is a function of its own with restrict pointers and one cast per operation: compilers turn it
 * into vectors of 16-bit numbers. */

#define REACH_OF_RING 5
#define REACH_OF_WIDE 8
#define LAG (REACH_OF_RING + 3) /* from an image row to the response that it completes */
/* Rows of suppression, and of the moments. */
#define BESIDE_MAXIMUM LARGER(NMS_RADIUS, 3)
#define BEYOND (LAG + BESIDE_MAXIMUM)
#define ROWS_AT_A_TIME 8 /* that a band takes */
#define ROWS_AHEAD 8 /* from the row that it reads to that which it calls into the cache */

/* Ring buffers: powers of two. A smoothed row serves from the response REACH_OF_RING rows above
 * until check 1 of a maximum REACH_OF_RING rows below; of S3, until the wide ring. */
#define SMOOTH_ROWS (NMS_RADIUS <= 4 ? 16 : 32)
#define COARSE_ROWS 32
#define RESPONSE_ROWS (NMS_RADIUS <= 3 ? 8 : NMS_RADIUS <= 7 ? 16 : 32)
#define SMOOTH_AT(y) ((size_t)((y) & (SMOOTH_ROWS - 1)) * step + PAD)
#define COARSE_AT(y) ((size_t)((y) & (COARSE_ROWS - 1)) * step + PAD)
#define RESPONSE_AT(y) ((size_t)((y) & (RESPONSE_ROWS - 1)) * step + PAD)
#define LEVEL_AT(y) ((size_t)((y) & 3) * step + PAD)
#define HELD(y) SMALLER(LARGER(y, 0), height - 1)

/* These functions are not inlined, because in inlined functions compilers forget that restrict
 * pointers do not overlap. Neighbours in a row have separate pointers, because two loads of one
 * pointer become a chain from pixel to pixel. */
#define ROW_LOOP __attribute__((noinline))

/* Call a row of a frame into the cache, lines of 64 bytes at a time. OpenCL's own function for this
 * does nothing on PoCL, and a compiler to SPIR has no other. */
void call_row(__global const PIXEL *row, const int width) {
#ifdef __SPIR__
  prefetch(row, width);
#else
  for (int x = 0; x < width; x += 64 / (int)sizeof(PIXEL))
    __builtin_prefetch((const void *)(size_t)(row + x));
#endif
}

/* Grey levels in sixteenths of 1/255 of full scale: floor((4080 g + F div 2) / F). */
ROW_LOOP void scale_levels(__global const PIXEL *restrict grey, __global ushort *restrict level,
                  const uint full_scale, const float inverse, const int width) {
  for (int x = 0; x < width; ++x) {
    const uint g = grey[x] < full_scale ? grey[x] : full_scale;
    const uint scaled = g * 4080 + full_scale / 2;
    const uint quotient = (uint)(int)((float)(int)scaled * inverse); /* off by one at most */
    const int remainder = (int)(scaled - quotient * full_scale);
    level[x] = (ushort)(quotient + (remainder >= (int)full_scale) - (remainder < 0));
  }
}

ROW_LOOP void pixels_of_row(__global const ushort *restrict from, __global PIXEL *restrict to,
                            const int width) {
  for (int x = 0; x < width; ++x) to[x] = AS_PIXEL(from[x]);
}

/* [1 2 1] down the columns. */
#define DOWN_COLUMNS(T)                                                             \
  (__global const T *restrict above, __global const T *restrict middle,             \
   __global const T *restrict below, __global ushort *restrict column, const int width) { \
    for (int x = 0; x < width; ++x)                                                 \
      column[x] = (ushort)((ushort)(above[x] + below[x]) + (ushort)(middle[x] << 1)); \
    column[-1] = column[0];                                                         \
    column[width] = column[width - 1];                                              \
  }
ROW_LOOP void column_of_greys DOWN_COLUMNS(PIXEL)
ROW_LOOP void column_of_levels DOWN_COLUMNS(ushort)

/* [1 2 1] along a row, and the repeated border of the result. */
#define ALONG_ROW(SCALED_DOWN)                                                      \
  (__global const ushort *restrict left, __global const ushort *restrict column,    \
   __global const ushort *restrict right, __global ushort *restrict smooth, const int width) { \
    for (int x = 0; x < width; ++x)                                                 \
      smooth[x] = SCALED_DOWN((ushort)(left[x] + right[x]) + (ushort)(column[x] << 1)); \
    for (int k = 1; k <= REACH_OF_WIDE; ++k) {                                      \
      smooth[-k] = smooth[0];                                                       \
      smooth[width - 1 + k] = smooth[width - 1];                                    \
    }                                                                               \
  }
#define AS_IT_IS(v) (ushort)(v)
#define BY_16(v) (ushort)((ushort)((ushort)(v) + 8) >> 4)
ROW_LOOP void smooth_row ALONG_ROW(AS_IT_IS)
ROW_LOOP void smooth_row_by_16 ALONG_ROW(BY_16)
#define NEIGHBOURS(row) (row) - 1, row, (row) + 1

/* [1 -2 1] down the columns. */
ROW_LOOP void curvature_of_row(__global const PIXEL *restrict above,
                               __global const PIXEL *restrict middle,
                               __global const PIXEL *restrict below,
                               __global CURVATURE *restrict curvature, const int width) {
  for (int x = 0; x < width; ++x)
    curvature[x] = (CURVATURE)((CURVATURE)(above[x] + below[x]) - (CURVATURE)(middle[x] << 1));
}

/* Add |[1 -2 1]| of it along a row to a sum for each column. A sum has room for NOISE_ROWS rows. */
#define NOISE_ROWS 32
ROW_LOOP void add_noise(__global const CURVATURE *restrict left,
                        __global const CURVATURE *restrict middle,
                        __global const CURVATURE *restrict right,
                        __global NOISE *restrict noise, const int width) {
  for (int x = 0; x < width; ++x) {
    const CURVATURE sides = (CURVATURE)(left[x] + right[x]);
    const CURVATURE both = (CURVATURE)(sides - (CURVATURE)(middle[x] << 1));
    noise[x] += (NOISE)(both < 0 ? -both : both);
  }
}

/* The sum of the inner columns. All are emptied. */
ROW_LOOP ulong take_noise(__global NOISE *restrict noise, const int width) {
  ROW_NOISE sum = 0;
  for (int x = 1; x < width - 1; ++x) sum += noise[x];
  for (int x = 0; x < width; ++x) noise[x] = 0;
  return sum;
}

#define ABS(v) (short)((v) < 0 ? -(v) : (v))
#define QUARTER(v) (short)((v) >> 2)
#define EIGHTH(v) (short)((v) >> 3)

/* The response of ring (axial, diagonal) along a row. */
#define RESPONSE_OF_ROW(PENALTY)                                                    \
  (__global const ushort *restrict north, __global const ushort *restrict upper,    \
   __global const ushort *restrict middle, __global const ushort *restrict lower,   \
   __global const ushort *restrict south, const int axial, const int diagonal,      \
   __global short *restrict response, const int width) {                            \
    for (int x = 0; x < width; ++x) {                                               \
      const short s0 = (short)north[x], s1 = (short)upper[x + diagonal];            \
      const short s2 = (short)middle[x + axial], s3 = (short)lower[x + diagonal];   \
      const short s4 = (short)south[x], s5 = (short)lower[x - diagonal];            \
      const short s6 = (short)middle[x - axial], s7 = (short)upper[x - diagonal];   \
      const short u0 = (short)(s0 + s4), u1 = (short)(s1 + s5);                     \
      const short u2 = (short)(s2 + s6), u3 = (short)(s3 + s7);                     \
      const short p = (short)(u0 - u2), q = (short)(u1 - u3);                       \
      const short a = ABS(p), b = ABS(q);                                           \
      const short low = a < b ? a : b, high = a < b ? b : a;                        \
      const short length = (short)(high + (short)(QUARTER(low) + EIGHTH(low)));     \
      const short d0 = (short)(s0 - s4), d1 = (short)(s1 - s5);                     \
      const short d2 = (short)(s2 - s6), d3 = (short)(s3 - s7);                     \
      const short o = (short)((short)(ABS(d0) + ABS(d1)) + (short)(ABS(d2) + ABS(d3))); \
      const short sum = (short)((short)(u0 + u2) + (short)(u1 + u3));               \
      const short c = (short)(sum - (short)(middle[x] << 3));                       \
      const short e = ABS(c);                                                       \
      response[x] = (short)(length - (short)(PENALTY));                             \
    }                                                                               \
    for (int k = 1; k <= BESIDE_MAXIMUM; ++k) /* none outside the image */   \
      response[-k] = response[width - 1 + k] = 0;                                   \
  }
ROW_LOOP void coarse_response_of_row RESPONSE_OF_ROW((short)(o - QUARTER(o)) +
                                            (short)(QUARTER(e) + EIGHTH(e)))
ROW_LOOP void fine_response_of_row RESPONSE_OF_ROW((short)(o + e) - QUARTER((short)(o + e)))

/* Sixteen responses, beginning at any element of a row. */
typedef short16 __attribute__((aligned(2))) SIXTEEN_ANYWHERE;
#define SIXTEEN_AT(p) *(__global const SIXTEEN_ANYWHERE *)(p)

/* A bit for each of sixteen columns at which the response of a row exceeds those above and to the
 * left, and is not less than those to the right and below. */
#define BIT_OF_LANE                                                                 \
  (short16)(1 << 0, 1 << 1, 1 << 2, 1 << 3, 1 << 4, 1 << 5, 1 << 6, 1 << 7, 1 << 8, 1 << 9, \
            1 << 10, 1 << 11, 1 << 12, 1 << 13, 1 << 14, (short)(1 << 15))
short16 peaks_at(__global const short *above, __global const short *response,
                 __global const short *below) {
  const short16 up = SIXTEEN_AT(above), left = SIXTEEN_AT(response - 1);
  const short16 right = SIXTEEN_AT(response + 1), down = SIXTEEN_AT(below);
  const short16 r = SIXTEEN_AT(response);
  const short16 before = up > left ? up : left, behind = down > right ? down : right;
  return (r > before) & (r >= behind) & (r > (short16)(LEAST)) & BIT_OF_LANE;
}

/* The bits of all lanes in one number. */
uint bits_of(const short16 v) {
  const ulong2 two = as_ulong2(v.lo | v.hi);
  const ulong four = two.x | two.y, pair = four | four >> 32;
  return (uint)(pair | pair >> 16) & 0xffff;
}

int any_of(const short8 v) {
  const ulong2 two = as_ulong2(v);
  return (two.x | two.y) != 0;
}

/* List the columns of the peaks of a row. Return how many there are. Only these few pixels are
 * then compared with their whole window. */
ROW_LOOP int peaks_of_row(__global const short *restrict above,
                          __global const short *restrict response,
                          __global const short *restrict below,
                          __global ushort *restrict places, const int width) {
  int count = 0;
  for (int first = 0; first < width; first += 32) {
    const int next = first + 16;
    const short16 r = SIXTEEN_AT(response + first), s = SIXTEEN_AT(response + next);
    const short16 large = (r > s ? r : s) > (short16)(LEAST);
    if (!any_of(large.lo | large.hi)) continue; /* most of an image has no response */
    const short16 left = peaks_at(above + first, response + first, below + first);
    const short16 right = peaks_at(above + next, response + next, below + next);
    const short16 both = left | right;
    if (!any_of(both.lo | both.hi)) continue;
    uint word = bits_of(left) | bits_of(right) << 16;
    if (first + 32 > width) word &= (1u << (width - first)) - 1;
    for (; word; word &= word - 1) places[count++] = (ushort)(first + (int)lowest_bit(word));
  }
  return count;
}

/* Eight responses, beginning at any element of a row. */
typedef short8 __attribute__((aligned(2))) SHORTS_ANYWHERE;
#define EIGHT_AT(p) *(__global const SHORTS_ANYWHERE *)(p)

/* True if a response is the largest of its window; of equal ones, the earlier. It compares eight
 * columns of the window at a time. row[dy] is a row of the window; those outside the image hold
 * 0. */
int is_maximum(__global const short *const *row, const int x, const short r) {
  const short8 lane = (short8)(0, 1, 2, 3, 4, 5, 6, 7);
  short8 larger = 0;
  for (short d = -NMS_RADIUS; d <= NMS_RADIUS; d += 8) {
    const short8 at = lane + d;
    short8 some = EIGHT_AT(row[0] + x + d) - (at < (short8)0) > r;
    for (int line = 1; line <= NMS_RADIUS; ++line)
      some |= (EIGHT_AT(row[-line] + x + d) >= r) | (EIGHT_AT(row[line] + x + d) > r);
    larger |= some & (at <= (short8)NMS_RADIUS);
  }
  return !any_of(larger);
}

/* Ring (a, d) around row y. */
#define RING_OF(rows_of, AT, y, a, d)                                               \
  (Ring){rows_of + AT(HELD((y) - (a))), rows_of + AT(HELD((y) - (d))), rows_of + AT(y),   \
   rows_of + AT(HELD((y) + (d))), rows_of + AT(HELD((y) + (a)))}

/* The place of the next entry that a band adds to a list. It takes a block at a time. */
uint next_place(volatile __global uint *count, uint *place) {
  if (*place % BLOCK == 0) *place = atomic_add(count, BLOCK);
  return (*place)++;
}

/* Fill the last block with entries that are none. */
void fill_block(__global int *list, const uint capacity, uint place) {
  for (; place % BLOCK && place < capacity; ++place)
    list[2 * capacity + place] = list[3 * capacity + place] = 0;
}

/* Write a maximum to a list. `rows_of` holds the five rows around it; those outside the image are
 * 0. A response is at most 11 220, so the sum of five fits in 16 bits. */
#define ABOVE_ZERO(v) ((v) & ~((v) >> (short)15))
#define POSITIVE(k) ABOVE_ZERO(EIGHT_AT(rows_of[k] + x - 2))
#define SUM5(v) ((int)v.s0 + (int)v.s1 + (int)v.s2 + (int)v.s3 + (int)v.s4)
void append(__global int *restrict list, const uint n, const uint capacity, const int x,
            const int y, const int marks, __global const short *const *rows_of) {
  const short8 above_2 = POSITIVE(0), above = POSITIVE(1), middle = POSITIVE(2);
  const short8 below = POSITIVE(3), below_2 = POSITIVE(4);
  const ushort8 columns = as_ushort8(above_2 + above + middle + below + below_2);
  const short8 far = below_2 - above_2, near = below - above;
  list[n] = x;
  list[capacity + n] = y;
  list[2 * capacity + n] = middle.s2;
  list[3 * capacity + n] = SUM5(columns) | marks;
  list[4 * capacity + n] =
      2 * ((int)columns.s4 - (int)columns.s0) + (int)columns.s3 - (int)columns.s1;
  list[5 * capacity + n] = 2 * SUM5(far) + SUM5(near);
}

/* How many bands search octave n of `rows` rows: few, because a band has rows beyond its own. */
uint bands_of(const uint n, const uint rows, const uint bands) {
  return n ? LARGER(SMALLER(bands >> n, (rows >> n) / 32), 1u) : bands;
}

/* Take rows of a segment, which two bands share, and return how many: the next ones are down from
 * row `next`, or up from it. 0 if the bands have taken all. */
int take_rows(volatile __global uint *taken, const int next, const int height, const int upward) {
  if ((int)atomic_inc(taken) * ROWS_AT_A_TIME >= height) return 0;
  return upward ? next % ROWS_AT_A_TIME + 1 : SMALLER(ROWS_AT_A_TIME, height - next);
}

/* Row y of the frame. */
#define FRAME_ROW(y) (frame + (size_t)(y) * step)
#define IMAGE_ROW(y) (image + (size_t)(y) * step)

/* List the maxima of a band of an octave, write the rows that its corners are refined in to
 * `image`, where the frame itself lies, and fill their padding. frame, image: the first pixel. An
 * odd band goes up. `taken` counts how often the two bands of a segment have taken rows.
 * `area` has a bit for every pixel of the frame, in rows of `frame_words`. lists, counts: of the
 * frame. Return the sum of the noise. */
ulong search_band(const uint n, __global const PIXEL *frame, __global PIXEL *image,
                  __global const uint *restrict area, const uint frame_words,
                  const Octave octave, const uint band, const uint bands, const uint capacity,
                  const uint full_scale, const float inverse, __global ushort *restrict work,
                  volatile __global uint *taken, volatile __global uint *counts,
                  __global int *lists) {
  const uint step = octave.step, columns = octave.columns;
  const int height = (int)octave.rows, width = (int)columns;
  const int upward = band % 2, way = upward ? -1 : 1;
  const int band_rows = (height + (int)bands - 1) / (int)bands;
  const int top = (int)band / 2 * 2 * band_rows;
  const int end = SMALLER(top + 2 * band_rows, height);
  const int first = upward ? end - 1 : top;
  __global ushort *levels = work, *s1 = levels + 4 * step, *s2 = s1 + SMOOTH_ROWS * step;
  __global ushort *s3 = s2 + 4 * step, *column = s3 + COARSE_ROWS * step;
  __global short *nothing = (__global short *)(column + 2 * step) + PAD;
  __global NOISE *noise_of_column = (__global NOISE *)(column + 3 * step) + PAD;
  __global short *first_response = (__global short *)(column + 5 * step);
  const size_t fine_from_coarse = (size_t)RESPONSE_ROWS * step;
  ulong noise_of_band = 0;
  uint places[2] = {0, 0};
  for (int x = -PAD; x < (int)step - PAD; ++x) nothing[x] = 0;
  take_noise(noise_of_column, width);

  /* `done` rows of the band are done; before the first, the steps fill their buffers. */
  int left = take_rows(taken, first - top, end - top, upward);
  for (int done = -2 * BEYOND; left; ++done) {
    const int y = first + way * done, y_response = y + way * BESIDE_MAXIMUM;
    const int y_in = y + way * BEYOND, y1 = y_in - way, y2 = y1 - way, y3 = y2 - way;
    const int y_soon = y_in + way * ROWS_AHEAD;
    if (n == 0 && y_soon >= 0 && y_soon < height) call_row(FRAME_ROW(y_soon), width);
#if !WHOLE_LEVELS
    if (y_in >= 0 && y_in < height)
      scale_levels(FRAME_ROW(y_in), levels + LEVEL_AT(y_in), full_scale, inverse, width);
#endif
    if (done > -2 * BEYOND && y1 >= 0 && y1 < height) {
#if WHOLE_LEVELS
      column_of_greys(FRAME_ROW(HELD(y1 - 1)), FRAME_ROW(y1), FRAME_ROW(HELD(y1 + 1)),
                      column + PAD, width);
      smooth_row(NEIGHBOURS(column + PAD), s1 + SMOOTH_AT(y1), width);
#else
      column_of_levels(levels + LEVEL_AT(HELD(y1 - 1)), levels + LEVEL_AT(y1),
                       levels + LEVEL_AT(HELD(y1 + 1)), column + PAD, width);
      smooth_row_by_16(NEIGHBOURS(column + PAD), s1 + SMOOTH_AT(y1), width);
#endif
    }
    if (done > -2 * BEYOND + 2 && y2 >= 0 && y2 < height) {
      column_of_levels(s1 + SMOOTH_AT(HELD(y2 - 1)), s1 + SMOOTH_AT(y2),
                       s1 + SMOOTH_AT(HELD(y2 + 1)), column + PAD, width);
      smooth_row_by_16(NEIGHBOURS(column + PAD), s2 + LEVEL_AT(y2), width);
    }
    if (done > -2 * BEYOND + 4 && y3 >= 0 && y3 < height) {
      column_of_levels(s2 + LEVEL_AT(HELD(y3 - 1)), s2 + LEVEL_AT(y3),
                       s2 + LEVEL_AT(HELD(y3 + 1)), column + PAD, width);
      smooth_row_by_16(NEIGHBOURS(column + PAD), s3 + COARSE_AT(y3), width);
    }
    if (done >= -2 * BESIDE_MAXIMUM && y_response >= 0 && y_response < height) {
      const int y = y_response;
      __global short *response = first_response + RESPONSE_AT(y);
      coarse_response_of_row(s3 + COARSE_AT(HELD(y - 5)), s3 + COARSE_AT(HELD(y - 4)),
                             s3 + COARSE_AT(y), s3 + COARSE_AT(HELD(y + 4)),
                             s3 + COARSE_AT(HELD(y + 5)), 5, 4, response, width);
#if FINE
      if (n == 0)
        fine_response_of_row(s1 + SMOOTH_AT(HELD(y - 3)), s1 + SMOOTH_AT(HELD(y - 2)),
                             s1 + SMOOTH_AT(y), s1 + SMOOTH_AT(HELD(y + 2)),
                             s1 + SMOOTH_AT(HELD(y + 3)), 3, 2, response + fine_from_coarse, width);
#endif
    }
    if (done < 0) continue;
    if (n) pixels_of_row(s3 + COARSE_AT(y), IMAGE_ROW(y), width);
    REPEAT_BORDER(PIXEL, IMAGE_ROW(y))
    if (y > 0 && y + 1 < height) {
      __global CURVATURE *curvature = (__global CURVATURE *)column + PAD;
      curvature_of_row(FRAME_ROW(y - 1), FRAME_ROW(y), FRAME_ROW(y + 1), curvature, width);
      add_noise(NEIGHBOURS(curvature), noise_of_column, width);
      if (done % NOISE_ROWS == NOISE_ROWS - 1) noise_of_band += take_noise(noise_of_column, width);
    }
#pragma unroll
    for (int fine = 0; fine <= FINE; ++fine) {
      if (n && fine) break;
      __global const short *responses = first_response + fine * fine_from_coarse;
      __global const short *rows_of[2 * BESIDE_MAXIMUM + 1], *const *row = rows_of + BESIDE_MAXIMUM;
      for (int dy = -BESIDE_MAXIMUM; dy <= BESIDE_MAXIMUM; ++dy)
        rows_of[BESIDE_MAXIMUM + dy] =
            y + dy < 0 || y + dy >= height ? nothing : responses + RESPONSE_AT(y + dy);
      const int peaks = peaks_of_row(row[-1], row[0], row[1], column, width);
      if (!peaks) continue;
      const Ring s1_2 = RING_OF(s1, SMOOTH_AT, y, 2, 1), s1_3 = RING_OF(s1, SMOOTH_AT, y, 3, 2);
      const Ring s3_4 = RING_OF(s3, COARSE_AT, y, 4, 3), s3_5 = RING_OF(s3, COARSE_AT, y, 5, 4);
      const Ring s3_8 = RING_OF(s3, COARSE_AT, y, 8, 6);
      __global const uint *allowed = area + (uint)TO_FRAME(y, n) * frame_words;
      const uint kind = fine ? 1 : KIND_OF_OCTAVE(n);
      __global int *list = lists + kind * LIST_COLUMNS * (size_t)capacity;
      for (int k = 0; k < peaks; ++k) {
        const int x = column[upward ? peaks - 1 - k : k];
        const uint bit = PAD + (uint)TO_FRAME(x, n);
        if (!(allowed[bit / 32] >> bit % 32 & 1) || !is_maximum(row, x, row[0][x])) continue;
        const int r = row[0][x];
        const Harmonics three = harmonics_of(s1_3, x, 3, 2);
        int marks;
        if (fine) {
          const Harmonics two = harmonics_of(s1_2, x, 2, 1);
          if (!are_aligned(4, two, three)) continue;
          marks = direction_of(three);
        } else {
          const Harmonics four = harmonics_of(s3_4, x, 4, 3);
          const Harmonics five = harmonics_of(s3_5, x, 5, 4);
          if (!looks_alike(r, three, four, five)) continue;
          marks = n ? marks_of_halved(r, five, harmonics_of(s3_8, x, 8, 6)) : marks_of(r, five);
        }
        const uint place = next_place(counts + kind, places + fine);
        if (place < capacity) append(list, place, capacity, x, y, marks, row - 2);
      }
    }
    if (--left == 0) left = take_rows(taken, y + way - top, end - top, upward);
  }
  for (int fine = 0; fine <= (n ? 0 : FINE); ++fine)
    fill_block(lists + (fine ? 1 : KIND_OF_OCTAVE(n)) * LIST_COLUMNS * (size_t)capacity, capacity,
               places[fine]);
  return noise_of_band + take_noise(noise_of_column, width);
}

/* List the maxima of all octaves, and decide for the frame. The counters of a frame are those of
 * its lists, of the bands that have finished, of the rows taken in each segment of each octave, and
 * of halving. The fences and the counts order the lists of all bands before the decision, on every
 * CPU: OpenCL 1.2 alone does not promise it between groups. One work-item per band. */
__kernel void harmonic_band(__global PIXEL *image, __global PIXEL *halves, const uint octaves,
                            __global const uint *restrict area, const uint rows,
                            const uint columns, const uint step, const uint capacity,
                            const uint full_scale, const float inverse,
                            __global ushort *restrict work, const uint work_size,
                            const uint coarse_noise, const int coarse_share,
                            const int fine_share, const uint corner_capacity,
                            const uint count_offset, const uint length,
                            const uint counters_of_frame, __global uint *counters,
                            __global ulong *noise, __global int *lists,
                            __global Level *restrict levels, __global int *restrict strong,
                            __global uint *restrict maxima, __global uint *restrict row_counts,
                            __global int *restrict row_columns, __global int *restrict corners,
                            __global uint *restrict counts) {
  const uint band = get_global_id(0), bands = get_global_size(0), segments = (bands + 1) / 2;
  const size_t p = get_global_id(1), frames = get_global_size(1);
  volatile __global uint *listed = counters + p * counters_of_frame, *finished = listed + KINDS;
  volatile __global uint *taken = finished + 1;
  __global const PIXEL *frame = image + (p * rows + 1) * step + PAD;
  volatile __global uint *halved = taken + segments * (1 + octaves);
  halve_frame(frame, halves, octaves, rows, columns, step, p, frames, halved, halved + 1);
  uint before = 0; /* bands of the smaller octaves: these spread over the work-items */
  for (int n = (int)octaves; n >= 0; --n) {
    const Octave octave = octave_of((uint)n, rows, columns, step, frames);
    const uint searching = bands_of((uint)n, rows, bands);
    const uint b = (band + bands - before % bands) % bands;
    before += searching;
    if (b >= searching) continue;
    const size_t in_octave = (p * octave.rows + 1) * octave.step + PAD;
    __global PIXEL *first = image + octave.start + in_octave;
    __global const PIXEL *from = n ? halves + octave.half_start + in_octave : frame;
    noise[(n * frames + p) * bands + b] = search_band(
        (uint)n, from, first, area, step / 32, octave, b, searching, capacity, full_scale, inverse,
        work + (p * bands + band) * work_size, taken + n * segments + b / 2, listed,
        lists + p * KINDS * LIST_COLUMNS * capacity);
  }
  mem_fence(CLK_GLOBAL_MEM_FENCE);
  if (atomic_inc(finished) + 1 < bands) return;
  mem_fence(CLK_GLOBAL_MEM_FENCE);
  __local ulong sums[DECIDING];
  for (uint kind = 0; kind < KINDS; ++kind)
    find_level(kind, p, frames, noise, bands, rows, columns, full_scale, coarse_noise, capacity,
               counters_of_frame, counters, lists, levels, 0);
  decide_frame(p, octaves, levels, strong, rows, step, capacity, coarse_share, fine_share,
               NMS_RADIUS, counters_of_frame, corner_capacity, count_offset, length, counters,
               lists, maxima, row_counts, row_columns, corners, counts, sums);
}
