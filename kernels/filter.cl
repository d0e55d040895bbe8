#include "field.clh"

/* The adaptive filter of a lattice: cmp_cl/reference/field/filter.py has its equations.
 *
 * K coordinates are filtered alike. A filter along an axis is a table of n x TAPS weights: row i
 * has those of the nodes of the window of node i. There are FILTERS_DOWN filters along the columns
 * and FILTERS_ALONG along the rows; filter 0 changes nothing. `rows_noise` and `rows_risk` are
 * Gaussians of 2 REACH + 1 nodes whose sum is 1. */

#define TAPS 15
#define PRODUCTS (K * (K + 1) / 2)
#define ESTIMATES 5 /* of the noise: from both axes, from each axis, from each diagonal */
#define MASKS 4     /* nodes that count in them; the diagonals share one */
#define MASK_PLANE(estimate) (ESTIMATES + ((estimate) < 3 ? (estimate) : 3))
#define PRODUCT_PLANE (ESTIMATES + MASKS)
#define NOISE_PLANES (ESTIMATES + MASKS + PRODUCTS)
#define SUMS (ESTIMATES * PRODUCTS + 1)
#define NOISE_REACH 10
#define RISK_REACH 8
#define REJECTED_AT 36.0f /* the square of 6 standard deviations */
#define LEAST_SUPPORTED(count, size) (4 * (count) >= 3 * (size))
#define LEAST_OF_FIVE 1.29f
#define SHARPNESS 4.71238898f /* 2 pi 1.5^2 / 3 */
#define FLOOR 1e-10f
#define LEAST_VARIANCE 1e-30f
#define NO_PAIR 1e30f
#define NONE_NEAR 1e-6f /* a smaller sum of Gaussian weights is no mean */

__constant float DIAGONAL[7] = {5 / 231.0f,  -30 / 231.0f, 75 / 231.0f, 131 / 231.0f,
                                75 / 231.0f, -30 / 231.0f, 5 / 231.0f};

/* Nodes without a vote now. */
#define MISSING_NOW \
  (counts[HOLES] + counts[REJECTED] + counts[REJECTED + 1] + counts[REJECTED + 2])

/* A round of the search for outliers has nothing to do if the one before has rejected none. */
#define SKIP_IF_SETTLED if (round > 0 && counts[REJECTED + round - 1] == 0) return;

/* Fill the holes: the quadratic surface through the votes around, with weights that fall with the
 * distance and a ridge towards a constant; 0 if there are fewer than 8 votes. One work-item a
 * node. */
__kernel void fill(__global const float *moved, __global const uchar *votes,
                   __global const int *counts, const int round, __global float *data) {
  const int i = get_global_id(0);
  if (i >= NODES) return;
  SKIP_IF_SETTLED
  if (votes[i]) {
    for (int k = 0; k < K; ++k) data[k * NODES + i] = moved[k * NODES + i];
    return;
  }
  const int row = i / COLUMNS, column = i % COLUMNS;
  for (int k = 0; k < K; ++k) data[k * NODES + i] = 0;
  for (int reach = 3; reach <= 6; reach += 3) {
    float normal[6][6 + K], origin[K];
    int found = 0;
    for (int a = 0; a < 6; ++a)
      for (int b = 0; b < 6 + K; ++b) normal[a][b] = 0;
    for (int r = max(row - reach, 0); r <= min(row + reach, ROWS - 1); ++r)
      for (int c = max(column - reach, 0); c <= min(column + reach, COLUMNS - 1); ++c) {
        const int j = r * COLUMNS + c;
        if (!votes[j]) continue;
        if (found++ == 0)
          for (int k = 0; k < K; ++k) origin[k] = moved[k * NODES + j];
        const float y = (float)(r - row), x = (float)(c - column);
        const float term[6] = {1, y, x, y * y, y * x, x * x};
        const float weight = exp(-2 * (x * x + y * y) / (float)(reach * reach));
        for (int a = 0; a < 6; ++a) {
          for (int b = 0; b < 6; ++b) normal[a][b] += weight * term[a] * term[b];
          for (int k = 0; k < K; ++k)
            normal[a][6 + k] += weight * term[a] * (moved[k * NODES + j] - origin[k]);
        }
      }
    if (found < 8) continue;
    for (int a = 1; a < 6; ++a) normal[a][a] += a < 3 ? 1e-3f : 1e-2f;
    for (int pivot = 5; pivot > 0; --pivot) /* from the last term, so that the first is left */
      for (int a = 0; a < pivot; ++a) {
        const float share = normal[a][pivot] / normal[pivot][pivot];
        for (int b = 0; b < pivot; ++b) normal[a][b] -= share * normal[pivot][b];
        for (int k = 0; k < K; ++k) normal[a][6 + k] -= share * normal[pivot][6 + k];
      }
    for (int k = 0; k < K; ++k) data[k * NODES + i] = origin[k] + normal[0][6 + k] / normal[0][0];
    return;
  }
}

/* Apply a filter along the columns for one row. */
void filter_down(__global const float *restrict plane, const int row, const int side,
                 __global const float *restrict weights, float *restrict result) {
  const int first = WINDOW_START(row, side, ROWS);
  EACH_COLUMN result[c] = 0;
  for (int t = 0; t <= 2 * side; ++t) {
    const float weight = weights[row * TAPS + t];
    __global const float *line = plane + (first + t) * COLUMNS;
    EACH_COLUMN result[c] += weight * line[c];
  }
}

/* Apply a filter along the row. */
void filter_along(const float *restrict line, const int side, __global const float *restrict weights,
                  float *restrict result) {
  for (int c = side; c < COLUMNS - side; ++c) result[c] = 0;
  for (int t = 0; t <= 2 * side; ++t) {
    const float weight = weights[side * TAPS + t];
    for (int c = side; c < COLUMNS - side; ++c) result[c] += weight * line[c - side + t];
  }
  for (int end = 0; end < 2 * side; ++end) {
    const int c = end < side ? end : COLUMNS - 2 * side + end;
    const int first = WINDOW_START(c, side, COLUMNS);
    float sum = 0;
    for (int t = 0; t <= 2 * side; ++t) sum += weights[c * TAPS + t] * line[first + t];
    result[c] = sum;
  }
}

/* Sum with Gaussian weights along the row; `line` has `reach` zeros before it and behind it. */
void average_along(const float *restrict line, const int reach, __global const float *restrict weights,
                   __global float *restrict result) {
  float sum[COLUMNS];
  EACH_COLUMN sum[c] = 0;
  for (int t = 0; t <= 2 * reach; ++t) {
    const float weight = weights[t];
    EACH_COLUMN sum[c] += weight * line[c + t];
  }
  EACH_COLUMN result[c] = sum[c];
}

/* Sum with Gaussian weights along the columns, for one row. */
void average_down(__global const float *restrict plane, const int row, const int reach,
                  __global const float *restrict weights, float *restrict result) {
  EACH_COLUMN result[c] = 0;
  for (int r = max(row - reach, 0); r <= min(row + reach, ROWS - 1); ++r) {
    const float weight = weights[r - row + reach];
    __global const float *line = plane + r * COLUMNS;
    EACH_COLUMN result[c] += weight * line[c];
  }
}

/* The residuals of the pilot along both axes, along each axis and along each diagonal; their sizes,
 * the masks of the nodes that count and the products of the coordinates of the first, averaged
 * along the row into `near`; and sums over the row, from which the degrees of freedom of each
 * estimate and the floor of the noise come. One work-item a row. */
__kernel void pilot(__global const float *restrict data, __global const uchar *restrict votes,
                    __global const int *restrict counts, const int round,
                    __global const float *restrict pilot_down, __global const float *restrict pilot_along,
                    __global const float *restrict own_down, __global const float *restrict own_along,
                    __global const float *restrict rows_noise, __global float *restrict residual,
                    __global float *restrict size, __global float *restrict near, __global float *restrict sums) {
  const int row = get_global_id(0);
  if (row >= ROWS) return;
  SKIP_IF_SETTLED
  float left[ESTIMATES][K][COLUMNS], down[COLUMNS];
  for (int k = 0; k < K; ++k) {
    __global const float *plane = data + k * NODES;
    float here[COLUMNS], along[COLUMNS], both[COLUMNS];
    EACH_COLUMN here[c] = plane[row * COLUMNS + c];
    filter_down(plane, row, PILOT_DOWN, pilot_down, down);
    filter_along(down, PILOT_ALONG, pilot_along, both);
    filter_along(here, PILOT_ALONG, pilot_along, along);
    EACH_COLUMN left[0][k][c] = here[c] - both[c];
    EACH_COLUMN left[1][k][c] = here[c] - down[c];
    EACH_COLUMN left[2][k][c] = here[c] - along[c];
    for (int sense = 0; sense < 2; ++sense) {
      float *across = left[3 + sense][k];
      EACH_COLUMN across[c] = 0;
#if ROWS >= 7 && COLUMNS >= 7
      if (row < 3 || row >= ROWS - 3) continue;
      for (int c = 3; c < COLUMNS - 3; ++c) across[c] = here[c];
      for (int t = -3; t <= 3; ++t) {
        const float weight = DIAGONAL[t + 3];
        __global const float *line = plane + (row + t) * COLUMNS + (sense ? -t : t);
        for (int c = 3; c < COLUMNS - 3; ++c) across[c] -= weight * line[c];
      }
#endif
    }
  }
  int supported[COLUMNS];
  EACH_COLUMN supported[c] = 1;
  if (MISSING_NOW != 0) {
    const int top = WINDOW_START(row, PILOT_DOWN, ROWS);
    EACH_COLUMN {
      const int first = WINDOW_START(c, PILOT_ALONG, COLUMNS);
      int count = 0;
      for (int r = 0; r <= 2 * PILOT_DOWN; ++r)
        for (int t = 0; t <= 2 * PILOT_ALONG; ++t) count += votes[(top + r) * COLUMNS + first + t];
      supported[c] = LEAST_SUPPORTED(count, (2 * PILOT_DOWN + 1) * (2 * PILOT_ALONG + 1));
    }
  }
  float vote[COLUMNS];
  EACH_COLUMN vote[c] = votes[row * COLUMNS + c];
  float line[COLUMNS + 2 * NOISE_REACH], mask[COLUMNS + 2 * NOISE_REACH];
  for (int c = 0; c < NOISE_REACH; ++c)
    line[c] = mask[c] = line[COLUMNS + NOISE_REACH + c] = mask[COLUMNS + NOISE_REACH + c] = 0;
  const float row_own = own_down[row];
  for (int e = 0; e < ESTIMATES; ++e) {
    float sum[PRODUCTS];
    for (int p = 0; p < PRODUCTS; ++p) sum[p] = 0;
    EACH_COLUMN {
      const int rim = row < 3 || row >= ROWS - 3 || c < 3 || c >= COLUMNS - 3;
      const float own = e == 0   ? row_own * own_along[c]
                        : e == 1 ? row_own
                        : e == 2 ? own_along[c]
                        : rim    ? 1.0f
                                 : DIAGONAL[3];
      float square = 0;
      for (int k = 0; k < K; ++k) square += left[e][k][c] * left[e][k][c];
      const int usable = vote[c] > 0 && (e == 0 ? supported[c] && 1 - own > 0.05f : own < 0.95f);
      const float root = sqrt(square / (K * fmax(1 - own, e == 0 ? 1e-3f : 0.05f)));
      line[NOISE_REACH + c] = usable ? root : 0.0f;
      mask[NOISE_REACH + c] = usable ? 1.0f : 0.0f;
      const float by_size = usable && root > 0 ? 1 / root : 0.0f;
      int p = 0;
      for (int j = 0; j < K; ++j)
        for (int k = j; k < K; ++k) sum[p++] += by_size * left[e][j][c] * left[e][k][c];
    }
    average_along(line, NOISE_REACH, rows_noise, near + (e * ROWS + row) * COLUMNS);
    if (e < 4)
      average_along(mask, NOISE_REACH, rows_noise, near + (MASK_PLANE(e) * ROWS + row) * COLUMNS);
    for (int p = 0; p < PRODUCTS; ++p) sums[row * SUMS + e * PRODUCTS + p] = sum[p];
  }
  int p = PRODUCT_PLANE;
  for (int j = 0; j < K; ++j)
    for (int k = j; k < K; ++k) {
      EACH_COLUMN line[NOISE_REACH + c] = vote[c] * left[0][j][c] * left[0][k][c];
      average_along(line, NOISE_REACH, rows_noise, near + (p++ * ROWS + row) * COLUMNS);
    }
  float total = 0;
  EACH_COLUMN {
    float square = 0, own_square = 0;
    for (int k = 0; k < K; ++k) {
      const float value = data[k * NODES + row * COLUMNS + c];
      residual[k * NODES + row * COLUMNS + c] = left[0][k][c];
      square += left[0][k][c] * left[0][k][c];
      own_square += value * value;
    }
    size[row * COLUMNS + c] = vote[c] * square / K;
    total += own_square;
  }
  sums[row * SUMS + SUMS - 1] = total;
}

/* The mean length of a residual with variance 1 per coordinate, if its length is chi-distributed.
 * The degrees of freedom are the effective number of directions of the residuals. */
float expected_length(__global const float *sums, const int estimate) {
  float trace = 0, square = 0;
  int p = estimate * PRODUCTS;
  for (int j = 0; j < K; ++j)
    for (int k = j; k < K; ++k, ++p) {
      float sum = 0;
      for (int row = 0; row < ROWS; ++row) sum += sums[row * SUMS + p];
      trace += j == k ? sum : 0;
      square += j == k ? sum * sum : 2 * sum * sum;
    }
  const float freedom = square > 0 ? trace * trace / square : (float)K;
  return sqrt(2 / freedom) * exp(lgamma(freedom / 2 + 0.5f) - lgamma(freedom / 2));
}

/* The variance of the noise, NaN where unknown; that with which filters are chosen, the least of
 * five estimates and of an upper bound; the covariance of the coordinates over its mean diagonal;
 * and the nodes whose residual is too large lose their vote. bound: the upper bound is the sum of
 * that at rest and of the variance of the points now. One work-item a row. */
__kernel void noise(__global const float *restrict near, __global const float *restrict sums,
                    __global const float *restrict size, __global const float *restrict own_down,
                    __global const float *restrict own_along, __global const float *restrict rows_noise,
                    __global const float *restrict bound_rest, __global const float *restrict variance_now,
                    const int round, __global int *restrict counts, __global uchar *restrict votes,
                    __global float *restrict variance, __global float *restrict chosen, __global float *restrict common) {
  const int row = get_global_id(0);
  if (row >= ROWS) return;
  SKIP_IF_SETTLED
  float length[ESTIMATES], floor_of_all = 0;
  for (int e = 0; e < ESTIMATES; ++e) length[e] = expected_length(sums, e);
  for (int r = 0; r < ROWS; ++r) floor_of_all += sums[r * SUMS + SUMS - 1];
  const float least_of_all = fmax(FLOOR * floor_of_all / (K * NODES), LEAST_VARIANCE);
  float both[COLUMNS], least[COLUMNS], mean[COLUMNS], mask[COLUMNS];
  for (int e = 0; e < ESTIMATES; ++e) {
    average_down(near + e * NODES, row, NOISE_REACH, rows_noise, mean);
    average_down(near + MASK_PLANE(e) * NODES, row, NOISE_REACH, rows_noise, mask);
    EACH_COLUMN {
      const float root = mean[c] / (fmax(mask[c], NONE_NEAR) * length[e]);
      const float estimate = mask[c] > NONE_NEAR ? root * root : NAN;
      if (e == 0) both[c] = least[c] = estimate + least_of_all;
      else least[c] = fmin(least[c], estimate);
    }
  }
  float product[PRODUCTS][COLUMNS];
  for (int p = 0; p < PRODUCTS; ++p)
    average_down(near + (PRODUCT_PLANE + p) * NODES, row, NOISE_REACH, rows_noise, product[p]);
  EACH_COLUMN {
    const int i = row * COLUMNS + c;
    const float bound = bound_rest[i] + variance_now[i];
    const float unbounded = fmin(both[c], LEAST_OF_FIVE * least[c]);
    variance[i] = both[c];
    chosen[i] = isnan(both[c]) ? NAN : fmax(fmin(unbounded, bound), LEAST_VARIANCE);
    float trace = 0;
    int p = 0;
    for (int j = 0; j < K; ++j)
      for (int k = j; k < K; ++k, ++p) trace += j == k ? product[p][c] : 0;
    p = 0;
    for (int j = 0; j < K; ++j)
      for (int k = j; k < K; ++k, ++p)
        common[p * NODES + i] = trace > 0 ? product[p][c] * (K / trace) : (float)(j == k);
  }
  if (round == 3) return;
  EACH_COLUMN {
    const int i = row * COLUMNS + c;
    const float left = 1 - own_down[row] * own_along[c];
    if (!(size[i] > REJECTED_AT * both[c] * left)) continue;
    float largest = 0;
    for (int r = max(row - 1, 0); r <= min(row + 1, ROWS - 1); ++r)
      for (int t = max(c - 1, 0); t <= min(c + 1, COLUMNS - 1); ++t)
        largest = fmax(largest, size[r * COLUMNS + t]);
    if (size[i] < largest) continue;
    votes[i] = 0;
    atomic_inc(counts + REJECTED + round);
  }
}

/* Every pair of filters: its estimate, and its loss, averaged along the row. A pair whose window
 * holds too few votes is marked. One work-item a row and a filter along the columns. */
__kernel void smooth(__global const float *restrict data, __global const uchar *restrict votes,
                     __global const int *restrict counts, __global const float *restrict chosen,
                     __global const int *restrict sides_down, __global const int *restrict sides_along,
                     __global const float *restrict filters_down, __global const float *restrict filters_along,
                     __global const float *restrict own_down, __global const float *restrict own_along,
                     __global const float *restrict rows_risk, __global float *restrict estimate,
                     __global float *restrict loss, __global float *restrict near_votes,
                     __global uchar *restrict unsupported) {
  const int row = get_global_id(0), a = get_global_id(1);
  if (row >= ROWS) return;
  const int side = sides_down[a], first = WINDOW_START(row, side, ROWS);
  float down[K][COLUMNS], here[K][COLUMNS], twice[COLUMNS], vote[COLUMNS];
  float line[COLUMNS + 2 * RISK_REACH];
  int before[COLUMNS + 1]; /* votes of the window's rows in the columns before */
  for (int c = 0; c < RISK_REACH; ++c) line[c] = line[COLUMNS + RISK_REACH + c] = 0;
  for (int k = 0; k < K; ++k) {
    EACH_COLUMN here[k][c] = data[k * NODES + row * COLUMNS + c];
    if (a == 0) EACH_COLUMN down[k][c] = here[k][c];
    else filter_down(data + k * NODES, row, side, filters_down + a * ROWS * TAPS, down[k]);
  }
  EACH_COLUMN {
    const float s = chosen[row * COLUMNS + c];
    twice[c] = 2 * K * (isnan(s) ? 1.0f : s) * own_down[a * ROWS + row];
    vote[c] = votes[row * COLUMNS + c];
  }
  const int missing = MISSING_NOW;
  if (missing != 0) {
    before[0] = 0;
    EACH_COLUMN {
      int count = 0;
      for (int t = 0; t <= 2 * side; ++t) count += votes[(first + t) * COLUMNS + c];
      before[c + 1] = before[c] + count;
    }
  }
  for (int b = 0; b < FILTERS_ALONG; ++b) {
    const int pair = a * FILTERS_ALONG + b;
    const size_t place = (size_t)(pair * ROWS + row) * COLUMNS;
    EACH_COLUMN line[RISK_REACH + c] = twice[c] * own_along[b * COLUMNS + c];
    for (int k = 0; k < K; ++k) {
      float found[COLUMNS];
      if (b == 0) EACH_COLUMN found[c] = down[k][c];
      else filter_along(down[k], sides_along[b], filters_along + b * COLUMNS * TAPS, found);
      __global float *kept = estimate + (size_t)k * PAIRS * NODES + place;
      EACH_COLUMN {
        const float apart = found[c] - here[k][c];
        kept[c] = found[c];
        line[RISK_REACH + c] += apart * apart;
      }
    }
    EACH_COLUMN line[RISK_REACH + c] *= vote[c];
    average_along(line, RISK_REACH, rows_risk, loss + place);
    if (missing != 0) EACH_COLUMN {
        const int left = WINDOW_START(c, sides_along[b], COLUMNS), size = 2 * sides_along[b] + 1;
        const int count = before[left + size] - before[left];
        unsupported[place + c] = !LEAST_SUPPORTED(count, size * (2 * side + 1));
      }
  }
  if (a == 0) {
    EACH_COLUMN line[RISK_REACH + c] = vote[c];
    average_along(line, RISK_REACH, rows_risk, near_votes + row * COLUMNS);
  }
}

/* exp(x) for x <= 0 within 2e-7, as a polynomial, so that it is packed into vectors. */
float exp_below(const float x) {
  const float y = fmax(x * 1.44269504f, -120.0f), whole = floor(y), t = y - whole;
  const float power =
      1 + t * (0.69314718f +
               t * (0.24022651f +
                    t * (0.05550411f + t * (0.00961813f + t * (0.00133336f + t * 0.000154f)))));
  return as_float((int)(whole + 127) << 23) * power;
}

/* The mean of all pairs with weights by their risk, and its variance. One work-item a row. */
__kernel void blend(__global const float *restrict estimate, __global const float *restrict loss,
                    __global const float *restrict near_votes, __global const uchar *restrict unsupported,
                    __global const int *restrict counts, __global const float *restrict variance,
                    __global const float *restrict chosen, __global const float *restrict own_down,
                    __global const float *restrict own_along, __global const float *restrict gain_down,
                    __global const float *restrict gain_along, __global const float *restrict rows_risk,
                    __global float *restrict weights, __global float *restrict values, __global float *restrict result,
                    __global float *restrict gain) {
  const int row = get_global_id(0);
  if (row >= ROWS) return;
  float risk[PAIRS][COLUMNS], least[COLUMNS], scale[COLUMNS], near[COLUMNS];
  float sum[COLUMNS], mean_risk[COLUMNS], mean_own[COLUMNS], mean_gain[COLUMNS];
  float value[K][COLUMNS];
  const int missing = MISSING_NOW;
  average_down(near_votes, row, RISK_REACH, rows_risk, near);
  EACH_COLUMN {
    const float s = chosen[row * COLUMNS + c];
    scale[c] = 1 / (K * (isnan(s) ? 1.0f : s) * fmax(near[c], NONE_NEAR));
    least[c] = NO_PAIR;
    sum[c] = mean_risk[c] = mean_own[c] = mean_gain[c] = 0;
    for (int k = 0; k < K; ++k) value[k][c] = 0;
  }
  for (int pair = 0; pair < PAIRS; ++pair) {
    average_down(loss + pair * NODES, row, RISK_REACH, rows_risk, risk[pair]);
    EACH_COLUMN risk[pair][c] *= scale[c];
    if (missing != 0 && pair > 0) EACH_COLUMN {
        const int i = row * COLUMNS + c;
        if (unsupported[pair * NODES + i] || isnan(chosen[i]) || !(near[c] > NONE_NEAR))
          risk[pair][c] = NO_PAIR;
      }
    EACH_COLUMN least[c] = fmin(least[c], risk[pair][c]);
  }
  for (int a = 0; a < FILTERS_DOWN; ++a)
    for (int b = 0; b < FILTERS_ALONG; ++b) {
      const int pair = a * FILTERS_ALONG + b, place = (pair * ROWS + row) * COLUMNS;
      const float own = own_down[a * ROWS + row], left = gain_down[a * ROWS + row];
      EACH_COLUMN {
        const float weight = exp_below(SHARPNESS * (least[c] - risk[pair][c]));
        weights[place + c] = weight;
        sum[c] += weight;
        mean_risk[c] += weight * risk[pair][c];
        mean_own[c] += weight * own * own_along[b * COLUMNS + c];
        mean_gain[c] += weight * left * gain_along[b * COLUMNS + c];
        for (int k = 0; k < K; ++k)
          value[k][c] += weight * estimate[k * PAIRS * NODES + place + c];
      }
    }
  EACH_COLUMN {
    const int i = row * COLUMNS + c;
    const float share = 1 / sum[c], s1 = chosen[i], s2 = variance[i];
    for (int k = 0; k < K; ++k) values[k * NODES + i] = value[k][c] * share;
    const float stein = s1 * mean_risk[c] * share + 2 * (s2 - s1) * mean_own[c] * share - s2;
    gain[i] = mean_gain[c] * share;
    result[i] = isnan(s2) ? NAN : fmax(stein, s1 * gain[i]);
    sum[c] = share;
  }
  for (int pair = 0; pair < PAIRS; ++pair) {
    __global float *line = weights + (pair * ROWS + row) * COLUMNS;
    EACH_COLUMN line[c] *= sum[c];
  }
}

/* What becomes of a node. A node with a vote takes its mean, a rejected one keeps its value, and one
 * that was not measured takes the mean of its neighbours. The variance is NaN where it is unknown.
 * moved: (K) planes, `measured`: whether the node had a vote at first. */
#define FINAL_OF_NODE                                                               \
  float final[K], off = 0;                                                          \
  const int rejected = measured[i] && !votes[i];                                    \
  const float s2 = variance_before[i];                                              \
  float after = votes[i] ? variance_after[i] : s2;                                  \
  for (int k = 0; k < K; ++k) {                                                     \
    const float gap = moved[k * NODES + i] - values[k * NODES + i];                 \
    off += gap * gap / K;                                                           \
  }                                                                                 \
  if (rejected) after = fmax(off, s2);                                              \
  for (int k = 0; k < K; ++k)                                                       \
    final[k] = (rejected || isnan(after) ? moved : values)[k * NODES + i];

#define NO_DISPLACEMENT                                                             \
  for (int k = 0; k < K; ++k) displacement[k * NODES + i] = raw[k * NODES + i] = NAN;
#define STORE_DISPLACEMENT                                                          \
  for (int k = 0; k < K; ++k) {                                                     \
    displacement[k * NODES + i] = final[k] - bent[k * NODES + i];                   \
    raw[k * NODES + i] = moved[k * NODES + i];                                      \
  }

#if K == 3

/* The covariance from the lattice, or that of the points where the lattice has none. */
void store_covariance(const float variance, __global const float *common,
                      __global const float *points, const int i, __global float *covariance) {
  for (int p = 0; p < 6; ++p)
    covariance[p * NODES + i] =
        isnan(variance) ? points[p * NODES + i] : variance * common[p * NODES + i];
}

/* The displacement of each node in space without the shift by bent edges, and its covariance, both
 * also before the filter; NaN where a node has none. `points`: covariance of the points, xx xy xz
 * yy yz zz. One work-item a node. */
__kernel void finish_in_space(__global const float *moved, __global const float *values,
                              __global const uchar *votes, __global const uchar *measured,
                              __global const float *variance_before,
                              __global const float *variance_after,
                              __global const float *common, __global const float *points,
                              __global const float *bent, __global const uchar *valid,
                              __global float *displacement, __global float *raw,
                              __global float *covariance, __global float *raw_covariance) {
  const int i = get_global_id(0);
  if (i >= NODES) return;
  if (!valid[i]) {
    NO_DISPLACEMENT
    for (int p = 0; p < 6; ++p) covariance[p * NODES + i] = raw_covariance[p * NODES + i] = NAN;
    return;
  }
  FINAL_OF_NODE
  STORE_DISPLACEMENT
  store_covariance(after, common, points, i, covariance);
  store_covariance(s2, common, points, i, raw_covariance);
}

#elif K == 2

/* The same in the plane, where both axes have the same variance. */
__kernel void finish_in_plane(__global const float *moved, __global const float *values,
                              __global const uchar *votes, __global const uchar *measured,
                              __global const float *variance_before,
                              __global const float *variance_after,
                              __global const float *points, __global const float *bent,
                              __global const uchar *valid, __global float *displacement,
                              __global float *raw, __global float *variance,
                              __global float *raw_variance) {
  const int i = get_global_id(0);
  if (i >= NODES) return;
  if (!valid[i]) {
    NO_DISPLACEMENT
    variance[i] = raw_variance[i] = NAN;
    return;
  }
  FINAL_OF_NODE
  STORE_DISPLACEMENT
  variance[i] = isnan(after) ? points[i] : after;
  raw_variance[i] = isnan(s2) ? points[i] : s2;
}

#endif
