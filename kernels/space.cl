#include "moment.clh"

/* From the nodes of two views to their displacement in space. In float32, points a few centimetres
 * away err by some hundredths of a micrometre. */

#define MOST_STEPS 30
#define ROUND_TRIP ((REAL)1e-2) /* px, from a pixel through the lens and back */
/* A camera: fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, then rotation (9) and translation (3)
 * from the left camera, then the camera's centre there (3), then the window if MEDIA is not 0. */
#define CAMERA 31
#define K1 camera[4]
#define K2 camera[5]
#define P1 camera[6]
#define P2 camera[7]
#define K3 camera[8]
#define K4 camera[9]
#define K5 camera[10]
#define K6 camera[11]
#define S1 camera[12]
#define S2 camera[13]
#define S3 camera[14]
#define S4 camera[15]
#define ROTATION (camera + 16)
#define TRANSLATION (camera + 25)
#define CENTRE (camera + 28)

/* The pixel of a point (x, y) of the plane at distance 1, and its derivatives xx xy yx yy. */
void distort(__global const REAL *camera, const REAL x, const REAL y, REAL *pixel, REAL *slope) {
  const REAL r = x * x + y * y;
  const REAL over = 1 + r * (K4 + r * (K5 + r * K6));
  const REAL g = (1 + r * (K1 + r * (K2 + r * K3))) / over;
  const REAL by_r =
      (K1 + r * (2 * K2 + 3 * r * K3) - g * (K4 + r * (2 * K5 + 3 * r * K6))) / over;
  const REAL fx = camera[0], fy = camera[1], thin_x = S1 + 2 * r * S2, thin_y = S3 + 2 * r * S4;
  pixel[0] =
      fx * (x * g + 2 * P1 * x * y + P2 * (r + 2 * x * x) + r * (S1 + r * S2)) + camera[2];
  pixel[1] =
      fy * (y * g + P1 * (r + 2 * y * y) + 2 * P2 * x * y + r * (S3 + r * S4)) + camera[3];
  const REAL mixed = 2 * x * y * by_r + 2 * P1 * x + 2 * P2 * y;
  slope[0] = fx * (g + 2 * x * x * by_r + 2 * P1 * y + 6 * P2 * x + 2 * x * thin_x);
  slope[1] = fx * (mixed + 2 * y * thin_x);
  slope[2] = fy * (mixed + 2 * x * thin_y);
  slope[3] = fy * (g + 2 * y * y * by_r + 6 * P1 * y + 2 * P2 * x + 2 * y * thin_y);
}

/* The point of the plane at distance 1 that a pixel shows, by Newton's method; false if the lens
 * cannot be inverted there. */
int undistort(__global const REAL *camera, const REAL *pixel, REAL *point) {
  REAL x = (pixel[0] - camera[2]) / camera[0], y = (pixel[1] - camera[3]) / camera[1];
  REAL seen[2], slope[4], off_x = 0, off_y = 0;
  for (int step = 0; step < MOST_STEPS; ++step) {
    distort(camera, x, y, seen, slope);
    off_x = pixel[0] - seen[0];
    off_y = pixel[1] - seen[1];
    if (off_x * off_x + off_y * off_y < EXACT * EXACT) break;
    const REAL determinant = slope[0] * slope[3] - slope[1] * slope[2];
    x += (slope[3] * off_x - slope[1] * off_y) / determinant;
    y += (slope[0] * off_y - slope[2] * off_x) / determinant;
  }
  point[0] = x;
  point[1] = y;
  return off_x * off_x + off_y * off_y < ROUND_TRIP * ROUND_TRIP;
}

/* A vector (3) of the left camera's frame in that of a camera. */
void turned_to(__global const REAL *camera, const REAL *vector, REAL *turned) {
  for (int j = 0; j < 3; ++j)
    turned[j] = ROTATION[3 * j] * vector[0] + ROTATION[3 * j + 1] * vector[1] +
                ROTATION[3 * j + 2] * vector[2];
}

/* The pixel of a point in the frame of its camera, and its two derivatives by the point in that of
 * the left camera. */
void see(__global const REAL *camera, const REAL *there, REAL *pixel, REAL *by_point) {
  REAL slope[4];
  const REAL x = there[0] / there[2], y = there[1] / there[2];
  distort(camera, x, y, pixel, slope);
  for (int j = 0; j < 3; ++j) {
    const REAL by_x = (ROTATION[j] - x * ROTATION[6 + j]) / there[2];
    const REAL by_y = (ROTATION[3 + j] - y * ROTATION[6 + j]) / there[2];
    by_point[j] = slope[0] * by_x + slope[1] * by_y;
    by_point[3 + j] = slope[2] * by_x + slope[3] * by_y;
  }
}

REAL dot_3(const REAL *a, const REAL *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

void cross_3(const REAL *a, const REAL *b, REAL *result) {
  result[0] = a[1] * b[2] - a[2] * b[1];
  result[1] = a[2] * b[0] - a[0] * b[2];
  result[2] = a[0] * b[1] - a[1] * b[0];
}

#if MEDIA
#include "window.clh"
#else
/* The same of a point in the frame of the left camera. Returns its depth. */
REAL project(__global const REAL *camera, const REAL *point, REAL *pixel, REAL *by_point) {
  REAL there[3];
  turned_to(camera, point, there);
  for (int j = 0; j < 3; ++j) there[j] += TRANSLATION[j];
  see(camera, there, pixel, by_point);
  return there[2];
}
#endif

/* The middle of the shortest segment between two rays, one from 0, the other from `offset`. */
void between(const REAL *one, const REAL *two, const REAL *offset, REAL *middle) {
  const REAL oo = dot_3(one, one), ot = dot_3(one, two), tt = dot_3(two, two);
  const REAL ahead_one = dot_3(one, offset), ahead_two = dot_3(two, offset);
  const REAL shared = oo * tt - ot * ot;
  const REAL depth_one = (ahead_one * tt - ot * ahead_two) / shared;
  const REAL depth_two = (ot * ahead_one - oo * ahead_two) / shared;
  for (int k = 0; k < 3; ++k)
    middle[k] = (depth_one * one[k] + depth_two * two[k] + offset[k]) / 2;
}

/* The point at which the rays of two image points (x, y, 1) meet best, in the frame of the left
 * camera. */
#if MEDIA
/* turned: the second one in that frame. tangents, passed: of both rays, see window.clh. */
void meet_behind(__global const REAL *left, __global const REAL *right, const REAL *one,
                 const REAL *turned, REAL *point, REAL *tangents, REAL *passed) {
  REAL from_one[3], from_two[3], first[3], second[3], offset[3];
  tangents[0] = refract(left, one, passed, from_one, first);
  tangents[1] = refract(right, turned, passed + PASSED, from_two, second);
  for (int k = 0; k < 3; ++k) offset[k] = from_two[k] - from_one[k];
  between(first, second, offset, point);
  for (int k = 0; k < 3; ++k) point[k] += from_one[k];
}
#else
/* Sampson's step moves them onto each other's epipolar lines first. */
void meet(__global const REAL *camera, const REAL *one, const REAL *two, REAL *point) {
  REAL essential[9], line_one[3], line_two[3], moved[3], centre[3];
  for (int j = 0; j < 3; ++j) {
    const int next = (j + 1) % 3, last = (j + 2) % 3; /* row j of the matrix of the cross product */
    for (int k = 0; k < 3; ++k)
      essential[3 * j + k] =
          TRANSLATION[next] * ROTATION[3 * last + k] - TRANSLATION[last] * ROTATION[3 * next + k];
  }
  for (int j = 0; j < 3; ++j) {
    line_one[j] = two[0] * essential[j] + two[1] * essential[3 + j] + essential[6 + j];
    line_two[j] =
        essential[3 * j] * one[0] + essential[3 * j + 1] * one[1] + essential[3 * j + 2];
  }
  const REAL square = line_one[0] * line_one[0] + line_one[1] * line_one[1] +
                      line_two[0] * line_two[0] + line_two[1] * line_two[1];
  const REAL step = dot_3(line_one, one) / (square > TINY ? square : TINY);
  const REAL first[3] = {one[0] - step * line_one[0], one[1] - step * line_one[1], 1};
  const REAL second[3] = {two[0] - step * line_two[0], two[1] - step * line_two[1], 1};
  for (int k = 0; k < 3; ++k) {
    moved[k] = second[0] * ROTATION[k] + second[1] * ROTATION[3 + k] + second[2] * ROTATION[6 + k];
    centre[k] = CENTRE[k];
  }
  between(first, moved, centre, point);
}
#endif

/* Triangulate the nodes that both views show, and subtract their position at rest: the point at
 * which the rays meet best, then one Gauss-Newton step on the reprojection error, weighted by
 * 1 / sigma^2.
 *
 * nodes: of both views, complete, px of the view; status: of NodeStatus; sigma: px, not positive if
 * unknown. rest: positions (3 planes), rest_*: their status, source, covariance (6 planes) and
 * motion by bent edges (3 planes). moved: 3 planes, 0 where not valid. points: the sum of the
 * covariances of both moments. own: the variance now per axis. One work-item a node. */
__kernel void space(__global const float2 *nodes, __global const uchar *seen_status,
                    __global const float *seen_sigma, __global const REAL *left,
                    __global const REAL *right, const REAL least_sine, const float largest_error,
                    __global const float *bend_down, __global const float *bend_along,
                    const float radius_left, const float radius_right,
                    __global const REAL *rest, __global const uchar *rest_status,
                    __global const uchar *rest_source, __global const float *rest_points,
                    __global const float *rest_bent, __global float *moved,
                    __global float *points, __global float *own, __global float *bent,
                    __global uchar *status, __global uchar *source, __global uchar *valid,
                    __global uchar *measured, __global uchar *votes, __global int *counts) {
  const int i = get_global_id(0);
  if (i >= NODES) return;
  __global const float2 *nodes_left = nodes, *nodes_right = nodes + NODES;
  __global const uchar *status_left = seen_status, *status_right = seen_status + NODES;
  __global const float *sigma_left = seen_sigma, *sigma_right = seen_sigma + NODES;
  const int there = status_left[i] != MISSING && status_right[i] != MISSING;
  const REAL pixel[4] = {nodes_left[i].x, nodes_left[i].y, nodes_right[i].x, nodes_right[i].y};
  REAL one[3], two[3], seen[4], slope[4];
  int now = VALID;
  const int invertible = undistort(left, pixel, one) & undistort(right, pixel + 2, two);
  one[2] = two[2] = 1;

  __global const REAL *turn = right + 16;
  REAL turned[3], across[3], point[3];
  for (int k = 0; k < 3; ++k)
    turned[k] = two[0] * turn[k] + two[1] * turn[3 + k] + two[2] * turn[6 + k];
  cross_3(one, turned, across);
  const REAL sine_2 = dot_3(across, across) / (dot_3(one, one) * dot_3(turned, turned));

  /* One Gauss-Newton step */
  REAL jacobian[12];
#if MEDIA
  REAL tangents[2], passed[2 * PASSED];
  meet_behind(left, right, one, turned, point, tangents, passed);
  const REAL depth_left = project_behind(left, point, tangents[0], passed, seen, jacobian);
  const REAL depth_right =
      project_behind(right, point, tangents[1], passed + PASSED, seen + 2, jacobian + 6);
#else
  meet(right, one, two, point);
  const REAL depth_left = project(left, point, seen, jacobian);
  const REAL depth_right = project(right, point, seen + 2, jacobian + 6);
#endif
  if (!(depth_left > 0 && depth_right > 0)) now = BEHIND;
  if (!(sine_2 >= least_sine * least_sine)) now = PARALLEL;
  if (!invertible) now = INCONSISTENT;
  const int known = sigma_left[i] > 0 && sigma_right[i] > 0;
  REAL weight[4], residual[4];
  for (int j = 0; j < 4; ++j) {
    const REAL deviation = j < 2 ? sigma_left[i] : sigma_right[i];
    weight[j] = known ? 1 / (deviation * deviation) : 1;
    residual[j] = pixel[j] - seen[j];
  }
  const float2 bend_left = bend_of(nodes_left, status_left, i / COLUMNS, i % COLUMNS, bend_down,
                                   bend_along, radius_left);
  const float2 bend_right = bend_of(nodes_right, status_right, i / COLUMNS, i % COLUMNS, bend_down,
                                    bend_along, radius_right);
  const REAL bend[4] = {bend_left.x, bend_left.y, bend_right.x, bend_right.y};
  REAL a[6] = {0, 0, 0, 0, 0, 0}, by_residual[3] = {0, 0, 0}, by_bend[3] = {0, 0, 0};
  for (int j = 0; j < 4; ++j) {
    const REAL *d = jacobian + 3 * j;
    const REAL x = weight[j] * d[0], y = weight[j] * d[1], z = weight[j] * d[2];
    a[0] += x * d[0];
    a[1] += x * d[1];
    a[2] += x * d[2];
    a[3] += y * d[1];
    a[4] += y * d[2];
    a[5] += z * d[2];
    for (int k = 0; k < 3; ++k) {
      by_residual[k] += weight[j] * d[k] * residual[j];
      by_bend[k] += weight[j] * d[k] * bend[j];
    }
  }
  const REAL c0 = a[3] * a[5] - a[4] * a[4], c1 = a[2] * a[4] - a[1] * a[5];
  const REAL c2 = a[1] * a[4] - a[2] * a[3], determinant = a[0] * c0 + a[1] * c1 + a[2] * c2;
  const REAL v[6] = {c0 / determinant,
                     c1 / determinant,
                     c2 / determinant,
                     (a[0] * a[5] - a[2] * a[2]) / determinant,
                     (a[1] * a[2] - a[0] * a[4]) / determinant,
                     (a[0] * a[3] - a[1] * a[1]) / determinant};
#define TIMES_COVARIANCE(x)                                                                \
  {                                                                                        \
    v[0] * x[0] + v[1] * x[1] + v[2] * x[2], v[1] * x[0] + v[3] * x[1] + v[4] * x[2],      \
        v[2] * x[0] + v[4] * x[1] + v[5] * x[2]                                            \
  }
  const REAL better[3] = TIMES_COVARIANCE(by_residual), bent_by[3] = TIMES_COVARIANCE(by_bend);
  REAL error = 0;
  for (int j = 0; j < 4; ++j) {
    const REAL left_over = residual[j] - dot_3(jacobian + 3 * j, better);
    error += left_over * left_over;
  }
  if (now == VALID && !(error <= 2 * largest_error * largest_error)) now = INCONSISTENT;
  if (!there) now = MISSING;
  const int good = judge(i, now, max(status_left[i], status_right[i]), rest_status, rest_source,
                         status, source, valid, measured, votes, counts);
  own[i] = good && known ? (float)((v[0] + v[3] + v[5]) / 3) : NAN;
  for (int k = 0; k < 3; ++k) {
    moved[k * NODES + i] = good ? (float)(point[k] + better[k] - rest[k * NODES + i]) : 0.0f;
    bent[k * NODES + i] = good ? (float)bent_by[k] - rest_bent[k * NODES + i] : 0.0f;
  }
  for (int p = 0; p < 6; ++p)
    points[p * NODES + i] = good && known ? (float)v[p] + rest_points[p * NODES + i] : NAN;
}
