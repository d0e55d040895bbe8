/* The working scale for CPUs: what scale.cl gives, along the rows first, then down the columns.
 * One work-item per band of rows of the scaled image.
 *
 * Tables of a row are read eight entries at a time; entries behind its end are 0. */

#if PIXEL_BITS == 8
typedef uint FOUR; /* neighbouring pixels */
typedef uint8 FOURS;
typedef uint SUM_OF_BOTH;
typedef uint8 SUMS_OF_BOTH;
#define WIDE(v) (v)
#define NARROW(v) (v)
#else
typedef ulong FOUR;
typedef ulong8 FOURS;
typedef ulong SUM_OF_BOTH;
typedef ulong8 SUMS_OF_BOTH;
#define EIGHT_PARTS(T, v) (T)(v.s0, v.s1, v.s2, v.s3, v.s4, v.s5, v.s6, v.s7)
#define WIDE(v) EIGHT_PARTS(ulong8, v)
#define NARROW(v) EIGHT_PARTS(uint8, v)
#endif
typedef FOUR __attribute__((aligned(PIXEL_BITS / 8))) FOUR_ANYWHERE;

/* The sums of a row's pixels under the weights of each output pixel, `count` of them. */
void sum_row(__global const PIXEL *restrict row, __global const int *restrict first,
             __global const uint *restrict weights, const uint taps, const uint count,
             __global uint *restrict sums) {
#define FOUR_AT(k) *(__global const FOUR_ANYWHERE *)(row + first[x + k] + tap)
#define WEIGHTS(k) *(__global const uint8 *)(weights + (tap + k) * count + x)
#define PIXELS_AT(k) (NARROW((fours >> PIXEL_BITS * k)) & ((1u << PIXEL_BITS) - 1))
  for (uint x = 0; x < count; x += 8) {
    uint8 sum = 0;
    for (uint tap = 0; tap < taps; tap += 4) {
      const FOURS fours = (FOURS)(FOUR_AT(0), FOUR_AT(1), FOUR_AT(2), FOUR_AT(3),
                                  FOUR_AT(4), FOUR_AT(5), FOUR_AT(6), FOUR_AT(7));
      sum += PIXELS_AT(0) * WEIGHTS(0) + PIXELS_AT(1) * WEIGHTS(1) +
             PIXELS_AT(2) * WEIGHTS(2) + PIXELS_AT(3) * WEIGHTS(3);
    }
    *(__global uint8 *)(sums + x) = sum;
  }
}

void add_row(__global const uint *restrict sums, const uint weight, const uint count,
             __global SUM_OF_BOTH *restrict total) {
  for (uint x = 0; x < count; x += 8)
    *(__global SUMS_OF_BOTH *)(total + x) += WIDE((*(__global const uint8 *)(sums + x))) * weight;
}

/* The rounded result; `total` is then that of nothing. */
void round_row(__global SUM_OF_BOTH *restrict total, const uint columns,
               __global PIXEL *restrict scaled) {
  for (uint x = 0; x < columns; ++x) {
    scaled[x] = (PIXEL)((total[x] + (1u << 21)) >> 22);
    total[x] = 0;
  }
}

__kernel void resample_bands(__global const PIXEL *restrict image,
                             __global const int *restrict first_y,
                             __global const uint *restrict weight_y, const uint taps_y,
                             __global const int *restrict first_x,
                             __global const uint *restrict weight_x, const uint taps_x,
                             const uint count, const uint full_rows, const uint full_step,
                             const uint rows, const uint columns, const uint step,
                             const uint band_rows, __global uint *restrict all_sums,
                             __global SUM_OF_BOTH *restrict all_totals,
                             __global PIXEL *restrict scaled) {
  const size_t p = get_global_id(1), band = p * get_global_size(0) + get_global_id(0);
  const uint first = get_global_id(0) * band_rows, end = SMALLER(first + band_rows, rows);
  __global const PIXEL *pixels = image + (p * full_rows + 1) * full_step + PAD;
  __global uint *sums = all_sums + 2 * band * count;
  __global SUM_OF_BOTH *total = all_totals + band * count;
  for (uint x = 0; x < count; ++x) total[x] = 0;
  int kept[2] = {-1, -1}; /* rows of the image whose sums are there, even and odd ones */
  for (uint y = first; y < end; ++y) {
    for (uint tap = 0; tap < taps_y; ++tap) {
      const uint weight = weight_y[y * taps_y + tap];
      if (weight == 0) continue;
      const int v = first_y[y] + (int)tap;
      __global uint *row_sums = sums + (v & 1) * count;
      if (kept[v & 1] != v)
        sum_row(pixels + (size_t)v * full_step, first_x, weight_x, taps_x, count, row_sums);
      kept[v & 1] = v;
      add_row(row_sums, weight, count, total);
    }
    round_row(total, columns, scaled + ROW(p, y) + PAD);
  }
}
