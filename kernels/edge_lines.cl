#include "edges.clh"

/* EDGE_LINES (section 3.5, Fig. 9): the corner is where the edges between its sectors meet. One
 * work-item per corner. */
__kernel void edge_lines(__global const PIXEL *restrict image, __global const int *restrict corners,
                         __global const uint *restrict counts, const uint rows,
                         const uint columns, const uint step, const uint capacity,
                         const uint count_offset, const uint length, const float max_shift,
#if SCALED
                         const float scale, __global const float8 *restrict ring_samples,
#endif
#if EDGE_STEP
                         __global float *restrict start, __global float *restrict lines,
#endif
                         __global float *restrict result) {
  CORNER_OF_WORK_ITEM
  EDGES_OF_CORNER
  EDGE_LINES((float)from_x, (float)from_y, centroid_x, centroid_y)
#if EDGE_STEP
  LANE(start, 0) = (float)from_x;
  LANE(start, 1) = (float)from_y;
  STORE_LINES
#endif
}
