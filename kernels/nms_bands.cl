/* Suppression for CPUs: which candidates the gate keeps, and what nms.cl does, row after row of
 * a band; the same results to the bit.
 *
 * Of each step the last ROWS_KEPT rows are kept, as far as a later one looks back. The rows
 * beside the band are worked out too, so bands need nothing of each other. */

#ifndef RADIUS
#error "RADIUS must be that of suppression"
#endif
#define ROWS_KEPT (2 * RADIUS + 3)
#define KEPT(rows, y) (rows + (size_t)(((y) + 4 * ROWS_KEPT) % ROWS_KEPT) * step)

typedef ushort16 SCORES; /* of sixteen pixels */
typedef SCORES __attribute__((aligned(2))) SCORES_ANYWHERE;
typedef uchar16 __attribute__((aligned(1))) RESPONSES_ANYWHERE;
#define SCORES_AT(row, x) (*(__global const SCORES_ANYWHERE *)((row) + (x)))
#define RESPONSES_AT(row, x) convert_ushort16(*(__global const RESPONSES_ANYWHERE *)((row) + (x)))
#define PUT(row, x) *(__global SCORES *)((row) + (x))
#define FOR_PIXELS for (uint x = PAD; x < PAD + columns; x += 16)

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

bool passes(const Candidates *candidates, const size_t p, const size_t n) {
#if GATE
  const int2 bound = candidates->bounds[p];
  return candidates->contrast[n] >= bound.x && candidates->mean_difference[n] >= bound.y;
#else
  return true;
#endif
}

/* The responses of row y, 0 outside the image; of three masks 2 R(0) + R(-1/2) + R(+1/2). */
void response_row(const Candidates *candidates, const uint frame, const int y, const uint rows,
                  const uint step, __global uchar *row) {
  for (uint x = 0; x < step; x += 16) *(__global uchar16 *)(row + x) = 0;
  if (y < 0 || y >= (int)rows) return;
  const uint width = step / 32, room = candidates->room;
  for (uint mask = 0; mask < MASKS; ++mask) {
    const size_t p = frame * MASKS + mask;
    __global const uint *words =
        candidates->words + p * candidates->plane_words + (y + REACH) * width;
    const uint weight = MASKS == 3 && mask == 0 ? 2 : 1;
    uint n = candidates->row_starts[p * rows + y];
    for (uint i = 0; i < width; ++i)
      for (uint left = words[i]; left; left &= left - 1, ++n) {
        const uint x = 32 * i + 31 - clz(left & (0u - left));
        if (n < room && passes(candidates, p, p * room + n))
          row[x] += (uchar)(weight * candidates->responses[p * room + n]);
      }
  }
}

bool is_zero(const SCORES v) {
  const ulong4 w = as_ulong4(v);
  return (w.s0 | w.s1 | w.s2 | w.s3) == 0;
}

/* The tent along x. */
void tent_row(__global const uchar *response, const uint columns, __global ushort *tent) {
  FOR_PIXELS {
    const SCORES here = RESPONSES_AT(response, x);
    const SCORES near = RESPONSES_AT(response, x - 1) + RESPONSES_AT(response, x + 1) + here;
    PUT(tent, x) =
        RESPONSES_AT(response, x - 2) + RESPONSES_AT(response, x + 2) + here + near + near;
  }
}

/* The tent along y, and the key: 0 where there is no response. */
void key_row(__global const uchar *response, __global const ushort *above2,
             __global const ushort *above, __global const ushort *tent,
             __global const ushort *below, __global const ushort *below2, const uint columns,
             __global ushort *key) {
  FOR_PIXELS {
    const SCORES r = RESPONSES_AT(response, x);
    if (is_zero(r)) {
      PUT(key, x) = 0;
      continue;
    }
    const SCORES here = SCORES_AT(tent, x);
    const SCORES near = SCORES_AT(above, x) + SCORES_AT(below, x) + here;
    const SCORES s = SCORES_AT(above2, x) + SCORES_AT(below2, x) + here + near + near;
    PUT(key, x) = (s * (ushort)10 + r) & as_ushort16(r != (SCORES)(0));
  }
}

/* The largest key of the window's row. */
void row_maximum(__global const ushort *key, const uint columns, __global ushort *largest) {
  FOR_PIXELS {
    SCORES m = SCORES_AT(key, x);
    for (int d = 1; d <= RADIUS; ++d) {
      const SCORES left = SCORES_AT(key, x - d), right = SCORES_AT(key, x + d);
      m = LARGER(m, left);
      m = LARGER(m, right);
    }
    PUT(largest, x) = m;
  }
}

/* Sixteen comparisons as bits. */
ushort bits_of(const short16 holds) {
  const ulong2 bytes = as_ulong2(convert_char16(holds)) & (ulong2)(0x0101010101010101UL);
  const ulong2 bits = bytes * 0x0102040810204080UL >> (ulong2)(56);
  return (ushort)(bits.s0 | bits.s1 << 8);
}

/* Which keys are above all earlier ones and not below any later one, as bits, and how many.
 * largest[RADIUS] is the row's own. */
uint maxima_row(__global const ushort *key, __global const ushort *const *largest,
                const uint columns, __global ushort *maxima) {
  uint count = 0;
  FOR_PIXELS {
    const SCORES k = SCORES_AT(key, x);
    ushort bits = 0;
    if (!is_zero(k)) {
      SCORES earlier = 0, later = SCORES_AT(largest[RADIUS], x);
      for (int d = 1; d <= RADIUS; ++d) {
        const SCORES left = SCORES_AT(key, x - d), above = SCORES_AT(largest[RADIUS - d], x);
        const SCORES below = SCORES_AT(largest[RADIUS + d], x);
        earlier = LARGER(earlier, left);
        earlier = LARGER(earlier, above);
        later = LARGER(later, below);
      }
      bits = bits_of((k > earlier) & (k >= later));
    }
    maxima[x / 16] = bits;
    count += popcount(bits);
  }
  return count;
}

/* The response, the maxima as bits and their number in each row. `kept` holds 4 ROWS_KEPT rows a
 * band. One work-item per band of rows. */
__kernel void suppress_bands(__global const uint *restrict words,
                             __global const uint *restrict row_starts,
#if GATE
                             __global const CONTRAST *restrict contrast,
                             __global const CONTRAST *restrict mean_difference,
                             __global const int2 *restrict bounds,
#endif
                             __global const CONTRAST *restrict responses, const uint rows,
                             const uint columns, const uint step, const uint plane_words,
                             const uint room, const uint band_rows, __global ushort *kept,
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
  __global ushort *tents = kept + (p * get_global_size(0) + band) * 4 * ROWS_KEPT * step;
  __global ushort *keys = tents + ROWS_KEPT * step, *largest = keys + ROWS_KEPT * step;
  __global uchar *near = (__global uchar *)(largest + ROWS_KEPT * step);
  for (uint k = 0; k < ROWS_KEPT; ++k) { /* beside the pixels keys are 0 */
    PUT(keys + k * step, PAD - 16) = 0;
    PUT(keys + k * step, PAD + (columns + 15) / 16 * 16) = 0;
  }

  for (int y = top - RADIUS - 2; y < end + RADIUS + 2; ++y) {
    __global uchar *row = KEPT(near, y);
    response_row(&candidates, (uint)p, y, rows, step, row);
    if (y >= top && y < end)
      for (uint x = 0; x < step; x += 16)
        *(__global uchar16 *)(response + ROW(p, y) + x) = *(__global uchar16 *)(row + x);
    tent_row(row, columns, KEPT(tents, y));

    const int scored = y - 2;
    if (scored < top - RADIUS) continue;
    key_row(KEPT(near, scored), KEPT(tents, scored - 2), KEPT(tents, scored - 1),
            KEPT(tents, scored), KEPT(tents, scored + 1), KEPT(tents, y), columns,
            KEPT(keys, scored));
    row_maximum(KEPT(keys, scored), columns, KEPT(largest, scored));

    const int decided = scored - RADIUS;
    if (decided < top) continue;
    __global const ushort *window[2 * RADIUS + 1];
    for (int d = -RADIUS; d <= RADIUS; ++d) window[d + RADIUS] = KEPT(largest, decided + d);
    counts[p * rows + decided] = maxima_row(KEPT(keys, decided), window, columns,
                                            maxima + (p * rows + decided) * (step / 16));
  }
}

/* The list of the maxima, as in collect.cl. One work-item per band of rows. */
__kernel void list_maxima_words(__global const uint *restrict maxima,
                                __global const uint *restrict counts, const uint rows,
                                const uint step, const uint room, const uint place,
                                const uint band_rows, __global int2 *restrict list,
                                __global uint *restrict totals) {
  const size_t band = get_global_id(0), p = get_global_id(1);
  const uint top = (uint)band * band_rows, end = SMALLER(top + band_rows, rows);
  uint n = 0;
  for (uint y = 0; y < top; ++y) n += counts[p * rows + y];
  for (uint y = top; y < end; ++y)
    for (uint i = 0; i < step / 32; ++i)
      for (uint left = maxima[(p * rows + y) * (step / 32) + i]; left; left &= left - 1, ++n)
        if (n < room)
          list[p * room + n] =
              (int2)((int)(32 * i + 31 - clz(left & (0u - left))) - PAD, (int)y);
  if (end == rows) totals[place + p] = n;
}
