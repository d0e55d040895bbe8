#include "plane.clh"

/* Non-maximum suppression (section 3.5): S is the response R convolved with the tent [1 2 3 2 1] in
 * x and y; a candidate is kept iff its key 10 S + R is the largest of its window. Of equal keys,
 * the pixel that comes first in raster order wins. The response is 0 outside the image.
 *
 * A candidate is given by its index from the start of the frame's rows. Elsewhere the response is
 * 0 and the key undefined. */

#ifndef NMS_RADIUS
#error "NMS_RADIUS must be that of suppression"
#endif

/* S of a pixel of row y. */
int tent(__global const RESPONSE *pixel, const int y, const uint rows, const uint step) {
  int s = 0;
  for (int dy = -2; dy <= 2; ++dy) {
    if (y + dy < 0 || y + dy >= (int)rows) continue;
    __global const RESPONSE *row = pixel + dy * (long)step;
    s += (3 - abs(dy)) * (row[-2] + row[2] + 2 * (row[-1] + row[1]) + 3 * row[0]);
  }
  return s;
}

/* S at every pixel, even where there is no response. */
__kernel void score_map(__global const RESPONSE *restrict response, const uint rows,
                        const uint step, __global int *restrict scores) {
  const int y = (int)get_global_id(1);
  const size_t i = ROW(0, y) + get_global_id(0);
  scores[i] = tent(response + i, y, rows, step);
}

#define CANDIDATE                                                                   \
  const size_t n = get_global_id(0), p = get_global_id(1);                         \
  if (n >= min(counts[p * LISTS], capacity)) return;                                \
  const uint index = list[p * capacity + n];                                        \
  const size_t i = ROW(p, 0) + index;                                               \
  const int y = (int)(index / step);

/* Write the responses of the candidates. */
__kernel void scatter(__global const uint *restrict list, __global const uint *restrict counts,
                      const uint rows, const uint step, const uint capacity,
                      __global const RESPONSE *restrict list_of_responses,
                      __global RESPONSE *restrict response) {
  CANDIDATE
  response[i] = list_of_responses[p * capacity + n];
}

#define KEY(pixel, y) (SCORE)(10 * tent(pixel, y, rows, step) + *(pixel))

#if KEYS

/* Compute the keys. */
__kernel void score(__global const uint *restrict list, __global const uint *restrict counts,
                    const uint rows, const uint step, const uint capacity,
                    __global const RESPONSE *restrict response, __global SCORE *restrict key) {
  CANDIDATE
  if (response[i] != 0) key[i] = KEY(response + i, y);
}

#define KEY_AT(i, y) key[i]
#else
#define KEY_AT(i, y) KEY(response + (i), y)
#endif

/* Keep a key that is above all earlier ones and not below any later one. */
__kernel void maximum(__global const uint *restrict list, __global const uint *restrict counts,
                      const uint rows, const uint step, const uint capacity,
                      __global const RESPONSE *restrict response,
#if KEYS
                      __global const SCORE *restrict key,
#endif
                      __global uint *restrict row_counts, __global uint *restrict maxima) {
  CANDIDATE
  if (response[i] == 0) return;
  const SCORE k = KEY_AT(i, y);
  for (int row = 0; row <= 2 * NMS_RADIUS; ++row) { /* the nearest ones first */
    const int dy = row % 2 ? row / 2 + 1 : -(row / 2);
    if (y + dy < 0 || y + dy >= (int)rows) continue;
    for (int dx = -NMS_RADIUS; dx <= NMS_RADIUS; ++dx) {
      const size_t other = i + dy * (long)step + dx;
      if (response[other] == 0) continue;
      const bool earlier = dy < 0 || (dy == 0 && dx < 0);
      const SCORE others = KEY_AT(other, y + dy);
      if (others > k || (earlier && others == k)) return;
    }
  }
  const uint bit = 1u << index % 32;
  __global uint *word = maxima + (p * rows + y) * (step / 32) + index % step / 32;
  atomic_or(word, bit);
#if !GATE /* which counts the maxima that pass */
  atomic_inc(row_counts + p * rows + y);
#endif
}
