#include "cpu/edge_lines.clh"

/* EDGE_LINES for CPUs. */
__kernel void edge_lines_eight(__global const PIXEL *restrict image,
                               __global const int *restrict corners,
                               __global const uint *restrict counts, const uint rows,
                               const uint columns, const uint step, const uint capacity,
                               const uint count_offset, const uint length,
                               const float max_shift, const float scale,
#if SCALED
                               const uint ring_reach, __global const float8 *restrict ring_samples,
#endif
                               __global float *restrict result) {
  FRAME_OF_WORK_ITEM
  FOR_EACH_EIGHT {
    EDGES_OF_EIGHT
    EDGE_LINES(start_x, start_y, centroid_x, centroid_y)
  }
}
