#include "edges.clh"

/* EDGE_LINES (section 3.5, Fig. 9): the corner is where the edges between its sectors meet. One
 * work-item per corner. */
__kernel void edge_lines(__global const PIXEL *restrict image, __global const int *restrict corners,
                         __global const uint *restrict counts, const uint rows,
                         const uint columns, const uint step, const uint capacity,
                         const uint count_offset, const uint length, const float max_shift,
                         const float scale,
#if SCALED
                         __global const float8 *restrict ring_samples,
#endif
                         __global float *restrict result) {
  CORNER_OF_WORK_ITEM
  EDGES_OF_CORNER
  EDGE_LINES((float)from_x, (float)from_y, centroid_x, centroid_y)
}
