#include "plane.clh"

/* The noise of an image (Immerkaer's estimate): sums of |[1 -2 1]^T [1 -2 1] * I| over the inner
 * pixels. */

/* The sums of NOISE_BAND rows of a column. One work-item per column of a band. */
__kernel void noise(__global const PIXEL *restrict image, const uint rows, const uint step,
                    const CURVATURE zero, __global NOISE *restrict sums) {
  const size_t x = get_global_id(0), band = get_global_id(1), p = get_global_id(2);
  const int y = (int)band * NOISE_BAND;
#define ACROSS(k)                                                                   \
  (CURVATURE)(image[NEAR_ROW(p, y + (k)) + x - 1] - 2 * image[NEAR_ROW(p, y + (k)) + x] + \
              image[NEAR_ROW(p, y + (k)) + x + 1])
  const CURVATURE before = ACROSS(-1), h0 = ACROSS(0) ^ zero, h1 = ACROSS(1), h2 = ACROSS(2) ^ zero;
  const CURVATURE h3 = ACROSS(3), h4 = ACROSS(4) ^ zero, h5 = ACROSS(5), h6 = ACROSS(6) ^ zero;
  const CURVATURE h7 = ACROSS(7), after = ACROSS(8) ^ zero;
#define INNER_ROW(k) (CURVATURE)(y + (k) > 0 && y + (k) + 1 < (int)rows ? -1 : 0)
#define CURVED(above, here, below) (CURVATURE)((above) - 2 * (here) + (below))
#define ABSOLUTE(v) (NOISE)((v) < 0 ? -(v) : (v))
#define AT_ROW(k, above, here, below) (ABSOLUTE(CURVED(above, here, below)) & (NOISE)INNER_ROW(k))
  sums[(p * get_global_size(1) + band) * step + x] =
      SUM3(NOISE,
           SUM3(NOISE, AT_ROW(0, before, h0, h1), AT_ROW(1, h0, h1, h2), AT_ROW(2, h1, h2, h3)),
           SUM3(NOISE, AT_ROW(3, h2, h3, h4), AT_ROW(4, h3, h4, h5), AT_ROW(5, h4, h5, h6)),
           SUM3(NOISE, AT_ROW(6, h5, h6, h7), AT_ROW(7, h6, h7, after), 0));
}

/* Sum them over the inner columns. `bands` is those of the frame, of which a halved one has fewer.
 * One work-group per band. */
__kernel void sum_bands(__global const NOISE *restrict sums, const uint columns,
                        const uint step, const uint octave, const uint bands,
                        __global ulong *restrict noise) {
  const size_t band = get_group_id(0), p = get_global_id(1), frames = get_global_size(1);
  __global const NOISE *own = sums + (p * get_num_groups(0) + band) * step;
  __local ulong parts[GROUP];
  ROW_NOISE sum = 0;
  for (uint x = 1 + get_local_id(0); x + 1 < columns; x += GROUP) sum += own[PAD + x];
  const ulong total = sum_of_group(sum, parts);
  if (get_local_id(0) == 0) noise[(octave * frames + p) * bands + band] = total;
}
