#include "plane.clh"

/* Load eight pixels, and tell whether any of them is not 0. */
#if RAPID
typedef uchar8 RESPONSES_8;
#define ANY_OF_EIGHT(v) (as_ulong(v) != 0)
#else
typedef ushort8 RESPONSES_8;
#define ANY_OF_EIGHT(v) ((as_ulong2(v).x | as_ulong2(v).y) != 0)
#endif

/* List the candidates within the area, in any order: their indices from the start of
 * the frame's rows, and their responses, which are cleared in the image. `area` has a bit for
 * every pixel. The list of frame p has `capacity` entries; its count, the first of the LISTS that a
 * frame has, may exceed that. One work-item per eight pixels. */
__kernel void list_candidates(__global RESPONSE *restrict response,
                              __global const uchar *restrict area, const uint rows,
                              const uint step, const uint capacity,
                              __global uint *restrict list,
                              __global RESPONSE *restrict list_of_responses,
                              __global uint *restrict counts) {
  const uint index = get_global_id(1) * step + 8 * get_global_id(0);
  const size_t p = get_global_id(2);
  __global RESPONSE *eight = response + ROW(p, 0) + index;
  if (!ANY_OF_EIGHT(*(__global RESPONSES_8 *)eight)) return;
  uint left = 0;
  for (uint k = 0; k < 8; ++k) left |= (uint)(eight[k] != 0) << k;
  left &= area[index / 8];
  uint n = atomic_add(counts + p * LISTS, popcount(left));
  for (; left && n < capacity; ++n, left &= left - 1) {
    const uint k = 31 - clz(left & (0u - left));
    list[p * capacity + n] = index + k;
    list_of_responses[p * capacity + n] = eight[k];
  }
  *(__global RESPONSES_8 *)eight = 0;
}
