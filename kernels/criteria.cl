#include "plane.clh"
#include "ring.clh"

/* Double-layer sampling and the four rapid criteria (sections 3.2 and 3.4, Eqs. 18 to 24).
 *
 * A colour is 0, white, or 1, black. a0..a15 are the inner ring's samples, b0..b15 the outer
 * ring's. Everything is a byte and nothing branches, so that a vector holds 32 or 64 pixels. */

/* The runs of the inner ring from sample 0 on are numbered modulo 4 by two bits:
 * lo = a_i ^ a_0 changes with every transition, hi with every second one. */
#define RUN_INDEX(i, before)                                                        \
  const uchar lo##i = a##i ^ a0;                                                    \
  const uchar hi##i = hi##before ^ ((a##i ^ a##before) & lo##before);
#define RUN_INDICES                                                                 \
  const uchar lo0 = 0, hi0 = 0;                                                     \
  RUN_INDEX(1, 0) RUN_INDEX(2, 1) RUN_INDEX(3, 2) RUN_INDEX(4, 3) RUN_INDEX(5, 4)   \
  RUN_INDEX(6, 5) RUN_INDEX(7, 6) RUN_INDEX(8, 7) RUN_INDEX(9, 8) RUN_INDEX(10, 9)  \
  RUN_INDEX(11, 10) RUN_INDEX(12, 11) RUN_INDEX(13, 12) RUN_INDEX(14, 13)           \
  RUN_INDEX(15, 14)

#define BLACK_AT(dx, dy) binary[NEAR_ROW(p, (int)y + (dy)) + x + (dx)]
#define LOAD_INNER(i, dx, dy) const uchar a##i = BLACK_AT(dx, dy);
#define LOAD_OUTER(i, dx, dy) const uchar b##i = BLACK_AT(dx, dy);
#define LOAD_REGION(i, dx, dy) const uchar r##i = BLACK_AT(dx, dy);

/* Response R of Eq. 24 where all criteria hold, 0 elsewhere. */
__kernel void rapid_criteria(__global const uchar *restrict binary, const uint rows,
                             const uint step, const uchar sector_threshold,
                             const uchar ring_threshold, const char corrosion_threshold,
                             const uchar zero, __global uchar *restrict response) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  INNER_RING(LOAD_INNER)
  OUTER_RING(LOAD_OUTER)
  RUN_INDICES

  /* Eqs. 19 and 20. */
#define CHANGE(i, j, k) const uchar c##i = a##i ^ a##j;
  AROUND(CHANGE)
#define STEADY_CHANGE(i, j, k) const uchar s##i = (b##i ^ b##j) & (b##i ^ b##k);
  AROUND(STEADY_CHANGE)
#define INNER(i) c##i
  const uchar inner_transitions = SUM_RING(uchar, INNER);
#define OUTER(i) s##i
  const uchar outer_transitions = SUM_RING(uchar, OUTER);

  /* Eq. 21. Lengths of runs: l1 + l3 samples have lo = 1, l2 have only hi, l3 have both. */
#define ODD(i) lo##i
  const uchar odd = SUM_RING(uchar, ODD);
#define SECOND(i) (hi##i & (lo##i ^ 1))
  const uchar l2 = SUM_RING(uchar, SECOND);
#define THIRD(i) (hi##i & lo##i)
  const uchar l3 = SUM_RING(uchar, THIRD);
  const uchar l0 = (uchar)(16 - odd - l2) ^ zero;
  const uchar even_difference = (uchar)(l0 > l2 ? l0 - l2 : l2 - l0);
  const uchar signed_difference = (uchar)(odd - l3 - l3) ^ zero;
  const uchar odd_difference =
      signed_difference > 127 ? (uchar)(0 - signed_difference) : signed_difference;
  const uchar sector_difference = LARGER(even_difference, odd_difference);

  /* Eq. 22. */
#define DIFFERENT(i) (a##i ^ b##i)
  const uchar ring_difference = SUM_RING(uchar, DIFFERENT);

  uchar holds = (uchar)((inner_transitions == 4) & (outer_transitions == 4) &
                        (sector_difference < sector_threshold) &
                        (ring_difference < ring_threshold));
#if CORROSION
  /* Eq. 23, on the black and on the white pixels. */
  REGION(LOAD_REGION)
#define BLACK(i) b##i
  const uchar n1 = SUM_RING(uchar, BLACK);
#define FILLED(i) r##i
  const uchar nr = SUM3(uchar, SUM_RING(uchar, FILLED), SUM3(uchar, r16, r17, r18),
                        SUM3(uchar, r19, r20, 0));
  const char black_loss = (char)(n1 - nr);
  const char white_loss = (char)((uchar)(nr - n1 - 5) ^ zero);
  holds &= (uchar)(LARGER(black_loss, white_loss) < corrosion_threshold);
#endif

  response[ROW(p, y) + x] =
      (uchar)((sector_threshold - sector_difference) & (uchar)(0 - holds));
}

/* d2 of Eq. 21; 255 if there are not four runs. */
uint run_difference(const uint mask) {
  uint left = mask ^ ROTATE(mask, 1), end[4];
  if (popcount(left) != 4) return 255;
  /* Sample k ends a run where bit k is set. */
  for (int k = 0; k < 4; ++k) {
    end[k] = 31 - clz(left & (0u - left));
    left &= left - 1;
  }
  const int l0 = 16 - (int)(end[3] - end[0]), l1 = (int)(end[1] - end[0]);
  const int l2 = (int)(end[2] - end[1]), l3 = (int)(end[3] - end[2]);
  return max(abs(l0 - l2), abs(l1 - l3));
}

/* Every quantity of the criteria, at every pixel. */
__kernel void ring_maps(__global const uchar *restrict binary, const uint rows,
                        const uint step, __global ushort *restrict inner,
                        __global ushort *restrict outer,
                        __global uchar *restrict inner_transitions,
                        __global uchar *restrict outer_transitions,
                        __global uchar *restrict sector_difference,
                        __global uchar *restrict ring_difference,
                        __global char *restrict corrosion) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  const size_t i = ROW(p, y) + x;
  const uint g2 = 0 INNER_RING(RING_BIT);
  const uint g1 = 0 OUTER_RING(RING_BIT);

  inner[i] = (ushort)g2;
  outer[i] = (ushort)g1;
  inner_transitions[i] = (uchar)popcount(g2 ^ ROTATE(g2, 1));
  outer_transitions[i] = (uchar)popcount((g1 ^ ROTATE(g1, 1)) & (g1 ^ ROTATE(g1, 2)));
  sector_difference[i] = (uchar)run_difference(g2);
  ring_difference[i] = (uchar)popcount(g1 ^ g2);
  corrosion[i] = (char)corrosion_of(g1, 0u REGION(RING_BIT));
}
