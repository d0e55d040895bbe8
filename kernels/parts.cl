#include "lattice.clh"

/* Parts (13.3): connected faces that agree, and numbers in them. A part in which a corner has two
 * numbers is divided: its faces must agree more closely, and all is done again.
 *
 * States are (x, y, d): the number of the corner of a half-edge, column and row, and the direction
 * of the half-edge, 0 to 3 along (1, 0) (0, 1) (-1, 0) (0, -1). */
#define TO_X(d) (((d) == 0) - ((d) == 2))
#define TO_Y(d) (((d) == 1) - ((d) == 3))
#define STEP(state, turn) \
  (int4)((state).x + TO_X((state).z), (state).y + TO_Y((state).z), ((state).z + (turn)) & 3, 0)
#define WAITING (-1) /* in the fourth place: the face has no number yet */

/* The root of a face. `part` points to lower faces of the same part until a root points to itself. */
int root_of(__global volatile int *part, int f) {
  for (int up = part[f]; up != f; up = part[f]) f = up;
  return f;
}

void unite(__global volatile int *part, int a, int b) {
  while ((a = root_of(part, a)) != (b = root_of(part, b))) {
    const int low = SMALLER(a, b), high = LARGER(a, b);
    if (atomic_min(part + high, low) == high) return;
  }
}

#define AGREES(h) (alike[h] > LARGER(cut[face[h]], alike[h] ? cut[face[twin[h]]] : 0))
#define FOR_ALL(k, count) for (int k = get_local_id(0); k < (count); k += get_local_size(0))
#define ALL_TOGETHER barrier(CLK_GLOBAL_MEM_FENCE | CLK_LOCAL_MEM_FENCE)

/* part[h]: the least half-edge of the part, NONE outside of faces. size[root]: its faces, 0 of a
 * part with two numbers for a corner. One work-group. */
__kernel void number_parts(__global const float *restrict corners, const uint capacity,
                           __global const int *restrict twin, __global const int *restrict face,
                           __global const uchar *restrict alike, const int most_cuts,
                           __global uchar *restrict cut, __global int *restrict part,
                           __global int *restrict waiting, __global int4 *restrict state,
                           __global int *restrict size) {
  const int count = (int)COUNT(corners), ends = 4 * count;
  __local int listed, contradictions;
  FOR_ALL(h, ends) cut[h] = 0;
  for (int round = 0;; ++round) {
    FOR_ALL(h, ends) {
      part[h] = face[h];
      size[h] = 0;
    }
    if (get_local_id(0) == 0) listed = contradictions = 0;
    ALL_TOGETHER;
    FOR_ALL(h, ends)
      if (twin[h] > h && AGREES(h)) unite(part, face[h], face[twin[h]]);
    ALL_TOGETHER;
    FOR_ALL(h, ends) {
      if (face[h] != h) continue;
      const int root = root_of(part, h);
      part[h] = root;
      atomic_inc(size + root);
      state[h] = (int4)(0, 0, 0, WAITING);
      if (root == h) waiting[atomic_inc(&listed)] = h;
    }
    ALL_TOGETHER;
    /* The numbers spread from the roots, face by face. */
    for (int first = 0, end = listed; first < end; first = end, end = listed) {
      ALL_TOGETHER;
      for (int k = first + get_local_id(0); k < end; k += get_local_size(0)) {
        const int f = waiting[k];
        int4 here = state[f];
        here.w = 0;
        int h = f;
        do {
          state[h] = here;
          const int other = twin[h], next = AGREES(h) ? face[other] : f;
          if (next != f && atomic_cmpxchg((__global volatile int *)(state + next) + 3, WAITING, 0) == WAITING) {
            int4 there = STEP(here, 2);
            for (int e = other; e != next; e = ALONG_FACE(twin[e])) there = STEP(there, 1);
            state[next] = there;
            waiting[atomic_inc(&listed)] = next;
          }
          here = STEP(here, 1);
          h = ALONG_FACE(other);
        } while (h != f);
      }
      ALL_TOGETHER;
    }
    FOR_ALL(h, ends)
      if (face[h] != NONE && face[h] != h) part[h] = part[face[h]];
    ALL_TOGETHER;
    FOR_ALL(i, count)
      for (int s = 1; s < 4; ++s)
        for (int t = 0; t < s; ++t) {
          const int a = 4 * i + s, b = 4 * i + t;
          if (part[a] == NONE || part[a] != part[b]) continue;
          if (state[a].x != state[b].x || state[a].y != state[b].y ||
              ((state[a].z - s) & 3) != ((state[b].z - t) & 3)) {
            size[part[a]] = 0;
            contradictions = 1;
          }
        }
    ALL_TOGETHER;
    const bool done = !contradictions || round == most_cuts;
    ALL_TOGETHER;
    if (done) return;
    FOR_ALL(h, ends)
      if (face[h] == h && !size[part[h]] && cut[h] < most_cuts) ++cut[h];
    ALL_TOGETHER;
  }
}
