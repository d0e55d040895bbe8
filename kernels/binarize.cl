/* Binarization (section 3.1): black iff (I + C) n < S, with S the sum of the n = w w pixels
 * of the window, border repeated.
 *
 * WINDOW_SUM(T, F) adds F(-w/2) .. F(w/2) in type T; WIDE_SUM(T, F) adds as many of them in type
 * COLUMN as it can hold, and these sums in type T. */

#ifndef WINDOW_SUM
#error "WINDOW_SUM must add over the window"
#endif

/* Repeat the border pixel in the PAD columns on either side. One work-item per row. */
#define REPEAT_BORDER(NAME, T)                                                      \
  __kernel void NAME(const uint rows, const uint columns, const uint step,          \
                     __global T *restrict image) {                                  \
    __global T *row = image + ROW(0, get_global_id(0)) + PAD;                       \
    const T first = row[0], last = row[columns - 1];                                \
    for (int k = 1; k <= PAD; ++k) row[-k] = first;                                 \
    for (int k = 0; k < (int)(step - PAD - columns); ++k) row[columns + k] = last;  \
  }

REPEAT_BORDER(repeat_border, PIXEL)
REPEAT_BORDER(repeat_border_binary, uchar)

/* Sum of each pixel's column within the window. */
__kernel void column_sums(__global const PIXEL *restrict image, const uint rows,
                          const uint step, const COLUMN zero,
                          __global COLUMN *restrict sums) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
#define TERM(k) image[NEAR_ROW(p, (int)y + (k)) + x]
  sums[ROW(p, y) + x] = WINDOW_SUM(COLUMN, TERM);
#undef TERM
}

/* Sum over the window of the columns' sums, and the comparison. */
__kernel void binarize(__global const PIXEL *restrict image,
                       __global const COLUMN *restrict sums, const uint rows,
                       const uint step, const LEVEL count, const LEVEL offset,
                       const uint zero, __global uchar *restrict binary) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  const size_t i = ROW(p, y) + x;
#define TERM(k) sums[i + (k)]
  binary[i] = (uchar)(((LEVEL)image[i] + offset) * count < (LEVEL)WIDE_SUM(uint, TERM));
#undef TERM
}

#if MASKS == 3

/* Sum of squares of each pixel's column within the window. */
__kernel void column_squares(__global const PIXEL *restrict image, const uint rows,
                             const uint step, const SQUARE zero,
                             __global SQUARE *restrict squares) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
#define GREY(k) (SQUARE)image[NEAR_ROW(p, (int)y + (k)) + x]
#define TERM(k) GREY(k) * GREY(k)
  squares[ROW(p, y) + x] = WINDOW_SUM(SQUARE, TERM);
#undef TERM
#undef GREY
}

/* Three masks, black iff I < mean - k sigma for k = 0, -1/2, +1/2: with d = n I - S and
 * v = n Q - S S, the variance times n n, k sigma n is half the root of v. */
__kernel void binarize_three(__global const PIXEL *restrict image,
                             __global const COLUMN *restrict sums,
                             __global const SQUARE *restrict squares, const uint rows,
                             const uint step, const ulong count, const ulong zero,
                             __global uchar *restrict binary) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  const size_t i = ROW(p, y) + x;
#define TERM(k) (ulong)sums[i + (k)]
  const ulong s = WINDOW_SUM(ulong, TERM);
#undef TERM
#define TERM(k) (ulong)squares[i + (k)]
  const ulong v = count * WINDOW_SUM(ulong, TERM) - s * s;
#undef TERM
  const ulong level = count * (ulong)image[i];
  const ulong distance = level < s ? s - level : level - s;
  const ulong square = distance * distance;
  binary[ROW(3 * p, y) + x] = (uchar)(level < s);
  binary[ROW(3 * p + 1, y) + x] = (uchar)(level < s || square < (v + 3) / 4);
  binary[ROW(3 * p + 2, y) + x] = (uchar)(level < s && square > v / 4);
}

#endif
