#include "cpu/edge_lines.clh"

/* EDGE_LINES for CPUs. */
__kernel void edge_lines_eight(CORNERS_TO_REFINE, __global float *restrict result) {
  FRAME_OF_WORK_ITEM
  FOR_EACH_EIGHT {
    EDGES_OF_EIGHT
    EDGE_LINES(start_x, start_y, centroid_x, centroid_y)
  }
}
