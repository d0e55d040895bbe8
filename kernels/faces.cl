#include "lattice.clh"

/* Faces (13.2): four steps along a link and to the right come back to where they began. */

/* face[h]: the least half-edge of the closed face that h belongs to, NONE without one. One
 * work-item per half-edge. */
__kernel void close_faces(__global const float *restrict corners, const uint capacity,
                          __global const int *restrict twin, __global int *restrict face) {
  const int h = get_global_id(0);
  if (h >= 4 * (int)COUNT(corners)) return;
  int at = h, least = h;
  for (int k = 0; k < 4; ++k) {
    const int end = twin[at];
    if (end == NONE) {
      face[h] = NONE;
      return;
    }
    at = ALONG_FACE(end);
    least = SMALLER(least, at);
  }
  face[h] = at == h ? least : NONE;
}

/* Twice the mean steps of a face along half-edge h and to its right. */
typedef struct {
  float2 along, aside;
} Steps;
Steps steps_of(__global const int *twin, __global const float2 *at, const int h) {
  const int h1 = ALONG_FACE(twin[h]), h2 = ALONG_FACE(twin[h1]), h3 = ALONG_FACE(twin[h2]);
  const float2 p0 = at[h >> 2], p1 = at[h1 >> 2], p2 = at[h2 >> 2], p3 = at[h3 >> 2];
  Steps found = {(p1 - p0) + (p2 - p3), (p3 - p0) + (p2 - p1)};
  return found;
}
float size_of(const float2 u, const float2 v) {
  return (u.x * u.x + u.y * u.y) + (v.x * v.x + v.y * v.y);
}

/* alike[h]: how many of the tolerances the faces on both sides of a link meet; 0 where there are no
 * two faces. One work-item per half-edge. */
__kernel void compare_faces(__global const float *restrict corners, const uint capacity,
                            __global const int *restrict twin, __global const int *restrict face,
                            __constant float *tolerances, const int count,
                            __global uchar *restrict alike) {
  const int h = get_global_id(0);
  if (h >= 4 * (int)COUNT(corners)) return;
  int met = 0;
  if (face[h] != NONE && face[twin[h]] != NONE) {
    const Steps a = steps_of(twin, POSITIONS(corners), h);
    const Steps b = steps_of(twin, POSITIONS(corners), twin[h]);
    const float gap = size_of(a.along + b.along, a.aside + b.aside);
    const float size = SMALLER(size_of(a.along, a.aside), size_of(b.along, b.aside));
    while (met < count && gap < tolerances[met] * size) ++met;
  }
  alike[h] = met;
}
