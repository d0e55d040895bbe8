#include "plane.clh"

/* The working scale: the image resampled with separable integer weights of sum 2048, rounded.
 * One work-item per pixel of the scaled image. Taps outside the image have no weight; in a row they
 * read its padding. */

__kernel void resample(__global const PIXEL *restrict image, __global const int *restrict first_y,
                       __global const int *restrict weight_y, const uint taps_y,
                       __global const int *restrict first_x, __global const int *restrict weight_x,
                       const uint taps_x, const uint full_rows, const uint full_step,
                       const uint rows, const uint columns, const uint step,
                       __global PIXEL *restrict scaled) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  if (x >= columns) return;
  __global const PIXEL *pixels = image + (p * full_rows + 1) * full_step + PAD + first_x[x];
  ulong sum = 0;
  for (uint j = 0; j < taps_y; ++j) {
    const uint v = SMALLER((uint)first_y[y] + j, full_rows - 1);
    __global const PIXEL *row = pixels + (size_t)v * full_step;
    uint line = 0;
    for (uint i = 0; i < taps_x; ++i) line += (uint)weight_x[i * columns + x] * row[i];
    sum += (ulong)line * (uint)weight_y[y * taps_y + j];
  }
  scaled[ROW(p, y) + PAD + x] = (PIXEL)((sum + (1u << 21)) >> 22);
}
