#include "plane.clh"

/* The working scale: the image resampled with separable integer weights of sum 2048, rounded.
 * One work-item per pixel of the scaled image. Taps outside the image have no weight; in a row they
 * read its padding. */

__kernel void resample(__global const PIXEL *restrict image, __global const int *restrict first_y,
                       __global const int *restrict weight_y, __global const int *restrict first_x,
                       __global const int *restrict weight_x, const uint full_rows,
                       const uint full_step, const uint rows, const uint step,
                       __global PIXEL *restrict scaled) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  __global const PIXEL *pixels = image + (p * full_rows + 1) * full_step + PAD + first_x[x];
  WEIGHTED sum = 0;
#pragma unroll
  for (uint j = 0; j < TAPS_Y; ++j) {
    const uint v = SMALLER((uint)first_y[y] + j, full_rows - 1);
    __global const PIXEL *row = pixels + (size_t)v * full_step;
    uint line = 0;
#pragma unroll
    for (uint i = 0; i < TAPS_X; ++i) line += (uint)weight_x[i * step + x] * row[i];
    sum += (WEIGHTED)line * (uint)weight_y[y * TAPS_Y + j];
  }
  scaled[ROW(p, y) + x] = (PIXEL)((sum + (1u << 21)) >> 22);
}
