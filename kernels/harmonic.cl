#include "harmonic.clh"
#include "pixel.clh"

/* From an image to the lists of its maxima, one work-item per pixel; harmonic.clh has the rule.
 *
 * A plane of S1 is in sixteenths of 1/255 of full scale. */

/* The column of a work-item; in the padding it is the border column. */
#define HELD_COLUMN (size_t)(PAD + clamp((int)get_global_id(0) - PAD, 0, (int)columns - 1))

#define BINOMIAL(at)                                                                \
  (at(-1, -1) + at(1, -1) + at(-1, 1) + at(1, 1) +                                  \
   2 * (at(0, -1) + at(-1, 0) + at(1, 0) + at(0, 1)) + 4 * at(0, 0))

/* S1. One work-item per pixel. */
__kernel void smooth_image(__global const PIXEL *restrict image, const uint rows,
                           const uint columns, const uint step, const uint full_scale,
                           __global ushort *restrict smooth) {
  const size_t x = HELD_COLUMN, y = get_global_id(1), p = get_global_id(2);
#if WHOLE_LEVELS /* a pixel is the grey level */
#define LEVEL_AT(dx, dy)                                                            \
  (uint)image[NEAR_ROW(p, (int)y + (dy)) + PAD +                                    \
              clamp((int)x - PAD + (dx), 0, (int)columns - 1)]
  const uint level = BINOMIAL(LEVEL_AT);
#else
#define LEVEL_AT(dx, dy)                                                            \
  ((min((uint)image[NEAR_ROW(p, (int)y + (dy)) + PAD +                              \
                    clamp((int)x - PAD + (dx), 0, (int)columns - 1)],               \
        full_scale) * 4080 + full_scale / 2) / full_scale)
  const uint level = (BINOMIAL(LEVEL_AT) + 8) >> 4;
#endif
  smooth[ROW(p, y) + get_global_id(0)] = (ushort)level;
}

/* S2 of S1, S3 of S2. One work-item per pixel. */
__kernel void smooth(__global const ushort *restrict plane, const uint rows,
                     const uint columns, const uint step, __global ushort *restrict smoother) {
  const size_t x = HELD_COLUMN, y = get_global_id(1), p = get_global_id(2);
#define SMOOTH_AT(dx, dy)                                                           \
  (uint)plane[NEAR_ROW(p, (int)y + (dy)) + PAD +                                    \
              clamp((int)x - PAD + (dx), 0, (int)columns - 1)]
  smoother[ROW(p, y) + get_global_id(0)] = (ushort)((BINOMIAL(SMOOTH_AT) + 8) >> 4);
}

/* The pixels of an octave's S3. One work-item per pixel. */
__kernel void pixels_of_plane(__global const ushort *restrict plane, const uint rows,
                              const uint step, __global PIXEL *restrict image) {
  const size_t at = ROW(get_global_id(2), get_global_id(1)) + get_global_id(0);
  image[at] = AS_PIXEL(plane[at]);
}

/* Ring (a, d) around row y of frame p. The padding repeats the border. */
#define RING_OF(plane, a, d)                                                        \
  (Ring){(plane) + NEAR_ROW(p, y - (a)), (plane) + NEAR_ROW(p, y - (d)),            \
         (plane) + ROW(p, y), (plane) + NEAR_ROW(p, y + (d)), (plane) + NEAR_ROW(p, y + (a))}

/* A response; 0 outside the image. One work-item per pixel. */
#define DENSE                                                                       \
  __global const ushort *restrict plane, const uint rows, const uint columns,       \
      const uint step, __global short *restrict response
#define STORE(RESPONSE_OF, a, d)                                                    \
  {                                                                                 \
    const int x = (int)get_global_id(0), y = (int)get_global_id(1);                 \
    const size_t p = get_global_id(2);                                              \
    const bool inside = x >= PAD && x < PAD + (int)columns;                         \
    const Harmonics h = harmonics_of(RING_OF(plane, a, d), inside ? x : PAD, a, d); \
    response[ROW(p, y) + x] = (short)(inside ? RESPONSE_OF(h) : 0);                 \
  }
__kernel void coarse_response(DENSE) STORE(coarse_response_of, 5, 4)
#if FINE
__kernel void fine_response(DENSE) STORE(fine_response_of, 3, 2)
#endif

/* True if a pixel is the largest of its window; of equal ones, the earlier pixel. */
bool is_maximum(__global const short *response, const size_t p, const int x, const int y,
                const uint rows, const uint step) {
  const short r = response[ROW(p, y) + x];
  if (r <= LEAST) return false;
  for (int line = 0; line <= 2 * NMS_RADIUS; ++line) { /* the nearest rows first */
    const int dy = line % 2 ? line / 2 + 1 : -(line / 2);
    if (y + dy < 0 || y + dy >= (int)rows) continue;
    for (int dx = -NMS_RADIUS; dx <= NMS_RADIUS; ++dx) {
      const short other = response[ROW(p, y + dy) + x + dx];
      const bool earlier = dy < 0 || (dy == 0 && dx < 0);
      if (other > r || (earlier && other == r)) return false;
    }
  }
  return true;
}

/* Append a maximum to a list. */
void append(__global const short *response, const size_t p, const int x, const int y,
            const int marks, const uint rows, const uint step, const uint capacity,
            __global uint *count, __global int *list) {
  const uint n = atomic_inc(count);
  if (n >= capacity) return;
  SUMS_OF_25(response, x, y)
  list[n] = x - PAD;
  list[capacity + n] = y;
  list[2 * capacity + n] = response[ROW(p, y) + x];
  list[3 * capacity + n] = sum | marks;
  list[4 * capacity + n] = sum_x;
  list[5 * capacity + n] = sum_y;
}

#define IN_AREA(x, y, words) (area[(uint)(y) * (words) + (uint)(x) / 32] >> (x) % 32 & 1)

/* List the maxima of the coarse response of an octave that look alike. `area` has a bit for every
 * pixel of the frame, in rows of `frame_words`. One work-item per pixel. */
__kernel void coarse_maxima(__global const ushort *restrict fine_plane,
                            __global const ushort *restrict coarse_plane,
                            __global const short *restrict response,
                            __global const uint *restrict area, const uint rows,
                            const uint columns, const uint step, const uint capacity,
                            const uint octave, const uint frame_words,
                            const uint counters_of_frame, __global uint *restrict counters,
                            __global int *restrict lists) {
  const int x = (int)get_global_id(0), y = (int)get_global_id(1);
  const size_t p = get_global_id(2);
  if (x < PAD || x >= PAD + (int)columns) return;
  if (!IN_AREA(PAD + TO_FRAME(x - PAD, octave), TO_FRAME(y, octave), frame_words)) return;
  if (!is_maximum(response, p, x, y, rows, step)) return;
  const int r = response[ROW(p, y) + x];
  const Harmonics inner = harmonics_of(RING_OF(fine_plane, 3, 2), x, 3, 2);
  const Harmonics middle = harmonics_of(RING_OF(coarse_plane, 4, 3), x, 4, 3);
  const Harmonics outer = harmonics_of(RING_OF(coarse_plane, 5, 4), x, 5, 4);
  if (!looks_alike(r, inner, middle, outer)) return;
  const int marks =
      octave ? marks_of_halved(r, outer, harmonics_of(RING_OF(coarse_plane, 8, 6), x, 8, 6))
             : marks_of(r, outer);
  const uint kind = KIND_OF_OCTAVE(octave);
  append(response, p, x, y, marks, rows, step, capacity, &COUNT_OF(kind),
         LIST_OF(kind));
}

#if FINE

/* List the maxima of the fine response with which the ring of 2 px is aligned. One work-item per
 * pixel. */
__kernel void fine_maxima(__global const ushort *restrict fine_plane,
                          __global const short *restrict response,
                          __global const uint *restrict area, const uint rows,
                          const uint columns, const uint step, const uint capacity,
                          const uint counters_of_frame, __global uint *restrict counters,
                          __global int *restrict lists) {
  const int x = (int)get_global_id(0), y = (int)get_global_id(1);
  const size_t p = get_global_id(2);
  if (x < PAD || x >= PAD + (int)columns || !IN_AREA(x, y, step / 32)) return;
  if (!is_maximum(response, p, x, y, rows, step)) return;
  const Harmonics inner = harmonics_of(RING_OF(fine_plane, 2, 1), x, 2, 1);
  const Harmonics outer = harmonics_of(RING_OF(fine_plane, 3, 2), x, 3, 2);
  if (!are_aligned(4, inner, outer)) return;
  append(response, p, x, y, direction_of(outer), rows, step, capacity, &COUNT_OF(1), LIST_OF(1));
}

#endif
