#include "lattice.clh"

/* Parts (13.3): connected faces that agree, and numbers in them. A part in which a corner has two
 * numbers is divided: its faces must agree more closely, and all is done again. */
#define STEP(state, turn) \
  (int4)((state).x + TO_X((state).z), (state).y + TO_Y((state).z), ((state).z + (turn)) & 3, 0)
#define WAITING (-1) /* in the fourth place: the face has no number yet */

/* The root of a face. `part` points to lower faces of the same part until a root points to
 * itself. */
int root_of(__global volatile int *part, int f) {
  for (int up = READ(part + f); up != f; up = READ(part + f)) f = up;
  return f;
}

/* A root that another work-item has meanwhile hung elsewhere brings its new root along. */
void unite(__global volatile int *part, int a, int b) {
  while ((a = root_of(part, a)) != (b = root_of(part, b))) {
    const int low = SMALLER(a, b), high = LARGER(a, b);
    b = atomic_min(part + high, low);
    if (b == high) return;
    a = low;
  }
}

/* Whether the steps of two faces, each from the link that they share, differ little for their
 * size. */
float size_of(const float4 steps) {
  return (steps.x * steps.x + steps.y * steps.y) + (steps.z * steps.z + steps.w * steps.w);
}
bool agree(const float4 one, const float4 other, const float tolerance) {
  return size_of(one + other) < tolerance * SMALLER(size_of(one), size_of(other));
}

/* beyond[h]: the half-edge on the other side of a link if both faces agree, else NONE. part[h]: the
 * least half-edge of the part, NONE outside of faces. faces_of_part[root]: its faces, 0 of a part
 * with two numbers for a corner. `cut` is that of the faces before. numbers: column, row, rotation,
 * and 1 of the corners of the part with the most faces; 0 in the fourth place of others. One
 * work-group. */
__kernel void number_parts(__global const float *restrict corners, const uint capacity,
                           __global const int *restrict twin, __global const int *restrict face,
                           __global const float4 *restrict steps,
                           __constant float *tolerances, __global uchar *restrict cut,
                           __global int *restrict beyond, __global int *restrict part,
                           __global int *restrict waiting, __global int4 *restrict state,
                           __global int *restrict faces_of_part, __global int4 *restrict numbers,
                           __global int *restrict layout) {
  const int count = (int)COUNT(corners), ends = 4 * count;
  __local int listed, contradictions, most, main, parts;
  for (int round = 0;; ++round) {
    FOR_ALL(h, ends) {
      part[h] = face[h];
      faces_of_part[h] = 0;
      beyond[h] = NONE;
    }
    if (get_local_id(0) == 0) listed = contradictions = 0;
    ALL_TOGETHER;
    FOR_ALL(h, ends) {
      const int other = twin[h], f = face[h];
      if (f == NONE || other < h || face[other] == NONE) continue;
      const int g = face[other];
      if (!agree(steps[h], steps[other], tolerances[LARGER(cut[f], cut[g])])) continue;
      beyond[h] = other;
      beyond[other] = h;
      unite(part, f, g);
    }
    ALL_TOGETHER;
    FOR_ALL(h, ends) {
      if (face[h] != h) continue;
      const int root = root_of(part, h);
      atomic_xchg(part + h, root);
      atomic_add(faces_of_part + root, 1);
      state[h] = (int4)(0, 0, 0, root == h ? 0 : WAITING);
      if (root == h) waiting[atomic_add(&listed, 1)] = h;
    }
    ALL_TOGETHER;
    /* The numbers spread from the roots, face by face. A face waits with the half-edge across which
     * it was reached. */
    for (int first = 0, end = listed; first < end; first = end, end = listed) {
      ALL_TOGETHER;
      for (int k = first + get_local_id(0); k < end; k += get_local_size(0)) {
        const int begin = waiting[k], f = face[begin], root = part[f];
        int4 here = state[begin];
        int h = begin;
        do {
          part[h] = root;
          state[h].xyz = here.xyz;
          const int other = beyond[h];
          if (other != NONE) {
            __global volatile int *reached = (__global volatile int *)(state + face[other]) + 3;
            if (READ(reached) == WAITING && atomic_xchg(reached, 0) == WAITING) {
              state[other].xyz = STEP(here, 2).xyz;
              waiting[atomic_add(&listed, 1)] = other;
            }
          }
          here = STEP(here, 1);
          h = ALONG_FACE(twin[h]);
        } while (h != begin);
      }
      ALL_TOGETHER;
    }
    FOR_ALL(i, count)
      for (int a = 4 * i + 1; a < 4 * i + 4; ++a) {
        int b = a - 1;
        while (b > 4 * i && part[b] != part[a]) --b;
        if (part[a] == NONE || part[a] != part[b]) continue;
        if (state[a].x != state[b].x || state[a].y != state[b].y ||
            ((state[a].z - a) & 3) != ((state[b].z - b) & 3)) {
          faces_of_part[part[a]] = 0;
          contradictions = 1;
        }
      }
    ALL_TOGETHER;
    const bool done = !contradictions || round == CUTS;
    ALL_TOGETHER;
    if (done) break;
    FOR_ALL(h, ends)
      if (face[h] == h && !faces_of_part[part[h]] && cut[h] < CUTS) ++cut[h];
    ALL_TOGETHER;
  }
  if (get_local_id(0) == 0) {
    most = parts = 0;
    main = INT_MAX;
  }
  ALL_TOGETHER;
  FOR_ALL(h, ends)
    if (part[h] == h && faces_of_part[h]) {
      if (faces_of_part[h] > READ(&most)) atomic_max(&most, faces_of_part[h]);
      if (faces_of_part[h] > 1) atomic_add(&parts, 1); /* one face agrees with none */
    }
  ALL_TOGETHER;
  FOR_ALL(h, ends)
    if (part[h] == h && faces_of_part[h] && faces_of_part[h] == most) atomic_min(&main, h);
  ALL_TOGETHER;
  if (get_local_id(0) == 0) {
    layout[PARTS] = parts;
    layout[MAIN] = main;
    layout[VOTES] = 0;
  }
  FOR_ALL(i, count) {
    int4 number = (int4)(0);
    for (int h = 4 * i; h < 4 * i + 4 && !number.w; ++h)
      if (part[h] == main && part[h] != NONE)
        number = (int4)(state[h].x, state[h].y, (state[h].z - h) & 3, 1);
    numbers[i] = number;
  }
}
