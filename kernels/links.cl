#include "lattice.clh"

/* Links between corners (13.1): of the neighbours along a boundary the cheapest whose side has the
 * colours that both claim, kept where both ends choose each other. */

#define COSTS_PER_PX 64.0f
#define UNSURE (-2)

/* The bins that hold enough corners, in rings around the bin of a corner. */
typedef struct {
  int top, bottom, left, right; /* the last ones not included */
} Window;
Window window_of(__global const int *layout, __global const int *starts, const int row,
                 const int column, const int enough, const int rings) {
  const int across = layout[BINS_ACROSS], down = layout[BINS_DOWN];
  for (int ring = 1;; ++ring) {
    const Window found = {LARGER(row - ring, 0), SMALLER(row + ring + 1, down),
                          LARGER(column - ring, 0), SMALLER(column + ring + 1, across)};
    int seen = 0;
    for (int k = found.top; k < found.bottom; ++k)
      seen += starts[k * across + found.right] - starts[k * across + found.left];
    if (seen >= enough || ring >= rings) return found;
  }
}

/* Any corner outside of the window is farther than this, px. */
float px_outside(__global const int *layout, const Window window, const float2 at) {
  const int shift = layout[BIN_SHIFT];
  float near = 1e6f;
  if (window.left) near = SMALLER(near, at.x - (float)(window.left << shift));
  if (window.top) near = SMALLER(near, at.y - (float)(window.top << shift));
  if (window.right < layout[BINS_ACROSS]) near = SMALLER(near, (float)(window.right << shift) - at.x);
  if (window.bottom < layout[BINS_DOWN]) near = SMALLER(near, (float)(window.bottom << shift) - at.y);
  return near;
}

/* A chord along a boundary to corner j: what it costs, then the half-edge at its other end, in one
 * number. There is none if it bends too much or joins boundaries of one colour. */
#define NO_CHORD ULONG_MAX
#define COST_OF(chord) (float)((chord) >> 32)
#define END_OF(chord) (int)(uint)(chord)
ulong chord_to(const int j, const Boundary near, const float4 other, const float dx, const float dy,
               const float squared, const float least_cosine, const float turn_price) {
  const float length = squared * inverse_root(squared), least = least_cosine * length;
  const Boundary far = boundary_along(other, -dx, -dy);
  const float price = length + turn_price * ((length + length) - (near.length + far.length));
  const ulong chord = (ulong)floor_of(price * COSTS_PER_PX) << 32 | (uint)(4 * j + far.side);
  const bool good = (near.length > least) & (far.length > least) & ((near.side ^ far.side) & 1);
  return good ? chord : NO_CHORD;
}

#define NEIGHBOURS_IN(window)                                                       \
  for (int k = window.top; k < window.bottom; ++k)                                  \
    for (int n = starts[k * across + window.left]; n < starts[k * across + window.right]; ++n)
#define BINS                                                                        \
  __global const int *restrict layout, __global const int *restrict starts,         \
      __global const int *restrict binned

/* first[4 i + s]: the half-edge 4 j + t at the other end of the cheapest chord along boundary s of
 * corner i; UNSURE if a corner outside of a narrow window may be cheaper. One work-item per
 * corner. */
#define NARROW 12
__kernel void choose_near(__global const float *restrict corners, const uint capacity,
                          __global const float4 *restrict lines, BINS, const uint rows,
                          const uint columns, const int rings, const float least_cosine,
                          const float turn_price, __global int *restrict first) {
  const int i = get_global_id(0);
  if (i >= (int)COUNT(corners)) return;
  __global const float2 *at = POSITIONS(corners);
  const float4 own = lines[i];
  const float2 here = at[i];
  const int shift = layout[BIN_SHIFT], across = layout[BINS_ACROSS];
  const Window window =
      window_of(layout, starts, BIN_ROW(here), BIN_COLUMN(here), NARROW, rings);
  const float outside = px_outside(layout, window, here), limit = outside * outside;
  ulong best[4] = {NO_CHORD, NO_CHORD, NO_CHORD, NO_CHORD};
  NEIGHBOURS_IN(window) {
    const int j = binned[n];
    const float dx = at[j].x - here.x, dy = at[j].y - here.y, squared = dx * dx + dy * dy;
    if (squared < 1.0f || squared > limit || j == i) continue;
    const Boundary near = boundary_along(own, dx, dy);
    const ulong chord = chord_to(j, near, lines[j], dx, dy, squared, least_cosine, turn_price);
    best[near.side] = SMALLER(chord, best[near.side]);
  }
  for (int s = 0; s < 4; ++s) {
    const bool sure = COST_OF(best[s]) < outside * (COSTS_PER_PX - 0.1f);
    first[4 * i + s] = sure ? END_OF(best[s]) : UNSURE;
  }
}

/* Whether both sides of the chord between two half-edges have the colours that their boundaries
 * claim. */
bool has_side(LEVELS_OF_IMAGE, __global const float2 *at, const int h, const int end,
              const float depth, const float depth_px) {
  const int low = SMALLER(h, end), p = low >> 2, q = LARGER(h, end) >> 2;
  const int step = difference(LEVELS, at[p], at[q], depth, depth_px);
  return low & 1 ? step < 0 : step > 0;
}

/* choice[h]: the half-edge that h wants to be linked with; UNSURE unless both are the first of each
 * other. One work-item per half-edge. */
__kernel void choose_mutual(__global const float *restrict corners, const uint capacity,
                            LEVELS_OF_IMAGE, const float depth, const float depth_px,
                            __global const int *restrict first, __global int *restrict choice) {
  const int h = get_global_id(0);
  if (h >= 4 * (int)COUNT(corners)) return;
  const int end = first[h];
  if (end == UNSURE || first[end] != h) {
    choice[h] = UNSURE;
  } else if (h < end) { /* the work-item of the other end leaves it to this one */
    const bool seen = has_side(LEVELS, POSITIONS(corners), h, end, depth, depth_px);
    choice[h] = seen ? end : UNSURE;
    choice[end] = seen ? h : UNSURE;
  }
}

/* The choices that are not sure: of the two cheapest chords along a boundary, in a window that
 * holds enough corners, the first that has a side. One work-item per corner. */
__kernel void choose_far(__global const float *restrict corners, const uint capacity,
                         __global const float4 *restrict lines, BINS, LEVELS_OF_IMAGE,
                         const int neighbours, const int rings, const float least_cosine,
                         const float turn_price, const float depth, const float depth_px,
                         __global int *restrict choice) {
  const int i = get_global_id(0);
  if (i >= (int)COUNT(corners)) return;
  bool open[4], any = false;
  for (int s = 0; s < 4; ++s) any |= open[s] = choice[4 * i + s] == UNSURE;
  if (!any) return;
  __global const float2 *at = POSITIONS(corners);
  const float4 own = lines[i];
  const float2 here = at[i];
  const int shift = layout[BIN_SHIFT], across = layout[BINS_ACROSS];
  const Window window =
      window_of(layout, starts, BIN_ROW(here), BIN_COLUMN(here), neighbours, rings);
  ulong best[4], second[4];
  for (int s = 0; s < 4; ++s) best[s] = second[s] = NO_CHORD;
  NEIGHBOURS_IN(window) {
    const int j = binned[n];
    const float dx = at[j].x - here.x, dy = at[j].y - here.y, squared = dx * dx + dy * dy;
    if (squared < 1.0f || j == i) continue;
    const Boundary near = boundary_along(own, dx, dy);
    if (!open[near.side]) continue;
    const ulong chord = chord_to(j, near, lines[j], dx, dy, squared, least_cosine, turn_price);
    const ulong worse = LARGER(chord, best[near.side]);
    best[near.side] = SMALLER(chord, best[near.side]);
    second[near.side] = SMALLER(worse, second[near.side]);
  }
  for (int s = 0; s < 4; ++s) {
    if (!open[s]) continue;
    int chosen = NONE;
    for (int k = 0; k < 2 && chosen == NONE; ++k) {
      const ulong chord = k ? second[s] : best[s];
      if (chord != NO_CHORD &&
          has_side(LEVELS, at, 4 * i + s, END_OF(chord), depth, depth_px))
        chosen = END_OF(chord);
    }
    choice[4 * i + s] = chosen;
  }
}

/* Keep the links that both ends want. One work-item per half-edge. */
__kernel void keep_mutual(__global const float *restrict corners, const uint capacity,
                          __global const int *restrict choice, __global int *restrict twin) {
  const int h = get_global_id(0);
  if (h >= 4 * (int)COUNT(corners)) return;
  const int end = choice[h];
  twin[h] = end != NONE && choice[end] == h ? end : NONE;
}
