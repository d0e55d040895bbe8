#include "plane.clh"
#include "ring.clh"

/* Double-layer sampling and the spectral criteria (section 3.3, Eqs. 13 and 17).
 *
 * The tables have an entry for each of the 65 536 rings. That of an inner ring is its response if
 * |F2| exceeds |F1| and |F3|, and 0 if not; that of an outer ring says whether it does. */

/* The largest correlation of the two rings over all rotations, and the smallest |centre| of the
 * runs of rotations that reach it, in half samples; 0 if all do. */
uint2 best_rotation(const uint g1, const uint g2) {
  uint best = 0, rotations = 0;
  for (uint k = 0; k < 16; ++k) {
    const uint r = popcount(g1 & ROTATE(g2, k));
    rotations = r > best ? 1u << k : r == best ? rotations | 1u << k : rotations;
    best = max(best, r);
  }
  if (rotations == 0xffffu) return (uint2)(best, 0);
  uint smallest = 16;
  const uint starts = rotations & ~((rotations << 1 | rotations >> 15) & 0xffffu);
  for (uint left = starts; left; left &= left - 1) {
    const uint first = 31 - clz(left & (0u - left));
    uint length = 1;
    while (rotations >> ((first + length) & 15) & 1) ++length;
    const uint twice = (2 * first + length - 1) & 31;
    smallest = min(smallest, twice > 16 ? 32 - twice : twice);
  }
  return (uint2)(best, smallest);
}

/* Response of the inner ring where all criteria hold, 0 elsewhere. `area` has
 * a bit for every pixel, set where candidates may be; other pixels are skipped. */
__kernel void spectral_criteria(__global const uchar *restrict binary,
                                __global const uchar *restrict area,
                                __global const int *restrict inner_response,
                                __global const uchar *restrict outer_passes,
                                __global const uchar *restrict least_correlation,
                                const uint rows, const uint step, const int phase_bound,
                                const char corrosion_threshold,
                                __global RESPONSE *restrict response) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  const size_t i = ROW(p, y) + x;
  response[i] = 0;
  if (!(area[(y * step + x) / 8] >> x % 8 & 1)) return;
  const uint g2 = 0 INNER_RING(RING_BIT);
  const int r = inner_response[g2];
  if (r == 0) return;
  const uint g1 = 0 OUTER_RING(RING_BIT);
  if (!outer_passes[g1]) return;
#if CORROSION
  if (corrosion_of(g1, 0u REGION(RING_BIT)) >= corrosion_threshold) return;
#endif
  const uint2 best = best_rotation(g1, g2);
  if (best.x < least_correlation[popcount(g1) * popcount(g2)]) return;
  if ((int)best.y >= phase_bound) return;
  response[i] = (RESPONSE)r;
}

/* Ring bits, corrosion, best correlation and phase in half samples, at every pixel of a plane. */
__kernel void spectral_maps(__global const uchar *restrict binary, const uint rows,
                            const uint step, __global ushort *restrict inner,
                            __global ushort *restrict outer, __global char *restrict corrosion,
                            __global uchar *restrict correlation,
                            __global uchar *restrict phase) {
  const size_t x = get_global_id(0), y = get_global_id(1), p = get_global_id(2);
  const size_t i = ROW(p, y) + x;
  const uint g2 = 0 INNER_RING(RING_BIT);
  const uint g1 = 0 OUTER_RING(RING_BIT);
  const uint2 best = best_rotation(g1, g2);
  inner[i] = (ushort)g2;
  outer[i] = (ushort)g1;
  corrosion[i] = (char)corrosion_of(g1, 0u REGION(RING_BIT));
  correlation[i] = (uchar)best.x;
  phase[i] = (uchar)best.y;
}
