#include "lattice.clh"

/* Votes for where a part lies beside another (13.4): ways across tears, from a node at the rim of
 * one to the rim of the other, of some steps after each of which the colours on both sides change
 * places. */

/* The mean length of the links of a corner, px; 0 without one. */
float mean_step(__global const float2 *at, __global const int *twin, const int i) {
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
  return total * (root * root);
}

/* Whether a half-edge is the first of its corner in a part of two faces or more. */
bool is_node(__global const int *part, __global const int *faces_of_part, const int h) {
  bool found = part[h] != NONE && faces_of_part[part[h]] > 1;
  for (int k = h & ~3; k < h; ++k) found &= part[k] != part[h];
  return found;
}

/* Whether the faces around a corner are not all of one part. */
bool is_at_rim(__global const int *part, const int i) {
  const int4 around = vload4(i, part);
  return around.x != around.y || around.x != around.z || around.x != around.w;
}

/* The differences of both sides of a way of m steps, each with the sign that it has if colours
 * change after every step. */
int difference_of_way(LEVELS_OF_IMAGE, const float2 from, const float2 step, const int m) {
  int sum = 0;
  for (int k = 0; k < m; ++k) {
    const float2 a = from + (float)k * step;
    const int here = difference(LEVELS, a, a + step, WHOLE_SIDE);
    sum += k & 1 ? -here : here;
  }
  return sum;
}

/* A vote: both parts, by their roots, the larger one first; the quarter turns, column and row of
 * the second one's numbers in those of the first; and the weight as the bits of a float. `number`
 * is that of the half-edge `other` in the first part. */
#define VOTE 6
void add_vote(__global const int *part, __global const int4 *state, const int one, const int other,
              const int quarter, const int2 number, const float weight, const int room,
              __global int *layout, __global int *votes) {
  const int k = atomic_inc(layout + VOTES), x = TO_X(quarter), y = TO_Y(quarter);
  if (k >= room) return;
  const int4 own = state[other];
  votes[VOTE * k] = part[one];
  votes[VOTE * k + 1] = part[other];
  votes[VOTE * k + 2] = quarter;
  votes[VOTE * k + 3] = number.x - (own.x * x - own.y * y);
  votes[VOTE * k + 4] = number.y - (own.x * y + own.y * x);
  votes[VOTE * k + 5] = as_int(weight);
}

/* List the votes of a frame of several parts, in any order; layout[VOTES], their number, may exceed
 * `room`. A node has votes beside those of larger parts in its reach. One work-item per
 * half-edge. */
#define ROTATION(h) (state[h].z - (h))
#define IS_LARGER(one, other)                                                       \
  (faces_of_part[one] > faces_of_part[other] ||                                     \
   (faces_of_part[one] == faces_of_part[other] && (one) < (other)))
__kernel void find_votes(__global const float *restrict corners, const uint capacity,
                         __global const float4 *restrict lines,
                         __global const int *restrict contrast, LEVELS_OF_IMAGE,
                         __global const int *restrict twin, __global const int *restrict part,
                         __global const int4 *restrict state,
                         __global const int *restrict faces_of_part,
                         __global const int *restrict starts, __global const int *restrict binned,
                         const int room, __global int *restrict layout,
                         __global int *restrict votes) {
  const int h = get_global_id(0), i = h >> 2;
  if (layout[PARTS] < 2 || h >= 4 * (int)COUNT(corners)) return;
  if (part[h] == layout[MAIN] || !is_node(part, faces_of_part, h)) return;
  if (!is_at_rim(part, i)) return;
  __global const float2 *at = POSITIONS(corners);
  const float own_step = mean_step(at, twin, i), own_reach = (SPAN + 0.5f) * own_step;
  const Window window = window_around(layout, rows, columns, at[i], own_reach);
  FOR_CORNERS_IN(window, j) {
    const float dx = at[i].x - at[j].x, dy = at[i].y - at[j].y, squared = dx * dx + dy * dy;
    if (i == j || !(squared < own_reach * own_reach) || !is_at_rim(part, j)) continue;
    for (int g = 4 * j; g < 4 * j + 4; ++g) {
      if (!is_node(part, faces_of_part, g) || !IS_LARGER(part[g], part[h])) continue;
      const float held = LARGER(squared, 1.0f), length = held * inverse_root(held);
      const Boundary near = boundary_along(lines[j], dx, dy);
      const Boundary far = boundary_along(lines[i], -dx, -dy);
      const float along = SMALLER(near.length, far.length), step = mean_step(at, twin, j);
      const float mean = 0.5f * (own_step + step);
      const int direction = (near.side + ROTATION(g)) & 3;
      const int quarter = (direction - far.side + 2 - ROTATION(h)) & 3;
      for (int m = 1; m <= SPAN; ++m) {
        if (!(along > LEAST_COSINE * length) || (near.side + far.side - m) & 1) continue;
        if (!(MAGNITUDE(length - (float)m * mean) < mean)) continue; /* a step off at most */
        const float weight = inverse_root((float)m), step_share = weight * weight;
        const int sum = difference_of_way(LEVELS, at[j], step_share * (float2)(dx, dy), m);
        const int seen = near.side & 1 ? -sum : sum;
        if (seen <= 0) continue;
        const float product = (float)contrast[i] * (float)contrast[j];
        const float share = ((float)seen * (2 * OF_POINTS * step_share)) * inverse_root(product);
        const int2 number = state[g].xy + m * (int2)(TO_X(direction), TO_Y(direction));
        add_vote(part, state, g, h, quarter, number, SMALLER(share, 1.0f) * weight, room,
                 layout, votes);
      }
    }
  }
}
