#include "octave.clh"

/* Halving for CPUs: one launch makes all octaves. */

#define ROWS_OF_FRAME (1 << OCTAVES)

/* Two neighbouring pixels, of which the first is in the lower bits. */
#if PIXEL_BITS == 8
typedef ushort PAIR;
#else
typedef uint PAIR;
#endif
typedef PAIR __attribute__((aligned(PIXEL_BITS / 8))) PAIR_ANYWHERE;
#define SUM_OF(pair) (((pair) & ((1u << PIXEL_BITS) - 1)) + ((pair) >> PIXEL_BITS))

__attribute__((noinline)) void halve_row(__global const PAIR_ANYWHERE *restrict upper,
                                         __global const PAIR_ANYWHERE *restrict lower,
                                         __global PIXEL *restrict half_row, const int width) {
  for (int x = 0; x < width; ++x)
    half_row[x] = (PIXEL)((SUM_OF((uint)upper[x]) + SUM_OF((uint)lower[x]) + 2) >> 2);
}

/* Halve as many rows of a frame as make one of the last octave. The frame has its first pixel at
 * `frame_start` and rows of `frame_step` elements; the octaves lie behind the frames in `image`.
 * One work-item for these rows. */
__kernel void halve_rows(__global const PIXEL *frame, const uint frame_start,
                         const uint frame_step, __global PIXEL *image, const uint rows,
                         const uint columns, const uint step) {
  const uint first = get_global_id(0) * ROWS_OF_FRAME;
  const size_t p = get_global_id(1), frames = get_global_size(1);
  __global const PIXEL *from = frame + frame_start + p * rows * frame_step;
  size_t from_step = frame_step;
  for (uint n = 1; n <= OCTAVES; ++n) {
    const Octave octave = octave_of(n, rows, columns, step, frames);
    __global PIXEL *to = image + octave.start + (p * octave.rows + 1) * octave.step + PAD;
    const uint end = SMALLER((first + ROWS_OF_FRAME) >> n, octave.rows);
    for (uint y = first >> n; y < end; ++y)
      halve_row((__global const PAIR_ANYWHERE *)(from + 2 * y * from_step),
                (__global const PAIR_ANYWHERE *)(from + (2 * y + 1) * from_step),
                to + y * octave.step, (int)octave.columns);
    from = to;
    from_step = octave.step;
  }
}
