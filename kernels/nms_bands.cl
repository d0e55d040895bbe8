/* Suppression for CPUs: which candidates the gate keeps, and what nms.cl does, row after row of
 * a band; the same results to the bit.
 *
 * Few pixels have a response, so only blocks of sixteen with a candidate are looked at; keys are
 * 0 elsewhere. Of each step the last ROWS_KEPT rows are kept, as far as a later one looks back.
 * The rows beside the band are worked out too, so bands need nothing of each other. */

#ifndef RADIUS
#error "RADIUS must be that of suppression"
#endif
#ifndef OVER_SUPPRESSION
#error "OVER_SUPPRESSION must list the distances 1 to the radius"
#endif
#define ROWS_KEPT (2 * RADIUS + 3)
#define KEPT(rows, y, step) (rows + (size_t)(((y) + 4 * ROWS_KEPT) % ROWS_KEPT) * (step))

typedef ushort16 SCORES; /* of sixteen pixels */
typedef SCORES __attribute__((aligned(2))) SCORES_ANYWHERE;
typedef uchar16 __attribute__((aligned(1))) RESPONSES_ANYWHERE;
#define SCORES_AT(row, x) (*(__global const SCORES_ANYWHERE *)((row) + (x)))
#define RESPONSES_AT(row, x) (*(__global const RESPONSES_ANYWHERE *)((row) + (x)))

/* As many entries of a list of contrasts as fit into a vector. */
#if PIXEL_BITS == 8
#define ENTRIES 16
typedef short16 CONTRASTS_OF_LIST;
#define TO_RESPONSES(v) convert_uchar16(v)
#define CONTRAST_OF(bound) (CONTRAST)SMALLER(LARGER(bound, SHRT_MIN), SHRT_MAX)
typedef uchar16 __attribute__((aligned(1))) RESPONSES_OF_LIST;
#else
#define ENTRIES 8
typedef int8 CONTRASTS_OF_LIST;
#define TO_RESPONSES(v) convert_uchar8(v)
#define CONTRAST_OF(bound) bound
typedef uchar8 __attribute__((aligned(1))) RESPONSES_OF_LIST;
#endif
typedef CONTRASTS_OF_LIST __attribute__((aligned(2))) CONTRASTS_IN_LIST;
#define LISTED(list, n) (*(__global const CONTRASTS_IN_LIST *)((list) + (n)))

/* The candidates and the lists of what is known of them, in the order of gate_words.cl. */
typedef struct {
  __global const uint *words, *row_starts;
#if GATE
  __global const CONTRAST *contrast, *mean_difference;
  __global const int2 *bounds;
#endif
  __global const CONTRAST *responses;
  uint plane_words, room;
} Candidates;

/* The responses of `count` entries of the list of plane p, n and following; 0 where the gate
 * does not keep them. */
void kept_responses(const Candidates *candidates, const size_t p, const uint n, const uint count,
                    __global uchar *to) {
  const size_t start = p * candidates->room + n;
#if GATE
  const int2 bound = candidates->bounds[p];
  const CONTRASTS_OF_LIST least = CONTRAST_OF(bound.x), difference = CONTRAST_OF(bound.y);
#endif
  for (uint k = 0; k < count; k += ENTRIES) {
    CONTRASTS_OF_LIST r = LISTED(candidates->responses, start + k);
#if GATE
    r &= LISTED(candidates->contrast, start + k) >= least;
    r &= LISTED(candidates->mean_difference, start + k) >= difference;
#endif
    *(__global RESPONSES_OF_LIST *)(to + k) = TO_RESPONSES(r);
  }
}

/* Sixty-four bytes at a time. */
void clear(__global uchar *bytes, const uint count) {
  for (uint k = 0; k < count; k += 64) {
    *(__global ulong4 *)(bytes + k) = 0;
    *(__global ulong4 *)(bytes + k + 32) = 0;
  }
}

/* The responses of row y, 0 outside the image; of three masks 2 R(0) + R(-1/2) + R(+1/2).
 * The number of blocks that hold a candidate, and which. */
uint response_row(const Candidates *candidates, const uint frame, const int y, const uint rows,
                  const uint step, __global uchar *list, __global uchar *row,
                  __global ushort *blocks) {
  clear(row, step);
  if (y < 0 || y >= (int)rows) return 0;
  const uint halves = step / 16, room = candidates->room;
  const size_t plane = 2 * (size_t)candidates->plane_words;
  __global const ushort *found = (__global const ushort *)candidates->words +
                                 frame * MASKS * plane + (y + REACH) * halves;
  uint filled = 0;
#if MASKS == 3
#define FOUND(block) (found[block] | found[(block) + plane] | found[(block) + 2 * plane])
#else
#define FOUND(block) found[block]
#endif
#define APPEND(block)                                                               \
  blocks[filled] = (ushort)(block);                                                 \
  filled += FOUND(block) != 0;
  for (uint block = 0; block < halves; block += 4) {
    APPEND(block)
    APPEND(block + 1)
    APPEND(block + 2)
    APPEND(block + 3)
  }
  for (uint mask = 0; mask < MASKS; ++mask) {
    const size_t p = frame * MASKS + mask;
    const uint n = candidates->row_starts[p * rows + y];
    if (n >= room) return filled;
    uint count = 0;
    for (uint k = 0; k < filled; ++k) count += bits_set(found[mask * plane + blocks[k]]);
    kept_responses(candidates, p, n, SMALLER(count, room - n), list);
    __global const uchar *next = list;
    for (uint k = 0; k < filled; ++k) {
      __global uchar *block = row + 16 * blocks[k];
      for (uint left = found[mask * plane + blocks[k]]; left; left &= left - 1)
#if MASKS == 3
        block[lowest_bit(left)] += *next++ << (mask == 0);
#else
        block[lowest_bit(left)] = *next++;
#endif
    }
  }
  return filled;
}

/* The tent along y, of rows y - 2 to y + 2: 2 R(-1) + 2 R(0) + 2 R(1) + R(-2) + R(0) + R(2),
 * the sums of three within a byte. */
SCORES tent_along_y(__global const uchar *const *rows, const uint x) {
  const uchar16 middle = RESPONSES_AT(rows[2], x);
  const SCORES near =
      convert_ushort16(RESPONSES_AT(rows[1], x) + RESPONSES_AT(rows[3], x) + middle);
  const SCORES far = convert_ushort16(RESPONSES_AT(rows[0], x) + RESPONSES_AT(rows[4], x) + middle);
  return near + near + far;
}

#define FROM_1(a, b) \
  (SCORES)((a).s1, (a).s2, (a).s3, (a).s4, (a).s5, (a).s6, (a).s7, (a).s8, (a).s9, (a).sa, \
           (a).sb, (a).sc, (a).sd, (a).se, (a).sf, (b).s0)
#define FROM_2(a, b) \
  (SCORES)((a).s2, (a).s3, (a).s4, (a).s5, (a).s6, (a).s7, (a).s8, (a).s9, (a).sa, (a).sb, \
           (a).sc, (a).sd, (a).se, (a).sf, (b).s0, (b).s1)
#define FROM_3(a, b) \
  (SCORES)((a).s3, (a).s4, (a).s5, (a).s6, (a).s7, (a).s8, (a).s9, (a).sa, (a).sb, (a).sc, \
           (a).sd, (a).se, (a).sf, (b).s0, (b).s1, (b).s2)
#define FROM_4(a, b) \
  (SCORES)((a).s4, (a).s5, (a).s6, (a).s7, (a).s8, (a).s9, (a).sa, (a).sb, (a).sc, (a).sd, \
           (a).se, (a).sf, (b).s0, (b).s1, (b).s2, (b).s3)

/* The keys of the blocks: 0 where there is no response. */
void key_row(__global const uchar *const *rows, __global const ushort *blocks, const uint filled,
             __global ushort *key) {
  for (uint n = 0; n < filled; ++n) {
    const uint x = 16 * blocks[n];
    const SCORES a = tent_along_y(rows, x - 2), b = tent_along_y(rows, x + 14);
    const SCORES middle = FROM_2(a, b), near = FROM_1(a, b) + FROM_3(a, b) + middle;
    const SCORES s = a + FROM_4(a, b) + middle + near + near;
    const SCORES r = convert_ushort16(RESPONSES_AT(rows[2], x));
    *(__global SCORES *)(key + x) = (s * (ushort)10 + r) & as_ushort16(r != (SCORES)(0));
  }
}

#define LANE_NUMBERS (ushort16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)

/* Sixteen comparisons as bits. */
ushort bits_of(const short16 holds) {
  const ushort16 bit = (ushort16)(1) << LANE_NUMBERS;
  const ulong4 fours = as_ulong4(as_ushort16(holds) & bit);
  const ulong four = fours.s0 | fours.s1 | fours.s2 | fours.s3, two = four | four >> 32;
  return (ushort)(two | two >> 16);
}

/* The pixels of a block whose key is above the earlier ones beside it and not below the later
 * ones. */
ushort above_neighbours(__global const ushort *const *keys, const uint x) {
  __global const ushort *above = keys[RADIUS - 1], *row = keys[RADIUS], *below = keys[RADIUS + 1];
  const SCORES key = SCORES_AT(row, x);
  SCORES earlier = SCORES_AT(row, x - 1), later = SCORES_AT(row, x + 1);
#define BESIDE(dx)                                                                  \
  earlier = LARGER(earlier, SCORES_AT(above, x + (dx)));                            \
  later = LARGER(later, SCORES_AT(below, x + (dx)));
  BESIDE(-1) BESIDE(0) BESIDE(1)
  return bits_of((key > earlier) & (key >= later));
}

/* Whether a pixel's key is above all earlier ones of its window and not below any later one. */
bool is_maximum(__global const ushort *const *keys, const uint x) {
  const SCORES key = keys[RADIUS][x];
  short16 larger = 0;
  for (int first = -RADIUS; first <= RADIUS; first += 16) {
    const short16 dx = as_short16(LANE_NUMBERS) + (short)first;
    const SCORES row = SCORES_AT(keys[RADIUS], (int)x + first);
    SCORES earlier = row & as_ushort16(dx < (short16)(0));
    SCORES later = row & as_ushort16(dx > (short16)(0));
#define ROWS_AT(dy)                                                                 \
  earlier = LARGER(earlier, SCORES_AT(keys[RADIUS - (dy)], (int)x + first));        \
  later = LARGER(later, SCORES_AT(keys[RADIUS + (dy)], (int)x + first));
    OVER_SUPPRESSION(ROWS_AT)
    larger |= ((earlier >= key) | (later > key)) & (dx <= (short16)(RADIUS));
  }
  const ulong4 any = as_ulong4(larger);
  return (any.s0 | any.s1 | any.s2 | any.s3) == 0;
}

/* The maxima of a row as bits, and how many. keys[RADIUS] is the row's own. */
uint maxima_row(__global const ushort *const *keys, __global const ushort *blocks,
                const uint filled, const uint step, __global ushort *maxima) {
  for (uint k = 0; k < step / 16; k += 4) *(__global ulong *)(maxima + k) = 0;
  uint count = 0;
  for (uint n = 0; n < filled; ++n) {
    uint bits = 0;
    for (uint left = above_neighbours(keys, 16 * blocks[n]); left; left &= left - 1) {
      const uint lane = lowest_bit(left);
      if (is_maximum(keys, 16 * blocks[n] + lane)) {
        bits |= 1u << lane;
        ++count;
      }
    }
    maxima[blocks[n]] = (ushort)bits;
  }
  return count;
}

/* The response, the maxima as bits and their number in each row. `kept` holds, for each band,
 * 2 ROWS_KEPT + 1 rows. One work-item per band of rows. */
__kernel void suppress_bands(__global const uint *restrict words,
                             __global const uint *restrict row_starts,
#if GATE
                             __global const CONTRAST *restrict contrast,
                             __global const CONTRAST *restrict mean_difference,
                             __global const int2 *restrict bounds,
#endif
                             __global const CONTRAST *restrict responses, const uint rows,
                             const uint step, const uint plane_words, const uint room,
                             const uint band_rows, __global ushort *kept,
                             __global uchar *response, __global ushort *maxima,
                             __global uint *counts) {
  const size_t band = get_global_id(0), p = get_global_id(1);
#if GATE
  const Candidates candidates = {words,  row_starts, contrast,    mean_difference,
                                 bounds, responses,  plane_words, room};
#else
  const Candidates candidates = {words, row_starts, responses, plane_words, room};
#endif
  const int top = (int)(band * band_rows), end = SMALLER(top + (int)band_rows, (int)rows);
  __global ushort *keys = kept + (p * get_global_size(0) + band) * (2 * ROWS_KEPT + 1) * step;
  __global uchar *beside = (__global uchar *)(keys + ROWS_KEPT * step);
  __global uchar *list = beside + ROWS_KEPT * step;
  __global ushort *blocks = (__global ushort *)(list + 2 * step);
  uint filled[ROWS_KEPT];
  __global const uchar *near[5]; /* rows of responses */

  for (int y = top - RADIUS - 2; y < end + RADIUS + 2; ++y) {
    const bool inside = y >= top && y < end;
    __global uchar *row = inside ? response + ROW(p, y) : KEPT(beside, y, step);
    for (int k = 0; k < 4; ++k) near[k] = near[k + 1];
    near[4] = row;
    *KEPT(filled, y, 1) = response_row(&candidates, (uint)p, y, rows, step, list, row,
                                       KEPT(blocks, y, step / 16));

    const int scored = y - 2;
    if (scored < top - RADIUS) continue;
    __global ushort *key = KEPT(keys, scored, step);
    clear((__global uchar *)key, 2 * step);
    key_row(near, KEPT(blocks, scored, step / 16), *KEPT(filled, scored, 1), key);

    const int decided = scored - RADIUS;
    if (decided < top) continue;
    __global const ushort *window[2 * RADIUS + 1];
    for (int d = -RADIUS; d <= RADIUS; ++d) window[d + RADIUS] = KEPT(keys, decided + d, step);
    counts[p * rows + decided] =
        maxima_row(window, KEPT(blocks, decided, step / 16), *KEPT(filled, decided, 1), step,
                   maxima + (p * rows + decided) * (step / 16));
  }
}
