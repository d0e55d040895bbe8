/* The working scale for CPUs: what scale.cl gives, down the columns first, then along the rows.
 * One work-item per band of rows of the scaled image. Where the sum of the products needs more
 * than 32 bits, those with the upper and with the lower half of the columns' sums are apart. */

#define HALF (1u << 21) /* what rounding adds */
#define HALVES (PIXEL_BITS / 8)

typedef uint4 __attribute__((aligned(4))) FOUR_ANYWHERE;

/* The sums of the columns under the weights of an output row. */
void first_rows(__global const PIXEL *restrict row, __global const PIXEL *restrict next,
                const uint weight, const uint next_weight, const uint columns,
                __global uint *restrict sums) {
  for (uint x = 0; x < columns; ++x) sums[x] = row[x] * weight + next[x] * next_weight;
}
void add_row(__global const PIXEL *restrict row, const uint weight, const uint columns,
             __global uint *restrict sums) {
  for (uint x = 0; x < columns; ++x) sums[x] += row[x] * weight;
}

/* Sums of neighbours: in each half of the vector those of a, then those of b. */
#define NEIGHBOURS(a, b)                                                            \
  ((uint8)(a.s0, a.s2, b.s0, b.s2, a.s4, a.s6, b.s4, b.s6) +                        \
   (uint8)(a.s1, a.s3, b.s1, b.s3, a.s5, a.s7, b.s5, b.s7))

/* Four more taps of each output pixel, eight at a time: of pixels k and k + 4 in a vector. */
#define FOUR_AT(k) *(__global const FOUR_ANYWHERE *)(sums + first[k])
#define TAPS_OF(k)                                                                  \
  const uint8 v##k = (uint8)(FOUR_AT(k), FOUR_AT(k + 4)), w##k = convert_uint8(weights[k]);
#define ADD_PRODUCTS(total, PART)                                                   \
  {                                                                                 \
    const uint8 a = PART(v0) * w0, b = PART(v1) * w1;                               \
    const uint8 c = PART(v2) * w2, d = PART(v3) * w3;                               \
    const uint8 ab = NEIGHBOURS(a, b), cd = NEIGHBOURS(c, d);                       \
    total += NEIGHBOURS(ab, cd);                                                    \
  }
#define WHOLE(v) (v)
#define LOWER_HALF(v) ((v) & 0xffffu)
#define UPPER_HALF(v) ((v) >> 16)
void add_taps(__global const uint *restrict sums, __global const int *restrict first,
              __global const ushort8 *restrict weights, const uint eights,
              __global uint8 *restrict totals) {
  for (uint i = 0; i < eights; ++i) {
    TAPS_OF(0) TAPS_OF(1) TAPS_OF(2) TAPS_OF(3)
#if HALVES == 1
    ADD_PRODUCTS(totals[i], WHOLE)
#else
    ADD_PRODUCTS(totals[i], LOWER_HALF)
    ADD_PRODUCTS(totals[eights + i], UPPER_HALF)
#endif
    first += 8;
    weights += 4;
  }
}

/* The rounded result; the totals are then those of nothing. */
void round_row(__global uint *restrict totals, const uint columns, const uint upper,
               __global PIXEL *restrict scaled) {
  for (uint x = 0; x < columns; ++x) {
#if HALVES == 1
    scaled[x] = (PIXEL)(totals[x] >> 22);
#else
    scaled[x] = (PIXEL)((totals[upper + x] + (totals[x] >> 16)) >> 6);
    totals[upper + x] = 0;
#endif
    totals[x] = HALF;
  }
}

__kernel void resample_bands(__global const PIXEL *restrict image,
                             __global const int *restrict first_y,
                             __global const uint *restrict weight_y, const uint taps_y,
                             __global const int *restrict first_x,
                             __global const ushort8 *restrict weight_x, const uint taps_x,
                             const uint full_rows, const uint full_columns,
                             const uint full_step, const uint rows, const uint columns,
                             const uint step, const uint band_rows,
                             __global uint *restrict all_sums,
                             __global uint *restrict all_totals,
                             __global PIXEL *restrict scaled) {
  const size_t p = get_global_id(1), band = p * get_global_size(0) + get_global_id(0);
  const uint first = get_global_id(0) * band_rows, end = SMALLER(first + band_rows, rows);
  const uint eights = (columns + 7) / 8;
  __global const PIXEL *pixels = image + (p * full_rows + 1) * full_step + PAD;
  __global uint *sums = all_sums + band * full_step;
  __global uint *totals = all_totals + HALVES * band * step;
  for (uint x = 0; x < 8 * HALVES * eights; ++x) totals[x] = x < 8 * eights ? HALF : 0;
  for (uint y = first; y < end; ++y) {
    __global const PIXEL *row = pixels + (size_t)first_y[y] * full_step;
    __global const uint *weights = weight_y + y * taps_y;
    first_rows(row, row + full_step, weights[0], weights[1], full_columns, sums);
    for (uint tap = 2; tap < taps_y; ++tap)
      if (weights[tap] > 0) add_row(row + tap * full_step, weights[tap], full_columns, sums);
    for (uint tap = 0; tap < taps_x; tap += 4)
      add_taps(sums + tap, first_x, weight_x + tap * eights, eights, (__global uint8 *)totals);
    round_row(totals, columns, 8 * eights, scaled + ROW(p, y) + PAD);
  }
}
