#include "field.clh"
#include "surface.clh"

/* The adaptive filter of a lattice: cmp_cl/reference/field/filter.py has its equations.
 *
 * K coordinates are filtered alike. There are FILTERS_DOWN filters along the columns, matrices
 * (ROWS, ROWS), and FILTERS_ALONG along the rows, (COLUMNS, LINE): a row of them has the weights of
 * a node in the values of all. Filter 0 changes nothing. `rows_noise` and `rows_risk` are Gaussians
 * of 2 REACH + 1 nodes whose sum is 1. */

#define ESTIMATES 5 /* of the noise: from both axes, from each axis, from each diagonal */
#define ROUNDS 3    /* that may reject nodes, as in cmp_cl/motion/filter.py */
#define MASKS 4     /* nodes that count in them; the diagonals share one */
#define MASK_PLANE(estimate) (PRODUCTS + ((estimate) < 3 ? (estimate) : 3))
#define LENGTH_PLANE(estimate) (PRODUCTS + MASKS + (estimate))
#define NOISE_PLANES (PRODUCTS + MASKS + ESTIMATES)
#define MOST_OWN 0.95f /* of a node in its own pilot, which else shows no noise */
#define NOISE_REACH 10
#define RISK_REACH 8
#define LEAST_VOTES 8     /* through which a surface goes */
#define REJECTED_AT 46.0f /* times the square of the mean length: 6 standard deviations */
#define ROUGH_COUNTS 4    /* a residual of a rough corner counts twice: 3 standard deviations */
#define IS_ROUGH(i) (measured[i] > DETECTED)
#define CLEARLY 4.0f /* times the usual variance */
#define FAR 9.0f     /* times the variance: the square of 3 standard deviations */
#define LEAST_OF_FIVE 1.29f
#define CHI 0.55f /* the square of the mean of a chi variable of freedom f is about f / (f + .55) */
#define SHARPNESS 4.71238898f /* 2 pi 1.5^2 / 3 */
#define LEAST_VARIANCE 1e-30f
#define NONE_NEAR 1e-6f /* a smaller sum of Gaussian weights is no mean */

#define KNOWN_OR_1(s) ((s) == (s) ? (s) : (float8)1)
#define HAS_VOTE(row, c) (EIGHT_AT(vote + (row) * LINE + (c)) > 0 ? (float8)1 : (float8)0)

__constant float DIAGONAL[7] = {5 / 231.0f,  -30 / 231.0f, 75 / 231.0f, 131 / 231.0f,
                                75 / 231.0f, -30 / 231.0f, 5 / 231.0f};

/* Whether the pilot's window around a node holds enough votes. */
int is_supported(const int row, const int column, __global const uchar *votes) {
  const int top = WINDOW_START(row, PILOT_DOWN, ROWS);
  const int first = WINDOW_START(column, PILOT_ALONG, COLUMNS);
  int count = 0;
  for (int r = 0; r <= 2 * PILOT_DOWN; ++r)
    for (int t = 0; t <= 2 * PILOT_ALONG; ++t) count += votes[(top + r) * COLUMNS + first + t];
  return 4 * count >= 3 * (2 * PILOT_DOWN + 1) * (2 * PILOT_ALONG + 1);
}

/* The value of node i, or what fills its hole: the surface through the votes around; 0 if there are
 * too few. Its vote: 0, 1, or 2 if the pilot's window holds enough of them. It is a number, since
 * NVIDIA's compiler (580.159) made others of bytes in the loops over a row of 33 to 40 nodes. */
void fill_node(const int i, __global const float *moved, __global const uchar *votes,
               __global float *data, __global float *vote) {
  const int row = i / COLUMNS, column = i % COLUMNS, at = IN_LINE(i);
  for (int k = 0; k < K; ++k) data[k * PLANE + at] = votes[i] ? moved[k * NODES + i] : 0.0f;
  if (votes[i]) {
    vote[at] = is_supported(row, column, votes) ? 2.0f : 1.0f;
    return;
  }
  vote[at] = 0;
  for (int reach = 3; reach <= 6; reach += 3) {
    Surface around;
    begin_surface(&around);
    for (int r = max(row - reach, 0); r <= min(row + reach, ROWS - 1); ++r)
      for (int c = max(column - reach, 0); c <= min(column + reach, COLUMNS - 1); ++c) {
        const int j = r * COLUMNS + c;
        if (!votes[j]) continue;
        float value[K];
        for (int k = 0; k < K; ++k) value[k] = moved[k * NODES + j];
        add_to_surface(&around, reach, r - row, c - column, value);
      }
    if (around.nodes < LEAST_VOTES) continue;
    float filled[K];
    solve_surface(&around, filled);
    for (int k = 0; k < K; ++k) data[k * PLANE + at] = filled[k];
    return;
  }
}

/* Fill the holes. One work-item a node. */
__kernel void fill(__global const float *moved, __global const uchar *votes,
                   __global float *data, __global float *vote) {
  const int i = get_global_id(0);
  if (i < NODES) fill_node(i, moved, votes, data, vote);
}

/* Apply a filter along the columns for eight nodes of a row. */
float8 filter_down(__global const float *plane, const int row, const int column, const int side,
                   __global const float *matrix) {
  float8 sum = 0;
  const int first = WINDOW_START(row, side, ROWS);
  for (int r = first; r <= first + 2 * side; ++r)
    sum += matrix[r * ROWS + row] * EIGHT_AT(plane + r * LINE + column);
  return sum;
}

/* Apply a filter along the row for eight of its nodes: the columns of its matrix in which their
 * windows are. */
#define EACH_NODE_OF_WINDOWS(j, column, side)                                       \
  for (int j = WINDOW_START(column, side, COLUMNS),                                 \
           end = WINDOW_START(min((column) + LANES, COLUMNS) - 1, side, COLUMNS) + 2 * (side); \
       j <= end; ++j)

float8 filter_along(const float *line, const int column, const int side,
                    __global const float *matrix) {
  float8 sum = 0;
  EACH_NODE_OF_WINDOWS(j, column, side) sum += line[j] * EIGHT_AT(matrix + j * LINE + column);
  return sum;
}

/* Sum with Gaussian weights along the row; `line` has `reach` numbers before it and behind it,
 * which become 0 as those between COLUMNS and LINE do. Eight results are `apart` from the next. */
void average_along(float *line, const int reach, __global const float *weights,
                   __global float *result, const int apart) {
  for (int c = 0; c < reach; ++c) line[c] = line[LINE + reach + c] = 0;
  for (int c = COLUMNS; c < LINE; ++c) line[reach + c] = 0;
  float8 sum[LINE / LANES]; /* side by side, since each waits for the addition before */
  for (int n = 0; n < LINE / LANES; ++n) sum[n] = 0;
  for (int t = 0; t <= 2 * reach; ++t) {
    const float weight = weights[t];
#pragma unroll
    for (int n = 0; n < LINE / LANES; ++n) sum[n] += weight * LOAD_EIGHT(line + LANES * n + t);
  }
  for (int n = 0; n < LINE / LANES; ++n) EIGHT_AT(result + apart * n) = sum[n];
}

/* The rows around `row` that are summed with Gaussian weights along the columns. Planes are summed
 * side by side, in loops that are unrolled, since each sum waits for its addition before. */
#define EACH_ROW_WITHIN(reach) \
  for (int r = max(row - (reach), 0); r <= min(row + (reach), ROWS - 1); ++r)

/* The residuals of the pilot in a row: 0 along both axes, 1 along the columns, 2 along the row. */
void left_by_axes(const int row, const int estimate, __global const float *data,
                  __global const float *pilot_down, __global const float *pilot_along,
                  float (*left)[LINE]) {
  float down[LINE];
  for (int k = 0; k < K; ++k) {
    __global const float *plane = data + k * PLANE, *here = plane + row * LINE;
    EACH_EIGHT STORE_EIGHT(down + c, estimate == 2 ? EIGHT_AT(here + c)
                                                   : filter_down(plane, row, c, PILOT_DOWN,
                                                                 pilot_down));
    EACH_EIGHT STORE_EIGHT(left[k] + c,
                           EIGHT_AT(here + c) -
                               (estimate == 1 ? LOAD_EIGHT(down + c)
                                              : filter_along(down, c, PILOT_ALONG, pilot_along)));
  }
}

/* The same along a diagonal, 3 or 4; 0 less than three nodes from a side. */
void left_by_diagonal(const int row, const int estimate, __global const float *data,
                      float (*left)[LINE]) {
  const int inside = row >= 3 && row < ROWS - 3;
  for (int k = 0; k < K; ++k) {
    __global const float *here = data + k * PLANE + row * LINE;
    for (int c = 0; c < LINE; ++c) left[k][c] = 0;
    for (int c = 3; inside && c < COLUMNS - 3; ++c) left[k][c] = here[c];
    for (int t = -3; inside && t <= 3; ++t) {
      const float weight = DIAGONAL[t + 3];
      __global const float *across = here + t * LINE + (estimate == 3 ? t : -t);
      for (int c = 3; c < COLUMNS - 3; ++c) left[k][c] -= weight * across[c];
    }
  }
}

/* What the pilot reads, what the noise does, and both. */
#define PILOT_READS data, pilot_down, pilot_along
#define OF_PILOT \
  __global float *data, __global const float *pilot_down, __global const float *pilot_along
#define NOISE_READS \
  bound_rest, own, measured, bends, rejected, votes, variance, chosen, common
#define OF_NOISE                                                                             \
  __global const float *bound_rest, __global const float *own, __global const uchar *measured, \
      const int bends, __global int *rejected, __global uchar *votes, __global float *variance,  \
      __global float *chosen, __global float *common
#define BOTH_READ vote, pilot_own_down, pilot_own_along, rows_noise, size, near
#define OF_BOTH                                                            \
  __global float *vote, __global const float *pilot_own_down,              \
      __global const float *pilot_own_along, __global const float *rows_noise, \
      __global float *size, __global float *near

/* What an estimate of the noise is made of, averaged along the row into `near`: the lengths of its
 * residuals over the share of the noise in them, and the mask of the nodes that count. Of those
 * along both axes also the products of their coordinates, and in `size` the squares, by which nodes
 * are rejected. */
void pilot_of_row(const int row, const int estimate, OF_PILOT, OF_BOTH) {
  float left[K][LINE], share[LINE], line[LINE + 2 * NOISE_REACH], mask[LINE + 2 * NOISE_REACH];
  if (estimate < 3) left_by_axes(row, estimate, data, pilot_down, pilot_along, left);
  else left_by_diagonal(row, estimate, data, left);
  const int inside = row >= 3 && row < ROWS - 3;
  const float8 own_of_row = pilot_own_down[row], own_inside = DIAGONAL[3], none = 0, one = 1;
  const float8 least_vote = estimate == 0 ? 2 : 1;
  EACH_EIGHT {
    const int8 column = c + (int8)(0, 1, 2, 3, 4, 5, 6, 7);
    const int8 has_diagonals = inside && column >= 3 && column < COLUMNS - 3;
    const float8 along = EIGHT_AT(pilot_own_along + c), across = has_diagonals ? own_inside : one;
    const float8 own = estimate == 0   ? own_of_row * along
                       : estimate == 1 ? own_of_row
                       : estimate == 2 ? along
                                       : across;
    const int8 usable = EIGHT_AT(vote + row * LINE + c) >= least_vote && own < MOST_OWN;
    float8 square = 0;
    for (int k = 0; k < K; ++k) square += LOAD_EIGHT(left[k] + c) * LOAD_EIGHT(left[k] + c) / K;
    if (estimate == 0) EIGHT_AT(size + row * LINE + c) = HAS_VOTE(row, c) * square;
    STORE_EIGHT(share + c, usable ? 1 / (1 - own) : none);
    STORE_EIGHT(mask + NOISE_REACH + c, usable ? one : none);
    STORE_EIGHT(line + NOISE_REACH + c, sqrt(LOAD_EIGHT(share + c) * square));
  }
  average_along(line, NOISE_REACH, rows_noise, near + (LENGTH_PLANE(estimate) * ROWS + row) * LINE,
                LANES);
  if (estimate < 4) /* both diagonals have the same mask */
    average_along(mask, NOISE_REACH, rows_noise, near + (MASK_PLANE(estimate) * ROWS + row) * LINE,
                  LANES);
  if (estimate > 0) return;
  int p = 0;
  for (int j = 0; j < K; ++j)
    for (int k = j; k < K; ++k, ++p) {
      EACH_EIGHT STORE_EIGHT(line + NOISE_REACH + c, LOAD_EIGHT(share + c) *
                                                         LOAD_EIGHT(left[j] + c) *
                                                         LOAD_EIGHT(left[k] + c));
      average_along(line, NOISE_REACH, rows_noise, near + (p * ROWS + row) * LINE, LANES);
    }
}

/* The pilot. One work-item a row and an estimate. */
__kernel void pilot(OF_PILOT, OF_BOTH) {
  const int row = get_global_id(0), estimate = get_global_id(1);
  if (row < ROWS) pilot_of_row(row, estimate, PILOT_READS, BOTH_READ);
}

/* For eight nodes of a row: the variance of the noise, NaN where unknown; that with which filters
 * are chosen, the least of it and of an upper bound and, if the values may bend sharply, of five
 * estimates; the covariance of the coordinates over its mean diagonal; and a node whose residual is
 * too large loses its vote, and so does a rough one that the pilot's window does not support. The
 * freedom of the lengths of residuals is the effective number of their directions. The upper bound
 * is the sum of that at rest and of the variance of the points now. round: of the search for
 * outliers; the last one rejects none. */
#define SURPRISE(i, at) (size[at] * (IS_ROUGH(i) ? ROUGH_COUNTS : 1))
void noise_of_eight(const int row, const int c, const int round, OF_BOTH, OF_NOISE) {
  const float8 none_near = NONE_NEAR, unknown = NAN, smallest = LEAST_VARIANCE;
  const int at = row * LINE + c;
  float8 near_here[NOISE_PLANES], trace = 0, squares = 0, first = 0, least = 0;
  float usual[LANES];
  for (int n = 0; n < NOISE_PLANES; ++n) near_here[n] = 0;
  EACH_ROW_WITHIN(NOISE_REACH) {
    const float weight = rows_noise[r - row + NOISE_REACH];
#pragma unroll
    for (int n = 0; n < NOISE_PLANES; ++n)
      near_here[n] += weight * EIGHT_AT(near + n * PLANE + r * LINE + c);
  }
  int p = 0;
  for (int j = 0; j < K; ++j)
    for (int k = j; k < K; ++k, ++p) {
      if (j == k) trace += near_here[p];
      squares += (j == k ? 1 : 2) * near_here[p] * near_here[p];
    }
  const float8 over_freedom = trace > 0 ? squares / (trace * trace) : (float8)(1.0f / K);
  for (int e = 0; e < ESTIMATES; ++e) {
    const float8 mask = near_here[MASK_PLANE(e)];
    const float8 length = near_here[LENGTH_PLANE(e)] / (mask > none_near ? mask : none_near);
    const float8 square = mask > none_near ? length * length : unknown;
    const float8 estimate = square * (1 + CHI * over_freedom);
    if (e == 0) {
      first = least = estimate + smallest;
      STORE_EIGHT(usual, square);
    }
    else least = estimate < least || least != least ? estimate : least;
  }
  const float8 bound = EIGHT_AT(bound_rest + at) + EIGHT_AT(own + at);
  const float8 lower = LEAST_OF_FIVE * least, lowest = lower < first ? lower : first;
  const float8 unbounded = bends ? lowest : first;
  const float8 bounded = bound < unbounded ? bound : unbounded;
  EIGHT_AT(variance + at) = first;
  EIGHT_AT(chosen + at) = first != first ? first : bounded > smallest ? bounded : smallest;
  p = 0;
  for (int j = 0; j < K; ++j)
    for (int k = j; k < K; ++k, ++p)
      EIGHT_AT(common + p * PLANE + at) =
          trace > 0 ? near_here[p] * K / trace : (float8)(j == k);
  if (round == ROUNDS) return;
  for (int column = c; column < min(c + LANES, COLUMNS); ++column) {
    const int node = row * COLUMNS + column;
    const float here = SURPRISE(node, row * LINE + column);
    const float left = 1 - pilot_own_down[row] * pilot_own_along[column];
    const int unsupported = IS_ROUGH(node) && vote[row * LINE + column] == 1;
    if (!unsupported && !(here > REJECTED_AT * usual[column - c] * left)) continue;
    float largest = 0;
    for (int r = max(row - 1, 0); r <= min(row + 1, ROWS - 1); ++r)
      for (int t = max(column - 1, 0); t <= min(column + 1, COLUMNS - 1); ++t)
        largest = fmax(largest, SURPRISE(r * COLUMNS + t, r * LINE + t));
    if (!unsupported && here < largest) continue;
    votes[node] = 0;
    atomic_inc(rejected + round);
  }
}

/* The noise, and the first round of the search for outliers. The work-items share the rows, and
 * those of a row its nodes, eight at a time. */
__kernel void noise(OF_BOTH, OF_NOISE) {
  for (int row = get_global_id(0); row < ROWS; row += get_global_size(0))
    for (int c = LANES * get_global_id(1); c < LINE; c += LANES * get_global_size(1))
      noise_of_eight(row, c, 0, BOTH_READ, NOISE_READS);
}

/* The other rounds, each of them if the one before has rejected nodes, which is rare. One
 * work-group: a launch for each step of each round would cost more than all of them mostly do. */
__kernel void settle(__global const float *moved, OF_PILOT, OF_BOTH, OF_NOISE) {
  const int first = get_local_id(0), items = get_local_size(0);
  for (int round = 1; round <= ROUNDS && rejected[round - 1] > 0; ++round) {
    for (int i = first; i < NODES; i += items) fill_node(i, moved, votes, data, vote);
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (int i = first; i < ESTIMATES * ROWS; i += items)
      pilot_of_row(i % ROWS, i / ROWS, PILOT_READS, BOTH_READ);
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (int i = LANES * first; i < PLANE; i += LANES * items)
      noise_of_eight(i / LINE, i % LINE, round, BOTH_READ, NOISE_READS);
    barrier(CLK_GLOBAL_MEM_FENCE);
  }
}

/* Every pair of filters: its estimate, and its loss, averaged along the row. The work-items of a
 * row and a filter along the columns share the filters along the row. */
__kernel void smooth(__global const float *data, __global const float *vote,
                     __global const float *chosen, __global const int *sides_down,
                     __global const int *sides_along, __global const float *filters_down,
                     __global const float *filters_along, __global const float *own_down,
                     __global const float *own_along, __global const float *rows_risk,
                     __global float *estimate, __global float *loss,
                     __global float *near_votes) {
  const int row = get_global_id(0), a = get_global_id(1), side = sides_down[a];
  if (row >= ROWS) return;
  float down[K][LINE], here[K][LINE], twice[LINE], line[LINE + 2 * RISK_REACH];
  EACH_EIGHT {
    for (int k = 0; k < K; ++k) {
      __global const float *plane = data + k * PLANE;
      STORE_EIGHT(here[k] + c, EIGHT_AT(plane + row * LINE + c));
      STORE_EIGHT(down[k] + c, filter_down(plane, row, c, side, filters_down + a * ROWS * ROWS));
    }
    const float8 s = EIGHT_AT(chosen + row * LINE + c);
    STORE_EIGHT(twice + c, 2 * K * own_down[a * ROWS + row] * KNOWN_OR_1(s));
  }
  for (int b = get_global_id(2); b < FILTERS_ALONG; b += get_global_size(2)) {
    const int pair = a * FILTERS_ALONG + b, reach = sides_along[b];
    __global const float *matrix = filters_along + b * COLUMNS * LINE;
    EACH_EIGHT {
      float8 found[K], square = LOAD_EIGHT(twice + c) * EIGHT_AT(own_along + b * LINE + c);
#pragma unroll
      for (int k = 0; k < K; ++k) found[k] = 0;
      if (c >= reach && c + LANES + reach <= COLUMNS) /* whole windows: eight nodes, one filter */
        for (int j = c - reach; j <= c + reach; ++j) {
          const float weight = matrix[j * LINE + c];
#pragma unroll
          for (int k = 0; k < K; ++k) found[k] += weight * LOAD_EIGHT(down[k] + j);
        }
      else EACH_NODE_OF_WINDOWS(j, c, reach) {
        const float8 weight = EIGHT_AT(matrix + j * LINE + c);
#pragma unroll
        for (int k = 0; k < K; ++k) found[k] += weight * down[k][j];
      }
#pragma unroll
      for (int k = 0; k < K; ++k) {
        const float8 apart = found[k] - LOAD_EIGHT(here[k] + c);
        square += apart * apart;
        EIGHT_AT(estimate + (k * PAIRS + pair) * PLANE + IN_PIECES(row, c)) = found[k];
      }
      STORE_EIGHT(line + RISK_REACH + c, square * HAS_VOTE(row, c));
    }
    average_along(line, RISK_REACH, rows_risk, loss + pair * PLANE + IN_PIECES(row, 0),
                  IN_PIECES(0, LANES));
  }
  if (a == 0 && get_global_id(2) == 0) {
    EACH_EIGHT STORE_EIGHT(line + RISK_REACH + c, HAS_VOTE(row, c));
    average_along(line, RISK_REACH, rows_risk, near_votes + IN_PIECES(row, 0), IN_PIECES(0, LANES));
  }
}

/* exp(x) for x <= 0 within 2e-7: 2 to a whole number, which the sum with 1.5 * 2^23 rounds to,
 * times a polynomial. Below 2^-60 it is 0: products of such weights would be subnormal, and take
 * an Intel core a hundred times as long. */
float8 exp_below(const float8 x) {
  const float8 y = x * 1.44269504f, most = y > -60.0f ? y : (float8)(-60);
  const float8 rounded = most + 12582912.0f, t = most - (rounded - 12582912.0f);
  const float8 power =
      1 + t * (0.69314718f +
               t * (0.24022651f +
                    t * (0.05550411f + t * (0.00961813f + t * (0.00133336f + t * 0.000154f)))));
  const float8 found = as_float8((as_int8(rounded) - as_int(12582912.0f) + 127) << 23) * power;
  return y > -60.0f ? found : (float8)0;
}

/* The mean of all pairs with weights by their risk, and its variance: that of the noise in it, and
 * what the risk shows beyond, the square of its bias. Where no vote is near, all pairs are alike.
 * One work-item for eight nodes of a row. */
__kernel void blend(__global const float *estimate, __global const float *loss,
                    __global const float *near_votes, __global const float *variance,
                    __global const float *chosen, __global const float *own_down,
                    __global const float *own_along, __global const float *gain_down,
                    __global const float *gain_along, __global const float *rows_risk,
                    __global float *values,
                    __global float *mixed_noise, __global float *mixed_bias,
                    __global float *mixed_own) {
  const int row = get_global_id(0), c = LANES * get_global_id(1), at = row * LINE + c;
  if (row >= ROWS || c >= COLUMNS) return;
  const float8 s1 = EIGHT_AT(chosen + at), s2 = EIGHT_AT(variance + at);
  float8 near = 0;
  EACH_ROW_WITHIN(RISK_REACH)
    near += rows_risk[r - row + RISK_REACH] * EIGHT_AT(near_votes + IN_PIECES(r, c));
  const float8 none = 0, scale = near > NONE_NEAR ? 1 / (K * KNOWN_OR_1(s1) * near) : none;
  float8 risk[PAIRS], least = INFINITY;
  for (int a = 0; a < PAIRS; a += FILTERS_ALONG) {
    float8 sum[FILTERS_ALONG];
    for (int b = 0; b < FILTERS_ALONG; ++b) sum[b] = 0;
    EACH_ROW_WITHIN(RISK_REACH) {
      const float weight = rows_risk[r - row + RISK_REACH];
#pragma unroll
      for (int b = 0; b < FILTERS_ALONG; ++b)
        sum[b] += weight * EIGHT_AT(loss + (a + b) * PLANE + IN_PIECES(r, c));
    }
    for (int b = 0; b < FILTERS_ALONG; ++b) {
      risk[a + b] = scale * sum[b];
      least = risk[a + b] < least ? risk[a + b] : least;
    }
  }
  float8 sum = 0, mean_risk = 0, mean_own = 0, mean_gain = 0, value[K];
  for (int k = 0; k < K; ++k) value[k] = 0;
  for (int a = 0; a < FILTERS_DOWN; ++a)
    for (int b = 0; b < FILTERS_ALONG; ++b) {
      const int pair = a * FILTERS_ALONG + b;
      const float8 weight = exp_below(SHARPNESS * (least - risk[pair]));
      sum += weight;
      mean_risk += weight * risk[pair];
      mean_own += weight * own_down[a * ROWS + row] * EIGHT_AT(own_along + b * LINE + c);
      mean_gain += weight * gain_down[a * ROWS + row] * EIGHT_AT(gain_along + b * LINE + c);
      for (int k = 0; k < K; ++k)
        value[k] += weight * EIGHT_AT(estimate + (k * PAIRS + pair) * PLANE + IN_PIECES(row, c));
    }
  const float8 share = 1 / sum, noise = s2 * mean_gain * share;
  const float8 stein = s1 * mean_risk * share + 2 * (s2 - s1) * mean_own * share - s2;
  for (int k = 0; k < K; ++k) EIGHT_AT(values + k * PLANE + at) = value[k] * share;
  EIGHT_AT(mixed_own + at) = mean_own * share;
  EIGHT_AT(mixed_noise + at) = noise;
  EIGHT_AT(mixed_bias + at) = stein > noise ? stein - noise : none;
}

/* The planes of a covariance: all in space; in the plane the variance, that of both axes. */
#define COVARIANCES (K == 3 ? PRODUCTS : 1)

#define IS_VARIANCE(p) ((p) == 0 || (p) == 3 || (p) == 5)
/* That of noise, over its mean diagonal; in the plane both axes have the same. */
#if K == 3
#define SHAPE(common, p, i) common[(p) * PLANE + IN_LINE(i)]
#else
#define SHAPE(common, p, i) 1
#endif

/* The covariance from the lattice, where a bias may have any direction, or that of the points where
 * the lattice has none. noise, bias: their variance per axis. */
void store_covariance(const float noise, const float bias, __global const float *common,
                      __global const float *points, const int i, __global float *covariance) {
  for (int p = 0; p < COVARIANCES; ++p) {
    const float found = noise * SHAPE(common, p, i) + (IS_VARIANCE(p) ? bias : 0);
    covariance[p * NODES + i] = isnan(noise) ? points[p * NODES + i] : found;
  }
}

/* The displacement of each node without the shift by bent edges, and its covariance, both also
 * before the filter; NaN where a node has none. A node with a vote takes its mean, a rejected one
 * keeps its value, and one that was not measured, or is rough and rejected, takes the mean of its
 * neighbours. A node that is clearly worse than the lattice, by its images or by its distance from
 * the mean, has its own variance. moved: K planes. measured: of NodeStatus; MISSING had no vote at
 * first. points: the covariance of the points. One work-item a node. */
__kernel void finish(__global const float *moved, __global const float *values,
                     __global const uchar *votes, __global const uchar *measured,
                     __global const float *variance, __global const float *mixed_noise,
                     __global const float *mixed_bias, __global const float *mixed_own,
                     __global const float *bound_rest, __global const float *own,
                     __global const float *common,
                     __global const float *points, __global const float *bent,
                     __global const uchar *valid,
                     __global float *displacement, __global float *raw_displacement,
                     __global float *covariance, __global float *raw_covariance,
                     __global int *rejected) {
  const int i = get_global_id(0);
  if (i < ROUNDS) rejected[i] = 0; /* the next frame counts from 0 */
  if (i >= NODES) return;
  if (!valid[i]) {
    for (int k = 0; k < K; ++k) displacement[k * NODES + i] = raw_displacement[k * NODES + i] = NAN;
    for (int p = 0; p < COVARIANCES; ++p)
      covariance[p * NODES + i] = raw_covariance[p * NODES + i] = NAN;
    return;
  }
  const int keeps_own = measured[i] == DETECTED && !votes[i], at = IN_LINE(i);
  float before = variance[at], after = votes[i] ? mixed_noise[at] : before, off = 0;
  for (int k = 0; k < K; ++k) {
    const float gap = moved[k * NODES + i] - values[k * PLANE + at];
    off += gap * gap / K;
  }
  const float by_images = own[at] > CLEARLY * (before + bound_rest[at]) ? own[at] : 0.0f;
  const float alone = fmax(by_images, off > FAR * before ? off : 0.0f);
  if (alone > 0) {
    before = alone;
    if (votes[i]) after += mixed_own[at] * mixed_own[at] * alone;
    else if (keeps_own || (IS_ROUGH(i) && !is_supported(i / COLUMNS, i % COLUMNS, votes)))
      after = alone;
  }
  for (int k = 0; k < K; ++k) {
    const float seen = moved[k * NODES + i];
    const float found = keeps_own || isnan(after) ? seen : values[k * PLANE + at];
    displacement[k * NODES + i] = found - bent[k * NODES + i];
    raw_displacement[k * NODES + i] = seen;
  }
  store_covariance(after, votes[i] ? mixed_bias[at] : 0.0f, common, points, i, covariance);
  store_covariance(before, 0.0f, common, points, i, raw_covariance);
}
