#include "result.clh"
#include "rank.clh"

/* What the residuals of all corners of a frame, octave by octave, say about each variance. Noise
 * that neighbouring pixels share moves a corner by more than other noise: the median grain tells.
 * What the model does not explain and is odd about a corner moves it too, and the median of the
 * autocorrelations tells how much it is at least. What is even, as ink that joins two squares, does
 * not. */
#define LEVELS (OCTAVES + 1)
#define MEDIANS 2 /* of an octave */
#define FEW 8 /* corners that do not tell what the noise is */
#define VARIANCE_OF_GRAIN 2.2f
#define VARIANCE_OF_ODD 1000 /* px^2 per squared autocorrelation */
#define DOUBT 0.010f /* excess of an autocorrelation over the median */

/* An integer in the order of the number, and the number. */
uint ordered(const float v) {
  const uint bits = as_uint(v);
  return bits & 0x80000000u ? ~bits : bits | 0x80000000u;
}
float number_of(const uint order) {
  return as_float(order & 0x80000000u ? order & 0x7fffffffu : ~order);
}

/* Of each frame and octave, the median autocorrelation of the residuals of the corners that
 * EDGE_STEP accepted, -INFINITY if there are none; then the median of their grains and of FEW
 * that are 0. Of two values it is the lower one. Byte by byte from the first. One work-group for
 * each. */
__kernel void typical_residual(__global float *restrict result,
                               __global const uint *restrict counts, const uint capacity,
                               const uint count_offset, __global float *restrict typical) {
  const size_t octave = get_group_id(1) / MEDIANS, p = get_group_id(2);
  const uint is_grain = get_group_id(1) % MEDIANS;
  RESULT_OF_FRAME(counts[count_offset + p])
  const uint total = SMALLER(counts[count_offset + p], capacity);
  const int few = is_grain ? FEW : 0;
  __local uint bins[BINS], found;
  __local int rank;
  if (get_local_id(0) == 0) found = 0;
  for (int shift = 24; shift >= 0; shift -= 8) {
    empty_bins(bins);
    FOR_ITEMS(n, total)
      if (*RESULT_METHOD == METHOD_EDGE_STEP && *RESULT_OCTAVE == octave)
        count_byte(bins, ordered(is_grain ? *RESULT_GRAIN : *RESULT_CORRELATION), shift, found);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (get_local_id(0) == 0) {
      const int all = few + sum_of(bins);
      if (shift == 24) rank = all > 0 ? (all - 1) / 2 - few : -1;
      found = found << 8 | byte_of(bins, &rank);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (rank < 0) break;
  }
  if (get_local_id(0) == 0)
    typical[(p * LEVELS + octave) * MEDIANS + is_grain] =
        rank < 0 ? (is_grain ? 0 : -INFINITY) : number_of(found);
}

/* The variance of a position, with what the residuals tell, and whether the corner is doubtful: its
 * surroundings do not look like the model, and those of most others do. One work-item a corner. */
__kernel void grow_variance(__global float *restrict result, __global const uint *restrict counts,
                            const uint capacity, const uint count_offset,
                            __global const float2 *restrict typical) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  const uint total = SMALLER(counts[count_offset + p], capacity);
  if (n >= total) return;
  RESULT_OF_FRAME(total)
  const uint octave = *RESULT_OCTAVE;
  const float2 median = typical[p * LEVELS + octave];
  const float correlation = *RESULT_CORRELATION, odd = fmax(fmax(correlation, median.x), 0.0f);
  const float coarse = fmax(VARIANCE_OF_GRAIN * median.y - 1, 0.0f);
  const float area = (float)(1 << 2 * octave); /* px^2 of the frame, of a pixel of the octave */
  float variance = *RESULT_VARIANCE;
  if (*RESULT_METHOD == METHOD_EDGE_STEP)
    variance += coarse * (variance - STEP_ERROR * STEP_ERROR * area);
  *RESULT_VARIANCE = variance + VARIANCE_OF_ODD * odd * odd * area;
  *RESULT_DOUBTFUL = correlation - median.x > DOUBT;
}
