/* The contrast gate: does a candidate have four sectors of clearly different grey?
 *
 * The four sectors are the runs of the inner ring; sample i of either ring belongs to the
 * sector of inner sample i. The contrast of a ring is the smallest white maximum minus the
 * largest black minimum. */

#define FULL ((PIXEL)(-1)) /* the largest grey */

#define BINS 256 /* of the histograms that the percentile is read from */

#if !IN_WORDS

#if PIXEL_BITS == 8
typedef ushort4 NOISE4;
typedef uint4 NOISES;
#define CONVERT_NOISES convert_uint4
#else
typedef uint4 NOISE4;
typedef ulong4 NOISES;
#define CONVERT_NOISES convert_ulong4
#endif

/* Noise: sums of |[1 -2 1]^T [1 -2 1] * I| over the inner pixels, NOISE_BAND rows of a column at
 * a time. One work-item per column of a band. */
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

/* Their sum over the inner columns, and empty bins. One work-item per band. */
__kernel void noise_of_band(__global const NOISE *restrict sums, const uint columns,
                            const uint step, __global ulong *restrict totals,
                            __global uint *restrict bins) {
  const size_t band = get_global_id(0), bands = get_global_size(0), p = get_global_id(1);
  const size_t row = p * bands + band;
  for (size_t b = band; b < MASKS * BINS; b += bands) bins[p * MASKS * BINS + b] = 0;
  __global const NOISE *sum = sums + row * step + PAD;
  if (columns < 3) {
    totals[row] = 0;
    return;
  }
  NOISES four = 0;
  uint x = 0;
  for (; x + 4 < columns; x += 4) four += CONVERT_NOISES(*(__global const NOISE4 *)(sum + x));
  BAND_NOISE total = four.x + four.y + four.z + four.w - sum[0];
  for (; x + 1 < columns; ++x) total += sum[x];
  totals[row] = total;
}

/* Contrast of the inner ring, the smaller one of both rings and the difference of the sector
 * means in eighths of twice a grey level, for any number of runs from two on; the inner contrasts
 * are counted by their highest eight bits. One work-item per candidate. */
__kernel void sector_contrast(__global const PIXEL *restrict image,
                              __global const uchar *restrict binary,
                              __global const uint *restrict list,
                              __global const uint *restrict totals, const uint rows,
                              const uint step, const uint room,
                              __global CONTRAST *restrict inner_contrast,
                              __global CONTRAST *restrict contrast,
                              __global CONTRAST *restrict mean_difference,
                              __global uint *restrict bins) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  if (n >= min(totals[p], room)) return;
  const uint place = list[p * room + n], layer = p % MASKS;
  const int x = place % step, y = place / step;
  const size_t frame = p / MASKS;
#define GREY_AT(i, dx, dy) image[NEAR_ROW(frame, y + (dy)) + x + (dx)],
#define COLOUR_AT(i, dx, dy) binary[NEAR_ROW(frame, y + (dy)) + x + (dx)] >> layer & 1,
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
  const size_t i = p * room + n;
  atomic_inc(bins + p * BINS + (max(white_inner - black_inner, 0) >> (PIXEL_BITS - 8)));
  inner_contrast[i] = (CONTRAST)(white_inner - black_inner);
  contrast[i] = (CONTRAST)min(white_inner - black_inner, white_outer - black_outer);
  mean_difference[i] = (CONTRAST)(white_mean - black_mean);
}

#endif

/* The 90th percentile of the inner contrasts: eight bits of it at a time, the highest first.
 * What a level leaves to the next is (the bits found, the rank within them) and empty bins. */

#if PIXEL_BITS == 16

/* How often the lower eight bits occur. One work-item per candidate. */
__kernel void histogram(__global const CONTRAST *restrict inner_contrast,
                        __global const uint *restrict total,
                        __global const uint2 *restrict found, const uint room,
                        __global uint *restrict bins) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  if (n >= min(total[p], room)) return;
  const uint value = (uint)max((int)inner_contrast[p * room + n], 0);
  if (value >> 8 == found[p].x) atomic_inc(bins + p * BINS + (value & 255));
}

#endif

/* Find the next eight bits; at the last level, the bounds of the gate:
 * contrast >= limit[P90] and 2 N sm >= F A. `counts` may be the bins. One work-item per plane. */
__kernel void percentile(__global const uint *counts, __global const uint *restrict total,
                         __global const ulong *restrict noise_totals,
                         __global const int *restrict limit, const uint rows,
                         const uint columns, const uint bands, const uint room,
                         const uint shift,
                         const uint parts, const uint noise_factor,
                         __global uint *bins, __global uint2 *restrict found,
                         __global int2 *restrict bounds) {
  const size_t p = get_global_id(0);
  const uint n = min(total[p], room);
  const bool first = shift + 8 == PIXEL_BITS;
  const uint rank = first ? (9 * n + 9) / 10 : found[p].y;
  uint bin = 0, count = 0, below = 0;
  for (uint b = 0; b < BINS; ++b) { /* to the end: the reads need not wait for one another */
    for (uint part = 0; part < parts; ++part) count += counts[(p * parts + part) * BINS + b];
    if (count < rank) {
      bin = b + 1;
      below = count;
    }
  }
  const uint value = (first ? 0 : found[p].x << 8) | bin;
  if (shift > 0) {
    found[p] = (uint2)(value, rank - below);
    for (uint b = 0; b < BINS; ++b) bins[p * BINS + b] = 0;
    return;
  }
  ulong noise = 0;
  for (uint band = 0; band < bands; ++band) noise += noise_totals[p / MASKS * bands + band];
  const ulong twice = 2 * (ulong)(rows > 2 ? rows - 2 : 0) * (columns > 2 ? columns - 2 : 0);
  const ulong bound = twice ? (noise_factor * noise + twice - 1) / twice : 0;
  bounds[p] = (int2)(limit[value], twice ? (int)min(bound, (ulong)INT_MAX) : INT_MIN);
}
