#include "moment.clh"

/* From the nodes of two views to their displacement in space. In float32, points a few centimetres
 * away err by some hundredths of a micrometre.
 *
 * On a CPU a work-item takes four nodes at a time, in vectors; elsewhere one. */

#if WIDTH == 1
typedef REAL REALS;
#define ANY_OF(condition) (condition)
#else
#define ANY_OF(condition) any(condition)
#if DOUBLE
typedef double4 REALS;
#else
typedef float4 REALS;
#endif
#endif
typedef union {
  REALS all;
  REAL each[WIDTH];
} BY_LANE;
#define EACH_LANE for (int lane = 0; lane < WIDTH; ++lane)

#define MOST_STEPS 30
#define ROUND_TRIP ((REAL)1e-2) /* px, from a pixel through the lens and back */
/* A camera: fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, then rotation (9) and translation (3)
 * from the left camera, then the camera's centre there (3), the radius at which the lens model
 * turns back, then the window if MEDIA is not 0. */
#define CAMERA 32
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
#define FOLD camera[31]

/* The pixel of a point (x, y) of the plane at distance 1, and its derivatives xx xy yx yy. */
void distort(__global const REAL *camera, const REALS x, const REALS y, REALS *pixel,
             REALS *slope) {
  const REALS r = x * x + y * y;
  const REALS over = 1 + r * (K4 + r * (K5 + r * K6));
  const REALS g = (1 + r * (K1 + r * (K2 + r * K3))) / over;
  const REALS by_r =
      (K1 + r * (2 * K2 + 3 * r * K3) - g * (K4 + r * (2 * K5 + 3 * r * K6))) / over;
  const REALS fx = camera[0], fy = camera[1], thin_x = S1 + 2 * r * S2, thin_y = S3 + 2 * r * S4;
  pixel[0] =
      fx * (x * g + 2 * P1 * x * y + P2 * (r + 2 * x * x) + r * (S1 + r * S2)) + camera[2];
  pixel[1] =
      fy * (y * g + P1 * (r + 2 * y * y) + 2 * P2 * x * y + r * (S3 + r * S4)) + camera[3];
  const REALS mixed = 2 * x * y * by_r + 2 * P1 * x + 2 * P2 * y;
  slope[0] = fx * (g + 2 * x * x * by_r + 2 * P1 * y + 6 * P2 * x + 2 * x * thin_x);
  slope[1] = fx * (mixed + 2 * y * thin_x);
  slope[2] = fy * (mixed + 2 * x * thin_y);
  slope[3] = fy * (g + 2 * y * y * by_r + 6 * P1 * y + 2 * P2 * x + 2 * y * thin_y);
}

/* Shorten a step from `last` that leaves the fold of the lens model, to half the way there, and one
 * that begins near the fold, where the slopes are small, and goes far inwards, to half as far out.
 * Beyond the fold, pixels of other points come again. */
void stay_inside(__global const REAL *camera, const REALS *last, REALS *x, REALS *y) {
  const REALS r_2 = *x * *x + *y * *y, last_2 = last[0] * last[0] + last[1] * last[1];
  const REALS along = *x * last[0] + *y * last[1], edge_2 = FOLD * FOLD;
  if (!ANY_OF(r_2 >= edge_2 || (4 * last_2 > edge_2 && 2 * along < last_2))) return;
  const REALS out = r_2 < edge_2 ? (REALS)1 : (sqrt(last_2) + FOLD) / (2 * sqrt(r_2));
  *x = 4 * last_2 > edge_2 && 2 * along < last_2 ? last[0] / 2 : out * *x;
  *y = 4 * last_2 > edge_2 && 2 * along < last_2 ? last[1] / 2 : out * *y;
}

/* The point of the plane at distance 1 that a pixel shows, by Newton's method. Returns the squared
 * distance, px^2, before the last step, which is large or NaN if the lens cannot be inverted
 * there. */
REALS undistort(__global const REAL *camera, const REALS *pixel, REALS *point) {
  REALS x = (pixel[0] - camera[2]) / camera[0], y = (pixel[1] - camera[3]) / camera[1];
  REALS seen[2], slope[4], off_2, last[2] = {0, 0};
  stay_inside(camera, last, &x, &y);
  for (int step = 0; step < MOST_STEPS; ++step) {
    distort(camera, x, y, seen, slope);
    const REALS off_x = pixel[0] - seen[0], off_y = pixel[1] - seen[1];
    const REALS inverse = 1 / (slope[0] * slope[3] - slope[1] * slope[2]);
    last[0] = x;
    last[1] = y;
    x += (slope[3] * off_x - slope[1] * off_y) * inverse;
    y += (slope[0] * off_y - slope[2] * off_x) * inverse;
    stay_inside(camera, last, &x, &y);
    off_2 = off_x * off_x + off_y * off_y;
    if (!ANY_OF(off_2 > SMALL * SMALL)) break; /* a step squares the error */
  }
  point[0] = x;
  point[1] = y;
  return off_2;
}

/* A vector (3) of the left camera's frame in that of a camera. */
void turned_to(__global const REAL *camera, const REALS *vector, REALS *turned) {
  for (int j = 0; j < 3; ++j)
    turned[j] = ROTATION[3 * j] * vector[0] + ROTATION[3 * j + 1] * vector[1] +
                ROTATION[3 * j + 2] * vector[2];
}

/* A vector (3) of a camera's frame in that of the left camera. */
void turned_from(__global const REAL *camera, const REALS *vector, REALS *turned) {
  for (int k = 0; k < 3; ++k)
    turned[k] = vector[0] * ROTATION[k] + vector[1] * ROTATION[3 + k] + vector[2] * ROTATION[6 + k];
}

/* The pixel of a point in the frame of its camera, and its two derivatives by the point in that of
 * the left camera. */
void see(__global const REAL *camera, const REALS *there, REALS *pixel, REALS *by_point) {
  REALS slope[4];
  const REALS x = there[0] / there[2], y = there[1] / there[2];
  distort(camera, x, y, pixel, slope);
  for (int j = 0; j < 3; ++j) {
    const REALS by_x = (ROTATION[j] - x * ROTATION[6 + j]) / there[2];
    const REALS by_y = (ROTATION[3 + j] - y * ROTATION[6 + j]) / there[2];
    by_point[j] = slope[0] * by_x + slope[1] * by_y;
    by_point[3 + j] = slope[2] * by_x + slope[3] * by_y;
  }
}

REALS dot_3(const REALS *a, const REALS *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

void cross_3(const REALS *a, const REALS *b, REALS *result) {
  result[0] = a[1] * b[2] - a[2] * b[1];
  result[1] = a[2] * b[0] - a[0] * b[2];
  result[2] = a[0] * b[1] - a[1] * b[0];
}

#if MEDIA
#include "window.clh"
#else
/* The same of a point in the frame of the left camera. Returns its depth. */
REALS project(__global const REAL *camera, const REALS *point, REALS *pixel, REALS *by_point) {
  REALS there[3];
  turned_to(camera, point, there);
  for (int j = 0; j < 3; ++j) there[j] += TRANSLATION[j];
  see(camera, there, pixel, by_point);
  return there[2];
}
#endif

/* The middle of the shortest segment between two rays, one from 0, the other from `offset`. */
void between(const REALS *one, const REALS *two, const REALS *offset, REALS *middle) {
  const REALS oo = dot_3(one, one), ot = dot_3(one, two), tt = dot_3(two, two);
  const REALS ahead_one = dot_3(one, offset), ahead_two = dot_3(two, offset);
  const REALS shared = oo * tt - ot * ot;
  const REALS depth_one = (ahead_one * tt - ot * ahead_two) / shared;
  const REALS depth_two = (ot * ahead_one - oo * ahead_two) / shared;
  for (int k = 0; k < 3; ++k)
    middle[k] = (depth_one * one[k] + depth_two * two[k] + offset[k]) / 2;
}

/* The point at which the rays of two image points (x, y, 1) meet best, all in the frame of the left
 * camera. */
#if MEDIA
/* tangents, passed: of both rays, see window.clh. */
void meet_behind(__global const REAL *left, __global const REAL *right, const REALS *one,
                 const REALS *turned, REALS *point, REALS *tangents, REALS *passed) {
  REALS from_one[3], from_two[3], first[3], second[3], offset[3];
  tangents[0] = refract(left, one, passed, from_one, first);
  tangents[1] = refract(right, turned, passed + PASSED, from_two, second);
  for (int k = 0; k < 3; ++k) offset[k] = from_two[k] - from_one[k];
  between(first, second, offset, point);
  for (int k = 0; k < 3; ++k) point[k] += from_one[k];
}
#else
void meet(__global const REAL *camera, const REALS *one, const REALS *turned, REALS *point) {
  const REALS centre[3] = {CENTRE[0], CENTRE[1], CENTRE[2]};
  between(one, turned, centre, point);
}
#endif

/* One Gauss-Newton step. The motion of a point (3) by its residuals in both views, and its shift
 * (3) by those of its pixels, `bend`, are (J' W J)^-1 J' W of them. jacobian: J, of the pixels by
 * the point, (4, 3). covariance: (J' W J)^-1, xx xy xz yy yz zz. */
void fit(const REALS *jacobian, const REALS *weight, const REALS *residual, const REALS *bend,
         REALS *covariance, REALS *move, REALS *shift) {
  REALS a[6], by_residual[3], by_bend[3];
  for (int p = 0; p < 6; ++p) a[p] = 0;
  for (int k = 0; k < 3; ++k) by_residual[k] = by_bend[k] = 0;
  for (int j = 0; j < 4; ++j) {
    const REALS *d = jacobian + 3 * j;
    const REALS x = weight[j] * d[0], y = weight[j] * d[1], z = weight[j] * d[2];
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
  const REALS c0 = a[3] * a[5] - a[4] * a[4], c1 = a[2] * a[4] - a[1] * a[5];
  const REALS c2 = a[1] * a[4] - a[2] * a[3], determinant = a[0] * c0 + a[1] * c1 + a[2] * c2;
  const REALS inverse = 1 / determinant;
  covariance[0] = c0 * inverse;
  covariance[1] = c1 * inverse;
  covariance[2] = c2 * inverse;
  covariance[3] = (a[0] * a[5] - a[2] * a[2]) * inverse;
  covariance[4] = (a[1] * a[2] - a[0] * a[4]) * inverse;
  covariance[5] = (a[0] * a[3] - a[1] * a[1]) * inverse;
  const int of_row[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};
  for (int k = 0; k < 3; ++k) {
    move[k] = shift[k] = 0;
    for (int j = 0; j < 3; ++j) {
      move[k] += covariance[of_row[k][j]] * by_residual[j];
      shift[k] += covariance[of_row[k][j]] * by_bend[j];
    }
  }
}

/* Triangulate the nodes that both views show, and subtract their position at rest: the point at
 * which the rays meet best, then one Gauss-Newton step on the reprojection error, weighted by
 * 1 / sigma^2.
 *
 * nodes: of both views, complete, px of the view; status: of NodeStatus; sigma: px, not positive if
 * unknown. rest: positions (3 planes), rest_*: their status, source, covariance (6 planes) and
 * motion by bent edges (3 planes). moved: 3 planes, 0 where not valid. points: the sum of the
 * covariances of both moments. own: the variance now per axis, in lines. misfit: the step from the
 * point at which the rays meet best to the node in the left view, px (2 planes): about half of its
 * distance from its epipolar line, NaN where a view does not show it.
 * One work-item for WIDTH nodes. */
__kernel void space(__global const float2 *nodes, __global const uchar *seen_status,
                    __global const float *seen_sigma, __global const REAL *left,
                    __global const REAL *right, const REAL least_sine, const float largest_error,
                    __global const float *bend_down, __global const float *bend_along,
                    const float radius_left, const float radius_right,
                    __global const REAL *rest, __global const uchar *rest_status,
                    __global const uchar *rest_source, __global const float *rest_points,
                    __global const float *rest_bent, __global float *moved,
                    __global float *points, __global float *own, __global float *bent,
                    __global float *misfit, __global uchar *status, __global uchar *source,
                    __global uchar *valid, __global uchar *measured, __global uchar *votes) {
  const int first = WIDTH * get_global_id(0);
  if (first >= NODES) return;
  BY_LANE pixel_of[4], weight_of[2], bend_in[4];
  EACH_LANE {
    const int i = min(first + lane, NODES - 1);
    const int known = seen_sigma[i] > 0 && seen_sigma[NODES + i] > 0;
    for (int view = 0; view < 2; ++view) {
      __global const float2 *at = nodes + view * NODES;
      const REAL deviation = known ? seen_sigma[view * NODES + i] : 1;
      const float2 bend = bend_of(at, seen_status + view * NODES, i / COLUMNS, i % COLUMNS,
                                  bend_down, bend_along, view ? radius_right : radius_left);
      pixel_of[2 * view].each[lane] = at[i].x;
      pixel_of[2 * view + 1].each[lane] = at[i].y;
      weight_of[view].each[lane] = deviation * deviation;
      bend_in[2 * view].each[lane] = bend.x;
      bend_in[2 * view + 1].each[lane] = bend.y;
    }
  }
  REALS pixel[4], one[3], two[3], seen[4];
  for (int j = 0; j < 4; ++j) pixel[j] = pixel_of[j].all;
  BY_LANE astray_one, astray_two, sine_2, depth_left, depth_right;
  astray_one.all = undistort(left, pixel, one);
  astray_two.all = undistort(right, pixel + 2, two);
  one[2] = two[2] = 1;

  REALS turned[3], across[3], point[3];
  turned_from(right, two, turned);
  cross_3(one, turned, across);
  sine_2.all = dot_3(across, across) / (dot_3(one, one) * dot_3(turned, turned));

  REALS jacobian[12];
#if MEDIA
  REALS tangents[2], passed[2 * PASSED];
  meet_behind(left, right, one, turned, point, tangents, passed);
  depth_left.all = project_behind(left, point, tangents[0], passed, seen, jacobian);
  depth_right.all =
      project_behind(right, point, tangents[1], passed + PASSED, seen + 2, jacobian + 6);
#else
  meet(right, one, turned, point);
  depth_left.all = project(left, point, seen, jacobian);
  depth_right.all = project(right, point, seen + 2, jacobian + 6);
#endif
  REALS weight[4], residual[4], bend[4], covariance[6], move[3], shift[3];
  for (int j = 0; j < 4; ++j) {
    weight[j] = 1 / weight_of[j / 2].all;
    residual[j] = pixel[j] - seen[j];
    bend[j] = bend_in[j].all;
  }
  fit(jacobian, weight, residual, bend, covariance, move, shift);
  BY_LANE better[3], bent_by[3], v[6], error, misfit_of[2];
  error.all = 0;
  for (int j = 0; j < 4; ++j) {
    const REALS *d = jacobian + 3 * j;
    const REALS left_over = residual[j] - d[0] * move[0] - d[1] * move[1] - d[2] * move[2];
    error.all += left_over * left_over;
  }
  for (int j = 0; j < 2; ++j) misfit_of[j].all = residual[j];
  for (int p = 0; p < 6; ++p) v[p].all = covariance[p];
  for (int k = 0; k < 3; ++k) {
    better[k].all = point[k] + move[k];
    bent_by[k].all = shift[k];
  }

  EACH_LANE {
    const int i = first + lane;
    if (i >= NODES) break;
    const uchar worst = max(seen_status[i], seen_status[NODES + i]);
    const int known = seen_sigma[i] > 0 && seen_sigma[NODES + i] > 0;
    int now = VALID;
    if (!(error.each[lane] <= 2 * largest_error * largest_error)) now = INCONSISTENT;
    if (!(depth_left.each[lane] > 0 && depth_right.each[lane] > 0)) now = BEHIND;
    if (!(sine_2.each[lane] >= least_sine * least_sine)) now = PARALLEL;
    if (!(astray_one.each[lane] < ROUND_TRIP * ROUND_TRIP &&
          astray_two.each[lane] < ROUND_TRIP * ROUND_TRIP))
      now = INCONSISTENT;
    const int seen_by_both = seen_status[i] != MISSING && seen_status[NODES + i] != MISSING;
    if (!seen_by_both) now = MISSING;
    for (int j = 0; j < 2; ++j)
      misfit[j * NODES + i] = seen_by_both ? (float)misfit_of[j].each[lane] : NAN;
    const int good = judge(i, now, worst, rest_status, rest_source, status, source, valid, measured,
                           votes);
    const REAL trace = v[0].each[lane] + v[3].each[lane] + v[5].each[lane];
    own[IN_LINE(i)] = good && known ? (float)(trace / 3) : NAN;
    for (int k = 0; k < 3; ++k) {
      const int at = k * NODES + i;
      moved[at] = good ? (float)(better[k].each[lane] - rest[at]) : 0.0f;
      bent[at] = good ? (float)bent_by[k].each[lane] - rest_bent[at] : 0.0f;
    }
    for (int p = 0; p < 6; ++p) {
      const int at = p * NODES + i;
      points[at] = good && known ? (float)v[p].each[lane] + rest_points[at] : NAN;
    }
  }
}
