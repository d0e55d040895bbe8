#include "field.clh"

/* The strain of a plane or of a surface in its tangent plane at rest, and its covariance:
 * cmp_cl/reference/field/strain.py has the equations. A surface is fitted to a window of nodes
 * around each node, which is moved inwards at a border. */

#define QUADRATIC 6 /* terms of a surface */
#define CUBIC 10
#define POWERS 7 /* in the products of two terms */
#define LEAST_PIVOT 1e-3f   /* of normal equations whose coefficients are integers */
#define MOST_VARIANCE 10.0f /* of a slope, where that of each node is 1 */
/* Errors of filtered neighbours are alike, which halves the variance of slopes. */
#define FILTERED (PILOT_DOWN + PILOT_ALONG > 0)
#define ALIKE (FILTERED ? 0.5f : 1.0f)
#define APART 5.0f /* times the square of how far apart two surfaces are */
#define TORN 0.06f /* that of a fourth difference: a jump of 1 is a slope of 7 / 12 and one of 3 */
#define SIDE 3 /* nodes, of the window of a quadratic surface, and of a cubic one */
#define CUBIC_SIDE 5
#define WEIGHTS (CUBIC_SIDE * CUBIC_SIDE)

/* On PoCL dot is a call. */
float dot_of(const float3 a, const float3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

/* Add the covariance of E11 E22 E12 due to the errors of one moment: xx xy xz yy yz zz. axis_1,
 * axis_2: derivatives of the three by the slope along each axis. inverse: from the steps, by column
 * and by row, to the axes. by_step: covariances of the slopes by step. */
void add_covariance(const float3 *axis_1, const float3 *axis_2, const float (*inverse)[2],
                    const float3 (*by_step)[3], float *result) {
  for (int step = 0; step < 2; ++step) {
    float3 one[3], two[3];
    for (int e = 0; e < 3; ++e) {
      one[e] = inverse[0][step] * axis_1[e] + inverse[1][step] * axis_2[e];
      two[e] = (float3)(dot_of(by_step[step][0], one[e]), dot_of(by_step[step][1], one[e]),
                        dot_of(by_step[step][2], one[e]));
    }
    int p = 0;
    for (int d = 0; d < 3; ++d)
      for (int e = d; e < 3; ++e) result[p++] += dot_of(one[d], two[e]);
  }
}

/* A window of nodes: its first row and column, and how many it has. */
typedef struct {
  int top, left, down, along;
} Window;

/* The window of up to side x side nodes around node i. */
Window window_around(const int i, const int side) {
  const int down = min(side / 2, (ROWS - 1) / 2), along = min(side / 2, (COLUMNS - 1) / 2);
  const Window window = {WINDOW_START(i / COLUMNS, down, ROWS),
                         WINDOW_START(i % COLUMNS, along, COLUMNS), 2 * down + 1, 2 * along + 1};
  return window;
}

/* Whether there are side x side nodes in a window, and all are valid. */
int is_whole(__global const uchar *valid, const Window window, const int side) {
  if (window.down != side || window.along != side) return 0;
  int count = 0;
  for (int r = 0; r < side; ++r)
    for (int c = 0; c < side; ++c)
      count += valid[(window.top + r) * COLUMNS + window.left + c] != 0;
  return count == side * side;
}

/* The weights of the nodes of a whole window in the slopes at node i, by column and by row. table:
 * those for each place in the window, (side, side, 2, side, side). */
void weights_of_whole(const int i, __global const float *table, const Window window,
                      float (*weight)[WEIGHTS]) {
  const int count = window.down * window.along;
  const int place = (i / COLUMNS - window.top) * window.along + i % COLUMNS - window.left;
  for (int step = 0; step < 2; ++step)
    for (int n = 0; n < count; ++n) weight[step][n] = table[(place * 2 + step) * count + n];
}

/* The powers of column and row in the terms of a surface. */
__constant int OF_COLUMN[CUBIC] = {0, 1, 0, 2, 1, 0, 3, 2, 1, 0};
__constant int OF_ROW[CUBIC] = {0, 0, 1, 0, 1, 2, 0, 1, 2, 3};

/* The powers 0 to 6 of a number. */
void powers_of(const float x, float *power) {
  power[0] = 1;
  for (int p = 1; p < POWERS; ++p) power[p] = power[p - 1] * x;
}

/* The same of the surface of so many terms through the valid nodes of a window; return whether they
 * determine it. */
int weights_of_some(const int i, __global const uchar *valid, const Window window, const int terms,
                    float (*weight)[WEIGHTS]) {
  const int middle_down = window.down / 2, middle_along = window.along / 2;
  float moment[POWERS][POWERS], u[POWERS], v[POWERS];
  for (int p = 0; p < POWERS; ++p)
    for (int q = 0; q < POWERS; ++q) moment[p][q] = 0;
  for (int r = 0; r < window.down; ++r) {
    float line[POWERS] = {0, 0, 0, 0, 0, 0, 0};
    for (int c = 0; c < window.along; ++c) {
      powers_of((float)(c - middle_along), u);
      const float there = valid[(window.top + r) * COLUMNS + window.left + c] != 0;
      for (int p = 0; p < POWERS; ++p) line[p] += there * u[p];
    }
    powers_of((float)(r - middle_down), v);
    for (int p = 0; p < POWERS; ++p)
      for (int q = 0; q < POWERS; ++q) moment[p][q] += line[p] * v[q];
  }
  powers_of((float)(i % COLUMNS - window.left - middle_along), u);
  powers_of((float)(i / COLUMNS - window.top - middle_down), v);
  float normal[CUBIC][CUBIC + 2];
  for (int a = 0; a < terms; ++a) {
    const int p = OF_COLUMN[a], q = OF_ROW[a];
    for (int b = 0; b < terms; ++b) normal[a][b] = moment[p + OF_COLUMN[b]][q + OF_ROW[b]];
    normal[a][terms] = p ? p * u[p - 1] * v[q] : 0;
    normal[a][terms + 1] = q ? q * u[p] * v[q - 1] : 0;
  }
  for (int pivot = 0; pivot < terms; ++pivot) {
    if (!(normal[pivot][pivot] > LEAST_PIVOT)) return 0;
    for (int b = terms + 1; b >= pivot; --b) normal[pivot][b] /= normal[pivot][pivot];
    for (int a = 0; a < terms; ++a) {
      if (a == pivot) continue;
      const float share = normal[a][pivot];
      for (int b = pivot; b < terms + 2; ++b) normal[a][b] -= share * normal[pivot][b];
    }
  }
  float own[2] = {0, 0};
  for (int r = 0; r < window.down; ++r)
    for (int c = 0; c < window.along; ++c) {
      powers_of((float)(c - middle_along), u);
      powers_of((float)(r - middle_down), v);
      const int there = valid[(window.top + r) * COLUMNS + window.left + c];
      for (int step = 0; step < 2; ++step) {
        float sum = 0;
        for (int a = 0; a < terms; ++a)
          sum += normal[a][terms + step] * u[OF_COLUMN[a]] * v[OF_ROW[a]];
        weight[step][r * window.along + c] = there ? sum : 0;
        own[step] += there ? sum * sum : 0;
      }
    }
  return own[0] < MOST_VARIANCE && own[1] < MOST_VARIANCE;
}

/* The weights of the nodes of a window of 5 x 5 in the mean fourth differences of its rows and of
 * its columns without a missing node; 0 without one. */
void weights_of_fourth(__global const uchar *valid, const Window window, float (*weight)[WEIGHTS]) {
  const float fourth[CUBIC_SIDE] = {1, -4, 6, -4, 1};
  for (int step = 0; step < 2; ++step) {
    int lines = 0, whole[CUBIC_SIDE];
    for (int a = 0; a < CUBIC_SIDE; ++a) {
      whole[a] = 1;
      for (int b = 0; b < CUBIC_SIDE; ++b)
        whole[a] &= valid[(window.top + (step ? b : a)) * COLUMNS + window.left + (step ? a : b)];
      lines += whole[a];
    }
    for (int r = 0; r < CUBIC_SIDE; ++r)
      for (int c = 0; c < CUBIC_SIDE; ++c)
        weight[step][r * CUBIC_SIDE + c] =
            whole[step ? c : r] ? fourth[step ? r : c] / (float)lines : 0;
  }
}

/* The slopes at node i of K planes, by column and by row, with these weights of the nodes of a
 * window; what is not valid may be NaN. */
void slopes_at(const int i, __global const float *values, __global const uchar *valid,
               const Window window, const float (*weight)[WEIGHTS], float3 *slope) {
  float sum[2][3] = {{0, 0, 0}, {0, 0, 0}};
  for (int r = 0; r < window.down; ++r)
    for (int c = 0; c < window.along; ++c) {
      const int j = (window.top + r) * COLUMNS + window.left + c;
      if (!valid[j]) continue;
      for (int k = 0; k < K; ++k) {
        const float off = values[k * NODES + j] - values[k * NODES + i];
        for (int step = 0; step < 2; ++step)
          sum[step][k] += weight[step][r * window.along + c] * off;
      }
    }
  for (int step = 0; step < 2; ++step)
    slope[step] = (float3)(sum[step][0], sum[step][1], sum[step][2]);
}

/* Add to the covariances of the slopes those of the errors of the nodes of a window. covariance: of
 * each node; in the plane its variance per axis. */
void add_errors(__global const float *covariance, __global const uchar *valid, const Window window,
                const float (*weight)[WEIGHTS], float3 (*by_step)[3]) {
  for (int n = 0; n < window.down * window.along; ++n) {
    const int j = (window.top + n / window.along) * COLUMNS + window.left + n % window.along;
    if (!valid[j]) continue;
    __global const float *of = covariance + j;
#if K == 3
    const float3 x = (float3)(of[0], of[NODES], of[2 * NODES]);
    const float3 y = (float3)(of[NODES], of[3 * NODES], of[4 * NODES]);
    const float3 z = (float3)(of[2 * NODES], of[4 * NODES], of[5 * NODES]);
#else
    const float3 x = (float3)(of[0], 0, 0), y = (float3)(0, of[0], 0), z = 0;
#endif
    for (int step = 0; step < 2; ++step) {
      const float square = ALIKE * weight[step][n] * weight[step][n];
      by_step[step][0] += square * x;
      by_step[step][1] += square * y;
      by_step[step][2] += square * z;
    }
  }
}

/* Add so many times the products of the coordinates of a vector to a covariance. */
void add_square(const float times, const float3 v, float3 *covariance) {
  covariance[0] += times * v.x * v;
  covariance[1] += times * v.y * v;
  covariance[2] += times * v.z * v;
}

/* The surface through the positions around node i, at rest and now, and what its slopes err by. It
 * is a quadratic one of 3 x 3 nodes, or of the valid ones of 5 x 5 where one of these is missing,
 * and a cubic one in the middle of 5 x 5 valid ones. Return whether the valid nodes determine it.
 * slope: at rest and now, by column and by row. covariance: of the displacement, rest_covariance:
 * of the position at rest; by_step: of the slopes due to these, at rest and now; now it has also
 * how far the slopes of the displacement are between the quadratic surface and the cubic one of the
 * 5 x 5 nodes, and its fourth differences there. */
int fit_surfaces(const int i, __global const float *rest_position,
                 __global const float *displacement, __global const uchar *valid,
                 __global const float *covariance, __global const float *rest_covariance,
                 __global const float *quadratic, __global const float *cubic,
                 float3 (*slope)[2], float3 (*by_step)[2][3]) {
  if (min(ROWS, COLUMNS) < SIDE) return 0;
  const Window near = window_around(i, SIDE), wide = window_around(i, CUBIC_SIDE);
  const int near_is_whole = is_whole(valid, near, SIDE);
  Window window = near_is_whole ? near : wide;
  float weight[2][WEIGHTS], weight_in_cubic[2][WEIGHTS];
  if (near_is_whole) weights_of_whole(i, quadratic, near, weight);
  else if (!weights_of_some(i, valid, wide, QUADRATIC, weight)) return 0;
  float3 moved[2];
  slopes_at(i, displacement, valid, window, weight, moved);
  for (int moment = 0; moment < 2; ++moment)
    for (int step = 0; step < 2; ++step)
      for (int k = 0; k < 3; ++k) by_step[moment][step][k] = 0;
  const int wide_is_whole = is_whole(valid, wide, CUBIC_SIDE);
  if (wide_is_whole) weights_of_whole(i, cubic, wide, weight_in_cubic);
  if (wide_is_whole || weights_of_some(i, valid, wide, CUBIC, weight_in_cubic)) {
    float3 moved_in_cubic[2], torn[2];
    float weight_of_fourth[2][WEIGHTS];
    slopes_at(i, displacement, valid, wide, weight_in_cubic, moved_in_cubic);
    weights_of_fourth(valid, wide, weight_of_fourth);
    slopes_at(i, displacement, valid, wide, weight_of_fourth, torn);
    const int middle = (wide.top + CUBIC_SIDE / 2) * COLUMNS + wide.left + CUBIC_SIDE / 2;
    const int follows = i == middle && wide_is_whole;
    for (int step = 0; step < 2; ++step) {
      add_square(APART, moved_in_cubic[step] - moved[step], by_step[1][step]);
      add_square(TORN, torn[step], by_step[1][step]);
      if (!follows) continue;
      moved[step] = moved_in_cubic[step];
      for (int n = 0; n < WEIGHTS; ++n) weight[step][n] = weight_in_cubic[step][n];
    }
    if (follows) window = wide;
  }
  slopes_at(i, rest_position, valid, window, weight, slope[0]);
  for (int step = 0; step < 2; ++step) slope[1][step] = slope[0][step] + moved[step];
  add_errors(rest_covariance, valid, window, weight, by_step[0]);
  add_errors(covariance, valid, window, weight, by_step[1]);
  return 1;
}

/* Green-Lagrange strain E11 E22 E12 and its covariance, xx xy xz yy yz zz; NaN where there is none.
 * rest_position: from the middle of the lattice. quadratic, cubic: tables of `weights_of_whole`.
 * One work-item a node. */
__kernel void strain(__global const float *rest_position, __global const float *displacement,
                     __global const uchar *valid, __global const float *covariance,
                     __global const float *rest_covariance, __global const float *quadratic,
                     __global const float *cubic, __global float *strain,
                     __global float *strain_covariance) {
  const int i = get_global_id(0);
  if (i >= NODES) return;
  for (int k = 0; k < 3; ++k) strain[k * NODES + i] = NAN;
  for (int p = 0; p < 6; ++p) strain_covariance[p * NODES + i] = NAN;
  if (!valid[i]) return;
  float3 slope[2][2], by_step[2][2][3];
  if (!fit_surfaces(i, rest_position, displacement, valid, covariance, rest_covariance, quadratic,
                    cubic, slope, by_step))
    return;
  const float3 a1 = slope[0][0], a2 = slope[0][1];
  if (!(length(cross(a1, a2)) > 1e-9f * (dot_of(a1, a1) + dot_of(a2, a2)))) return;
#if K == 2
  const float area = a1.x * a2.y - a1.y * a2.x;
  const float inverse[2][2] = {{a2.y / area, -a1.y / area}, {-a2.x / area, a1.x / area}};
  const float3 q1 = (float3)(1, 0, 0), q2 = (float3)(0, 1, 0), turned = 0;
#else
  const float l11 = length(a1), l21 = dot_of(a1, a2) / l11, l22 = sqrt(dot_of(a2, a2) - l21 * l21);
  const float inverse[2][2] = {{1 / l11, 0}, {-l21 / (l11 * l22), 1 / l22}};
  const float3 q1 = inverse[0][0] * a1, q2 = inverse[1][0] * a1 + inverse[1][1] * a2;
  const float3 turned = q2; /* an error of the slope along axis 1 turns the axes */
#endif
  const float3 f1 = inverse[0][0] * slope[1][0] + inverse[0][1] * slope[1][1];
  const float3 f2 = inverse[1][0] * slope[1][0] + inverse[1][1] * slope[1][1];
  const float e11 = (dot_of(f1, f1) - 1) / 2, e22 = (dot_of(f2, f2) - 1) / 2;
  const float e12 = dot_of(f1, f2) / 2;
  strain[i] = e11;
  strain[NODES + i] = e22;
  strain[2 * NODES + i] = e12;
  const float3 off_1 = f1 - (2 * e11 + 1) * q1 - 2 * e12 * q2;
  const float3 off_2 = f2 - 2 * e12 * q1 - (2 * e22 + 1) * q2;
  const float3 none = 0;
  const float3 now_1[3] = {f1, none, f2 / 2}, now_2[3] = {none, f2, f1 / 2};
  const float3 before_1[3] = {off_1 + 2 * e12 * turned, -2 * e12 * turned,
                              off_2 / 2 + (e22 - e11) * turned};
  const float3 before_2[3] = {none, off_2, off_1 / 2};
  float found[6] = {0, 0, 0, 0, 0, 0};
  add_covariance(before_1, before_2, inverse, by_step[0], found);
  add_covariance(now_1, now_2, inverse, by_step[1], found);
  for (int p = 0; p < 6; ++p) strain_covariance[p * NODES + i] = found[p];
}
