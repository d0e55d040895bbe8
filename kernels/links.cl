#include "lattice.clh"

/* Links between corners (13.1): of the neighbours along a boundary the cheapest, kept where both
 * ends choose each other and the middle of the side between them has the colours that both claim. A
 * bar or an arm before the pattern leaves only the ends of such a side. */

#define COSTS_PER_PX 64.0f

/* The bins that hold enough corners, in rings around the bin of a corner. */
Window window_of(__global const int *layout, __global const int *starts, const int row,
                 const int column, const int enough, const int rings) {
  const int across = layout[BINS_ACROSS], down = layout[BINS_DOWN];
  for (int ring = 1;; ++ring) {
    const Window found = {LARGER(row - ring, 0), SMALLER(row + ring + 1, down),
                          LARGER(column - ring, 0), SMALLER(column + ring + 1, across), across};
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

/* choice[4 i + s]: the half-edge 4 j + t at the other end of the cheapest chord along boundary s of
 * corner i, NONE without one. A narrow window is enough if any corner outside of it is farther away
 * than the chords in it cost. One work-item per corner. */
#define NARROW 12
__kernel void choose_links(__global const float *restrict corners, const uint capacity,
                           __global const float4 *restrict lines,
                           __global const int *restrict layout, __global const int *restrict starts,
                           __global const int *restrict binned, const uint rows, const uint columns,
                           const int neighbours, const int rings, const float least_cosine,
                           const float turn_price, __global int *restrict choice) {
  const int i = get_global_id(0);
  if (i >= (int)COUNT(corners)) return;
  __global const float2 *at = POSITIONS(corners);
  const float4 own = lines[i];
  const float2 here = at[i];
  const int shift = layout[BIN_SHIFT], row = BIN_ROW(here), column = BIN_COLUMN(here);
  ulong best[4];
  bool sure = false;
  for (int enough = NARROW; !sure; enough = neighbours) {
    const Window window = window_of(layout, starts, row, column, enough, rings);
    for (int s = 0; s < 4; ++s) best[s] = NO_CHORD;
    FOR_CORNERS_IN(window, j) {
      const float dx = at[j].x - here.x, dy = at[j].y - here.y, squared = dx * dx + dy * dy;
      if (squared < 1.0f || j == i) continue;
      const Boundary near = boundary_along(own, dx, dy);
      const ulong chord = chord_to(j, near, lines[j], dx, dy, squared, least_cosine, turn_price);
      best[near.side] = SMALLER(chord, best[near.side]);
    }
    const float outside = px_outside(layout, window, here) * (COSTS_PER_PX - 0.1f);
    sure = enough == neighbours ||
           (COST_OF(best[0]) < outside && COST_OF(best[1]) < outside &&
            COST_OF(best[2]) < outside && COST_OF(best[3]) < outside);
  }
  for (int s = 0; s < 4; ++s) choice[4 * i + s] = best[s] == NO_CHORD ? NONE : END_OF(best[s]);
}

/* twin[h]: the half-edge at the other end of a link. One work-item per half-edge; that of the lower
 * end looks at the side of both. Tabs of a puzzle, and a side that bends, hide colours near the
 * chord, marks those deeper in the cells, and a bar both. least_middle: share of the contrast, summed
 * over three points. deep: share of the side, how far beside it. */
__kernel void keep_links(__global const float *restrict corners, const uint capacity,
                         __global const int *restrict contrast, LEVELS_OF_IMAGE,
                         const float least_middle, const float deep,
                         __global const int *restrict choice, __global int *restrict twin) {
  const int h = get_global_id(0);
  if (h >= 4 * (int)COUNT(corners)) return;
  const int end = choice[h];
  if (end == NONE || choice[end] != h) {
    twin[h] = NONE;
  } else if (h < end) {
    __global const float2 *at = POSITIONS(corners);
    const float2 a = at[h >> 2], b = at[end >> 2];
    const float product = (float)contrast[h >> 2] * (float)contrast[end >> 2];
    const float root = inverse_root(product), sign = h & 1 ? -2.0f : 2.0f;
    const int near = difference(LEVELS, a, b, MIDDLE);
    bool is_seen = sign * (float)near * root > least_middle;
    if (!is_seen) {
      const int far = difference_within(LEVELS, a, b, MIDDLE, deep);
      is_seen = sign * (float)far * root > least_middle;
    }
    twin[h] = is_seen ? end : NONE;
    twin[end] = is_seen ? h : NONE;
  }
}
