#include "octave.clh"
#if OCTAVES
#include "cpu/halve.clh"
#endif

/* The grey-level rule for CPUs: one launch takes bands of rows from the image to the maxima of
 * both responses, and the last band to finish decides for the frame, because a launch of its own
 * costs as much as half of the decision. kernels/harmonic.cl has the equations.
 *
 * Only the noise and the reference need the whole frame. A band therefore goes over its rows
 * once; every step keeps a ring buffer of as many rows as the later steps need, and all of them
 * stay in the cache. Two bands share the rows between them: one goes down from the first row, the
 * other goes up from the last, and they take a few rows at a time until none is left. So both end
 * together, even if one of them starts late or runs on a slower core. The small octaves come first,
 * so that the frame evens out what they leave. Each loop over a row is a
 * function of its own with restrict pointers and one cast per operation: compilers turn it into
 * vectors of 16-bit numbers. */

#ifndef NMS_RADIUS
#error "NMS_RADIUS must be that of suppression"
#endif

#define LEAST 80  /* below every bound of a response */
#define REACH_OF_RING 5
#define REACH_OF_WIDE (OCTAVES ? 8 : REACH_OF_RING)
#define LAG (REACH_OF_RING + 3) /* from an image row to the response that it completes */
/* Rows of suppression, and of the moments. */
#define BESIDE_MAXIMUM LARGER(NMS_RADIUS, OCTAVES ? 3 : 2)
#define BEYOND (LAG + BESIDE_MAXIMUM)
#define ROWS_AT_A_TIME 8 /* that a band takes */

/* Ring buffers: powers of two. A smoothed row serves from the response REACH_OF_RING rows above
 * until check 1 of a maximum REACH_OF_RING rows below; of S3, until the wide ring. */
#define SMOOTH_ROWS (NMS_RADIUS <= 4 ? 16 : 32)
#define COARSE_ROWS (OCTAVES ? 32 : SMOOTH_ROWS)
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

ROW_LOOP void copy_row(__global const PIXEL *restrict from, __global PIXEL *restrict to,
                       const int width) {
  for (int x = 0; x < width; ++x) to[x] = from[x];
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

#define LIST_COLUMNS 6
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

/* The rows that ring (a, d) around row y meets. */
typedef struct {
  __global const ushort *north, *upper, *middle, *lower, *south;
} Ring;
#define RING_OF(rows_of, AT, y, a, d)                                               \
  {rows_of + AT(HELD((y) - (a))), rows_of + AT(HELD((y) - (d))), rows_of + AT(y),   \
   rows_of + AT(HELD((y) + (d))), rows_of + AT(HELD((y) + (a)))}

typedef struct {
  int2 second; /* A, B */
  int length, odd, centre;
} Harmonics;

#define MAGNITUDE_OF(v) ((v) < 0 ? -(v) : (v))
Harmonics harmonics_of(const Ring *ring, const int x, const int a, const int d) {
  const int s0 = ring->north[x], s1 = ring->upper[x + d], s2 = ring->middle[x + a];
  const int s3 = ring->lower[x + d], s4 = ring->south[x], s5 = ring->lower[x - d];
  const int s6 = ring->middle[x - a], s7 = ring->upper[x - d];
  const int u0 = s0 + s4, u1 = s1 + s5, u2 = s2 + s6, u3 = s3 + s7;
  const int2 v = (int2)(u0 - u2, u1 - u3);
  const int p = MAGNITUDE_OF(v.x), q = MAGNITUDE_OF(v.y), low = SMALLER(p, q);
  const int c = u0 + u1 + u2 + u3 - 8 * ring->middle[x];
  const Harmonics found = {v, LARGER(p, q) + (low >> 2) + (low >> 3),
                           MAGNITUDE_OF(s0 - s4) + MAGNITUDE_OF(s1 - s5) +
                               MAGNITUDE_OF(s2 - s6) + MAGNITUDE_OF(s3 - s7),
                           MAGNITUDE_OF(c)};
  return found;
}

int coarse_response_of(const Harmonics h) {
  return h.length - (h.odd - (h.odd >> 2)) - ((h.centre >> 2) + (h.centre >> 3));
}

int dot_of(const int2 a, const int2 b) { return a.x * b.x + a.y * b.y; }

/* Append a maximum to a list. The columns are x, y, the response, and the sum and the moments in x
 * and y of the positive responses of the 5 x 5 around it. `mark` is CLEAN or WIDE, and the
 * direction. `rows_of` holds the five rows; those outside the image are 0. A response is at most
 * 11 220, so the sum of five fits in 16 bits. */
#define CLEAN (1 << 30) /* in the column of the sums, of the frame: little is subtracted from the
                           length. Weak at most in contrast, it may be half as weak as others */
#define WIDE CLEAN      /* the same bit in a halved frame: the ring of 8 px responds too */
#define LONE (1 << 29)  /* in the same column: no corner */
#define ABOVE_ZERO(v) ((v) & ~((v) >> (short)15))
#define POSITIVE(k) ABOVE_ZERO(EIGHT_AT(rows_of[k] + x - 2))
#define SUM5(v) ((int)v.s0 + (int)v.s1 + (int)v.s2 + (int)v.s3 + (int)v.s4)
void append(__global int *restrict list, const uint n, const uint capacity, const int x, const int y,
            const int mark, __global const short *const *rows_of) {
  const short8 above_2 = POSITIVE(0), above = POSITIVE(1), middle = POSITIVE(2);
  const short8 below = POSITIVE(3), below_2 = POSITIVE(4);
  const ushort8 columns = as_ushort8(above_2 + above + middle + below + below_2);
  const short8 far = below_2 - above_2, near = below - above;
  list[n] = x;
  list[capacity + n] = y;
  list[2 * capacity + n] = middle.s2;
  list[3 * capacity + n] = SUM5(columns) | mark;
  list[4 * capacity + n] = 2 * ((int)columns.s4 - (int)columns.s0) + (int)columns.s3 - (int)columns.s1;
  list[5 * capacity + n] = 2 * SUM5(far) + SUM5(near);
}

/* The least response that the noise allows. */
int noise_bound(const ulong factor, const ulong amplitude, const ulong pixels,
                const ulong full_scale) {
  if (!pixels) return LEAST;
  const ulong whole = 100 * pixels * full_scale;
  const ulong bound = (factor * amplitude * 255 + whole - 1) / whole;
  return (int)LARGER(LEAST, SMALLER(bound, (ulong)INT_MAX));
}

/* The lists of a segment: the maxima of the frame, those of the fine response, and those of each
 * halved frame. */
#define KINDS (1 + FINE + OCTAVES)
#define KIND_OF_OCTAVE(n) ((n) ? FINE + (n) : 0)

/* How many bands search octave n of `rows` rows: few, because a band has rows beyond its own. */
uint bands_of(const uint n, const uint rows, const uint bands) {
  return n ? LARGER(SMALLER(bands >> n, (rows >> n) / 32), 1u) : bands;
}

/* The part of a segment's list that one of its two bands fills: the number of its first entry, and
 * of its entries, which may exceed the capacity. */
#define SPAN_OF(band, kind) spans[(band) * KINDS + (kind)]
#define LIST_OF(band, kind)                                                         \
  (lists + (size_t)((band) / 2 * KINDS + (kind)) * LIST_COLUMNS * capacity +        \
   SPAN_OF(band, kind).x)

/* The sum of the squares of those responses of a list that are at least `least`. */
ROW_LOOP ulong squares_from(__global const int *restrict response, const uint count,
                            const int least) {
  ulong sum = 0;
  for (uint n = 0; n < count; ++n)
    sum += response[n] >= least ? (uint)(response[n] * response[n]) : 0;
  return sum;
}
ulong squares_of_frame(__global const int *lists, __global const uint2 *spans, const uint kind,
                       const uint bands, const uint capacity, const int least) {
  ulong sum = 0;
  for (uint band = 0; band < bands; ++band)
    sum += squares_from(LIST_OF(band, kind) + 2 * capacity,
                        SMALLER(SPAN_OF(band, kind).y, capacity), least);
  return sum;
}

/* The reference W: the largest number at which the responses from it on have at least half of the
 * sum of the squares of all above a bound; 0 if there are none. It is found bit by bit. */
#define HIGHEST_BIT_OF_RESPONSE (1 << 13)
int reference_of(__global const int *lists, __global const uint2 *spans, const uint kind,
                 const uint bands, const uint capacity, const int bound) {
#define SQUARES_FROM(least) squares_of_frame(lists, spans, kind, bands, capacity, least)
  const ulong all = bound < INT_MAX ? SQUARES_FROM(bound + 1) : 0;
  int reference = 0;
  for (int bit = HIGHEST_BIT_OF_RESPONSE; all && bit; bit >>= 1)
    if (2 * SQUARES_FROM(reference + bit) >= all) reference += bit;
  return reference;
}

/* Whether a mark is within x - before .. x + behind, and in such rows; behind is before, or one
 * more. The nearest rows come first: most marks are within one or two rows. */
int is_marked(__global const uint *marks, const int x, const int y, const int before,
              const int behind, const int last, const uint width) {
  const uint first = (uint)(PAD + x - before);
  for (int line = 0; line <= before + behind; ++line) {
    const int row = y + (line % 2 ? line / 2 + 1 : -(line / 2));
    if (row < 0 || row > last) continue;
    __global const uint *word = marks + (uint)row * width + first / 32;
    const ulong both = (ulong)word[1] << 32 | word[0];
    if (both >> first % 32 & ((2ul << (before + behind)) - 1)) return 1;
  }
  return 0;
}

/* Copy entries of a list to another one, whose columns lie `length` apart. */
void copy_entries(__global const int *from, const uint capacity, const uint count,
                  __global int *to, const uint length) {
  for (uint k = 0; k < LIST_COLUMNS; ++k)
    for (uint n = 0; n < count; ++n) to[(size_t)k * length + n] = from[k * capacity + n];
}

/* The least response that the noise of octave n allows; noise: of its bands. */
int bound_of_octave(__global const ulong *noise, const uint n, const uint rows,
                    const uint columns, const uint bands, const uint full_scale,
                    const uint factor) {
  const uint height = rows >> n, width = columns >> n;
  ulong amplitude = 0;
  for (uint band = 0; band < bands_of(n, rows, bands); ++band) amplitude += noise[band];
  const ulong pixels = height > 2 && width > 2 ? (ulong)(height - 2) * (width - 2) : 0;
  return noise_bound(factor, amplitude, pixels, full_scale);
}

/* Columns 0, 1 and 6 of a corner: its pixel, and the octave that it is a pixel of. */
#define CORNER_COLUMN(k, n) corners[(size_t)(k) * length + (n)]
#define FRAME_X(n) TO_FRAME(CORNER_COLUMN(0, n), CORNER_COLUMN(6, n))
#define FRAME_Y(n) TO_FRAME(CORNER_COLUMN(1, n), CORNER_COLUMN(6, n))

#if OCTAVES

/* A corner of octave n has no other one within 5 px of the octave, in x and in y. Corners are
 * marked in a map of pixels of the octave, shifted by half a pixel: a maximum at x is near those at
 * x - 4 .. x + 5. */
#define LEAST_SHARE 48 /* of the reference, in 1/128 */
#define MARK_AT(x, n) (((x) + (1 << (n) >> 1)) >> (n))

/* Mark the maxima of octave 1 that are above a bound and at least a share of the reference. */
void mark_octave(const Octave octave, __global const int *lists, __global const uint2 *spans,
                 const uint bands, const uint capacity, const int bound, const int least,
                 __global uint *marks) {
  const uint kind = KIND_OF_OCTAVE(1), width = octave.step / 32;
  for (uint k = 0; k < octave.rows * width; ++k) marks[k] = 0;
  for (uint band = 0; band < bands; ++band) {
    __global const int *list = LIST_OF(band, kind);
    for (uint k = 0; k < SMALLER(SPAN_OF(band, kind).y, capacity); ++k) {
      const int r = list[2 * capacity + k], x = PAD + list[k];
      if (r <= bound || 128 * r < least) continue;
      marks[(uint)list[capacity + k] * width + x / 32] |= 1u << x % 32;
    }
  }
}

/* Count those of some maxima that are around (x, y). own: the marks of the maximum there. */
ROW_LOOP Around count_around(__global const int *restrict columns, __global const int *restrict rows,
                             __global const int *restrict marks, const uint count, const int x,
                             const int y, const int own) {
  const int own_x = DIRECTION_X(own), own_y = DIRECTION_Y(own);
  int aligned = 0, askew = 0;
  for (uint n = 0; n < count; ++n) {
    const int across = MAGNITUDE_OF(columns[n] - x), down = MAGNITUDE_OF(rows[n] - y);
    const int near = (across <= AROUND) & ((across > NMS_RADIUS) | (down > NMS_RADIUS));
    const int is_askew = are_askew(own_x, own_y, DIRECTION_X(marks[n]), DIRECTION_Y(marks[n]));
    aligned += near & !is_askew;
    askew += near & is_askew;
  }
  const Around around = {aligned, askew};
  return around;
}

/* The first entry of a list in row y or below it. */
uint first_from(__global const int *rows, const uint count, const int y) {
  uint first = 0;
  for (uint end = count; first < end;) {
    const uint middle = (first + end) / 2;
    if (rows[middle] < y) first = middle + 1;
    else end = middle;
  }
  return first;
}

/* Whether a weak maximum of the frame is lone. `marks` holds the maxima of octave 1. */
int is_lone(__global const int *lists, __global const uint2 *spans, const uint bands,
            const uint capacity, const int x, const int y, const int own,
            __global const uint *marks, const Octave smaller) {
  Around around = {0, 0};
  for (uint kind = 0; kind <= FINE; ++kind)
    for (uint band = 0; band < bands; ++band) {
      __global const int *list = LIST_OF(band, kind), *rows = list + capacity;
      const uint count = SPAN_OF(band, kind).y, first = first_from(rows, count, y - AROUND);
      const uint end = first + first_from(rows + first, count - first, y + AROUND + 1);
      const Around here = count_around(list + first, rows + first, list + 3 * capacity + first,
                                       end - first, x, y, own);
      around.aligned += here.aligned;
      around.askew += here.askew;
    }
  return IS_LONE_IN(
      around, is_marked(marks, x >> 1, y >> 1, 1, 1, (int)smaller.rows - 1, smaller.step / 32));
}
#define IS_LONE(list, n)                                                            \
  (IS_WEAK(list[2 * capacity + (n)], reference) &&                                  \
   is_lone(lists, spans, bands, capacity, list[n], list[capacity + (n)],            \
           list[3 * capacity + (n)], marks, smaller))

/* Add the corners of octave n to those of the frame and of the octaves before. Return how many
 * there are then. `marks` has room for the bits of the octave. */
uint add_octave(const uint n, const Octave octave, __global uint2 *spans, __global int *lists,
                const uint bands, const uint capacity, const int bound, const int reference,
                const uint total, const uint corner_capacity, const uint length,
                __global uint *marks, __global int *corners) {
  const uint kind = KIND_OF_OCTAVE(n), width = octave.step / 32;
  uint added = 0;
  for (uint band = 0; band < bands; ++band) {
    __global int *list = LIST_OF(band, kind);
    uint kept = 0;
    for (uint k = 0; k < SMALLER(SPAN_OF(band, kind).y, capacity); ++k) {
      const int r = list[2 * capacity + k];
      if (r <= bound || 128 * r < LEAST_SHARE * reference) continue;
      if (!(list[3 * capacity + k] & WIDE)) continue;
      list[3 * capacity + k] &= SUM_MASK;
      if (kept < k) copy_entries(list + k, capacity, 1, list + kept, capacity);
      ++kept;
    }
    SPAN_OF(band, kind).y = kept;
    added += kept;
  }
  if (!added || total > corner_capacity) return total + added;
  for (uint k = 0; k < (octave.rows + 2) * width; ++k) marks[k] = 0;
  for (uint k = 0; k < total; ++k) {
    const int x = PAD + MARK_AT(FRAME_X(k), n);
    marks[(uint)MARK_AT(FRAME_Y(k), n) * width + x / 32] |= 1u << x % 32;
  }
  added = 0;
  for (uint band = 0; band < bands; ++band) {
    __global int *list = LIST_OF(band, kind);
    uint kept = 0;
    for (uint k = 0; k < SPAN_OF(band, kind).y; ++k) {
      if (is_marked(marks, list[k], list[capacity + k], 4, 5, (int)octave.rows + 1, width)) continue;
      if (kept < k) copy_entries(list + k, capacity, 1, list + kept, capacity);
      ++kept;
    }
    SPAN_OF(band, kind).y = kept;
    added += kept;
  }
  if (total + added > corner_capacity) return total + added;
  /* Merge from the end: both are in (y, x) order. */
  int last = (int)total - 1, place = (int)(total + added) - 1;
  for (int band = (int)bands - 1; band >= 0; --band) {
    __global const int *list = LIST_OF(band, kind);
    for (int k = (int)SPAN_OF(band, kind).y - 1; k >= 0; --k, --place) {
      const int x = TO_FRAME(list[k], n), y = TO_FRAME(list[capacity + k], n);
      for (; last >= 0 && (FRAME_Y(last) > y || (FRAME_Y(last) == y && FRAME_X(last) > x));
           --last, --place)
        for (uint c = 0; c <= LIST_COLUMNS; ++c)
          CORNER_COLUMN(c, place) = CORNER_COLUMN(c, last);
      copy_entries(list + k, capacity, 1, corners + place, length);
      CORNER_COLUMN(6, place) = (int)n;
    }
  }
  return total + added;
}

#endif

/* Shorten the lists of a kind to the maxima above the bound from the noise, and not below a share
 * of the reference, or half of that share if they are clean; or to those that are not LONE. */
#define SHORTEN(IS_KEPT)                                                            \
  for (uint band = 0; band < bands; ++band) {                                       \
    __global int *list = LIST_OF(band, kind);                                       \
    const uint count = SMALLER(SPAN_OF(band, kind).y, capacity);                    \
    uint kept = 0;                                                                  \
    for (uint n = 0; n < count; ++n) {                                              \
      const int r = list[2 * capacity + n], marks = list[3 * capacity + n];         \
      if (!(IS_KEPT)) continue;                                                     \
      if (kept < n) copy_entries(list + n, capacity, 1, list + kept, capacity);     \
      ++kept;                                                                       \
    }                                                                               \
    SPAN_OF(band, kind).y = kept;                                                   \
  }
void keep_strong(__global int *lists, __global uint2 *spans, const uint kind, const uint bands,
                 const uint capacity, const int bound, const int least) {
  SHORTEN(r > bound && (marks & CLEAN ? 256 : 128) * r >= least)
}
void remove_lone(__global int *lists, __global uint2 *spans, const uint kind, const uint bands,
                 const uint capacity) {
  SHORTEN(r > 0 && !(marks & LONE))
}

/* Write the maxima that are corners, in (y, x) order: those that are strong enough and not lone; a
 * fine one counts only if no coarse corner is within NMS_RADIUS. `maxima` gets a bit for each coarse
 * corner. The lists keep the corners. */
void decide(const size_t p, __global const ulong *noise, __global uint2 *spans,
            __global int *lists, const uint rows, const uint columns, const uint step,
            const uint bands, const uint capacity, const uint full_scale,
            const uint coarse_noise, const int coarse_share, const int fine_share,
            const uint corner_capacity, const uint count_offset, const uint length,
            __global uint *maxima, __global int *corners, __global uint *counts) {
  noise += p * bands * (1 + OCTAVES);
  const int least[2] = {coarse_share, fine_share}; /* of the reference, 1/128 */
  const int bound[2] = {
      bound_of_octave(noise, 0, rows, columns, bands, full_scale, coarse_noise),
      bound_of_octave(noise, 0, rows, columns, bands, full_scale, 2 * coarse_noise)};
  lists += p * ((bands + 1) / 2) * KINDS * LIST_COLUMNS * capacity;
  spans += p * bands * KINDS;
  maxima += p * (1 + (OCTAVES > 0)) * rows * step / 32;
  corners += p * corner_capacity;
  const uint width = step / 32;
  int reference = reference_of(lists, spans, 0, bands, capacity, bound[0]);
#if OCTAVES
  int bounds[OCTAVES + 1];
  for (uint n = 1; n <= OCTAVES; ++n) {
    const uint own = bands_of(n, rows, bands);
    bounds[n] =
        bound_of_octave(noise + n * bands, n, rows, columns, bands, full_scale, coarse_noise);
    const int other = reference_of(lists, spans, KIND_OF_OCTAVE(n), own, capacity, bounds[n]);
    reference = LARGER(reference, other);
  }
#endif
#if FINE
  if (reference == 0)
    reference = reference_of(lists, spans, 1, bands, capacity, bound[1]);
#endif
  uint total = 0, most = 0;
  for (uint kind = 0; kind < KINDS; ++kind)
    for (uint band = 0; band < bands_of(kind > FINE ? kind - FINE : 0, rows, bands); ++band) {
      const uint before = band % 2 ? SPAN_OF(band - 1, kind).y : 0;
      most = LARGER(most, before + SPAN_OF(band, kind).y);
    }
  for (uint kind = 0; kind <= FINE; ++kind)
    keep_strong(lists, spans, kind, bands, capacity, bound[kind], least[kind] * reference);
#if OCTAVES
  __global uint *marks = maxima + rows * width;
  const Octave smaller = octave_of(1, rows, columns, step, 1);
  mark_octave(smaller, lists, spans, bands_of(1, rows, bands), capacity, bounds[1],
              coarse_share * reference, marks);
#else
#define IS_LONE(list, n) 0
#endif
#if FINE
  for (uint i = 0; i < rows * width; ++i) maxima[i] = 0;
#endif
  for (uint band = 0; band < bands; ++band) {
    __global int *list = LIST_OF(band, 0);
    for (uint n = 0; n < SPAN_OF(band, 0).y; ++n) {
      const uint x = (uint)list[n] + PAD;
      if (IS_LONE(list, n)) list[3 * capacity + n] |= LONE;
#if FINE
      else maxima[(uint)list[capacity + n] * width + x / 32] |= 1u << x % 32;
#endif
    }
  }
#if FINE
  for (uint band = 0; band < bands; ++band) {
    __global int *list = LIST_OF(band, 1);
    for (uint n = 0; n < SPAN_OF(band, 1).y; ++n)
      if (is_marked(maxima, list[n], list[capacity + n], NMS_RADIUS, NMS_RADIUS, (int)rows - 1,
                    width) ||
          IS_LONE(list, n))
        list[3 * capacity + n] |= LONE;
  }
#endif
  for (uint kind = 0; kind <= FINE; ++kind) remove_lone(lists, spans, kind, bands, capacity);
  for (uint band = 0; band < bands; ++band) {
    const uint coarse_count = SPAN_OF(band, 0).y;
    __global const int *coarse = LIST_OF(band, 0);
#if FINE
    const uint fine_count = SPAN_OF(band, 1).y;
    __global const int *fine = LIST_OF(band, 1);
#else
    const uint fine_count = 0;
    __global const int *fine = coarse;
#endif
    for (uint c = 0, f = 0; c < coarse_count || f < fine_count;) {
      uint next = f == fine_count ? coarse_count : c;
      while (next < coarse_count &&
             (coarse[capacity + next] < fine[capacity + f] ||
              (coarse[capacity + next] == fine[capacity + f] && coarse[next] < fine[f])))
        ++next;
      const int is_fine = next == c;
      const uint count = is_fine ? 1 : next - c;
      const uint room = corner_capacity - SMALLER(total, corner_capacity);
      copy_entries(is_fine ? fine + f : coarse + c, capacity, SMALLER(count, room),
                   corners + total, length);
      total += count;
      f += is_fine ? 1 : 0;
      c = next;
    }
  }
  for (uint k = 0; k < SMALLER(total, corner_capacity); ++k) CORNER_COLUMN(3, k) &= SUM_MASK;
#if OCTAVES
  for (uint k = 0; k < SMALLER(total, corner_capacity); ++k) CORNER_COLUMN(6, k) = 0;
  for (uint n = 1; n <= OCTAVES; ++n)
    total = add_octave(n, octave_of(n, rows, columns, step, 1), spans, lists,
                       bands_of(n, rows, bands), capacity, bounds[n], reference, total,
                       corner_capacity, length, maxima, corners);
#endif
  counts[p * KINDS] = most;
  for (uint kind = 1; kind < KINDS; ++kind) counts[p * KINDS + kind] = 0;
  counts[count_offset + p] = total;
}

/* Take rows of a segment, which two bands share, and return how many: the next ones are down from
 * row `next`, or up from it. 0 if the bands have taken all. */
int take_rows(volatile __global uint *taken, const int next, const int height, const int upward) {
  if ((int)atomic_inc(taken) * ROWS_AT_A_TIME >= height) return 0;
  return upward ? next % ROWS_AT_A_TIME + 1 : SMALLER(ROWS_AT_A_TIME, height - next);
}

/* Row y of the frame. */
#define FRAME_ROW(y) (frame + (size_t)(y) * frame_step)
#define IMAGE_ROW(y) (image + (size_t)(y) * step)

/* List the maxima of a band of an octave, copy its rows to `image` unless the frame lies there, and
 * fill their padding. frame, image: the first pixel. An odd band goes up. Two bands share a segment
 * of the image and its list, which the second one fills from the end; together they may count more
 * than its capacity. `taken` counts how often the bands of a segment have taken rows. `area` has a
 * bit for every pixel of the frame, in rows of `frame_words`. Return the sum of the noise. */
ulong search_band(const uint n, __global const PIXEL *frame, const uint frame_step,
                  __global PIXEL *image, __global const uint *restrict area,
                  const uint frame_words, const Octave octave, const uint band,
                  const uint bands, const uint capacity, const uint full_scale,
                  const float inverse, __global ushort *restrict work,
                  volatile __global uint *taken, __global uint2 *spans, __global int *lists) {
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
  const size_t kind = (size_t)RESPONSE_ROWS * step;
  ulong noise_of_band = 0;
  uint found[2] = {0, 0};
  for (int x = -PAD; x < (int)step - PAD; ++x) nothing[x] = 0;
  take_noise(noise_of_column, width);

  /* `done` rows of the band are done; before the first, the steps fill their buffers. */
  int left = take_rows(taken, first - top, end - top, upward);
  for (int done = -2 * BEYOND; left; ++done) {
    const int y = first + way * done, y_response = y + way * BESIDE_MAXIMUM;
    const int y_in = y + way * BEYOND, y1 = y_in - way, y2 = y1 - way, y3 = y2 - way;
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
                             s1 + SMOOTH_AT(HELD(y + 3)), 3, 2, response + kind, width);
#endif
    }
    if (done < 0) continue;
    if (frame != image) copy_row(FRAME_ROW(y), IMAGE_ROW(y), width);
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
      __global const short *responses = first_response + fine * kind;
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
      __global int *list = lists + (n ? FINE + n : fine) * LIST_COLUMNS * (size_t)capacity;
      for (int k = 0; k < peaks; ++k) {
        const int x = column[upward ? peaks - 1 - k : k];
        const uint bit = PAD + (uint)TO_FRAME(x, n);
        if (!(allowed[bit / 32] >> bit % 32 & 1) || !is_maximum(row, x, row[0][x])) continue;
        int mark = 0;
        if (fine) {
          const int2 v2 = harmonics_of(&s1_2, x, 2, 1).second;
          const Harmonics h3 = harmonics_of(&s1_3, x, 3, 2);
          if (4 * dot_of(v2, h3.second) < dot_of(h3.second, h3.second)) continue;
          mark = OCTAVES ? direction_bits(h3.second, h3.length) : 0;
        } else {
          const Harmonics h5 = harmonics_of(&s3_5, x, 5, 4);
          const int2 v3 = harmonics_of(&s1_3, x, 3, 2).second;
          const int along = dot_of(v3, h5.second), all = dot_of(h5.second, h5.second);
          if (8 * (long)along < all) continue;
          const int r = row[0][x], r4 = coarse_response_of(harmonics_of(&s3_4, x, 4, 3));
          if (32 * r4 < r || r4 > 2 * r) continue;
          if (8 * h5.centre * (long)all > h5.length * (11 * (long)all + 8 * (long)along))
            continue;
          mark = 4 * r < 3 * h5.length ? 0 : CLEAN;
#if OCTAVES
          if (n)
            mark = 4 * coarse_response_of(harmonics_of(&s3_8, x, 8, 6)) < r ? 0 : WIDE;
          else
            mark |= direction_bits(h5.second, h5.length);
#endif
        }
        if (found[fine] < capacity) {
          const uint place = upward ? capacity - 1 - found[fine] : found[fine];
          append(list, place, capacity, x, y, mark, row - 2);
        }
        ++found[fine];
      }
    }
    if (--left == 0) left = take_rows(taken, y + way - top, end - top, upward);
  }
  for (int fine = 0; fine <= (n ? 0 : FINE); ++fine) {
    const uint start = upward ? capacity - SMALLER(found[fine], capacity) : 0;
    spans[n ? FINE + n : fine] = (uint2)(start, found[fine]);
  }
  return noise_of_band + take_noise(noise_of_column, width);
}

/* List the maxima of all octaves, and decide for the frame. The frame has its first pixel at
 * `frame_start` and rows of `frame_step` elements; the octaves lie behind the frames in `image`.
 * One work-item per band. The last band of a frame to finish decides; `finished` counts them. It and
 * `taken` are 0 between launches. The fences and the counts order the lists of all bands before the
 * decision, on every CPU: OpenCL 1.2 alone does not promise it between groups. */
__kernel void harmonic_band(__global const PIXEL *frame, const uint frame_start,
                            const uint frame_step, __global PIXEL *image,
                            __global const uint *restrict area, const uint rows,
                            const uint columns, const uint step, const uint capacity,
                            const uint full_scale, const float inverse,
                            __global ushort *restrict work, const uint work_size,
                            const uint coarse_noise, const int coarse_share,
                            const int fine_share, const uint corner_capacity,
                            const uint count_offset, const uint length,
                            volatile __global uint *taken, volatile __global uint *finished,
#if OCTAVES
                            volatile __global uint *halved,
#endif
                            __global ulong *noise, __global uint2 *spans, __global int *lists,
                            __global uint *restrict maxima, __global int *restrict corners,
                            __global uint *restrict counts) {
  const uint band = get_global_id(0), bands = get_global_size(0), segments = (bands + 1) / 2;
  const size_t p = get_global_id(1), own = p * bands + band;
#if OCTAVES
  halve_frame(frame + frame_start + p * rows * frame_step, frame_step, image, rows, columns, step,
              p, get_global_size(1), halved + 2 * p, halved + 2 * p + 1);
#endif
  uint before = 0; /* bands of the smaller octaves: these spread over the work-items */
  for (int n = OCTAVES; n >= 0; --n) {
    const Octave octave = octave_of((uint)n, rows, columns, step, get_global_size(1));
    const uint searching = bands_of((uint)n, rows, bands);
    const uint b = (band + bands - before % bands) % bands;
    before += searching;
    if (b >= searching) continue;
    __global PIXEL *first = image + octave.start + (p * octave.rows + 1) * octave.step + PAD;
    __global const PIXEL *from = n ? first : frame + frame_start + p * rows * frame_step;
    const size_t segment = p * segments + b / 2;
    noise[(p * (1 + OCTAVES) + n) * bands + b] =
        search_band((uint)n, from, n ? octave.step : frame_step, first, area, step / 32, octave, b,
                    searching, capacity, full_scale, inverse, work + own * work_size,
                    taken + (p * (1 + OCTAVES) + n) * segments + b / 2,
                    spans + (p * bands + b) * KINDS,
                    lists + segment * KINDS * LIST_COLUMNS * capacity);
  }
  mem_fence(CLK_GLOBAL_MEM_FENCE);
  if (atomic_inc(finished + p) + 1 < bands) return;
  mem_fence(CLK_GLOBAL_MEM_FENCE);
  finished[p] = 0;
#if OCTAVES
  halved[2 * p] = halved[2 * p + 1] = 0;
#endif
  for (uint k = 0; k < segments * (1 + OCTAVES); ++k) taken[p * segments * (1 + OCTAVES) + k] = 0;
  decide(p, noise, spans, lists, rows, columns, step, bands, capacity, full_scale,
         coarse_noise, coarse_share, fine_share, corner_capacity, count_offset, length, maxima,
         corners, counts);
}
