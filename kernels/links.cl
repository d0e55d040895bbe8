#include "lattice.clh"

/* Links between corners (13.1): of the neighbours along a boundary the cheapest whose side shows a
 * contrast, kept where both ends choose each other. */

/* Grey difference of the two sides of the chord from a to b, left minus right, five times. */
int difference(LEVELS_OF_IMAGE, const float2 a, const float2 b, const float depth,
               const float depth_px) {
  const float dx = b.x - a.x, dy = b.y - a.y;
  const float share = LARGER(depth, depth_px * inverse_root(dx * dx + dy * dy));
  const float across_x = -(share * dy), across_y = share * dx;
  int sum = 0;
  for (int k = 2; k <= 6; ++k) {
    const float x = a.x + 0.125f * (float)k * dx, y = a.y + 0.125f * (float)k * dy;
    sum += level_at(LEVELS, x - across_x, y - across_y) -
           level_at(LEVELS, x + across_x, y + across_y);
  }
  return sum;
}

/* Boundary of a corner with these lines that is nearest to (dx, dy), and the length along it. */
typedef struct {
  int side;
  float length;
} Boundary;
Boundary boundary_along(const float4 lines, const float dx, const float dy) {
  const float first = lines.x * dx + lines.y * dy, second = lines.z * dx + lines.w * dy;
  const bool is_first = MAGNITUDE(first) >= MAGNITUDE(second);
  const float along = is_first ? first : second;
  Boundary found = {(is_first ? 0 : 1) + (along >= 0 ? 0 : 2), MAGNITUDE(along)};
  return found;
}

#define COSTS_PER_PX 64.0f
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

/* A corner outside of the window costs more than this. */
int cost_outside(__global const int *layout, const Window window, const float2 at) {
  const int shift = layout[BIN_SHIFT];
  float near = 1e6f;
  if (window.left) near = SMALLER(near, at.x - (float)(window.left << shift));
  if (window.top) near = SMALLER(near, at.y - (float)(window.top << shift));
  if (window.right < layout[BINS_ACROSS]) near = SMALLER(near, (float)(window.right << shift) - at.x);
  if (window.bottom < layout[BINS_DOWN]) near = SMALLER(near, (float)(window.bottom << shift) - at.y);
  return floor_of(near * (COSTS_PER_PX - 0.1f));
}

#define IS_LESS(cost, end, k) \
  ((cost) < cost_of[k] || ((cost) == cost_of[k] && (end) < end_of[k]))
/* choice[4 i + s]: the half-edge 4 j + t at the other end of the link that corner i wants along its
 * boundary s. A narrow window is enough if it holds a good end for each boundary that is cheaper
 * than all others can be. One work-item per corner. */
#define NARROW 12
__kernel void choose_links(__global const float *restrict corners, const uint capacity,
                           __global const float4 *restrict lines,
                           __global const int *restrict contrast,
                           __global const int *restrict layout, __global const int *restrict starts,
                           __global const int *restrict binned, LEVELS_OF_IMAGE,
                           const int neighbours, const int rings, const float least_cosine,
                           const float turn_price, const float depth, const float depth_px,
                           const float least_side, __global int *restrict choice) {
  const int i = get_global_id(0);
  if (i >= (int)COUNT(corners)) return;
  __global const float2 *at = POSITIONS(corners);
  const float4 own = lines[i];
  const float2 here = at[i];
  int chosen[4] = {NONE, NONE, NONE, NONE};
  const int shift = layout[BIN_SHIFT], across = layout[BINS_ACROSS];
  const int row = BIN_ROW(here), column = BIN_COLUMN(here);
  bool sure = own.x == 0 && own.y == 0;
  for (int wide = 0; wide < 2 && !sure; ++wide) {
    const Window window = window_of(layout, starts, row, column, wide ? neighbours : NARROW, rings);
    int cost_of[8], end_of[8];
    float farthest[4];
    for (int k = 0; k < 8; ++k) cost_of[k] = end_of[k] = INT_MAX;
    for (int k = 0; k < 4; ++k) farthest[k] = FLT_MAX;
    for (int k = window.top; k < window.bottom; ++k)
      for (int n = starts[k * across + window.left]; n < starts[k * across + window.right]; ++n) {
        const int j = binned[n];
        const float dx = at[j].x - here.x, dy = at[j].y - here.y, squared = dx * dx + dy * dy;
        const Boundary near = boundary_along(own, dx, dy);
        const int s = near.side;
        if (squared < 1.0f || squared > farthest[s] || j == i) continue;
        const float length = squared * inverse_root(squared), least = least_cosine * length;
        if (!(near.length > least)) continue;
        const Boundary far = boundary_along(lines[j], -dx, -dy);
        if (!(far.length > least) || !((s + far.side) & 1)) continue;
        const float price = length + turn_price * ((length + length) - (near.length + far.length));
        const int cost = floor_of(price * COSTS_PER_PX), end = 4 * j + far.side;
        if (IS_LESS(cost, end, s)) {
          cost_of[s + 4] = cost_of[s];
          end_of[s + 4] = end_of[s];
          cost_of[s] = cost;
          end_of[s] = end;
        } else if (IS_LESS(cost, end, s + 4)) {
          cost_of[s + 4] = cost;
          end_of[s + 4] = end;
        } else
          continue;
        const int worst = cost_of[wide ? s + 4 : s];
        const float most = (float)worst * (1.01f / COSTS_PER_PX) + 0.1f;
        if (worst != INT_MAX) farthest[s] = most * most;
      }
    sure = true;
    const int outside = cost_outside(layout, window, here);
    for (int s = 0; s < 4; ++s) {
      chosen[s] = NONE;
      for (int k = s; k < 8 && chosen[s] == NONE && end_of[k] != INT_MAX; k += 4) {
        const int end = end_of[k], j = end >> 2, low = SMALLER(i, j), high = LARGER(i, j);
        const int step = difference(LEVELS, at[low], at[high], depth, depth_px);
        const float side = (float)((low == i ? s : end) & 1 ? -step : step);
        if (side > 0 && side * side > least_side * ((float)contrast[low] * (float)contrast[high]))
          chosen[s] = end;
        if (!wide) break;
      }
      sure = sure && chosen[s] != NONE && cost_of[s] < outside;
    }
  }
  for (int s = 0; s < 4; ++s) choice[4 * i + s] = chosen[s];
}

/* Keep the links that both ends want. One work-item per half-edge. */
__kernel void keep_mutual(__global const float *restrict corners, const uint capacity,
                          __global const int *restrict choice, __global int *restrict twin) {
  const int h = get_global_id(0);
  if (h >= 4 * (int)COUNT(corners)) return;
  const int end = choice[h];
  twin[h] = end != NONE && choice[end] == h ? end : NONE;
}
