#include "decide.clh"

/* Find the level of each list. One work-group per list of a frame. */
__kernel void find_reference(__global const ulong *restrict noise, const uint bands,
                             const uint rows, const uint columns, const uint full_scale,
                             const uint coarse_noise, const uint capacity,
                             const uint counters_of_frame, __global const uint *restrict counters,
                             __global const int *restrict lists,
                             __global Level *restrict levels) {
  __local ulong sums[DECIDING];
  find_level(get_group_id(0), get_group_id(1), get_num_groups(1), noise, bands, rows, columns,
             full_scale, coarse_noise, capacity, counters_of_frame, counters, lists, levels, sums);
}

/* Decide which maxima of a frame are corners. One work-group per frame. */
__kernel void decide(const uint octaves, __global const Level *restrict levels,
                     __global int *strong, const uint rows, const uint step, const uint capacity,
                     const int coarse_share, const int fine_share, const int nms_radius,
                     const uint corner_capacity, const uint count_offset, const uint length,
                     const uint counters_of_frame, __global uint *counters,
                     __global int *lists, __global uint *maxima, __global uint *row_counts,
                     __global int *row_columns, __global int *corners, __global uint *counts) {
  __local ulong sums[DECIDING];
  decide_frame(get_group_id(0), octaves, levels, strong, rows, step, capacity, coarse_share,
               fine_share, nms_radius, counters_of_frame, corner_capacity, count_offset, length,
               counters, lists, maxima, row_counts, row_columns, corners, counts, sums);
}
