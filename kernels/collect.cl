/* Lists of the pixels that are not 0, in (y, x) order whatever the order of the work-items.
 *
 * Pads hold 0, and rows are aligned to 64 bits, which WORD holds: few of them are read one after
 * the other. The list of plane p has `room` entries; its count, at place + p, runs past the room. */

#define LISTS(COUNT, LIST, T, WORD)                                                 \
  /* Pixels of each row that are not 0. One work-item per row. */                   \
  __kernel void COUNT(__global const T *restrict image, const uint rows,            \
                      const uint columns, const uint step,                          \
                      __global uint *restrict counts) {                             \
    const size_t y = get_global_id(0), p = get_global_id(1);                        \
    __global const WORD *words = (__global const WORD *)(image + ROW(p, y) + PAD);  \
    const uint pixels = sizeof(WORD) / sizeof(T);                                   \
    uint bits = 0;                                                                  \
    for (uint word = 0; word * pixels < columns; ++word)                            \
      bits += (uint)popcount(as_ulong(words[word] != (WORD)(0)));                   \
    counts[p * rows + y] = bits / (8 * sizeof(T));                                  \
  }                                                                                 \
  /* Their positions and the count of the plane. One work-item per row. */          \
  __kernel void LIST(__global const T *restrict image,                              \
                     __global const uint *restrict counts, const uint rows,         \
                     const uint columns, const uint step, const uint room,          \
                     const uint place, __global int2 *restrict list,                \
                     __global uint *restrict totals) {                              \
    const size_t y = get_global_id(0), p = get_global_id(1);                        \
    __global const T *row = image + ROW(p, y) + PAD;                                \
    const uint count = counts[p * rows + y];                                        \
    uint n = 0;                                                                     \
    for (uint k = 0; k < y; ++k) n += counts[p * rows + k];                         \
    const uint end = n + count;                                                     \
    if (y == rows - 1) totals[place + p] = end;                                     \
    __global const ulong *words = (__global const ulong *)row;                      \
    for (uint word = 0; n < end; ++word) {                                          \
      if (words[word] == 0) continue;                                               \
      const uint first = word * (sizeof(ulong) / sizeof(T));                        \
      for (uint x = first; x < first + sizeof(ulong) / sizeof(T); ++x)              \
        if (row[x] != 0) {                                                          \
          if (n < room) list[p * room + n] = (int2)((int)x, (int)y);                \
          ++n;                                                                      \
        }                                                                           \
    }                                                                               \
  }

LISTS(count_candidates, list_candidates, RESPONSE, RESPONSE_WORD)
LISTS(count_maxima, list_maxima, uchar, uchar8)
