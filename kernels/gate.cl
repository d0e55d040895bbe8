/* The contrast gate: does a candidate have four sectors of clearly different grey?
 *
 * The four sectors are the runs of the inner ring; sample i of either ring belongs to the
 * sector of inner sample i. With h = grey where white and the complement where black, the
 * contrast of a ring is min(M0, M2) + min(M1, M3) - FULL for the largest h of each run: the
 * smallest white maximum minus the largest black minimum, whichever colour run 0 has. */

#define FULL ((PIXEL)(-1)) /* the complement of g is FULL - g = g ^ FULL */

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

#endif

/* floor(8 s / n), exactly. A byte's quotient lies at least 0.5 / 16 from where rounding could
 * change its floor; a longer one is put right by its remainder. */
MEANS mean_of_run(const SUM s, const PIXEL n) {
  const int count = n > 0 ? n : 1;
#if PIXEL_BITS == 8
  return (MEANS)(((float)(int)(8 * s) + 0.5f) / (float)count);
#else
  const int sum = (int)(8 * s);
  const int quotient = (int)((float)sum / (float)count);
  const int rest = sum - quotient * count;
  return quotient + (rest >= count) - (rest < 0);
#endif
}

#if RAPID && !IN_WORDS

/* Copy what the rings of a candidate see, so that neighbouring work-items of the next kernel
 * read neighbouring bytes: in blocks of GROUP candidates 16 inner greys, 16 outer greys, and the
 * inner ring as 0 where white and FULL where black. One work-item per candidate. */
#define CHANNELS 48
#define BLOCK(n, p) (((size_t)(p) * room + (n) / GROUP * GROUP) * CHANNELS + (n) % GROUP)

__kernel void sample_rings(__global const PIXEL *restrict image,
                           __global const uchar *restrict binary,
                           __global const int2 *restrict list,
                           __global const uint *restrict total, const uint rows,
                           const uint step, const uint room,
                           __global PIXEL *restrict samples) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  if (n >= total[p] || n >= room) return;
  const int x = list[p * room + n].x + PAD, y = list[p * room + n].y;
  __global const PIXEL *grey = image + ROW(p / MASKS, 0) + x;
  __global const uchar *black = binary + ROW(p, 0) + x;
  __global PIXEL *column = samples + BLOCK(n, p);
#define LINE(dy) ((size_t)SMALLER(LARGER(y + (dy), 0), (int)rows - 1) * step)
  const size_t line[] = {LINE(-5), LINE(-4), LINE(-3), LINE(-2), LINE(-1), LINE(0),
                         LINE(1),  LINE(2),  LINE(3),  LINE(4),  LINE(5)};
#define COPY_INNER(i, dx, dy)                                                       \
  column[(i) * GROUP] = grey[line[(dy) + REACH] + (dx)];                            \
  column[((i) + 32) * GROUP] = (PIXEL)(0 - black[line[(dy) + REACH] + (dx)]);
  INNER_RING(COPY_INNER)
#define COPY_OUTER(i, dx, dy) column[((i) + 16) * GROUP] = grey[line[(dy) + REACH] + (dx)];
  OUTER_RING(COPY_OUTER)
}

#define CHANNEL(k) samples[first + (k) * GROUP]
#undef RUN_INDEX /* that of bytes, in criteria.cl */
#define RUN_INDEX(i, before)                                                        \
  const PIXEL lo##i = a##i ^ a0;                                                    \
  const PIXEL hi##i = hi##before ^ ((a##i ^ a##before) & lo##before);
#define LOAD(i, j, k)                                                               \
  const PIXEL g##i = CHANNEL(i), q##i = CHANNEL(i + 16), a##i = CHANNEL(i + 32);

/* The samples of one sector, 0 elsewhere. */
#define IN_RUN_0(i) (PIXEL)(~(lo##i | hi##i))
#define IN_RUN_1(i) (PIXEL)(lo##i & ~hi##i)
#define IN_RUN_2(i) (PIXEL)(hi##i & ~lo##i)
#define IN_RUN_3(i) (PIXEL)(lo##i & hi##i)
#define INNER_0(i) (PIXEL)((g##i ^ a##i) & IN_RUN_0(i))
#define INNER_1(i) (PIXEL)((g##i ^ a##i) & IN_RUN_1(i))
#define INNER_2(i) (PIXEL)((g##i ^ a##i) & IN_RUN_2(i))
#define INNER_3(i) (PIXEL)((g##i ^ a##i) & IN_RUN_3(i))
#define OUTER_0(i) (PIXEL)((q##i ^ a##i) & IN_RUN_0(i))
#define OUTER_1(i) (PIXEL)((q##i ^ a##i) & IN_RUN_1(i))
#define OUTER_2(i) (PIXEL)((q##i ^ a##i) & IN_RUN_2(i))
#define OUTER_3(i) (PIXEL)((q##i ^ a##i) & IN_RUN_3(i))
/* Sums over the samples with lo, with hi and with both give those of the four runs. */
#define GREYS(i) (SUM)((SUM)g##i + (SUM)q##i)
#define WIDE(mask) ((SUM)0 - (SUM)((mask) & 1))
#define GREYS_LO(i) (SUM)(GREYS(i) & WIDE(lo##i))
#define GREYS_HI(i) (SUM)(GREYS(i) & WIDE(hi##i))
#define GREYS_BOTH(i) (SUM)(GREYS(i) & WIDE(lo##i & hi##i))
#define ONE_LO(i) (PIXEL)(lo##i & 1)
#define ONE_HI(i) (PIXEL)(hi##i & 1)
#define ONE_BOTH(i) (PIXEL)(lo##i & hi##i & 1)

/* Contrast of the inner ring, the smaller one of both rings, the difference of the sector means
 * in eighths of twice a grey level, and the response (Eqs. 21 and 24). One work-item per
 * candidate; the entries past the last candidate hold nothing and are never used. */
__kernel void sector_contrast(__global const PIXEL *restrict samples, const uint room,
                              const CONTRAST sector_threshold, const PIXEL zero,
                              __global CONTRAST *restrict inner_contrast,
                              __global CONTRAST *restrict contrast,
                              __global CONTRAST *restrict mean_difference,
                              __global CONTRAST *restrict responses) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  const size_t first = (p * room + get_group_id(0) * GROUP) * CHANNELS + get_local_id(0);
  AROUND(LOAD)
  const PIXEL lo0 = 0, hi0 = 0;
  RUN_INDEX(1, 0) RUN_INDEX(2, 1) RUN_INDEX(3, 2) RUN_INDEX(4, 3) RUN_INDEX(5, 4)
  RUN_INDEX(6, 5) RUN_INDEX(7, 6) RUN_INDEX(8, 7) RUN_INDEX(9, 8) RUN_INDEX(10, 9)
  RUN_INDEX(11, 10) RUN_INDEX(12, 11) RUN_INDEX(13, 12) RUN_INDEX(14, 13) RUN_INDEX(15, 14)

  const PIXEL m0 = LARGEST_RING(PIXEL, INNER_0), m1 = LARGEST_RING(PIXEL, INNER_1);
  const PIXEL m2 = LARGEST_RING(PIXEL, INNER_2), m3 = LARGEST_RING(PIXEL, INNER_3);
  const PIXEL n0 = LARGEST_RING(PIXEL, OUTER_0), n1 = LARGEST_RING(PIXEL, OUTER_1);
  const PIXEL n2 = LARGEST_RING(PIXEL, OUTER_2), n3 = LARGEST_RING(PIXEL, OUTER_3);
  const CONTRAST inner = (CONTRAST)SMALLER(m0, m2) + (CONTRAST)(SMALLER(m1, m3) ^ zero) - FULL;
  const CONTRAST outer = (CONTRAST)(SMALLER(n0, n2) ^ zero) + (CONTRAST)SMALLER(n1, n3) - FULL;

  const SUM s3 = SUM_RING(SUM, GREYS_BOTH);
  const SUM s1 = (SUM)(SUM_RING(SUM, GREYS_LO) - s3);
  const SUM s2 = (SUM)((SUM_RING(SUM, GREYS_HI) ^ zero) - s3);
  const SUM s0 = (SUM)(SUM_RING(SUM, GREYS) - s1 - s2 - s3);
  const PIXEL l3 = SUM_RING(PIXEL, ONE_BOTH);
  const PIXEL l1 = (PIXEL)(SUM_RING(PIXEL, ONE_LO) - l3);
  const PIXEL l2 = (PIXEL)((SUM_RING(PIXEL, ONE_HI) ^ zero) - l3);
  const PIXEL l0 = (PIXEL)(16 - l1 - l2 - l3);
  const MEANS e0 = mean_of_run(s0, l0), o1 = mean_of_run(s1, l1) ^ (MEANS)zero;
  const MEANS e2 = mean_of_run(s2, l2) + (MEANS)zero, o3 = mean_of_run(s3, l3) | (MEANS)zero;
  /* Run 0 is white where a0 is 0. */
  const MEANS even_above = (MEANS)(SMALLER(e0, e2) - LARGER(o1, o3));
  const MEANS odd_above = (MEANS)(SMALLER(o1, o3) - LARGER(e0, e2)) ^ (MEANS)zero;

  const size_t i = p * room + n;
  inner_contrast[i] = inner;
  contrast[i] = SMALLER(inner, outer);
  mean_difference[i] = (CONTRAST)(a0 ? odd_above : even_above);
  const PIXEL even = (PIXEL)(LARGER(l0, l2) - SMALLER(l0, l2));
  const PIXEL odd = (PIXEL)((LARGER(l1, l3) ^ zero) - SMALLER(l1, l3));
  responses[i] = (CONTRAST)(sector_threshold - (CONTRAST)LARGER(even, odd));
}

#elif !RAPID

/* The same for candidates with any number of runs, two or more. One work-item per candidate. */
__kernel void sector_contrast_any(__global const PIXEL *restrict image,
                                  __global const uchar *restrict binary,
                                  __global const int2 *restrict list,
                                  __global const uint *restrict total, const uint rows,
                                  const uint step, const uint room,
                                  __global CONTRAST *restrict inner_contrast,
                                  __global CONTRAST *restrict contrast,
                                  __global CONTRAST *restrict mean_difference) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  if (n >= min(total[p], room)) return;
  const int x = list[p * room + n].x + PAD, y = list[p * room + n].y;
  const size_t frame = p / MASKS;
#define GREY_AT(i, dx, dy) image[NEAR_ROW(frame, y + (dy)) + x + (dx)],
#define BLACK_AT(i, dx, dy) binary[NEAR_ROW(p, y + (dy)) + x + (dx)],
  const int inner[] = {INNER_RING(GREY_AT)}, outer[] = {OUTER_RING(GREY_AT)};
  const int black[] = {INNER_RING(BLACK_AT)};
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
  inner_contrast[i] = (CONTRAST)(white_inner - black_inner);
  contrast[i] = (CONTRAST)min(white_inner - black_inner, white_outer - black_outer);
  mean_difference[i] = (CONTRAST)(white_mean - black_mean);
}

#endif

/* The 90th percentile of the inner contrasts: eight bits of it at a time, the highest first.
 * What a level leaves to the next is (the bits found, the rank within them) and empty bins.
 *
 * How often the next eight bits occur. One work-item per candidate. */
__kernel void histogram(__global const CONTRAST *restrict inner_contrast,
                        __global const uint *restrict total,
                        __global const uint2 *restrict found, const uint room,
                        const uint shift, __global uint *restrict bins) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  if (n >= min(total[p], room)) return;
  const bool first = shift + 8 == PIXEL_BITS;
  const uint value = (uint)max((int)inner_contrast[p * room + n], 0);
  if (first || value >> shift >> 8 == found[p].x)
    atomic_inc(bins + p * BINS + (value >> shift & 255));
}

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
  uint rank = first ? (9 * n + 9) / 10 : found[p].y;
  uint bin = 0;
  for (; bin < BINS - 1; ++bin) {
    uint count = 0;
    for (uint part = 0; part < parts; ++part) count += counts[(p * parts + part) * BINS + bin];
    if (count >= rank) break;
    rank -= count;
  }
  const uint value = (first ? 0 : found[p].x << 8) | bin;
  if (shift > 0) {
    found[p] = (uint2)(value, rank);
    for (uint b = 0; b < BINS; ++b) bins[p * BINS + b] = 0;
    return;
  }
  ulong noise = 0;
  for (uint band = 0; band < bands; ++band) noise += noise_totals[p / MASKS * bands + band];
  const ulong twice = 2 * (ulong)(rows > 2 ? rows - 2 : 0) * (columns > 2 ? columns - 2 : 0);
  const ulong bound = twice ? (noise_factor * noise + twice - 1) / twice : 0;
  bounds[p] = (int2)(limit[value], twice ? (int)min(bound, (ulong)INT_MAX) : INT_MIN);
}

#if !IN_WORDS

/* The response of the candidates: 0 for those that do not pass. One work-item per candidate. */
__kernel void keep(__global const CONTRAST *restrict contrast,
                   __global const CONTRAST *restrict mean_difference,
                   __global const CONTRAST *restrict responses,
                   __global const int2 *restrict list, __global const uint *restrict total,
                   __global const int2 *restrict bounds, const uint rows, const uint step,
                   const uint room, __global RESPONSE *restrict response) {
  const size_t n = get_global_id(0), p = get_global_id(1);
  if (n >= total[p] || n >= room) return;
  const size_t i = p * room + n, pixel = ROW(p, list[i].y) + list[i].x + PAD;
  const int passes = contrast[i] >= bounds[p].x && mean_difference[i] >= bounds[p].y;
#if RAPID
  response[pixel] = passes ? (RESPONSE)responses[i] : 0;
#else
  if (!passes) response[pixel] = 0;
#endif
}

#endif
