#include "field.clh"

/* The nodes of a frame from those of the frame before. A check can only make a node fail, never
 * give it another number. A corner is (x, y, angle, sigma): px of the view; its first boundary, rad,
 * NaN if unknown; px, negative if it is torn, NaN if it is unknown, and then it is torn too. Each of
 * VIEWS views has CAPACITY corners and NODES nodes; dimension 1 of a launch is the view. */

#define NEAR_CELLS 0.3f /* from the prediction, of the smaller local step */
#define ALONE_CELLS 0.5f /* no second corner may be as near as that */
#define ALIKE_CELLS 0.18f /* from the mean residual of the neighbours */
#define STRAY_CELLS 0.3f /* from the prediction of the nodes around */
#define STRAY_TORN_CELLS 0.07f
#define STRAY_PX 1.0f
#define MISSING 0 /* of NodeStatus */
#define DETECTED 1
#define NONE (-1)
#define OTHER_COLOUR (-2)

/* What is counted in each view; a side is top, bottom, left or right. */
#define LOST 0    /* nodes without a corner */
#define CROSSED 1 /* nodes whose corner has the other colour */
#define ASTRAY 2  /* nodes that are far from what the nodes around predict */
#define BEYOND 3  /* free corners beyond a side, where the next line would be */
#define GONE 7    /* lost nodes on a side */
#define COUNTED 11

#define VIEW const int view = get_global_id(1), i = get_global_id(0);
#define OF_NODE (view * NODES + i)
#define CORNERS (view * CAPACITY)
#define BINS (view * bin_rows * bin_columns)

/* The bin of a place, held inside the grid of bins. */
#define BIN_COLUMN(x) clamp((int)floor((x) / bin), 0, bin_columns - 1)
#define BIN_ROW(y) clamp((int)floor((y) / bin), 0, bin_rows - 1)

/* The steps to the next column and to the next row around node i of its view. */
#define STEPS(at)                                                                   \
  const int row = i / COLUMNS, column = i % COLUMNS;                                \
  const int before = column > 0 ? i - 1 : i, behind = column < COLUMNS - 1 ? i + 1 : i; \
  const int above = row > 0 ? i - COLUMNS : i, below = row < ROWS - 1 ? i + COLUMNS : i; \
  const float2 along = ((at)[behind] - (at)[before]) / (float)max(behind - before, 1); \
  const float2 down = ((at)[below] - (at)[above]) / (float)max((below - above) / COLUMNS, 1);

/* Chain the corners of each bin, and predict the nodes: they move on as they moved last. One
 * work-item a corner or a node. */
__kernel void place(__global const float4 *corners, __global const int *found, const float bin,
                    const int bin_rows, const int bin_columns, __global const float2 *nodes,
                    __global float2 *last, __global float2 *predicted, __global int *first_of_bin,
                    __global int *next, __global int *claims) {
  VIEW
  if (i < NODES) {
    const float2 here = nodes[OF_NODE];
    predicted[OF_NODE] = here + (here - last[OF_NODE]);
    last[OF_NODE] = here;
  }
  if (i >= found[view]) return;
  const float4 corner = corners[CORNERS + i];
  const int at = BINS + BIN_ROW(corner.y) * bin_columns + BIN_COLUMN(corner.x);
  claims[CORNERS + i] = 0;
  next[CORNERS + i] = atomic_xchg(first_of_bin + at, i);
}

/* Find the allowed corner nearest to a place within `reach`, of equally near ones the first, and
 * count them. */
#define NEAREST(place, reach, IS_ALLOWED)                                           \
  int best = NONE, within = 0;                                                      \
  float best_2 = (reach) * (reach);                                                 \
  float2 best_off = 0;                                                              \
  for (int y = BIN_ROW((place).y - (reach)); y <= BIN_ROW((place).y + (reach)); ++y) \
    for (int x = BIN_COLUMN((place).x - (reach)); x <= BIN_COLUMN((place).x + (reach)); ++x) \
      for (int j = first_of_bin[BINS + y * bin_columns + x]; j >= 0; j = next[CORNERS + j]) { \
        const float2 off = corners[CORNERS + j].xy - (place);                       \
        const float off_2 = dot(off, off);                                          \
        if (!(off_2 < (reach) * (reach)) || !(IS_ALLOWED)) continue;                \
        ++within;                                                                   \
        if (best >= 0 && (off_2 > best_2 || (off_2 == best_2 && j > best))) continue; \
        best = j;                                                                   \
        best_2 = off_2;                                                             \
        best_off = off;                                                             \
      }

/* The corner of each node: the one at its prediction, if it has the node's colour. `colour`: 1
 * if the first boundary of a corner of even row + column runs along the row, -1 if down. One
 * work-item a node. */
__kernel void match(__global const float4 *corners, const float bin, const int bin_rows,
                    const int bin_columns, __global const int *first_of_bin,
                    __global const int *next, __global const float2 *last,
                    __global const float2 *predicted, __global const int *colour,
                    __global int *owner, __global float2 *residual, __global int *claims,
                    __global int *counts) {
  VIEW
  if (i >= NODES) return;
  STEPS(last + view * NODES)
  const float cell = sqrt(fmin(dot(along, along), dot(down, down)));
  const float2 place = predicted[OF_NODE];
  NEAREST(place, ALONE_CELLS * cell, 1)
  if (within != 1 || !(best_2 < NEAR_CELLS * NEAR_CELLS * cell * cell)) best = NONE;
  residual[OF_NODE] = best_off;
  if (best >= 0) {
    const float angle = corners[CORNERS + best].z;
    const float2 edge = (float2)(cos(angle), sin(angle));
    const float off_down = fabs(edge.x * down.y - edge.y * down.x);
    const float off_along = fabs(along.x * edge.y - along.y * edge.x);
    const float sign = (row + column) % 2 ? -colour[view] : colour[view];
    if (sign * (off_down - off_along) <= 0) { /* false if the angle is unknown */
      best = OTHER_COLOUR;
      atomic_inc(counts + view * COUNTED + CROSSED);
    } else atomic_inc(claims + CORNERS + best);
  }
  owner[OF_NODE] = best;
}

/* A node keeps its corner if no other node has it, and if its residual is like that of its
 * neighbours; else it moves as they do. One work-item a node. */
__kernel void agree(__global const float4 *corners, __global const float2 *last,
                    __global const float2 *predicted, __global int *owner,
                    __global const float2 *residual, __global const int *claims,
                    __global float2 *nodes, __global uchar *status, __global float *sigma,
                    __global uchar *torn, __global int *kept, __global int *counts) {
  VIEW
  if (i >= NODES) return;
  STEPS(last + view * NODES)
  const int near[4] = {before, behind, above, below};
  float2 mean = 0;
  int known = 0;
  for (int k = 0; k < 4; ++k) {
    const int j = owner[view * NODES + near[k]];
    if (near[k] == i || j < 0 || claims[CORNERS + j] != 1) continue;
    mean += residual[view * NODES + near[k]];
    ++known;
  }
  if (known > 0) mean /= (float)known;
  const float cell_2 = fmin(dot(along, along), dot(down, down));
  const float2 off = residual[OF_NODE] - mean;
  const int j = owner[OF_NODE];
  const int good = j >= 0 && claims[CORNERS + max(j, 0)] == 1 && known > 0 &&
                   dot(off, off) < ALIKE_CELLS * ALIKE_CELLS * cell_2;
  kept[OF_NODE] = good ? j : NONE;
  nodes[OF_NODE] = good ? corners[CORNERS + j].xy : predicted[OF_NODE] + mean;
  status[OF_NODE] = good ? DETECTED : MISSING;
  sigma[OF_NODE] = good ? fabs(corners[CORNERS + j].w) : NAN;
  torn[OF_NODE] = !(good && corners[CORNERS + j].w > 0);
  if (good) return;
  __global int *own = counts + view * COUNTED;
  atomic_inc(own + LOST);
  if (row == 0) atomic_inc(own + GONE);
  if (row == ROWS - 1) atomic_inc(own + GONE + 1);
  if (column == 0) atomic_inc(own + GONE + 2);
  if (column == COLUMNS - 1) atomic_inc(own + GONE + 3);
}

/* Nodes far from what the nodes around predict lose their status, and free corners where a line
 * beyond a side would be are counted. `stencils`: 49 weights of the 7 x 7 nodes around for each of
 * 16 x 16 distances from the sides, 0 to 3 above, below, before and behind; all 0 where too few
 * nodes predict. One work-item a node. */
__kernel void check(__global const float4 *corners, const float bin, const int bin_rows,
                    const int bin_columns, __global const int *first_of_bin,
                    __global const int *next, __global const int *claims,
                    __global const int *kept, __global const float2 *nodes,
                    __global const uchar *torn, __global const float *stencils,
                    __global uchar *status, __global int *counts) {
  VIEW
  if (i >= NODES) return;
  __global const float2 *at = nodes + view * NODES;
  __global int *own = counts + view * COUNTED;
  STEPS(at)
  const int rows_around = 4 * min(row, 3) + min(ROWS - 1 - row, 3);
  const int columns_around = 4 * min(column, 3) + min(COLUMNS - 1 - column, 3);
  __global const float *weights = stencils + 49 * (16 * rows_around + columns_around);
  float2 expected = 0;
  float sum = 0;
  for (int r = -3; r <= 3; ++r)
    for (int c = -3; c <= 3; ++c) {
      const float weight = weights[7 * (r + 3) + c + 3];
      if (weight == 0) continue;
      expected += weight * at[i + r * COLUMNS + c];
      sum += weight;
    }
  const float cell = (length(along) + length(down)) / 2, off = length(at[i] - expected);
  const float most = torn[OF_NODE] ? STRAY_TORN_CELLS : STRAY_CELLS;
  if (kept[OF_NODE] >= 0 && sum > 0.5f && off > STRAY_PX && off > most * cell) {
    status[OF_NODE] = MISSING;
    atomic_inc(own + ASTRAY);
  }
  const int inner[4] = {row == 0 ? below : i, row == ROWS - 1 ? above : i,
                        column == 0 ? behind : i, column == COLUMNS - 1 ? before : i};
  for (int side = 0; side < 4; ++side) {
    if (inner[side] == i) continue;
    const float2 step = at[i] - at[inner[side]];
    const float2 beyond = at[i] + step;
    NEAREST(beyond, NEAR_CELLS * length(step), claims[CORNERS + j] == 0)
    if (best >= 0) atomic_inc(own + BEYOND + side);
  }
}
