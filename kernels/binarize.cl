#include "pixel.clh"

/* Binarization (section 3.1): black iff (I + C) n < S, with S the sum of the n = w w pixels of
 * the window, border repeated. A pixel of the binary image is 1 where black.
 *
 * WINDOW_SUM(T, F) adds F(-w/2) .. F(w/2) in type T; WIDE_SUM(T, F) adds as many of them in
 * type SUM_OF_COLUMN as it can hold, and these sums in type T. */

#ifndef WINDOW_SUM
#error "WINDOW_SUM must add over the window"
#endif

/* Repeat the border of the binary image, and empty the lists and the maxima. One work-item per
 * row. */
__kernel void repeat_border_binary(const uint rows, const uint columns, const uint step,
                                   __global uchar *restrict binary,
                                   __global uint *restrict counts,
                                   __global uint *restrict row_counts,
#if GATE
                                   __global uint *restrict passed,
#endif
                                   __global uint *restrict maxima) {
  const size_t row = get_global_id(0);
  REPEAT_BORDER(uchar, binary + ROW(0, row) + PAD)
  if (row % rows == 0)
    counts[row / rows * LISTS] = 0;
  row_counts[row] = 0;
  for (uint word = 0; word < step / 32; ++word) {
    maxima[row * (step / 32) + word] = 0;
#if GATE
    passed[row * (step / 32) + word] = 0;
#endif
  }
}

/* Sum of each pixel's column within the window. */
__kernel void column_sums(__global const PIXEL *restrict image, const uint rows,
                          const uint step, const SUM_OF_COLUMN zero,
                          __global SUM_OF_COLUMN *restrict sums) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
#define TERM(k) image[NEAR_ROW(p, (int)y + (k)) + x]
  sums[ROW(p, y) + x] = WINDOW_SUM(SUM_OF_COLUMN, TERM);
#undef TERM
}

/* Sum the column sums over the window, and compare. */
__kernel void binarize(__global const PIXEL *restrict image,
                       __global const SUM_OF_COLUMN *restrict sums, const uint rows,
                       const uint step, const LEVEL count, const LEVEL offset, const uint zero,
                       __global uchar *restrict binary) {
  const size_t i = ROW(get_global_id(2), get_global_id(1)) + get_global_id(0);
#define TERM(k) sums[i + (k)]
  binary[i] = (uchar)(((LEVEL)image[i] + offset) * count < (LEVEL)WIDE_SUM(uint, TERM));
#undef TERM
}
