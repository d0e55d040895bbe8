#include "plane.clh"

/* Halve an image: (sum of 2 x 2 + 2) >> 2. One work-item per pixel of the half; in the padding it
 * repeats the border. */
__kernel void halve(__global const PIXEL *restrict image, const uint full_rows,
                    const uint full_step, const uint rows, const uint columns, const uint step,
                    __global PIXEL *restrict half_image) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  const int column = clamp((int)x - PAD, 0, (int)columns - 1);
  __global const PIXEL *upper = image + (p * full_rows + 2 * y + 1) * full_step + PAD + 2 * column;
  __global const PIXEL *lower = upper + full_step;
  const uint sum = (uint)upper[0] + upper[1] + lower[0] + lower[1];
  half_image[ROW(p, y) + x] = (PIXEL)((sum + 2) >> 2);
}
