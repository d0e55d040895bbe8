#include "plane.clh"
#include "ring.clh"
#include "rank.clh"

/* The contrast gate: a maximum passes if its four sectors differ clearly in grey level.
 *
 * The four sectors are the runs of the inner ring; sample i of either ring belongs to the
 * sector of inner sample i. The contrast of a ring is the smallest white maximum minus the
 * largest black minimum. A candidate that is no maximum has no contrast. */

#define FULL ((PIXEL)(-1)) /* the largest grey level */
#define NO_CONTRAST (PIXEL_BITS == 8 ? SHRT_MIN : INT_MIN)
#define WORD_OF(bits) (bits + (p * rows + index / step) * (step / 32) + index % step / 32)

/* The contrast of the inner ring, the smaller contrast of the two rings, and the difference of the
 * sector means in sixteenths of a grey level. There are two runs or more. One work-item per
 * candidate; those that are no maxima are skipped. */
__kernel void sector_contrast(__global const PIXEL *restrict image,
                              __global const uchar *restrict binary,
                              __global const uint *restrict list,
                              __global const uint *restrict counts, const uint rows,
                              const uint step, const uint capacity,
                              __global const uint *restrict maxima,
                              __global CONTRAST *restrict inner_contrast,
                              __global CONTRAST *restrict contrast,
                              __global CONTRAST *restrict mean_difference) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  if (n >= min(counts[p * LISTS], capacity)) return;
  const uint index = list[p * capacity + n];
  const int x = index % step, y = index / step;
  contrast[p * capacity + n] = inner_contrast[p * capacity + n] = (CONTRAST)NO_CONTRAST;
  if (!(*WORD_OF(maxima) >> index % 32 & 1)) return;
#define GREY_AT(i, dx, dy) image[NEAR_ROW(p, y + (dy)) + x + (dx)],
#define COLOUR_AT(i, dx, dy) binary[NEAR_ROW(p, y + (dy)) + x + (dx)],
  const int inner[] = {INNER_RING(GREY_AT)}, outer[] = {OUTER_RING(GREY_AT)};
  const int black[] = {INNER_RING(COLOUR_AT)};
  int start = 0;
  while (black[start] == black[(start + 15) & 15]) ++start;

  int white_inner = FULL, white_outer = FULL, white_mean = INT_MAX;
  int black_inner = 0, black_outer = 0, black_mean = INT_MIN;
  for (int k = 0; k < 16;) {
    const int colour = black[(start + k) & 15];
    const int first = inner[(start + k) & 15], second = outer[(start + k) & 15];
    int low = first, high = first, outer_low = second, outer_high = second;
    int sum = 0, length = 0;
    for (; k < 16 && black[(start + k) & 15] == colour; ++k, ++length) {
      const int g = inner[(start + k) & 15], q = outer[(start + k) & 15];
      low = min(low, g);
      high = max(high, g);
      outer_low = min(outer_low, q);
      outer_high = max(outer_high, q);
      sum += g + q;
    }
    if (colour) {
      black_inner = max(black_inner, low);
      black_outer = max(black_outer, outer_low);
      black_mean = max(black_mean, 8 * sum / length);
    } else {
      white_inner = min(white_inner, high);
      white_outer = min(white_outer, outer_high);
      white_mean = min(white_mean, 8 * sum / length);
    }
  }
  const size_t i = p * capacity + n;
  inner_contrast[i] = (CONTRAST)(white_inner - black_inner);
  contrast[i] = (CONTRAST)min(white_inner - black_inner, white_outer - black_outer);
  mean_difference[i] = (CONTRAST)(white_mean - black_mean);
}

/* From the 90th percentile of the inner contrasts the bounds of the gate: contrast >= limit[P90]
 * and 2 N sm >= F A. One work-group per plane. */
__kernel void percentile(__global const CONTRAST *restrict inner_contrast,
                         __global const uint *restrict counts, const uint capacity,
                         __global const ulong *restrict noise_sums,
                         __global const int *restrict limit, const uint rows, const uint columns,
                         const uint bands, const uint noise_factor,
                         __global int2 *restrict bounds) {
  const size_t p = get_group_id(2);
  __local uint bins[BINS], found;
  __local int rank;
  if (get_local_id(0) == 0) found = 0;
  for (int shift = PIXEL_BITS - 8; shift >= 0; shift -= 8) {
    empty_bins(bins);
    FOR_ITEMS(n, min(counts[p * LISTS], capacity)) {
      const int contrast = inner_contrast[p * capacity + n];
      if (contrast != NO_CONTRAST) count_byte(bins, max(contrast, 0), shift, found);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (get_local_id(0) == 0) {
      if (shift == PIXEL_BITS - 8) rank = (9 * sum_of(bins) + 9) / 10 - 1;
      found = found << 8 | byte_of(bins, &rank);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
  }
  if (get_local_id(0)) return;
  ulong noise = 0;
  for (uint band = 0; band < bands; ++band) noise += noise_sums[p * bands + band];
  const ulong twice = 2 * (ulong)(rows > 2 ? rows - 2 : 0) * (columns > 2 ? columns - 2 : 0);
  const ulong bound = twice ? (noise_factor * noise + twice - 1) / twice : 0;
  bounds[p] = (int2)(limit[found], twice ? (int)min(bound, (ulong)INT_MAX) : INT_MIN);
}

/* Keep the maxima that pass the gate. One work-item per candidate. */
__kernel void pass_gate(__global const uint *restrict list, __global const uint *restrict counts,
                        __global const CONTRAST *restrict contrast,
                        __global const CONTRAST *restrict mean_difference,
                        __global const int2 *restrict bounds, const uint rows, const uint step,
                        const uint capacity, __global uint *restrict passed,
                        __global uint *restrict row_counts) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  if (n >= min(counts[p * LISTS], capacity) || contrast[p * capacity + n] == NO_CONTRAST) return;
  const size_t i = p * capacity + n;
  if (contrast[i] < bounds[p].x || mean_difference[i] < bounds[p].y) return;
  const uint index = list[i];
  atomic_or(WORD_OF(passed), 1u << index % 32);
  atomic_inc(row_counts + p * rows + index / step);
}
