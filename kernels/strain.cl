#include "field.clh"

/* The strain of a plane or of a surface in its tangent plane at rest, and its covariance:
 * cmp_cl/reference/field/strain.py has the equations. A plane is fitted to the window of
 * (2 STRAIN_REACH + 1)^2 nodes around each node. */

#define LEAST_NODES 6
#define LEAST_DETERMINANT 1e-6f
#define LAGS 3 /* of second differences: with themselves, with the next row, the next column */
#define MOST_SHARED 0.25f
#define BIAS 0.5f /* of the covariance of the slopes of the pairs */
#define WIDE (2 * STRAIN_REACH + 1)

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

/* The slope of the windows around the nodes of a row in a plane whose rows, and whose columns, lie
 * so far apart. down: the weights of the window of the row, (WIDE). along: those of its nodes,
 * (WIDE, LINE). */
void slopes_of_row(const int row, __global const float *plane, const int apart_down,
                   const int apart_along, __global const float *down,
                   __global const float *along, float *slope) {
  float line[LINE + 2 * STRAIN_REACH];
  for (int c = 0; c < LINE + 2 * STRAIN_REACH; ++c) line[c] = 0;
  EACH_EIGHT {
    float8 sum = 0;
    for (int r = max(row - STRAIN_REACH, 0); r <= min(row + STRAIN_REACH, ROWS - 1); ++r)
      sum += down[r - row + STRAIN_REACH] * EIGHT_AT(plane + apart_down * r + apart_along * c);
    STORE_EIGHT(line + STRAIN_REACH + c, sum);
  }
  EACH_EIGHT {
    float8 sum = 0;
    for (int t = 0; t < WIDE; ++t) sum += EIGHT_AT(along + t * LINE + c) * LOAD_EIGHT(line + c + t);
    STORE_EIGHT(slope + c, sum);
  }
}

/* How far the slopes that the pairs of filters give are from their mean, for each node of a row:
 * their covariance under the weights of the node, (PRODUCTS, LINE). Slopes are taken less that of
 * the filtered values, which is near their mean. */
void spread_of_row(const int row, __global const float *weights, __global const float *estimate,
                   __global const float *values, __global const float *down,
                   __global const float *along, float (*spread)[LINE]) {
  float filtered[K][LINE], mean[K][LINE], apart[K][LINE];
  for (int k = 0; k < K; ++k) {
    slopes_of_row(row, values + k * PLANE, LINE, 1, down, along, filtered[k]);
    for (int c = 0; c < LINE; ++c) mean[k][c] = 0;
  }
  for (int p = 0; p < PRODUCTS; ++p)
    for (int c = 0; c < LINE; ++c) spread[p][c] = 0;
  for (int pair = 0; pair < PAIRS; ++pair) {
    __global const float *weight = weights + (pair * ROWS + row) * LINE;
    for (int k = 0; k < K; ++k) {
      slopes_of_row(row, estimate + (k * PAIRS + pair) * PLANE, LANES, ROWS, down, along, apart[k]);
      for (int c = 0; c < LINE; ++c) {
        apart[k][c] -= filtered[k][c];
        mean[k][c] += weight[c] * apart[k][c];
      }
    }
    int p = 0;
    for (int j = 0; j < K; ++j)
      for (int k = j; k < K; ++k, ++p)
        for (int c = 0; c < LINE; ++c) spread[p][c] += weight[c] * apart[j][c] * apart[k][c];
  }
  int p = 0;
  for (int j = 0; j < K; ++j)
    for (int k = j; k < K; ++k, ++p)
      for (int c = 0; c < LINE; ++c) spread[p][c] -= mean[j][c] * mean[k][c];
}

/* The weights of the pairs of filters, times the deviation of the noise, in their mean over the
 * votes of the window, for each node of a row; NaN where there is no vote. */
void mean_weights(const int row, __global const float *weights, __global const float *variance,
                  __global const uchar *votes, float (*mean)[COLUMNS]) {
  const int top = max(row - STRAIN_REACH, 0), bottom = min(row + STRAIN_REACH, ROWS - 1);
  float scale[WIDE][COLUMNS], share[COLUMNS], line[COLUMNS + 2 * STRAIN_REACH];
  for (int c = 0; c < COLUMNS + 2 * STRAIN_REACH; ++c) line[c] = 0;
  for (int r = top; r <= bottom; ++r)
    EACH_COLUMN {
      const float size = sqrt(variance[r * LINE + c]);
      const int counts = votes[r * COLUMNS + c] && size >= 0;
      scale[r - top][c] = counts ? size : 0.0f;
      line[STRAIN_REACH + c] += counts;
    }
  EACH_COLUMN {
    float count = 0;
    for (int t = 0; t < WIDE; ++t) count += line[c + t];
    share[c] = count > 0 ? 1 / count : NAN;
  }
  for (int pair = 0; pair < PAIRS; ++pair) {
    EACH_COLUMN line[STRAIN_REACH + c] = 0;
    for (int r = top; r <= bottom; ++r) {
      __global const float *from = weights + (pair * ROWS + r) * LINE;
      EACH_COLUMN line[STRAIN_REACH + c] += scale[r - top][c] * from[c];
    }
    EACH_COLUMN mean[pair][c] = 0;
    for (int t = 0; t < WIDE; ++t) EACH_COLUMN mean[pair][c] += line[c + t];
    EACH_COLUMN mean[pair][c] *= share[c];
  }
}

/* The variance of the noise of a slope, for each node of a row: the quadratic form of the mean
 * weights. Its matrices are products of the filters behind the mean and behind the slope of a
 * window along an axis: `down` of this row, `along` of its nodes; first those of the same node,
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
 * unknown. With the same weights in the whole window, a slope is one combination of its nodes. The
 * bias of smoothing is not in the noise of that, and shows in how far apart the slopes of the pairs
 * are; BIAS of that is added. common: the covariance of the noise of the coordinates over its mean
 * diagonal. span_down, span_along: the weights of the nodes of a window in its mean, and in its
 * slope, (2, ROWS, WIDE) and (2, WIDE, LINE); gram_*: see `noise_of_row`, of both. One work-item a
 * row. */
__kernel void slopes(__global const float *weights, __global const float *estimate,
                     __global const float *values, __global const float *variance,
                     __global const uchar *votes,
                     __global const float *common, __global const float *rough,
                     __global const float *span_down, __global const float *span_along,
                     __global const float *gram_down, __global const float *gram_along,
                     __global float *slopes) {
  const int row = get_global_id(0);
  if (row >= ROWS) return;
  float mean[PAIRS][COLUMNS], noise[COLUMNS], spread[PRODUCTS][LINE];
  mean_weights(row, weights, variance, votes, mean);
  const float2 shared = shared_with_neighbours(rough);
  for (int turn = 0; turn < 2; ++turn) { /* the slope along the row, down the columns */
    spread_of_row(row, weights, estimate, values, span_down + (turn * ROWS + row) * WIDE,
                  span_along + (1 - turn) * WIDE * LINE, spread);
    noise_of_row(gram_down + (turn * 2 * ROWS + row) * FILTERS_DOWN * FILTERS_DOWN,
                 gram_along + (1 - turn) * 2 * FILTERS_ALONG * FILTERS_ALONG * COLUMNS, shared,
                 mean, noise);
    for (int p = 0; p < PRODUCTS; ++p)
      EACH_COLUMN slopes[(turn * PRODUCTS + p) * NODES + row * COLUMNS + c] =
          noise[c] * SHAPE(common, p, row * COLUMNS + c) + BIAS * spread[p][c];
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
 * filter the errors of the nodes, of that covariance, count as independent. own, whole: the
 * variance of the slope of independent errors of variance 1, over the valid nodes and over the
 * whole window. */
void of_slope(__global const float *by_slope, __global const float *covariance, const int i,
              const float own, const float whole, float3 *result) {
  const int known = !isnan(by_slope[i]);
  const float share = known ? own / whole : own;
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

/* Fit planes to the positions in the window around node i, at rest and now; return whether there
 * are enough nodes. slope: of both, by column and by row. own, whole: the variances of the two
 * slopes of independent errors of variance 1, over the valid nodes and over the whole window. */
int fit_planes(const int i, __global const float *rest_position,
               __global const float *displacement, __global const uchar *valid,
               float3 (*slope)[2], float *own, float *whole) {
  const int row = i / COLUMNS, column = i % COLUMNS;
  const int top = max(row - STRAIN_REACH, 0), bottom = min(row + STRAIN_REACH, ROWS - 1);
  const int left = max(column - STRAIN_REACH, 0), right = min(column + STRAIN_REACH, COLUMNS - 1);
  float n = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0;
  float sum[2][2][3], all[2][3]; /* at rest and now: of x and y times the values; of the values */
  for (int m = 0; m < 2; ++m)
    for (int k = 0; k < 3; ++k) sum[m][0][k] = sum[m][1][k] = all[m][k] = 0;
  for (int r = top; r <= bottom; ++r)
    for (int c = left; c <= right; ++c) {
      const int j = r * COLUMNS + c;
      if (!valid[j]) continue;
      const float u = (float)(c - column), v = (float)(r - row);
      n += 1;
      x += u;
      y += v;
      xx += u * u;
      xy += u * v;
      yy += v * v;
      for (int k = 0; k < K; ++k) {
        const float at_rest = rest_position[k * NODES + j] - rest_position[k * NODES + i];
        const float now =
            at_rest + (displacement[k * NODES + j] - displacement[k * NODES + i]);
        all[0][k] += at_rest;
        all[1][k] += now;
        sum[0][0][k] += u * at_rest;
        sum[0][1][k] += v * at_rest;
        sum[1][0][k] += u * now;
        sum[1][1][k] += v * now;
      }
    }
  const float cxx = n * xx - x * x, cxy = n * xy - x * y, cyy = n * yy - y * y;
  const float determinant = cxx * cyy - cxy * cxy; /* n times that of the normal equations */
  if (n < LEAST_NODES || !(determinant > LEAST_DETERMINANT * n)) return 0;
  for (int m = 0; m < 2; ++m) {
    const float3 total = (float3)(all[m][0], all[m][1], all[m][2]);
    const float3 by_x = n * (float3)(sum[m][0][0], sum[m][0][1], sum[m][0][2]) - x * total;
    const float3 by_y = n * (float3)(sum[m][1][0], sum[m][1][1], sum[m][1][2]) - y * total;
    slope[m][0] = (cyy * by_x - cxy * by_y) / determinant;
    slope[m][1] = (cxx * by_y - cxy * by_x) / determinant;
  }
  own[0] = n * cyy / determinant;
  own[1] = n * cxx / determinant;
  const float high = bottom - top + 1, wide = right - left + 1;
  whole[0] = 12 / (high * wide * (wide * wide - 1));
  whole[1] = 12 / (wide * high * (high * high - 1));
  return 1;
}

/* Green-Lagrange strain E11 E22 E12 and its covariance, xx xy xz yy yz zz; NaN where there is none.
 * rest: the position at rest, from the middle of the lattice. slopes, rest_slopes: as in `slopes`.
 * One work-item a node. */
__kernel void strain(__global const float *rest_position, __global const float *displacement,
                     __global const uchar *valid, __global const float *covariance,
                     __global const float *slopes, __global const float *rest_covariance,
                     __global const float *rest_slopes, __global float *strain,
                     __global float *strain_covariance) {
  const int i = get_global_id(0);
  if (i >= NODES) return;
  for (int k = 0; k < 3; ++k) strain[k * NODES + i] = NAN;
  for (int p = 0; p < 6; ++p) strain_covariance[p * NODES + i] = NAN;
  if (!valid[i]) return;
  float3 slope[2][2];
  float own[2], whole[2];
  if (!fit_planes(i, rest_position, displacement, valid, slope, own, whole)) return;
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
  const float e11 = (dot_of(f1, f1) - 1) / 2, e22 = (dot_of(f2, f2) - 1) / 2, e12 = dot_of(f1, f2) / 2;
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
    of_slope(slopes + at, covariance, i, own[step], whole[step], by_step[step]);
    of_slope(rest_slopes + at, rest_covariance, i, own[step], whole[step], rest_by_step[step]);
  }
  add_covariance(now_1, now_2, inverse, by_step, found);
  add_covariance(before_1, before_2, inverse, rest_by_step, found);
  for (int p = 0; p < 6; ++p) strain_covariance[p * NODES + i] = found[p];
}
