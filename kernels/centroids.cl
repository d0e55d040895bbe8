#include "result.clh"

/* Positions without refinement: the centroids of the responses. One work-item per corner. */
__kernel void centroids(__global const int *restrict corners, __global const uint *restrict counts,
                        const uint capacity, const uint count_offset, const uint length,
                        __global float *restrict result) {
  CORNER_OF_WORK_ITEM
  STORE_CENTROID(METHOD_CENTROID, REFUSED_NONE)
}
