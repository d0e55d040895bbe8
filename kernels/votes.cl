#include "lattice.clh"

/* Ways across tears (13.4): from a node at the rim of a part to one of another, of some steps after
 * each of which the colours on both sides change places. They vote for where the parts lie. */

/* The mean length of the links of a corner, px; 0 without one. One work-item per corner. */
__kernel void mean_steps(__global const float *restrict corners, const uint capacity,
                         __global const int *restrict twin, __global float *restrict step) {
  const int i = get_global_id(0);
  if (i >= (int)COUNT(corners)) return;
  __global const float2 *at = POSITIONS(corners);
  float total = 0;
  int count = 0;
  for (int h = 4 * i; h < 4 * i + 4; ++h) {
    if (twin[h] == NONE) continue;
    const float dx = at[twin[h] >> 2].x - at[i].x, dy = at[twin[h] >> 2].y - at[i].y;
    const float squared = dx * dx + dy * dy;
    total += squared * inverse_root(squared);
    ++count;
  }
  const float root = inverse_root((float)LARGER(count, 1));
  step[i] = total * (root * root);
}

/* For each number m of steps: the least cosine, 1 / m, the factor of a sum of differences, and
 * 1 / sqrt(m). */
typedef struct {
  float cosine, part, factor, weight;
} Way;

/* List the votes, in any order: both places in the list of rim nodes, both boundaries, the number
 * of steps, and the weight as the bits of a float. rims: the corner of each node, part by part, and the
 * place of the first node of the next part.
 * rims_and_votes: the numbers of both; that of votes may exceed `room`. One work-item per node of a
 * rim. */
__kernel void find_votes(__global const float *restrict corners, const uint capacity,
                         __global const float4 *restrict lines,
                         __global const int *restrict contrast, LEVELS_OF_IMAGE,
                         __global const float *restrict step, __global const int2 *restrict rims,
                         __constant Way *ways, const float reach,
                         const float depth, const float depth_px, const int room,
                         __global int *restrict rims_and_votes, __global int *restrict votes) {
  const int n = get_global_id(0), count = rims_and_votes[0];
  if (n >= count) return;
  __global const float2 *at = POSITIONS(corners);
  const int i = rims[n].x;
  const float own_reach = reach * step[i];
  for (int k = rims[n].y; k < count; ++k) {
    const int j = rims[k].x;
    const float dx = at[j].x - at[i].x, dy = at[j].y - at[i].y, squared = dx * dx + dy * dy;
    const float other_reach = reach * step[j];
    const float one = own_reach * own_reach, two = other_reach * other_reach;
    if (!(squared < LARGER(one, two)) || i == j) continue;
    const float held = LARGER(squared, 1.0f), length = held * inverse_root(held);
    const Boundary near = boundary_along(lines[i], dx, dy);
    const Boundary far = boundary_along(lines[j], -dx, -dy);
    const float along = SMALLER(near.length, far.length), mean = 0.5f * (step[i] + step[j]);
    const float product = (float)contrast[i] * (float)contrast[j];
    for (int m = 1; m <= SPAN; ++m) {
      const Way way = ways[m - 1];
      if (!(along > way.cosine * length) || (near.side + far.side - m) & 1) continue;
      if (!(MAGNITUDE(length - (float)m * mean) < mean)) continue; /* a step off at most */
      const float x = dx * way.part, y = dy * way.part, of_step = x * x + y * y;
      const float share = LARGER(depth, depth_px * inverse_root(LARGER(of_step, 1.0f)));
      const float across_x = -(share * y), across_y = share * x;
      int sum = 0;
      for (int e = 8; e < 8 * m + 8; e += 8)
        for (int f = 2; f <= 6; f += SIDE_STEP) { /* eighths of a step */
          const float t = 0.125f * (float)(e - 8 + f);
          const float on_x = at[i].x + t * x, on_y = at[i].y + t * y;
          const int here = level_at(LEVELS, on_x - across_x, on_y - across_y) -
                           level_at(LEVELS, on_x + across_x, on_y + across_y);
          sum += e / 8 & 1 ? here : -here;
        }
      if (near.side & 1) sum = -sum;
      const float seen = ((float)sum * way.factor) * inverse_root(product);
      if (sum <= 0) continue;
      const int vote = atomic_inc(rims_and_votes + 1);
      if (vote >= room) continue;
      const float weight = SMALLER(seen, 1.0f) * way.weight;
      votes[6 * vote] = n;
      votes[6 * vote + 1] = k;
      votes[6 * vote + 2] = near.side;
      votes[6 * vote + 3] = far.side;
      votes[6 * vote + 4] = m;
      votes[6 * vote + 5] = as_int(weight);
    }
  }
}
