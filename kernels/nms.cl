/* Non-maximum suppression (section 3.5): S is the response under the tent [1 2 3 2 1] in x
 * and y; a candidate is kept iff its key 10 S + R is the largest of its window, the earlier
 * pixel in raster order winning a tie. The response is 0 outside the image.
 *
 * OVER_SUPPRESSION(F) is F(1) .. F(r) with r the radius of the window. */

/* S at every pixel, where there is no response too. */
__kernel void score_map(__global const RESPONSE *restrict response, const uint rows,
                        const uint step, __global int *restrict scores) {
  const int x = (int)get_global_id(0), y = (int)get_global_id(1);
  int s = 0;
  for (int dy = -2; dy <= 2; ++dy)
    for (int dx = -2; dx <= 2; ++dx)
      if (y + dy >= 0 && y + dy < (int)rows)
        s += (3 - abs(dx)) * (3 - abs(dy)) * response[ROW(0, y + dy) + PAD + x + dx];
  scores[(size_t)y * get_global_size(0) + x] = s;
}

#if !IN_WORDS

#ifndef OVER_SUPPRESSION
#error "OVER_SUPPRESSION must list the distances 1 to the radius"
#endif

#define RESPONSE_AT(dx) (SCORE)response[i + (dx)]

/* The tent along x. */
__kernel void tent_rows(__global const RESPONSE *restrict response, const uint rows,
                        const uint step, const SCORE zero, __global SCORE *restrict tent) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  const size_t i = ROW(p, y) + x;
  const SCORE near = SUM3(SCORE, RESPONSE_AT(-1), RESPONSE_AT(1), RESPONSE_AT(0));
  tent[i] = SUM3(SCORE, SUM3(SCORE, RESPONSE_AT(-2), RESPONSE_AT(2), RESPONSE_AT(0)),
                 near, near);
}

/* What lies at a distance in y; a row of zeros outside the image. */
#define AT(image, dy)                                                               \
  ((int)y + (dy) >= 0 && (int)y + (dy) < (int)rows ? image + ROW(p, (int)y + (dy)) : zeros)[x]

/* The tent along y, and the key; the key is 0 where there is no response. */
__kernel void score(__global const RESPONSE *restrict response,
                    __global const SCORE *restrict tent,
                    __global const SCORE *restrict zeros, const uint rows, const uint step,
                    const SCORE zero, __global SCORE *restrict key) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  const size_t i = ROW(p, y) + x;
  const SCORE near = SUM3(SCORE, AT(tent, -1), AT(tent, 1), tent[i]);
  const SCORE s = SUM3(SCORE, SUM3(SCORE, AT(tent, -2), AT(tent, 2), tent[i]), near, near);
  const SCORE r = (SCORE)response[i];
  key[i] = (SCORE)(r != 0 ? 10 * s + r : 0);
}

/* The largest key of the window's row. */
__kernel void row_maximum(__global const SCORE *restrict key, const uint rows, const uint step,
                          const SCORE zero, __global SCORE *restrict largest) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  const size_t i = ROW(p, y) + x;
  SCORE m = key[i];
#define EITHER_SIDE(d) m = LARGEST3(SCORE, key[i - (d)], key[i + (d)], m);
  OVER_SUPPRESSION(EITHER_SIDE)
  largest[i] = m;
}

/* A key that is above all earlier ones and not below any later one is kept. */
__kernel void maximum(__global const SCORE *restrict key, __global const SCORE *restrict largest,
                      __global const SCORE *restrict zeros, const uint rows,
                      const uint step, const SCORE zero, __global uchar *restrict maxima) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  const size_t i = ROW(p, y) + x;
  SCORE earlier = 0, later = largest[i];
#define EARLIER(d)                                                                  \
  const SCORE left##d = key[i - (d)], above##d = AT(largest, -(d));                 \
  earlier = LARGEST3(SCORE, left##d, above##d, earlier);
  OVER_SUPPRESSION(EARLIER)
#define LATER(d)                                                                    \
  const SCORE below##d = AT(largest, d);                                            \
  later = (SCORE)LARGER(below##d, later) ^ zero;
  OVER_SUPPRESSION(LATER)
  const SCORE k = key[i];
  maxima[i] = (uchar)((k > earlier) & (k >= later));
}

#if MASKS == 3

/* The responses of the three masks together: 2 R(0) + R(-1/2) + R(+1/2). */
__kernel void combine(__global const RESPONSE *restrict responses, const uint rows,
                      const uint step, __global RESPONSE *restrict response) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  response[ROW(p, y) + x] =
      (RESPONSE)(2 * responses[ROW(3 * p, y) + x] + responses[ROW(3 * p + 1, y) + x] +
                 responses[ROW(3 * p + 2, y) + x]);
}

#endif

#endif
