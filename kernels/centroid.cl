#include "plane.clh"

/* The corners of a frame, as refinement reads them. The columns, of `length` rows each, are x,
 * y, the response, the sum and the moments in x and y of the responses of the 5 x 5 around it,
 * and the octave. Corner n of frame p has row p * capacity + n. */

/* List the maxima in (y, x) order, whatever the order of the work-items. Bit k of word i of a
 * row is pixel 32 i + k. The number of corners, counts[count_offset + p], may exceed the
 * capacity. One work-item per row. */
__kernel void list_maxima(__global const uint *restrict maxima,
                          __global const uint *restrict row_counts, const uint rows,
                          const uint step, const uint capacity, const uint count_offset,
                          const uint length, __global int *restrict corners,
                          __global uint *restrict counts) {
  const size_t y = get_global_id(0), p = get_global_id(1);
  uint n = 0;
  for (uint row = 0; row < y; ++row) n += row_counts[p * rows + row];
  for (uint i = 0; i < step / 32; ++i)
    for (uint left = maxima[(p * rows + y) * (step / 32) + i]; left; left &= left - 1, ++n) {
      if (n >= capacity) continue;
      corners[p * capacity + n] = (int)(32 * i + 31 - clz(left & (0u - left))) - PAD;
      corners[length + p * capacity + n] = (int)y;
    }
  if (y + 1 == rows) counts[count_offset + p] = n;
}

/* The response and its moments. One work-item per corner. */
__kernel void centroid(__global const RESPONSE *restrict response,
                       __global const uint *restrict counts, const uint rows, const uint step,
                       const uint capacity, const uint count_offset, const uint length,
                       __global int *restrict corners) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  if (n >= min(counts[count_offset + p], capacity)) return;
  __global int *corner = corners + p * capacity + n;
  const int x = PAD + corner[0], y = corner[length];
  SUMS_OF_25(response, x, y)
  corner[2 * (size_t)length] = (int)response[ROW(p, y) + x];
  corner[3 * (size_t)length] = sum;
  corner[4 * (size_t)length] = sum_x;
  corner[5 * (size_t)length] = sum_y;
  corner[6 * (size_t)length] = 0;
}
