#include "moment.clh"

/* From the nodes of one view to their displacement in the plane of a flat pattern. */

/* Map the nodes to the plane, and subtract their position at rest. nodes: complete, px of the view;
 * status: of NodeStatus; sigma: px, not positive if unknown. homography: (9), from px to the plane.
 * rest: positions (2 planes), rest_*: their status, source, variance per axis and motion by bent
 * edges (2 planes). moved: 2 planes, 0 where not valid. points: the sum of the variances of both
 * moments. own: the variance now, in lines. One work-item a node. */
__kernel void in_plane(__global const float2 *nodes, __global const uchar *seen_status,
                       __global const float *seen_sigma, __global const REAL *homography,
                       __global const float *bend_down, __global const float *bend_along,
                       const float radius, __global const REAL *rest,
                       __global const uchar *rest_status, __global const uchar *rest_source,
                       __global const float *rest_points, __global const float *rest_bent,
                       __global float *moved, __global float *points, __global float *own,
                       __global float *bent, __global uchar *status, __global uchar *source,
                       __global uchar *valid, __global uchar *measured, __global uchar *votes) {
  const int i = get_global_id(0);
  if (i >= NODES) return;
  __global const REAL *h = homography;
  const int now = seen_status[i] != MISSING ? VALID : MISSING;
  const int good = judge(i, now, seen_status[i], rest_status, rest_source, status, source, valid,
                         measured, votes);
  const REAL x = nodes[i].x, y = nodes[i].y, share = 1 / (h[6] * x + h[7] * y + h[8]);
  const REAL u = share * (h[0] * x + h[1] * y + h[2]), v = share * (h[3] * x + h[4] * y + h[5]);
  const REAL slope[4] = {share * (h[0] - u * h[6]), share * (h[1] - u * h[7]),
                         share * (h[3] - v * h[6]), share * (h[4] - v * h[7])};
  const float2 bend = bend_of(nodes, seen_status, i / COLUMNS, i % COLUMNS, bend_down, bend_along,
                              radius);
  const REAL grown = (slope[0] * slope[0] + slope[1] * slope[1] + slope[2] * slope[2] +
                      slope[3] * slope[3]) / 2;
  const float variance =
      good && seen_sigma[i] > 0 ? (float)((REAL)seen_sigma[i] * (REAL)seen_sigma[i] * grown) : NAN;
  own[IN_LINE(i)] = variance;
  points[i] = variance + rest_points[i];
  moved[i] = good ? (float)(u - rest[i]) : 0.0f;
  moved[NODES + i] = good ? (float)(v - rest[NODES + i]) : 0.0f;
  const float bent_u = (float)(slope[0] * bend.x + slope[1] * bend.y);
  const float bent_v = (float)(slope[2] * bend.x + slope[3] * bend.y);
  bent[i] = good ? bent_u - rest_bent[i] : 0.0f;
  bent[NODES + i] = good ? bent_v - rest_bent[NODES + i] : 0.0f;
}
