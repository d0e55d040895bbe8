#include "octave.clh"

/* The grey-level rule: the second harmonic of eight samples on a ring, minus quantities that are
 * small at a corner. Shifts are arithmetic; every number is whole, so every device has the same
 * result.
 *
 *   S1 = [1 2 1]^T [1 2 1] * I; S2 is the same of S1, and S3 of S2, each divided by 16
 *   s0 .. s7 the samples of ring (a, d), clockwise: (0, -a) (d, -d) (a, 0) (d, d) ...
 *   u_k = s_k + s_(k+4);  A = u0 - u2, B = u1 - u3: the second harmonic
 *   F = max(|A|, |B|) + min / 4 + min / 8, its length
 *   o = sum |s_k - s_(k+4)|: the odd harmonics;  e = |u0 + u1 + u2 + u3 - 8 centre|
 *   coarse response: F - 3/4 o - 3/8 e of ring (5, 4) on S3
 *   fine response:   F - 3/4 (o + e) of ring (3, 2) on S1
 *
 * A plane of S1 is in sixteenths of 1/255 of full scale. */

#ifndef NMS_RADIUS
#error "NMS_RADIUS must be that of suppression"
#endif

#define LEAST 80 /* least bound: a step of two grey levels may have this response */
#define KINDS (1 + FINE + OCTAVES)
#define KIND_OF_OCTAVE(n) ((n) ? FINE + (n) : 0)
#define LIST_COLUMNS 6
#define CLEAN (1 << 30) /* in the column of the sums, of the frame: see is_clean */
#define WIDE CLEAN      /* the same bit in a halved frame: the ring of 8 px responds too */
#define KEPT (1 << 29)  /* in the same column: a corner */

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

typedef struct {
  int2 second; /* A, B */
  int length, odd, centre;
} Harmonics;

/* The harmonics of ring (a, d) around column x of row y of frame p. The padding repeats the
 * border. */
Harmonics harmonics_of(__global const ushort *plane, const size_t p, const int x, const int y,
                       const int a, const int d, const uint rows, const uint step) {
  __global const ushort *middle = plane + ROW(p, y) + x;
  __global const ushort *upper = plane + NEAR_ROW(p, y - d) + x;
  __global const ushort *lower = plane + NEAR_ROW(p, y + d) + x;
  const int s0 = plane[NEAR_ROW(p, y - a) + x], s4 = plane[NEAR_ROW(p, y + a) + x];
  const int s1 = upper[d], s5 = lower[-d], s2 = middle[a], s6 = middle[-a];
  const int s3 = lower[d], s7 = upper[-d];
  const int u0 = s0 + s4, u1 = s1 + s5, u2 = s2 + s6, u3 = s3 + s7;
  const int low = min(abs(u0 - u2), abs(u1 - u3)), high = max(abs(u0 - u2), abs(u1 - u3));
  Harmonics found = {(int2)(u0 - u2, u1 - u3), high + (low >> 2) + (low >> 3),
                     abs(s0 - s4) + abs(s1 - s5) + abs(s2 - s6) + abs(s3 - s7),
                     abs(u0 + u1 + u2 + u3 - 8 * middle[0])};
  return found;
}

int coarse_response_of(const Harmonics h) {
  return h.length - (h.odd - (h.odd >> 2)) - ((h.centre >> 2) + (h.centre >> 3));
}

int fine_response_of(const Harmonics h) {
  return h.length - ((h.odd + h.centre) - ((h.odd + h.centre) >> 2));
}

/* A response; 0 outside the image. One work-item per pixel. */
#define DENSE(RESPONSE_OF, a, d)                                                    \
  (__global const ushort *restrict plane, const uint rows, const uint columns,      \
   const uint step, __global short *restrict response) {                            \
    const int x = (int)get_global_id(0), y = (int)get_global_id(1);                 \
    const size_t p = get_global_id(2);                                              \
    const bool inside = x >= PAD && x < PAD + (int)columns;                         \
    const int near = inside ? x : PAD;                                              \
    const Harmonics h = harmonics_of(plane, p, near, y, a, d, rows, step);          \
    response[ROW(p, y) + x] = (short)(inside ? RESPONSE_OF(h) : 0);                 \
  }
__kernel void coarse_response DENSE(coarse_response_of, 5, 4)
#if FINE
__kernel void fine_response DENSE(fine_response_of, 3, 2)
#endif

int dot_of(const int2 a, const int2 b) { return a.x * b.x + a.y * b.y; }

/* Check 1: the second harmonics of a small and of a large ring point in the same direction. */
bool aligned(const int alignment, const Harmonics inner, const Harmonics outer) {
  return (long)alignment * dot_of(inner.second, outer.second) >= dot_of(outer.second, outer.second);
}

/* Check 3: no stripe. Around the middle of a stripe the grey level also rises and falls twice,
 * but there the centre differs from its ring, and the small ring, inside the stripe, has a weak
 * second harmonic. */
bool no_stripe(const Harmonics inner, const Harmonics outer) {
  const long all = dot_of(outer.second, outer.second), along = dot_of(inner.second, outer.second);
  return 8 * outer.centre * all <= outer.length * (11 * all + 8 * along);
}

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

/* True if little is subtracted from the length: the corner is weak at most in contrast, and may be
 * half as weak as others. */
bool is_clean(const int response, const Harmonics h) { return 4 * response >= 3 * h.length; }

/* Append a maximum to a list. The columns are x, y, the response, and the sum and the moments
 * in x and y of the positive responses of the 5 x 5 around it. `mark` is CLEAN or WIDE, and the
 * direction. */
void append(__global const short *response, const size_t p, const int x, const int y,
            const int mark, const uint rows, const uint step, const uint capacity,
            __global uint *total, __global int *list) {
  const uint n = atomic_inc(total);
  if (n >= capacity) return;
  int sum = 0, sum_x = 0, sum_y = 0;
  for (int dy = -2; dy <= 2; ++dy) {
    if (y + dy < 0 || y + dy >= (int)rows) continue;
    for (int dx = -2; dx <= 2; ++dx) {
      const int r = max((int)response[ROW(p, y + dy) + x + dx], 0);
      sum += r;
      sum_x += r * dx;
      sum_y += r * dy;
    }
  }
  list[n] = x - PAD;
  list[capacity + n] = y;
  list[2 * capacity + n] = response[ROW(p, y) + x];
  list[3 * capacity + n] = sum | mark;
  list[4 * capacity + n] = sum_x;
  list[5 * capacity + n] = sum_y;
}

#define LIST(kind) (p * KINDS + (kind))
#define LIST_OF(kind) lists + LIST(kind) * LIST_COLUMNS * capacity

#define IN_AREA(x, y, words) (area[(uint)(y) * (words) + (uint)(x) / 32] >> (x) % 32 & 1)

/* List the maxima of the coarse response of an octave that pass the checks. `area` has a bit for
 * every pixel of the frame, in rows of `frame_words`. One work-item per pixel. */
__kernel void coarse_maxima(__global const ushort *restrict fine_plane,
                            __global const ushort *restrict coarse_plane,
                            __global const short *restrict response,
                            __global const uint *restrict area, const uint rows,
                            const uint columns, const uint step, const uint capacity,
                            const uint octave, const uint frame_words,
                            __global uint *restrict counts, __global int *restrict lists) {
  const int x = (int)get_global_id(0), y = (int)get_global_id(1);
  const size_t p = get_global_id(2);
  if (x < PAD || x >= PAD + (int)columns) return;
  if (!IN_AREA(PAD + TO_FRAME(x - PAD, octave), TO_FRAME(y, octave), frame_words)) return;
  if (!is_maximum(response, p, x, y, rows, step)) return;
  const Harmonics outer = harmonics_of(coarse_plane, p, x, y, 5, 4, rows, step);
  const Harmonics inner = harmonics_of(fine_plane, p, x, y, 3, 2, rows, step);
  if (!aligned(8, inner, outer) || !no_stripe(inner, outer)) return;
  const int r = response[ROW(p, y) + x];
  /* Check 2: a ring of 4 px responds alike. */
  const int middle = coarse_response_of(harmonics_of(coarse_plane, p, x, y, 4, 3, rows, step));
  if (32 * middle < r || middle > 2 * r) return;
  int mark = is_clean(r, outer) ? CLEAN : 0;
#if OCTAVES
  if (octave) {
    const Harmonics wide = harmonics_of(coarse_plane, p, x, y, 8, 6, rows, step);
    mark = 4 * coarse_response_of(wide) < r ? 0 : WIDE;
  } else {
    mark |= direction_bits(outer.second, outer.length);
  }
#endif
  const uint kind = KIND_OF_OCTAVE(octave);
  append(response, p, x, y, mark, rows, step, capacity, counts + LIST(kind), LIST_OF(kind));
}

#if FINE

/* List the maxima of the fine response that pass their check. One work-item per pixel. */
__kernel void fine_maxima(__global const ushort *restrict fine_plane,
                          __global const short *restrict response,
                          __global const uint *restrict area, const uint rows,
                          const uint columns, const uint step, const uint capacity,
                          __global uint *restrict counts, __global int *restrict lists) {
  const int x = (int)get_global_id(0), y = (int)get_global_id(1);
  const size_t p = get_global_id(2);
  if (x < PAD || x >= PAD + (int)columns || !IN_AREA(x, y, step / 32)) return;
  if (!is_maximum(response, p, x, y, rows, step)) return;
  const Harmonics inner = harmonics_of(fine_plane, p, x, y, 2, 1, rows, step);
  const Harmonics outer = harmonics_of(fine_plane, p, x, y, 3, 2, rows, step);
  if (!aligned(4, inner, outer)) return;
  const int mark = OCTAVES ? direction_bits(outer.second, outer.length) : 0;
  append(response, p, x, y, mark, rows, step, capacity, counts + LIST(1), LIST_OF(1));
}

#endif

/* Empty the lists of a frame. One work-item per list. */
__kernel void clear_lists(__global uint *restrict counts) { counts[get_global_id(0)] = 0; }

/* With octaves, `seen` has a bit for each maximum of the first one, see see_octave. */
#if OCTAVES
#define SEEN_ARGUMENT __global uint *restrict seen,
#else
#define SEEN_ARGUMENT
#endif

/* Clear the maps of bits. One work-item per word of a map; dimension 1 is a row. */
__kernel void clear_maxima(const uint rows, const uint step, SEEN_ARGUMENT
                           __global uint *restrict row_counts, __global uint *restrict maxima) {
  const size_t row = get_global_id(2) * rows + get_global_id(1);
  const size_t word = row * (step / 32) + get_global_id(0);
  if (get_global_id(0) >= step / 32) return;
  if (get_global_id(0) == 0) row_counts[row] = 0;
  maxima[word] = 0;
#if OCTAVES
  seen[word] = 0;
#endif
}

/* What is known of an octave of a frame before its maxima are judged. */
typedef struct {
  int bound[2]; /* the least responses that the noise allows */
  int kind, reference;
} Decision;

int noise_bound(const ulong factor, const ulong amplitude, const ulong pixels,
                const ulong full_scale) {
  if (!pixels) return LEAST;
  const ulong whole = 100 * pixels * full_scale;
  const ulong bound = (factor * amplitude * 255 + whole - 1) / whole;
  return (int)max((ulong)LEAST, min(bound, (ulong)INT_MAX));
}

/* The decision about octave n of frame p. */
#define DECISION(p, n) found[(p) * (1 + OCTAVES) + (n)]

#define RESPONSE_BITS 14

/* The sum of the squares of the responses of a list above a bound and not below a level. One
 * work-group. */
ulong squares_from(__global const int *value, const uint count, const int bound, const int level,
                   __local ulong *sums) {
  ulong sum = 0;
  for (uint n = get_local_id(0); n < count; n += get_local_size(0))
    if (value[n] > bound && value[n] >= level) sum += (ulong)((long)value[n] * value[n]);
  return sum_of_group(sum, sums);
}

/* The bounds of an octave from its noise, which comes in `bands` sums. Then its reference: of the
 * responses in descending order, the first at which twice the sum of the squares so far reaches the
 * sum of all, which is the greatest level from which it does; 0 if there are none. One work-group
 * per frame. */
__kernel void find_reference(__global const ulong *restrict noise,
                             __global const uint *restrict counts,
                             __global const int *restrict lists, const uint rows,
                             const uint columns, const uint bands, const uint capacity,
                             const uint full_scale, const uint coarse_noise, const uint octave,
                             __global Decision *restrict found) {
  const size_t p = get_global_id(1);
  __local ulong sums[FRAME_GROUP];
  const ulong pixels = rows > 2 && columns > 2 ? (ulong)(rows - 2) * (columns - 2) : 0;
  ulong amplitude = 0;
  for (uint band = get_local_id(0); band < bands; band += get_local_size(0))
    amplitude += noise[p * bands + band];
  amplitude = sum_of_group(amplitude, sums);
  Decision own = {{0}};
  own.bound[0] = noise_bound(coarse_noise, amplitude, pixels, full_scale);
  own.bound[1] = noise_bound(2 * coarse_noise, amplitude, pixels, full_scale);
  own.kind = KIND_OF_OCTAVE((int)octave);
#define RESPONSES LIST_OF(own.kind) + 2 * capacity, min(counts[LIST(own.kind)], capacity)
  ulong all = squares_from(RESPONSES, own.bound[0], 0, sums);
#if FINE /* the reference comes from the fine responses if no coarse one is above its bound */
  if (octave == 0 && !all) {
    own.kind = 1;
    all = squares_from(RESPONSES, own.bound[1], 0, sums);
  }
#endif
  const int bound = own.bound[FINE && own.kind == 1];
  for (int bit = 1 << (RESPONSE_BITS - 1); bit && all; bit >>= 1)
    if (2 * squares_from(RESPONSES, bound, own.reference | bit, sums) >= all) own.reference |= bit;
  if (get_local_id(0) == 0) DECISION(p, octave) = own;
}

#if OCTAVES

/* The reference of a frame: the greatest of its octaves. One of fine responses counts only if there
 * is no other. One work-item per frame. */
__kernel void choose_reference(__global Decision *restrict found) {
  const size_t p = get_global_id(0);
  const Decision frame = DECISION(p, 0);
  int reference = FINE && frame.kind == 1 ? 0 : frame.reference;
  for (int n = 1; n <= OCTAVES; ++n) reference = max(reference, DECISION(p, n).reference);
  DECISION(p, 0).reference = reference ? reference : frame.reference;
}

#endif

/* Entry n of a list of frame p, its octave, and the pixel of the frame nearest to it. */
#define ENTRY(kind)                                                                 \
  if (n >= min(counts[LIST(kind)], capacity)) return;                               \
  __global int *entry = LIST_OF(kind) + n;                                          \
  const int octave = (int)(kind) > FINE ? (int)(kind) - FINE : 0;                   \
  const int x = PAD + TO_FRAME(entry[0], octave), y = TO_FRAME(entry[capacity], octave); \
  const size_t word = (p * rows + y) * (step / 32) + x / 32;
#define OF_FRAME const size_t n = get_global_id(0), p = get_global_id(1);

/* True if a bit is within x - before .. x + behind, and in such rows. */
bool any_bit(__global const uint *bits, const size_t p, const int x, const int y,
             const int before, const int behind, const uint rows, const uint step) {
  const int left = max(x - before, PAD), right = min(x + behind, (int)step - 1);
  for (int j = max(y - before, 0); j <= min(y + behind, (int)rows - 1); ++j) {
    __global const uint *row = bits + (p * rows + j) * (step / 32);
    for (int k = left / 32; k <= right / 32; ++k) {
      const uint from = 32 * k < left ? 0xffffffffu << left % 32 : 0xffffffffu;
      const uint to = 32 * k + 31 > right ? 0xffffffffu >> (31 - right % 32) : 0xffffffffu;
      if (row[k] & from & to) return true;
    }
  }
  return false;
}

/* True if a maximum of the frame is strong enough. `marks` is its column of the sums. */
bool is_candidate(const Decision decision, const bool fine, const int r, const int marks,
                  const int coarse_share, const int fine_share) {
  if (r <= decision.bound[fine]) return false;
  return (marks & CLEAN ? 256 : 128) * r >= (fine ? fine_share : coarse_share) * decision.reference;
}

#if OCTAVES

/* Mark the maxima of octave 1. One work-item per maximum. */
__kernel void see_octave(__global const int *restrict lists, __global const uint *restrict counts,
                         __global const Decision *restrict found, const uint rows,
                         const uint step, const uint capacity, const int coarse_share,
                         __global uint *restrict seen) {
  OF_FRAME
  ENTRY(KIND_OF_OCTAVE(1))
  const int r = entry[2 * capacity];
  if (r <= DECISION(p, octave).bound[0]) return;
  if (128 * r < coarse_share * DECISION(p, 0).reference) return;
  atomic_or(seen + word, 1u << x % 32);
}

/* Count the maxima of the frame around one of them. Others may mark theirs as KEPT meanwhile, which
 * changes no bit that is read here. */
Around around_maximum(__global const int *lists, __global const uint *counts, const size_t p,
                      const Decision decision, __global const int *entry, const uint capacity,
                      const int coarse_share, const int fine_share) {
  const int x = entry[0], y = entry[capacity], own = entry[3 * capacity];
  Around around = {0, 0};
  for (int fine = 0; fine <= FINE; ++fine) {
    __global const int *list = LIST_OF(fine);
    const uint count = min(counts[LIST(fine)], capacity);
    for (uint n = 0; n < count; ++n) {
      const uint down = abs(list[capacity + n] - y), across = abs(list[n] - x);
      if (max(down, across) > AROUND || max(down, across) <= NMS_RADIUS) continue;
      const int marks = list[3 * capacity + n];
      if (!is_candidate(decision, fine, list[2 * capacity + n], marks, coarse_share, fine_share))
        continue;
      const bool askew = are_askew(DIRECTION_X(own), DIRECTION_Y(own), DIRECTION_X(marks),
                                   DIRECTION_Y(marks));
      around.aligned += !askew;
      around.askew += askew;
    }
  }
  return around;
}

/* A corner of the frame is strong, or not lone. A maximum of octave 1 is seen within 1 px of the
 * pixel of that octave. */
bool is_lone(__global const int *lists, __global const uint *counts, __global const uint *seen,
             const size_t p, const Decision decision, __global const int *entry, const uint rows,
             const uint step, const uint capacity, const int coarse_share, const int fine_share) {
  if (!IS_WEAK(entry[2 * capacity], decision.reference)) return false;
  const Around around =
      around_maximum(lists, counts, p, decision, entry, capacity, coarse_share, fine_share);
  const int x = (PAD + entry[0]) & ~1, y = entry[capacity] & ~1;
  return IS_LONE_IN(around, any_bit(seen, p, x, y, 1, 3, rows, step));
}
#define IS_LONE                                                                     \
  is_lone(lists, counts, seen, p, decision, entry, rows, step, capacity, coarse_share, fine_share)
#else
#define IS_LONE false
#endif

/* Keep the coarse corners: their response is above the noise bound and not below a share of the
 * reference, or half of that share if it is clean, and they are not lone. One work-item per
 * maximum. */
__kernel void keep_coarse(__global int *lists, __global const uint *restrict counts,
                          __global const Decision *restrict found, const uint rows,
                          const uint step, const uint capacity, const int coarse_share,
                          const int fine_share, SEEN_ARGUMENT __global uint *restrict row_counts,
                          __global uint *restrict maxima) {
  OF_FRAME
  ENTRY(0)
  const Decision decision = DECISION(p, 0);
  const int r = entry[2 * capacity], marks = entry[3 * capacity];
  if (!is_candidate(decision, false, r, marks, coarse_share, fine_share) || IS_LONE) return;
  entry[3 * capacity] |= KEPT;
  atomic_or(maxima + word, 1u << x % 32);
  atomic_inc(row_counts + p * rows + y);
}

#if FINE

/* Keep the fine corners where no coarse corner is within NMS_RADIUS. The others that mark theirs
 * meanwhile are farther. One work-item per maximum. */
__kernel void keep_fine(__global int *lists, __global const uint *restrict counts,
                        __global const Decision *restrict found, const uint rows,
                        const uint step, const uint capacity, const int coarse_share,
                        const int fine_share, SEEN_ARGUMENT __global uint *restrict row_counts,
                        __global uint *maxima) {
  OF_FRAME
  ENTRY(1)
  const Decision decision = DECISION(p, 0);
  const int r = entry[2 * capacity], marks = entry[3 * capacity];
  if (any_bit(maxima, p, x, y, NMS_RADIUS, NMS_RADIUS, rows, step)) return;
  if (!is_candidate(decision, true, r, marks, coarse_share, fine_share) || IS_LONE) return;
  entry[3 * capacity] |= KEPT;
  atomic_or(maxima + word, 1u << x % 32);
  atomic_inc(row_counts + p * rows + y);
}

#endif

#if OCTAVES

/* Keep the corners of an octave: their response is above the noise bound of the octave and at least
 * 3/8 of the reference, the wide ring responds, and no corner of the frame or of an octave before
 * is within 5 px of the octave, in x and in y. One work-item per maximum. */
__kernel void keep_octave(__global int *restrict lists, __global const uint *restrict counts,
                          __global const Decision *restrict found, const uint number,
                          __global const uint *restrict maxima, const uint rows,
                          const uint step, const uint capacity) {
  OF_FRAME
  ENTRY(KIND_OF_OCTAVE(number))
  const int r = entry[2 * capacity], reach = 5 << octave;
  if (!(entry[3 * capacity] & WIDE) || r <= DECISION(p, octave).bound[0]) return;
  if (128 * r < 48 * DECISION(p, 0).reference) return;
  if (any_bit(maxima, p, x, y, reach, reach - 1, rows, step)) return;
  entry[3 * capacity] |= KEPT;
}

/* Mark the kept corners of an octave. One work-item per maximum. */
__kernel void mark_octave(__global int *restrict lists, __global const uint *restrict counts,
                          const uint number, const uint rows, const uint step,
                          const uint capacity, __global uint *restrict row_counts,
                          __global uint *restrict maxima) {
  OF_FRAME
  ENTRY(KIND_OF_OCTAVE(number))
  if (!(entry[3 * capacity] & KEPT)) return;
  atomic_or(maxima + word, 1u << x % 32);
  atomic_inc(row_counts + p * rows + y);
}

#endif

/* Count the corners in the rows before each row, and in the frame: counts[count_offset + p]. One
 * work-group per frame, whose work-items have some rows each. */
__kernel void start_rows(__global const uint *restrict row_counts, const uint rows,
                         const uint count_offset, __global uint *restrict row_starts,
                         __global uint *restrict counts) {
  const size_t p = get_global_id(1);
  __local uint corners[FRAME_GROUP];
  const uint k = get_local_id(0), each = (rows + FRAME_GROUP - 1) / FRAME_GROUP;
  const uint first = min(k * each, rows), end = min(first + each, rows);
  corners[k] = 0;
  for (uint y = first; y < end; ++y) corners[k] += row_counts[p * rows + y];
  barrier(CLK_LOCAL_MEM_FENCE);
  uint start = 0;
  for (uint before = 0; before < k; ++before) start += corners[before];
  for (uint y = first; y < end; start += row_counts[p * rows + y], ++y)
    row_starts[p * rows + y] = start;
  if (k + 1 == FRAME_GROUP) counts[count_offset + p] = start;
}

/* Put the corners in (y, x) order: each finds its rank among the bits of the maxima. One work-item
 * per maximum; dimension 1 is a list of a frame. */
__kernel void put_in_order(__global int *restrict lists, __global const uint *restrict counts,
                           __global const uint *restrict maxima,
                           __global const uint *restrict row_starts, const uint rows,
                           const uint step, const uint capacity, const uint corner_capacity,
                           const uint length, __global int *restrict corners) {
  const size_t n = get_global_id(0), p = get_global_id(1) / KINDS;
  const uint kind = get_global_id(1) % KINDS;
  ENTRY(kind)
  if (!(entry[3 * capacity] & KEPT)) return;
  uint rank = row_starts[p * rows + y] + popcount(maxima[word] & ((1u << x % 32) - 1));
  for (size_t before = word - x / 32; before < word; ++before) rank += popcount(maxima[before]);
  if (rank >= corner_capacity) return;
  __global int *corner = corners + p * corner_capacity + rank;
  for (uint k = 0; k < LIST_COLUMNS; ++k)
    corner[(size_t)k * length] =
        k == 3 ? entry[k * capacity] & SUM_MASK : entry[k * capacity];
#if OCTAVES
  corner[(size_t)LIST_COLUMNS * length] = octave;
#endif
}
