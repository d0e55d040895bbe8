#include "field.clh"

/* The strain of a plane or of a surface in its tangent plane at rest, and its covariance:
 * cmp_cl/reference/field/strain.py has the equations. A surface is fitted to a window of nodes
 * around each node, which is moved inwards at a border. */

#define QUADRATIC 6 /* terms of a surface */
#define CUBIC 10
#define POWERS 7 /* in the products of two terms */
#define LEAST_PIVOT 1e-3f   /* of normal equations whose coefficients are integers */
#define MOST_VARIANCE 10.0f /* of a slope, where that of each node is 1 */
#define LAGS 3 /* of second differences: with themselves, with the next row, the next column */
#define MOST_SHARED 0.25f
#define CHOSEN 1.15f /* times the variance: the weights were chosen by the noise they average */
#define APART 3.0f /* times the square of how far apart two surfaces are */
#define TORN 0.02f /* that of a fourth difference: a jump of 1 is a slope of 7 / 12 and one of 3 */
#define SIDE 3 /* nodes, of the window of a quadratic surface, and of a cubic one */
#define CUBIC_SIDE 5
#define WEIGHTS (CUBIC_SIDE * CUBIC_SIDE)
#define REACH_DOWN (ROWS > 2) /* nodes on each side of the middle of a window */
#define REACH_ALONG (COLUMNS > 2)
#define WIDE_DOWN (2 * REACH_DOWN + 1)
#define WIDE_ALONG (2 * REACH_ALONG + 1)

/* A row of nodes between two margins. The node that the window at an end is moved to go into the
 * margin beyond it, so that each window is the WIDE_ALONG numbers around its node. */
#define TURN_ENDS(line)                                      \
  if (REACH_ALONG) {                                         \
    (line)[0] = (line)[WIDE_ALONG];                          \
    (line)[COLUMNS + 1] = (line)[COLUMNS + 1 - WIDE_ALONG];  \
  }

/* Second differences along the rows of second differences along the columns, over the deviation of
 * the noise, for one row; `known` is 1 where all nine nodes have a vote. */
void second_differences(__global const float *plane, __global const uchar *votes,
                        __global const float *variance, const int row, float *found,
                        float *known) {
  EACH_COLUMN found[c] = known[c] = 0;
  if (row < 1 || row >= ROWS - 1) return;
  for (int c = 1; c < COLUMNS - 1; ++c) {
    float sum = 0;
    int count = 0;
    for (int v = -1; v <= 1; ++v)
      for (int u = -1; u <= 1; ++u) {
        sum += (v ? 1.0f : -2.0f) * (u ? 1.0f : -2.0f) * plane[(row + v) * LINE + c + u];
        count += votes[(row + v) * COLUMNS + c + u];
      }
    const float size = sqrt(variance[row * LINE + c]);
    known[c] = count == 9 && size > 0;
    found[c] = known[c] > 0 ? sum / size : 0.0f;
  }
}

/* Sums over a row of the products of second differences that lie one of the lags apart, and how
 * many there are. One work-item a row. */
__kernel void roughness(__global const float *data, __global const uchar *votes,
                        __global const float *variance, __global float *rough) {
  const int row = get_global_id(0);
  if (row >= ROWS) return;
  float sum[2 * LAGS], here[COLUMNS], below[COLUMNS], known[COLUMNS], known_below[COLUMNS];
  for (int s = 0; s < 2 * LAGS; ++s) sum[s] = 0;
  for (int k = 0; k < K; ++k) {
    second_differences(data + k * PLANE, votes, variance, row, here, known);
    second_differences(data + k * PLANE, votes, variance, row + 1, below, known_below);
    EACH_COLUMN {
      sum[0] += here[c] * here[c];
      sum[1] += here[c] * below[c];
      sum[LAGS] += known[c];
      sum[LAGS + 1] += known[c] * known_below[c];
    }
    for (int c = 1; c < COLUMNS; ++c) {
      sum[2] += here[c - 1] * here[c];
      sum[LAGS + 2] += known[c - 1] * known[c];
    }
  }
  for (int s = 0; s < 2 * LAGS; ++s) rough[row * 2 * LAGS + s] = sum[s];
}

/* The correlation of the noise of a node with that of the next one in its column, and in its row.
 * With noise of variance v and correlations a and b, the means of the products are (36 - 48 a - 48
 * b) v, (42 a + 32 b - 24) v for the next row and (32 a + 42 b - 24) v for the next column. */
float2 shared_with_neighbours(__global const float *sums) {
  float mean[LAGS];
  for (int lag = 0; lag < LAGS; ++lag) {
    float sum = 0, count = 0;
    for (int row = 0; row < ROWS; ++row) {
      sum += sums[row * 2 * LAGS + lag];
      count += sums[row * 2 * LAGS + LAGS + lag];
    }
    if (count == 0) return (float2)(0, 0);
    mean[lag] = sum / count;
  }
  const float v = (mean[1] + mean[2] + 37 * mean[0] / 24) / 7.5f;
  const float both = (36 * v - mean[0]) / 48, apart = (mean[1] - mean[2]) / 10;
  if (!(v > 0)) return (float2)(0, 0);
  return clamp((float2)(both + apart, both - apart) / (2 * v), 0.0f, MOST_SHARED);
}

/* The weights of the pairs of filters, times the deviation of the noise, in their mean over the
 * votes of the window, for each node of a row; NaN where there is no vote. */
void mean_weights(const int row, __global const float *weights, __global const float *variance,
                  __global const uchar *votes, float (*mean)[COLUMNS]) {
  const int top = WINDOW_START(row, REACH_DOWN, ROWS);
  float scale[WIDE_DOWN][COLUMNS], share[COLUMNS], line[COLUMNS + 2 * REACH_ALONG];
  EACH_COLUMN line[REACH_ALONG + c] = 0;
  for (int r = 0; r < WIDE_DOWN; ++r)
    EACH_COLUMN {
      const float size = sqrt(variance[(top + r) * LINE + c]);
      const int counts = votes[(top + r) * COLUMNS + c] && size >= 0;
      scale[r][c] = counts ? size : 0.0f;
      line[REACH_ALONG + c] += counts;
    }
  TURN_ENDS(line)
  EACH_COLUMN {
    float count = 0;
    for (int t = 0; t < WIDE_ALONG; ++t) count += line[c + t];
    share[c] = count > 0 ? 1 / count : NAN;
  }
  for (int pair = 0; pair < PAIRS; ++pair) {
    EACH_COLUMN line[REACH_ALONG + c] = 0;
    for (int r = 0; r < WIDE_DOWN; ++r) {
      __global const float *from = weights + (pair * ROWS + top + r) * LINE;
      EACH_COLUMN line[REACH_ALONG + c] += scale[r][c] * from[c];
    }
    TURN_ENDS(line)
    EACH_COLUMN mean[pair][c] = 0;
    for (int t = 0; t < WIDE_ALONG; ++t) EACH_COLUMN mean[pair][c] += line[c + t];
    EACH_COLUMN mean[pair][c] *= share[c];
  }
}

/* The variance of the noise of a slope, for each node of a row: the quadratic form of the mean
 * weights. Its matrices are products of the filters behind the value and behind the slope at a node
 * along an axis: `down` of this row, `along` of its nodes; first those of the same node,
 * then those of nodes that are neighbours. shared: see `shared_with_neighbours`. */
void noise_of_row(__global const float *down, __global const float *along, const float2 shared,
                  const float (*mean)[COLUMNS], float *noise) {
  float product[FILTERS_ALONG * FILTERS_ALONG][COLUMNS];
  for (int p = 0; p < FILTERS_ALONG * FILTERS_ALONG; ++p) {
    __global const float *alone = along + p * COLUMNS;
    __global const float *beside = alone + FILTERS_ALONG * FILTERS_ALONG * COLUMNS;
    EACH_COLUMN product[p][c] = alone[c] + shared.y * beside[c];
  }
  EACH_COLUMN noise[c] = 0;
  for (int a = 0; a < FILTERS_DOWN; ++a) {
    float mixed[FILTERS_ALONG][COLUMNS];
    for (int b = 0; b < FILTERS_ALONG; ++b) {
      EACH_COLUMN mixed[b][c] = 0;
      for (int other = 0; other < FILTERS_DOWN; ++other) {
        const int p = a * FILTERS_DOWN + other;
        const float factor = down[p] + shared.x * down[ROWS * FILTERS_DOWN * FILTERS_DOWN + p];
        EACH_COLUMN mixed[b][c] += factor * mean[other * FILTERS_ALONG + b][c];
      }
    }
    for (int b = 0; b < FILTERS_ALONG; ++b) {
      float along_too[COLUMNS];
      EACH_COLUMN along_too[c] = 0;
      for (int other = 0; other < FILTERS_ALONG; ++other)
        EACH_COLUMN along_too[c] += product[b * FILTERS_ALONG + other][c] * mixed[other][c];
      EACH_COLUMN noise[c] += along_too[c] * mean[a * FILTERS_ALONG + b][c];
    }
  }
  EACH_COLUMN noise[c] = noise[c] < 0 ? 0 : noise[c];
}

/* The covariances of the coordinates of the slopes of the filtered values over whole windows, per
 * node step: PRODUCTS planes along the rows and as many along the columns, NaN where they are
 * unknown. With the same weights in the whole window, a slope is one combination of its nodes.
 * common: the covariance of the noise of the coordinates over its mean diagonal. gram_*: see
 * `noise_of_row`, of the value of the line at a node and of the slope of the parabola there. One
 * work-item a row. */
__kernel void slopes(__global const float *weights, __global const float *variance,
                     __global const uchar *votes,
                     __global const float *common, __global const float *rough,
                     __global const float *gram_down, __global const float *gram_along,
                     __global float *slopes) {
  const int row = get_global_id(0);
  if (row >= ROWS) return;
  float mean[PAIRS][COLUMNS], noise[COLUMNS];
  mean_weights(row, weights, variance, votes, mean);
  const float2 shared = shared_with_neighbours(rough);
  for (int turn = 0; turn < 2; ++turn) { /* the slope along the row, down the columns */
    noise_of_row(gram_down + (turn * 2 * ROWS + row) * FILTERS_DOWN * FILTERS_DOWN,
                 gram_along + (1 - turn) * 2 * FILTERS_ALONG * FILTERS_ALONG * COLUMNS, shared,
                 mean, noise);
    for (int p = 0; p < PRODUCTS; ++p)
      EACH_COLUMN slopes[(turn * PRODUCTS + p) * NODES + row * COLUMNS + c] =
          CHOSEN * noise[c] * SHAPE(common, p, row * COLUMNS + c);
  }
}

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

/* The covariance of a slope of node i, from that of the slope over the whole window; without a
 * filter the errors of the nodes, of that covariance, count as independent. own, more: see
 * `fit_surfaces`. */
void of_slope(__global const float *by_slope, __global const float *covariance, const int i,
              const float own, const float more, float3 *result) {
  const int known = !isnan(by_slope[i]);
  const float share = known ? more : own;
  __global const float *from = (known ? by_slope : covariance) + i;
#if K == 3
  result[0] = share * (float3)(from[0], from[NODES], from[2 * NODES]);
  result[1] = share * (float3)(from[NODES], from[3 * NODES], from[4 * NODES]);
  result[2] = share * (float3)(from[2 * NODES], from[4 * NODES], from[5 * NODES]);
#else /* the covariance of a node is its variance per axis */
  const float xy = known ? from[NODES] : 0, yy = known ? from[2 * NODES] : from[0];
  result[0] = share * (float3)(from[0], xy, 0);
  result[1] = share * (float3)(xy, yy, 0);
  result[2] = 0;
#endif
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

/* The weights of the cubic surface through the valid nodes of the 5 x 5 that hold node i, determine
 * it, and have the nearest middle: of equals, the first by rows. Return that window, one of no
 * nodes if there is none. */
Window weights_of_cubic(const int i, __global const uchar *valid, __global const float *table,
                        float (*weight)[WEIGHTS]) {
  const int row = i / COLUMNS, column = i % COLUMNS, reach = CUBIC_SIDE / 2;
  for (int far = 0; far <= 2 * reach * reach; ++far)
    for (int down = -reach; down <= reach; ++down)
      for (int along = -reach; along <= reach; ++along) {
        const int top = row + down - reach, left = column + along - reach;
        if (down * down + along * along != far || min(top, left) < 0 ||
            top + CUBIC_SIDE > ROWS || left + CUBIC_SIDE > COLUMNS)
          continue;
        const Window window = {top, left, CUBIC_SIDE, CUBIC_SIDE};
        const int whole = is_whole(valid, window, CUBIC_SIDE);
        if (whole) weights_of_whole(i, table, window, weight);
        if (whole || weights_of_some(i, valid, window, CUBIC, weight)) return window;
      }
  const Window none = {0, 0, 0, 0};
  return none;
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

/* Fit surfaces to the positions around node i, at rest and now; return whether the valid nodes
 * determine them. They are quadratic ones of 3 x 3 nodes, or of the valid ones of 5 x 5 where one
 * of these is missing, and cubic ones in the middle of 5 x 5 valid ones. slope: of both at the
 * node, by column and by row. apart: how far the slopes of the displacement are between the
 * quadratic one and that of `weights_of_cubic`; 0 without it. torn: its fourth differences in the
 * window of that. own: the variances of the two slopes for independent errors of variance 1. more:
 * over those of a whole window in `slopes`. */
int fit_surfaces(const int i, __global const float *rest_position,
                 __global const float *displacement, __global const uchar *valid,
                 __global const float *quadratic, __global const float *cubic,
                 float3 (*slope)[2], float3 *apart, float3 *torn, float *own, float *more) {
  if (REACH_DOWN * REACH_ALONG == 0) return 0;
  const Window near = window_around(i, SIDE), wide = window_around(i, CUBIC_SIDE);
  const int near_is_whole = is_whole(valid, near, SIDE);
  Window window = near_is_whole ? near : wide;
  float weight[2][WEIGHTS], weight_in_cubic[2][WEIGHTS];
  if (near_is_whole) weights_of_whole(i, quadratic, near, weight);
  else if (!weights_of_some(i, valid, wide, QUADRATIC, weight)) return 0;
  float3 moved[2], moved_in_cubic[2];
  slopes_at(i, displacement, valid, window, weight, moved);
  const Window other = weights_of_cubic(i, valid, cubic, weight_in_cubic);
  slopes_at(i, displacement, valid, other, weight_in_cubic, moved_in_cubic);
  torn[0] = torn[1] = 0;
  if (other.down) {
    float weight_of_fourth[2][WEIGHTS];
    weights_of_fourth(valid, other, weight_of_fourth);
    slopes_at(i, displacement, valid, other, weight_of_fourth, torn);
  }
  const int middle = (other.top + CUBIC_SIDE / 2) * COLUMNS + other.left + CUBIC_SIDE / 2;
  const int follows = i == middle && is_whole(valid, other, CUBIC_SIDE);
  for (int step = 0; step < 2; ++step) {
    apart[step] = other.down ? moved_in_cubic[step] - moved[step] : 0;
    if (!follows) continue;
    moved[step] = moved_in_cubic[step];
    for (int n = 0; n < WEIGHTS; ++n) weight[step][n] = weight_in_cubic[step][n];
  }
  if (follows) window = other;
  const float x = (float)(i % COLUMNS - near.left - REACH_ALONG);
  const float y = (float)(i / COLUMNS - near.top - REACH_DOWN);
  const float whole[2] = {(0.5f + 6 * x * x) * (1 / 3.0f + 0.5f * y * y),
                          (0.5f + 6 * y * y) * (1 / 3.0f + 0.5f * x * x)};
  for (int step = 0; step < 2; ++step) {
    own[step] = 0;
    for (int n = 0; n < window.down * window.along; ++n)
      own[step] += weight[step][n] * weight[step][n];
    more[step] = own[step] / whole[step];
    if (!near_is_whole) more[step] = fmax(more[step], 1.0f); /* neighbours err alike */
  }
  slopes_at(i, rest_position, valid, window, weight, slope[0]);
  for (int step = 0; step < 2; ++step) slope[1][step] = slope[0][step] + moved[step];
  return 1;
}

/* Add so many times the products of the coordinates of a vector to a covariance. */
void add_square(const float times, const float3 v, float3 *covariance) {
  covariance[0] += times * v.x * v;
  covariance[1] += times * v.y * v;
  covariance[2] += times * v.z * v;
}

/* Green-Lagrange strain E11 E22 E12 and its covariance, xx xy xz yy yz zz; NaN where there is none.
 * rest: the position at rest, from the middle of the lattice. slopes, rest_slopes: as in `slopes`.
 * quadratic, cubic: tables of `weights_of_whole`. One work-item a node. */
__kernel void strain(__global const float *rest_position, __global const float *displacement,
                     __global const uchar *valid, __global const float *covariance,
                     __global const float *slopes, __global const float *rest_covariance,
                     __global const float *rest_slopes, __global const float *quadratic,
                     __global const float *cubic, __global float *strain,
                     __global float *strain_covariance) {
  const int i = get_global_id(0);
  if (i >= NODES) return;
  for (int k = 0; k < 3; ++k) strain[k * NODES + i] = NAN;
  for (int p = 0; p < 6; ++p) strain_covariance[p * NODES + i] = NAN;
  if (!valid[i]) return;
  float3 slope[2][2], apart[2], torn[2];
  float own[2], more[2];
  if (!fit_surfaces(i, rest_position, displacement, valid, quadratic, cubic, slope, apart, torn,
                    own, more))
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
  float3 by_step[2][3], rest_by_step[2][3];
  float found[6] = {0, 0, 0, 0, 0, 0};
  for (int step = 0; step < 2; ++step) {
    const int at = step * PRODUCTS * NODES;
    of_slope(slopes + at, covariance, i, own[step], more[step], by_step[step]);
    add_square(APART, apart[step], by_step[step]);
    add_square(TORN, torn[step], by_step[step]);
    of_slope(rest_slopes + at, rest_covariance, i, own[step], more[step], rest_by_step[step]);
  }
  add_covariance(now_1, now_2, inverse, by_step, found);
  add_covariance(before_1, before_2, inverse, rest_by_step, found);
  for (int p = 0; p < 6; ++p) strain_covariance[p * NODES + i] = found[p];
}
