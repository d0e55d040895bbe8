/* Binarization (section 3.1) for CPUs: what binarize.cl decides, as words for criteria_words.cl,
 * and whatever else takes one look at every row. One work-item per band of rows.
 *
 * From row to row the sums of the columns within the window change by the row that enters and
 * the one that leaves. With P[x] the sum of the columns before x, the sum of a window is
 * S = P[x + w] - P[x]: the columns count from where the window of the first pixel begins.
 *
 * A loop over a row is a function of its own: what restrict says lets compilers vectorise it. */

#define NEAR_PIXELS(y) (pixels + max(min((int)(y), (int)rows - 1), 0) * (long)step)

/* Repeat the first and the last of the `columns` elements of a row, as often as that. */
#define REPEAT_ENDS(T, row, before, after)                                                  \
  {                                                                                         \
    const T first_one = (row)[0], last_one = (row)[columns - 1];                            \
    for (uint k = 1; k <= (before); ++k) (row)[-(int)k] = first_one;                        \
    for (uint k = 0; k < (after); ++k) (row)[columns + k] = last_one;                       \
  }

/* P, eight at a time, up to the one after the last, of which up to seven are too many. */
typedef uint8 __attribute__((aligned(4))) UINT8_ANYWHERE;

#define PREFIX_SUMS(NAME, T, T8)                                                            \
  void NAME(__global const T *restrict sums, const uint count, __global uint *restrict prefix) { \
    uint8 carry = 0;                                                                        \
    for (uint x = 0; x < count; x += 8) {                                                   \
      uint8 v = convert_uint8(*(__global const T8 *)(sums + x));                            \
      v += (uint8)(0, v.s012, 0, v.s456);                                                   \
      v += as_uint8((ulong4)(0, as_ulong4(v).s0, 0, as_ulong4(v).s2));                      \
      v += (uint8)(0, 0, 0, 0, v.s3333);                                                    \
      *(__global UINT8_ANYWHERE *)(prefix + x + 1) = v + carry;                             \
      carry += v.s77777777;                                                                 \
    }                                                                                       \
  }

/* Sums F over the columns within the window: of the one above a band, and of the next one, with P.
 * P[0] stays 0. */
#define WINDOW_SUMS(ABOVE, NEXT, MOVE_DOWN, PREFIX, T, P, F)                                \
  void ABOVE(__global const PIXEL *restrict pixels, const uint rows, const uint columns,    \
             const uint step, const int first, const uint window, __global T *restrict sums, \
             __global P *restrict prefix) {                                                 \
    for (uint x = 0; x < columns; ++x) sums[window / 2 + x] = 0;                            \
    for (uint k = 0; k < window; ++k) {                                                     \
      __global const PIXEL *row = NEAR_PIXELS(first - (int)(window / 2) - 1 + (int)k);      \
      for (uint x = 0; x < columns; ++x) sums[window / 2 + x] += F(row[x]);                 \
    }                                                                                       \
    prefix[0] = 0;                                                                          \
  }                                                                                         \
  void MOVE_DOWN(__global const PIXEL *restrict in, __global const PIXEL *restrict out,     \
                 const uint columns, __global T *restrict sums) {                           \
    for (uint x = 0; x < columns; ++x) sums[x] += F(in[x]) - F(out[x]);                     \
  }                                                                                         \
  void NEXT(__global const PIXEL *restrict in, __global const PIXEL *restrict out,          \
            const uint columns, const uint reach, __global T *restrict sums,                \
            __global P *restrict prefix) {                                                  \
    MOVE_DOWN(in, out, columns, sums + reach);                                              \
    REPEAT_ENDS(T, sums + reach, reach, reach)                                              \
    PREFIX(sums, columns + 2 * reach, prefix);                                              \
  }

#define GREY(i) (i)
PREFIX_SUMS(prefix_of_sums, COLUMN, COLUMN8)
WINDOW_SUMS(sums_above, next_sums, move_sums_down, prefix_of_sums, COLUMN, uint, GREY)

#if MASKS == 1

/* Black iff (I + C) n < S. */
void compare(__global const PIXEL *restrict row, __global const uint *restrict from,
             __global const uint *restrict to, const uint columns, const LEVEL count,
             const LEVEL offset, __global uchar *restrict black) {
  for (uint x = 0; x < columns; ++x)
    black[x] = ((LEVEL)row[x] + offset) * count < (LEVEL)(to[x] - from[x]);
}

#else

#define SQUARED(i) ((SQUARE)(i) * (i))
#if PIXEL_BITS == 8
PREFIX_SUMS(prefix_of_squares, uint, uint8)
#else
void prefix_of_squares(__global const ulong *restrict squares, const uint count,
                       __global ulong *restrict prefix) {
  for (uint x = 0; x < count; ++x) prefix[x + 1] = prefix[x] + squares[x];
}
#endif
WINDOW_SUMS(squares_above, next_squares, move_squares_down, prefix_of_squares, SQUARE, SQUARE,
            SQUARED)

/* Black iff I < mean - k sigma for k = 0, -1/2, +1/2, as in binarize.cl. */
void compare_three(__global const PIXEL *restrict row, __global const uint *restrict from,
                   __global const uint *restrict to, __global const SQUARE *restrict squares_from,
                   __global const SQUARE *restrict squares_to, const uint columns,
                   const uint count, __global uchar *restrict black,
                   __global uchar *restrict more_black, __global uchar *restrict less_black) {
  for (uint x = 0; x < columns; ++x) {
    const uint level = count * row[x], s = to[x] - from[x];
    const SQUARE q = squares_to[x] - squares_from[x];
    const VARIANCE v = (VARIANCE)count * q - (VARIANCE)s * s;
    const DISTANCE d = (DISTANCE)level - (DISTANCE)s;
    const VARIANCE square = (VARIANCE)d * d;
    black[x] = d < 0;
    more_black[x] = (d < 0) | (square < (v + 3) >> 2);
    less_black[x] = (d < 0) & (square > v >> 2);
  }
}

#endif

/* Bytes 0 or 1 to bits, eight at a time. */
void pack(__global const ulong *restrict bytes, const uint count, __global uchar *restrict bits) {
  for (uint i = 0; i < count; ++i) {
    ulong v = bytes[i];
    v |= v >> 7;
    v |= v >> 14;
    v |= v >> 28;
    bits[i] = (uchar)v;
  }
}

#if GATE

/* [1 -2 1]^T * I of a row, and the sum of |[1 -2 1] * that| over its inner columns. */
void curvature(__global const PIXEL *restrict above, __global const PIXEL *restrict here,
               __global const PIXEL *restrict below, const uint columns,
               __global CURVATURE *restrict curved) {
  for (uint x = 0; x < columns; ++x) curved[x] = above[x] - 2 * here[x] + below[x];
}

BAND_NOISE amplitude(__global const CURVATURE *restrict left,
                     __global const CURVATURE *restrict here,
                     __global const CURVATURE *restrict right, const uint columns) {
  BAND_NOISE sum = 0;
  for (uint x = 0; x < columns; ++x) {
    const CURVATURE c = left[x] - 2 * here[x] + right[x];
    sum += (NOISE)(c < 0 ? -c : c);
  }
  return sum;
}

#endif

/* The pads of the image, the words of the binary images and the noise. */
__kernel void binarize_bands(__global PIXEL *restrict image, const uint rows,
                             const uint columns, const uint step, const uint band_rows,
                             const uint window, const uint plane_words,
                             __global COLUMN *restrict all_sums,
                             __global uint *restrict all_prefixes,
#if MASKS == 1
                             const LEVEL offset,
#else
                             __global SQUARE *restrict all_squares,
                             __global SQUARE *restrict all_square_prefixes,
#endif
#if GATE
                             __global CURVATURE *restrict all_curved,
                             __global ulong *restrict noise,
#endif
                             __global uchar *restrict all_black,
                             __global uint *restrict words) {
  const size_t p = get_global_id(1), band = p * get_global_size(0) + get_global_id(0);
  const int first = (int)(get_global_id(0) * band_rows), reach = (int)window / 2;
  const int end = min(first + (int)band_rows, (int)rows);
  const uint after = step - PAD - columns;
  __global PIXEL *pixels = image + ROW(p, 0) + PAD;
  __global COLUMN *sums = all_sums + band * step;
  __global uint *prefix = all_prefixes + band * (step + BEYOND);
  sums_above(pixels, rows, columns, step, first, window, sums, prefix);
#if MASKS == 3
  __global SQUARE *squares = all_squares + band * step;
  __global SQUARE *square_prefix = all_square_prefixes + band * (step + BEYOND);
  squares_above(pixels, rows, columns, step, first, window, squares, square_prefix);
#endif
#if GATE
  __global CURVATURE *curved = all_curved + band * step;
  ulong total = 0;
#endif
  __global uchar *bytes = all_black + MASKS * band * step, *black = bytes + PAD;
  for (int y = first; y < end; ++y) {
    __global PIXEL *row = pixels + y * (long)step;
    __global const PIXEL *in = NEAR_PIXELS(y + reach), *out = NEAR_PIXELS(y - reach - 1);
    REPEAT_ENDS(PIXEL, row, PAD, after)
    next_sums(in, out, columns, reach, sums, prefix);
#if MASKS == 1
    compare(row, prefix, prefix + window, columns, window * window, offset, black);
#else
    next_squares(in, out, columns, reach, squares, square_prefix);
    compare_three(row, prefix, prefix + window, square_prefix, square_prefix + window, columns,
                  window * window, black, black + step, black + 2 * step);
#endif
    for (uint mask = 0; mask < MASKS; ++mask) {
      __global uint *bits = words + WORDS_MARGIN + (MASKS * p + mask) * plane_words;
      REPEAT_ENDS(uchar, black + mask * step, PAD, after)
      for (int k = y > 0 ? y : -REACH; k <= (y + 1 < (int)rows ? y : y + REACH); ++k)
        pack((__global const ulong *)(bytes + mask * step), step / 8,
             (__global uchar *)(bits + (k + REACH) * (step / 32)));
    }
#if GATE
    if (y > 0 && y + 1 < (int)rows && columns > 2) {
      curvature(row - step, row, row + step, columns, curved);
      total += amplitude(curved, curved + 1, curved + 2, columns - 2);
    }
#endif
  }
#if GATE
  noise[band] = total;
#endif
}
