/* Contrast and response of the candidates in words, for CPUs: the numbers of gate.cl, for
 * sixteen candidates in a vector.
 *
 * The candidates of a band of rows lie one after the other in the lists, in (y, x) order; where
 * those of row y begin is in row_starts. The bands come in any order.
 *
 * With h = grey where white and the complement, grey ^ FULL, where black, the contrast of a ring
 * is min(M0, M2) + min(M1, M3) - FULL for the largest h of each run, whichever colour run 0 has. */

#define BLOCK 16 /* candidates */

#if PIXEL_BITS == 8
typedef uchar16 GREYS;
typedef ushort16 GREY_SUMS;
typedef short16 CONTRASTS;
#define AS_GREYS(v) as_uchar16(convert_char16(v))
#define AS_SUMS(v) as_ushort16(convert_short16(as_char16(v)))
#define TO_SUMS(v) convert_ushort16(v)
#define TO_CONTRASTS(v) convert_short16(v)
#else
typedef ushort16 GREYS;
typedef uint16 GREY_SUMS;
typedef int16 CONTRASTS;
/* By halves: no vector longer than a CPU's may be the argument of a function. */
#define AS_GREYS(v) as_ushort16(v)
#define AS_SUMS(v) as_uint16(TO_CONTRASTS(as_short16(v)))
#define TO_SUMS(v) (uint16)(convert_uint8((v).lo), convert_uint8((v).hi))
#define TO_CONTRASTS(v) (int16)(convert_int8((v).lo), convert_int8((v).hi))
#endif
typedef GREYS __attribute__((aligned(1))) GREYS_ANYWHERE;
typedef CONTRASTS __attribute__((aligned(1))) CONTRASTS_ANYWHERE;
typedef uint __attribute__((aligned(1))) BITS_ANYWHERE;

/* A ring in sixteen elements: of the sixteen of row dy from `first` on, those whose bit is set
 * in `places` stay in their place. ORDER lists the places clockwise from sample 13. */
#define INNER_PLACES(F)                                                             \
  F(-3, -3, 0x001c) F(-2, -3, 0x0022) F(-1, -3, 0x0041) F(0, -10, 0x0080)           \
  F(0, -12, 0x8000) F(1, -11, 0x4100) F(2, -11, 0x2200) F(3, -11, 0x1c00)
#define INNER_ORDER {0, 1, 2, 3, 4, 5, 6, 15, 14, 13, 12, 11, 10, 9, 8, 7}
#if OUTER_RADIUS == 5
#define OUTER_PLACES(F)                                                             \
  F(-5, -13, 0xa800) F(-4, -10, 0x4040) F(-2, -7, 0x1004) F(0, -13, 0x0100)         \
  F(0, 1, 0x0010) F(2, -5, 0x0401) F(4, -5, 0x0202) F(5, -5, 0x00a8)
#define OUTER_ORDER {2, 6, 11, 13, 15, 14, 12, 4, 10, 9, 7, 5, 3, 1, 0, 8}
#else
#define OUTER_PLACES(F)                                                             \
  F(-4, -13, 0xa800) F(-3, -11, 0x4100) F(-2, -8, 0x1010) F(0, -6, 0x0404)          \
  F(2, -5, 0x0202) F(3, -3, 0x0041) F(4, -5, 0x00a8)
#define OUTER_ORDER {4, 8, 11, 13, 15, 14, 12, 10, 9, 6, 7, 5, 3, 0, 1, 2}
#endif
#define PLACE(places, k) (PIXEL)(((places) >> (k) & 1) ? -1 : 0)
#define PLACES(places)                                                              \
  (GREYS)(PLACE(places, 0), PLACE(places, 1), PLACE(places, 2), PLACE(places, 3),   \
          PLACE(places, 4), PLACE(places, 5), PLACE(places, 6), PLACE(places, 7),   \
          PLACE(places, 8), PLACE(places, 9), PLACE(places, 10), PLACE(places, 11), \
          PLACE(places, 12), PLACE(places, 13), PLACE(places, 14), PLACE(places, 15))

/* What the rings of a block of candidates see: greys, and the inner ring's colours as bits. */
typedef struct {
  GREYS inner[16], outer[16];
  ushort16 colours; /* of a candidate */
} Samples;

typedef struct {
  CONTRASTS inner, contrast, mean_difference, response;
} Sectors;

/* Pixels of a row of words from x on, sixteen at least. */
uint bits_from(__global const uint *row, const uint x) {
  return *(__global const BITS_ANYWHERE *)((__global const uchar *)row + x / 8) >> x % 8;
}

/* Sixteen candidates of sixteen samples to sixteen samples of sixteen candidates: four times,
 * elements of the first half and of the second one in turn. */
void interleave(const GREYS *from, GREYS *to) {
  for (int k = 0; k < 8; ++k) {
    const GREYS a = from[k], b = from[k + 8];
    to[2 * k] = (GREYS)(a.s0, b.s0, a.s1, b.s1, a.s2, b.s2, a.s3, b.s3, a.s4, b.s4, a.s5, b.s5,
                        a.s6, b.s6, a.s7, b.s7);
    to[2 * k + 1] = (GREYS)(a.s8, b.s8, a.s9, b.s9, a.sa, b.sa, a.sb, b.sb, a.sc, b.sc, a.sd,
                            b.sd, a.se, b.se, a.sf, b.sf);
  }
}

void transpose(GREYS *v) {
  GREYS other[16];
  interleave(v, other);
  interleave(other, v);
  interleave(v, other);
  interleave(other, v);
}

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

/* Lane k of a vector. */
#define LANE_OF(T, v, k) ((T *)&(v))[k]

#define MEANS_OF_RUN(means, sums, lengths)                                          \
  CONTRASTS means;                                                                  \
  for (int k = 0; k < BLOCK; ++k)                                                   \
    LANE_OF(CONTRAST, means, k) =                                                   \
        mean_of_run(LANE_OF(const SUM, sums, k), LANE_OF(const PIXEL, lengths, k));

/* Eqs. 21 and 24, and the contrasts that sector_contrast of gate.cl has. */
Sectors sectors_of(Samples *samples, const CONTRAST sector_threshold) {
  const int inner_order[] = INNER_ORDER, outer_order[] = OUTER_ORDER;
  const ushort16 colours = samples->colours;
#define BLACK_AT_PLACE(k) AS_GREYS((colours & (ushort)(1 << inner_order[k])) != (ushort16)(0))
  const GREYS start = BLACK_AT_PLACE(0);
  GREYS before = start, lo = 0, hi = 0, lo_length = 0, hi_length = 0, l3 = 0;
  transpose(samples->inner);
  transpose(samples->outer);
  GREYS m0 = 0, m1 = 0, m2 = 0, m3 = 0, n0 = 0, n1 = 0, n2 = 0, n3 = 0;
  GREY_SUMS sum = 0, lo_sum = 0, hi_sum = 0, s3 = 0;
  for (int i = 0; i < 16; ++i) {
    /* The run of a sample, modulo 4, has the digits hi and lo. */
    const GREYS black = BLACK_AT_PLACE(i);
    hi ^= (black ^ before) & lo;
    lo = black ^ start;
    before = black;
    lo_length -= lo; /* -1 where set */
    hi_length -= hi;
    l3 -= lo & hi;
    const GREYS g = samples->inner[inner_order[i]], q = samples->outer[outer_order[i]];
#define LARGEST_OF_RUN(m, v, run) m = LARGER(m, ((v) ^ black) & (run));
    LARGEST_OF_RUN(m0, g, ~(lo | hi))
    LARGEST_OF_RUN(m1, g, lo & ~hi)
    LARGEST_OF_RUN(m2, g, hi & ~lo)
    LARGEST_OF_RUN(m3, g, lo & hi)
    LARGEST_OF_RUN(n0, q, ~(lo | hi))
    LARGEST_OF_RUN(n1, q, lo & ~hi)
    LARGEST_OF_RUN(n2, q, hi & ~lo)
    LARGEST_OF_RUN(n3, q, lo & hi)
    const GREY_SUMS both = TO_SUMS(g) + TO_SUMS(q);
    sum += both;
    lo_sum += both & AS_SUMS(lo);
    hi_sum += both & AS_SUMS(hi);
    s3 += both & AS_SUMS(lo & hi);
  }
  const GREYS l1 = lo_length - l3, l2 = hi_length - l3, l0 = (PIXEL)16 - l1 - l2 - l3;
  const GREYS even = LARGER(l0, l2) - SMALLER(l0, l2), odd = LARGER(l1, l3) - SMALLER(l1, l3);
  Sectors found;
  found.response = sector_threshold - TO_CONTRASTS(LARGER(even, odd));
  found.inner = TO_CONTRASTS(SMALLER(m0, m2)) + TO_CONTRASTS(SMALLER(m1, m3)) - (CONTRAST)FULL;
  const CONTRASTS outer =
      TO_CONTRASTS(SMALLER(n0, n2)) + TO_CONTRASTS(SMALLER(n1, n3)) - (CONTRAST)FULL;
  found.contrast = SMALLER(found.inner, outer);
  const GREY_SUMS s1 = lo_sum - s3, s2 = hi_sum - s3, s0 = sum - s1 - s2 - s3;
  MEANS_OF_RUN(e0, s0, l0)
  MEANS_OF_RUN(o1, s1, l1)
  MEANS_OF_RUN(e2, s2, l2)
  MEANS_OF_RUN(o3, s3, l3)
  const CONTRASTS even_above = SMALLER(e0, e2) - LARGER(o1, o3);
  const CONTRASTS odd_above = SMALLER(o1, o3) - LARGER(e0, e2);
  const CONTRASTS starts_black = TO_CONTRASTS(start) != (CONTRASTS)(0);
  found.mean_difference = (odd_above & starts_black) | (even_above & ~starts_black);
  return found;
}

/* The lists of a plane, of which the candidates before `n` are done. */
typedef struct {
  uint n, room;
  __global CONTRAST *inner, *contrast, *mean_difference, *response;
} Lists;

/* The first `count` of sixteen numbers. */
void store(const CONTRASTS *values, const uint count, __global CONTRAST *to) {
  if (count == BLOCK) *(__global CONTRASTS_ANYWHERE *)to = *values;
  else
    for (uint k = 0; k < count; ++k) to[k] = LANE_OF(const CONTRAST, *values, k);
}

/* The numbers of `filled` candidates into the lists, as far as they have room, and how often
 * each inner contrast occurs; of 16 bits the higher eight. The candidates done. */
uint finish_block(Samples *samples, const uint filled, const CONTRAST sector_threshold,
                  const Lists lists, uint *bins) {
  const Sectors sectors = sectors_of(samples, sector_threshold);
  const uint n = lists.n;
  const uint count = n < lists.room ? SMALLER(filled, lists.room - n) : 0;
  store(&sectors.inner, count, lists.inner + n);
  store(&sectors.contrast, count, lists.contrast + n);
  store(&sectors.mean_difference, count, lists.mean_difference + n);
  store(&sectors.response, count, lists.response + n);
  for (uint k = 0; k < count; ++k) {
    const CONTRAST inner = LANE_OF(const CONTRAST, sectors.inner, k);
    ++bins[LARGER(inner, 0) >> (PIXEL_BITS - 8)];
  }
  return n + filled;
}

/* The lists of a band of rows. One work-item per band. */
__kernel void gate_words(__global const PIXEL *restrict image, __global const uint *restrict words,
                         __global const uint *restrict candidates, const uint rows,
                         const uint step, const uint plane_words, const uint room,
                         const uint band_rows, const CONTRAST sector_threshold,
                         __global uint *restrict totals, __global uint *restrict row_starts,
                         __global CONTRAST *restrict inner_contrast,
                         __global CONTRAST *restrict contrast,
                         __global CONTRAST *restrict mean_difference,
                         __global CONTRAST *restrict responses,
                         __global uint *restrict counts) {
  const size_t band = get_global_id(0), p = get_global_id(1);
  const uint width = step / 32;
  const uint top = (uint)band * band_rows, end = SMALLER(top + band_rows, rows);
  __global const uint *black = words + WORDS_MARGIN + p * plane_words + REACH * width;
  __global const uint *found = candidates + p * plane_words + REACH * width;

  uint in_band = 0;
  for (uint i = top * width; i < end * width; ++i) in_band += bits_set(found[i]);
  const size_t list = p * room;
  Lists lists = {atomic_add(totals + p, in_band), room, inner_contrast + list, contrast + list,
                 mean_difference + list, responses + list};

  __global const PIXEL *frame = image + ROW(p / MASKS, 0);
  uint bins[BINS];
  for (uint b = 0; b < BINS; ++b) bins[b] = 0;
  Samples samples;
  uint filled = 0;
  for (uint y = top; y < end; ++y) {
    row_starts[p * rows + y] = lists.n + filled;
    __global const uint *row = black + y * width;
#define LINE(dy) frame + (size_t)SMALLER(LARGER((int)y + (dy), 0), (int)rows - 1) * step
    __global const PIXEL *line[] = {LINE(-5), LINE(-4), LINE(-3), LINE(-2), LINE(-1), LINE(0),
                                    LINE(1),  LINE(2),  LINE(3),  LINE(4),  LINE(5)};
    for (uint i = 0; i < width; ++i)
      for (uint left = found[y * width + i]; left; left &= left - 1) {
        const uint x = 32 * i + lowest_bit(left);
#define BITS_FROM(dy, first, places) \
  | (bits_from(row + (dy) * (int)width, x + (first)) & (places))
        LANE_OF(ushort, samples.colours, filled) = (ushort)(0 INNER_PLACES(BITS_FROM));
#define GREYS_FROM(dy, first, places) \
  | (*(__global const GREYS_ANYWHERE *)(line[(dy) + REACH] + x + (first)) & PLACES(places))
        samples.inner[filled] = (GREYS)(0) INNER_PLACES(GREYS_FROM);
        samples.outer[filled] = (GREYS)(0) OUTER_PLACES(GREYS_FROM);
        if (++filled < BLOCK) continue;
        lists.n = finish_block(&samples, filled, sector_threshold, lists, bins);
        filled = 0;
      }
  }
  finish_block(&samples, filled, sector_threshold, lists, bins);
  for (uint b = 0; b < BINS; ++b) counts[(p * get_global_size(0) + band) * BINS + b] = bins[b];
}
