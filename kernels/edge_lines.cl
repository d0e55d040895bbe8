#include "edges.clh"

/* EDGE_LINES (section 3.5, Fig. 9): the corner is where the edges between its sectors meet. One
 * work-item per corner. */
__kernel void edge_lines(CORNERS_TO_REFINE, __global float *restrict result) {
  CORNER_OF_WORK_ITEM
  EDGES_OF_CORNER
  EDGE_LINES((float)from_x, (float)from_y, centroid_x, centroid_y)
}
