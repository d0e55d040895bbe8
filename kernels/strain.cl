#include "field.clh"

/* The strain of a surface in its tangent plane at rest, and its standard deviation. A plane is
 * fitted to the (2 STRAIN_REACH + 1)^2 nodes around each node; cmp_cl/field/strain.py has the
 * equations. */

#define K 3
#define LEAST_NODES 6
#define LEAST_DETERMINANT 1e-6f

/* The variances of the slopes of the filtered displacement, per node step and coordinate. The
 * filter's weights and the noise are taken as constant over the window, with their mean there.
 * Then a slope is one combination of the nodes, and its variance a quadratic form of the weights of
 * the pairs: gram_value and gram_slope hold, for each position along an axis, the products of the
 * filters behind the mean of a window and behind its slope. One work-item a row. */
__kernel void slopes(__global const float *weights, __global const float *variance,
                     __global const float *gain, __global const uchar *valid,
                     __global const float *gram_value_down, __global const float *gram_slope_down,
                     __global const float *gram_value_along,
                     __global const float *gram_slope_along, __global float *by_column,
                     __global float *by_row) {
  const int row = get_global_id(0);
  if (row >= ROWS) return;
  const int top = max(row - STRAIN_REACH, 0), bottom = min(row + STRAIN_REACH, ROWS - 1);
  float scale[2 * STRAIN_REACH + 1][COLUMNS], share[COLUMNS], mean[PAIRS][COLUMNS];
  float line[COLUMNS + 2 * STRAIN_REACH];
  for (int c = 0; c < STRAIN_REACH; ++c) line[c] = line[COLUMNS + STRAIN_REACH + c] = 0;
  EACH_COLUMN line[STRAIN_REACH + c] = 0;
  for (int r = top; r <= bottom; ++r)
    EACH_COLUMN {
      const int i = r * COLUMNS + c;
      const float size = sqrt(variance[i] / gain[i]);
      const int counts = valid[i] && size >= 0;
      scale[r - top][c] = counts ? size : 0.0f;
      line[STRAIN_REACH + c] += counts;
    }
  EACH_COLUMN {
    float count = 0;
    for (int t = 0; t <= 2 * STRAIN_REACH; ++t) count += line[c + t];
    share[c] = 1 / count;
  }
  for (int pair = 0; pair < PAIRS; ++pair) {
    EACH_COLUMN line[STRAIN_REACH + c] = 0;
    for (int r = top; r <= bottom; ++r) {
      __global const float *from = weights + (pair * ROWS + r) * COLUMNS;
      EACH_COLUMN line[STRAIN_REACH + c] += scale[r - top][c] * from[c];
    }
    EACH_COLUMN mean[pair][c] = 0;
    for (int t = 0; t <= 2 * STRAIN_REACH; ++t) EACH_COLUMN mean[pair][c] += line[c + t];
    EACH_COLUMN mean[pair][c] *= share[c];
  }
  for (int turn = 0; turn < 2; ++turn) {
    __global const float *down =
        (turn ? gram_slope_down : gram_value_down) + row * FILTERS_DOWN * FILTERS_DOWN;
    __global const float *along = turn ? gram_value_along : gram_slope_along;
    float total[COLUMNS];
    EACH_COLUMN total[c] = 0;
    for (int a = 0; a < FILTERS_DOWN; ++a) {
      float mixed[FILTERS_ALONG][COLUMNS];
      for (int b = 0; b < FILTERS_ALONG; ++b) {
        EACH_COLUMN mixed[b][c] = 0;
        for (int other = 0; other < FILTERS_DOWN; ++other) {
          const float product = down[a * FILTERS_DOWN + other];
          EACH_COLUMN mixed[b][c] += product * mean[other * FILTERS_ALONG + b][c];
        }
      }
      for (int b = 0; b < FILTERS_ALONG; ++b) {
        float along_too[COLUMNS];
        EACH_COLUMN along_too[c] = 0;
        for (int other = 0; other < FILTERS_ALONG; ++other) {
          __global const float *product = along + (b * FILTERS_ALONG + other) * COLUMNS;
          EACH_COLUMN along_too[c] += product[c] * mixed[other][c];
        }
        EACH_COLUMN total[c] += along_too[c] * mean[a * FILTERS_ALONG + b][c];
      }
    }
    EACH_COLUMN (turn ? by_row : by_column)[row * COLUMNS + c] = fmax(total[c], 0.0f);
  }
}

/* The variance of one . g1 + two . g2, with g1 and g2 the errors of the slopes by axis. spread: 11
 * 12 22 of the covariance of the axes per coordinate; alike: xx xy xz yy yz zz of the coordinates,
 * with a mean diagonal of 1. */
float variance_along(const float3 one, const float3 two, const float *spread,
                     const float *alike) {
  const float3 x = (float3)(alike[0], alike[1], alike[2]);
  const float3 y = (float3)(alike[1], alike[3], alike[4]);
  const float3 z = (float3)(alike[2], alike[4], alike[5]);
  const float3 of_one = (float3)(dot(x, one), dot(y, one), dot(z, one));
  const float3 of_two = (float3)(dot(x, two), dot(y, two), dot(z, two));
  return fmax(dot(one, of_one) * spread[0] + 2 * dot(one, of_two) * spread[1] +
                  dot(two, of_two) * spread[2],
              0.0f);
}

/* Divide a covariance by its mean diagonal. */
void scaled_to_one(__global const float *covariance, const int i, float *alike) {
  const float mean =
      (covariance[i] + covariance[3 * NODES + i] + covariance[5 * NODES + i]) / 3;
  for (int p = 0; p < 6; ++p) alike[p] = covariance[p * NODES + i] / mean;
}

/* The covariance of the errors of the slopes along the axes of the plane, per coordinate. inverse:
 * 11 21 22 of the matrix from steps between nodes to the axes. */
void spread_of(const float by_column, const float by_row, const float *inverse, float *spread) {
  spread[0] = inverse[0] * inverse[0] * by_column;
  spread[1] = inverse[0] * inverse[1] * by_column;
  spread[2] = inverse[1] * inverse[1] * by_column + inverse[2] * inverse[2] * by_row;
}

/* Green-Lagrange strain E11 E22 E12 and its standard deviations; NaN where there is none. rest: the
 * position at rest, from the middle of the lattice. One work-item a node. */
__kernel void strain(__global const float *rest, __global const float *displacement,
                     __global const uchar *valid, __global const float *covariance,
                     __global const float *by_column, __global const float *by_row,
                     __global const float *rest_covariance,
                     __global const float *rest_by_column, __global const float *rest_by_row,
                     __global float *result, __global float *deviation) {
  const int i = get_global_id(0);
  if (i >= NODES) return;
  const int row = i / COLUMNS, column = i % COLUMNS;
  for (int k = 0; k < 3; ++k) result[k * NODES + i] = deviation[k * NODES + i] = NAN;
  if (!valid[i]) return;
  float n = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0;
  float sum[2][2][K], all[2][K]; /* at rest and now: of x and y times the values; of the values */
  for (int m = 0; m < 2; ++m)
    for (int k = 0; k < K; ++k) sum[m][0][k] = sum[m][1][k] = all[m][k] = 0;
  for (int r = max(row - STRAIN_REACH, 0); r <= min(row + STRAIN_REACH, ROWS - 1); ++r)
    for (int c = max(column - STRAIN_REACH, 0); c <= min(column + STRAIN_REACH, COLUMNS - 1);
         ++c) {
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
        const float at_rest = rest[k * NODES + j] - rest[k * NODES + i];
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
  if (n < LEAST_NODES || !(determinant > LEAST_DETERMINANT * n)) return;
  float slope[2][2][K]; /* at rest and now, by column and by row */
  for (int m = 0; m < 2; ++m)
    for (int k = 0; k < K; ++k) {
      const float a = n * sum[m][0][k] - x * all[m][k], b = n * sum[m][1][k] - y * all[m][k];
      slope[m][0][k] = (cyy * a - cxy * b) / determinant;
      slope[m][1][k] = (cxx * b - cxy * a) / determinant;
    }
#define VECTOR(m, axis) (float3)(slope[m][axis][0], slope[m][axis][1], slope[m][axis][2])
  const float3 a1 = VECTOR(0, 0), a2 = VECTOR(0, 1), b1 = VECTOR(1, 0), b2 = VECTOR(1, 1);
  if (!(length(cross(a1, a2)) > 1e-9f * (dot(a1, a1) + dot(a2, a2)))) return;
  const float l11 = length(a1), l21 = dot(a1, a2) / l11, l22 = sqrt(dot(a2, a2) - l21 * l21);
  const float inverse[3] = {1 / l11, -l21 / (l11 * l22), 1 / l22};
  const float3 q1 = inverse[0] * a1, q2 = inverse[1] * a1 + inverse[2] * a2;
  const float3 f1 = inverse[0] * b1, f2 = inverse[1] * b1 + inverse[2] * b2;
  const float e11 = (dot(f1, f1) - 1) / 2, e22 = (dot(f2, f2) - 1) / 2, e12 = dot(f1, f2) / 2;
  result[i] = e11;
  result[NODES + i] = e22;
  result[2 * NODES + i] = e12;
  const float3 off_1 = f1 - (2 * e11 + 1) * q1 - 2 * e12 * q2;
  const float3 off_2 = f2 - 2 * e12 * q1 - (2 * e22 + 1) * q2;
  const float3 none = 0;
  float alike[6], rest_alike[6], spread[3], rest_spread[3];
  scaled_to_one(covariance, i, alike);
  scaled_to_one(rest_covariance, i, rest_alike);
  spread_of(by_column[i], by_row[i], inverse, spread);
  spread_of(rest_by_column[i], rest_by_row[i], inverse, rest_spread);
#define DEVIATION(now_1, now_2, rest_1, rest_2)               \
  sqrt(variance_along(now_1, now_2, spread, alike) +          \
       variance_along(rest_1, rest_2, rest_spread, rest_alike))
  deviation[i] = DEVIATION(f1, none, off_1 + 2 * e12 * q2, none);
  deviation[NODES + i] = DEVIATION(none, f2, -2 * e12 * q2, off_2);
  deviation[2 * NODES + i] =
      DEVIATION(f2 / 2, f1 / 2, off_2 / 2 + (e22 - e11) * q2, off_1 / 2);
}
