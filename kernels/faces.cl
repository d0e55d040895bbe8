#include "lattice.clh"

/* Faces (13.2): four steps along a link and to the right come back to where they began. */

/* face[h]: the least half-edge of the closed face that h belongs to; it stays NONE without one.
 * steps[h]: twice the mean steps of the face along h, and to its right. cut[face]: how often its
 * tolerance is lowered, once for each torn corner beyond TORN_CORNERS. One work-item per half-edge;
 * that of the least one writes the face. */
__kernel void close_faces(__global const float *restrict corners, const uint capacity,
                          __global const int *restrict twin, __global int *restrict face,
                          __global uchar *restrict cut, __global float4 *restrict steps) {
  const int h = get_global_id(0);
  if (h >= 4 * (int)COUNT(corners)) return;
  int way[5] = {h};
  for (int k = 0; k < 4; ++k) {
    const int end = twin[way[k]];
    way[k + 1] = ALONG_FACE(end);
    if (end == NONE || way[k + 1] < h) return;
  }
  if (way[4] != h) return;
  __global const float2 *at = POSITIONS(corners);
  const float2 p0 = at[h >> 2], p1 = at[way[1] >> 2], p2 = at[way[2] >> 2], p3 = at[way[3] >> 2];
  const float2 along = (p1 - p0) + (p2 - p3), right = (p3 - p0) + (p2 - p1);
  steps[h] = (float4)(along, right);
  steps[way[1]] = (float4)(right, -along);
  steps[way[2]] = (float4)(-along, -right);
  steps[way[3]] = (float4)(-right, along);
  int torn = 0;
  for (int k = 0; k < 4; ++k) {
    face[way[k]] = h;
    torn += IS_TORN(way[k] >> 2);
  }
  cut[h] = LARGER(torn - TORN_CORNERS, 0);
}
