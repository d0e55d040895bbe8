#include "field.clh"
#include "surface.clh"

/* The nodes of a frame from those of the frame before. A check can only make a node fail, never
 * give it another number. A corner is (x, y, angle, sigma): px of the view; its first boundary,
 * rad, NaN if unknown; px, NaN if unknown.
 * Each view has at most CAPACITY corners, and NODES nodes; dimension 1 of a launch is the view.
 *
 * `result` has the corners of all views as kernels/result.clh lays them out: `stride` numbers for a
 * view, with room for `room` corners. */
#pragma OPENCL FP_CONTRACT OFF

#ifndef LOOKS
#error "LOOKS must be the room for the second looks of a view, one a node"
#endif
#if !defined(HEAD) || !defined(EDGES_FIELD) || !defined(METHOD_FIELD) || !defined(VARIANCE_FIELD)
#error "HEAD and the fields of a result must be defined"
#endif
#define CENTROID 0
#define SAME_PX 0.5f            /* a corner so near is the same */

#define NEAR_CELLS 0.3f /* from a prediction */
#define ALIKE_CELLS 0.18f /* from the mean residual of the neighbours */
#define LEAST_AROUND 16 /* nodes that say where one without a corner is */
#define ADRIFT_CELLS 0.75f /* a free corner so near to a lost node may be its own */
#define ATTACHED 2
#define SECOND_LOOK 3
#define INTERPOLATED 4
#define NONE (-1)
#define OTHER_COLOUR (-2)

/* What is counted in each view; a side is top, bottom, left or right. */
#define LOST 0    /* nodes without a corner */
#define BEYOND 1  /* free corners beyond a side, where the next line would be */
#define GONE 5    /* lost nodes on a side */
#define ADRIFT 9  /* lost nodes near a corner that is not like those of the neighbours */
#define COUNTED 10

/* The status of a node with this corner. */
#define STATUS_OF(corner) (isnan((corner).w) ? ATTACHED : DETECTED)

#define IS_SEEN(status) ((status) != MISSING && (status) != INTERPOLATED)

#define VIEW const int view = get_global_id(1), i = get_global_id(0);
#define OF_NODE (view * NODES + i)
#define CORNERS (view * CAPACITY)
#define BINS (view * bin_rows * bin_columns)

/* The bin of a place, held inside the grid of bins. */
#define HELD(n, count) ((n) < 0 ? 0 : (n) < (count) ? (n) : (count) - 1)
#define BIN_COLUMN(x) HELD((int)((x) * bins_per_px), bin_columns)
#define BIN_ROW(y) HELD((int)((y) * bins_per_px), bin_rows)

/* The steps to the next column and to the next row around node i of its view. */
#define STEPS(at)                                                                   \
  const int row = i / COLUMNS, column = i % COLUMNS;                                \
  const int before = column > 0 ? i - 1 : i, behind = column < COLUMNS - 1 ? i + 1 : i; \
  const int above = row > 0 ? i - COLUMNS : i, below = row < ROWS - 1 ? i + COLUMNS : i; \
  const float2 along = ((at)[behind] - (at)[before]) / (float)max(behind - before, 1); \
  const float2 down = ((at)[below] - (at)[above]) / (float)max((below - above) / COLUMNS, 1);

/* The corners of a view in a result, of which at most `most` fit. */
#define RESULT_OF_VIEW(result, stride, most)                                        \
  const int count = (int)min(((__global const uint *)(result))[view * (stride)], (uint)(most)); \
  const int padded = (count + 7) / 8 * 8;                                           \
  __global const float *fields = (result) + view * (stride) + HEAD;                 \
  __global const float *edges = fields + EDGES_FIELD * padded;                      \
  __global const uchar *methods = (__global const uchar *)(fields + METHOD_FIELD * padded); \
  __global const uchar *refusals = methods + padded;                                \
  __global const float *variances = fields + VARIANCE_FIELD * padded;

/* The sine of an angle within .001. On PoCL sin, floor and fabs are calls, sin a slow one. */
#define SIZE(v) ((v) < 0 ? -(v) : (v))
float sine_of(const float angle) {
  const float turns = angle * 0.15915494f, middle = turns + 0.5f;
  const int whole = (int)middle - ((float)(int)middle > middle);
  const float x = 2 * (turns - (float)whole); /* in pi, -1 to 1 */
  const float y = 4 * x * (1 - SIZE(x));
  return y * (0.775f + 0.225f * SIZE(y));
}

/* Whether a corner of this first boundary has the colour of node i, where the lattice has these
 * steps; true if the boundary is unknown. `colour`: 1 if the first boundary of a corner of even row
 * + column runs along the row, -1 if down. */
int has_colour(const float angle, const float2 along, const float2 down, const int i,
               const int colour) {
  const float2 edge = (float2)(sine_of(angle + 1.57079633f), sine_of(angle));
  const float off_down = edge.x * down.y - edge.y * down.x;
  const float off_along = along.x * edge.y - along.y * edge.x;
  const float sign = (i / COLUMNS + i % COLUMNS) % 2 ? -colour : colour;
  return !(sign * (SIZE(off_down) - SIZE(off_along)) <= 0);
}

/* Predict the nodes: they move on as they moved last. From where a node is taken to be to its
 * corner, or back, is no motion: it keeps the one that it had. Empty what is counted and the bins.
 * One work-item a node or a bin. */
__kernel void predict(const int bin_rows, const int bin_columns,
                      __global const float2 *nodes, __global const uchar *seen_status,
                      __global uchar *last_status, __global float2 *last,
                      __global float2 *predicted, __global int *first_of_bin,
                      __global uint *look_counts, const uint first_count,
                      __global int *tracked) {
  VIEW
  if (i < COUNTED) tracked[view * COUNTED + i] = 0;
  if (i == 0) look_counts[first_count + view] = 0;
  if (i < bin_rows * bin_columns) first_of_bin[BINS + i] = NONE;
  if (i >= NODES) return;
  const float2 here = nodes[OF_NODE];
  const int alike = IS_SEEN(seen_status[OF_NODE]) == IS_SEEN(last_status[OF_NODE]);
  predicted[OF_NODE] = here + ((alike ? here : predicted[OF_NODE]) - last[OF_NODE]);
  last[OF_NODE] = here;
  last_status[OF_NODE] = seen_status[OF_NODE];
}

/* Chain the corners of each bin. One work-item a corner. */
__kernel void place(__global const float *result, const uint stride, const uint room,
                    const float bins_per_px, const int bin_rows, const int bin_columns,
                    __global float4 *corners, __global int *first_of_bin, __global int *next,
                    __global int *claims) {
  VIEW
  RESULT_OF_VIEW(result, stride, room)
  if (i >= min(count, CAPACITY)) return;
  const float4 corner =
      (float4)(fields[2 * i], fields[2 * i + 1], edges[4 * i], sqrt(variances[i]));
  corners[CORNERS + i] = corner;
  const int at = BINS + BIN_ROW(corner.y) * bin_columns + BIN_COLUMN(corner.x);
  claims[CORNERS + i] = 0;
  next[CORNERS + i] = atomic_xchg(first_of_bin + at, i);
}

/* The corners of all views, and the chains of those of each bin. */
#define CORNERS_IN_BINS                                                             \
  __global const float4 *corners, const float bins_per_px, const int bin_rows,       \
      const int bin_columns, __global const int *first_of_bin, __global const int *next

/* Find the allowed corner nearest to a place within `reach`, of equally near ones the first. */
#define NEAREST(place, reach, IS_ALLOWED)                                           \
  int best = NONE;                                                                  \
  float best_2 = (reach) * (reach);                                                 \
  float2 best_off = 0;                                                              \
  for (int y = BIN_ROW((place).y - (reach)); y <= BIN_ROW((place).y + (reach)); ++y) \
    for (int x = BIN_COLUMN((place).x - (reach)); x <= BIN_COLUMN((place).x + (reach)); ++x) \
      for (int j = first_of_bin[BINS + y * bin_columns + x]; j >= 0; j = next[CORNERS + j]) { \
        const float2 off = corners[CORNERS + j].xy - (place);                       \
        const float off_2 = off.x * off.x + off.y * off.y; /* dot is a call on PoCL */  \
        if (!(off_2 < (reach) * (reach)) || !(IS_ALLOWED)) continue;                \
        if (best >= 0 && (off_2 > best_2 || (off_2 == best_2 && j > best))) continue; \
        best = j;                                                                   \
        best_2 = off_2;                                                             \
        best_off = off;                                                             \
      }

/* The corner of each node: the one at its prediction, if it has the node's colour. One work-item a
 * node. */
__kernel void match(CORNERS_IN_BINS, __global const float2 *last,
                    __global const float2 *predicted, __global const int *colour,
                    __global int *nearest, __global float2 *residual, __global int *claims) {
  VIEW
  if (i >= NODES) return;
  STEPS(last + view * NODES)
  const float cell = sqrt(fmin(dot(along, along), dot(down, down)));
  const float2 place = predicted[OF_NODE];
  NEAREST(place, NEAR_CELLS * cell, 1)
  residual[OF_NODE] = best_off;
  if (best >= 0) {
    if (has_colour(corners[CORNERS + best].z, along, down, i, colour[view]))
      atomic_inc(claims + CORNERS + best);
    else best = OTHER_COLOUR;
  }
  nearest[OF_NODE] = best;
}

/* A node keeps its corner if no other node has it, and if its residual is like that of its
 * neighbours; else it moves as they do. One work-item a node. */
__kernel void agree(__global const float4 *corners, __global const float2 *last,
                    __global const float2 *predicted, __global int *nearest,
                    __global const float2 *residual, __global const int *claims,
                    __global float2 *nodes, __global uchar *seen_status,
                    __global float *seen_sigma, __global int *kept,
                    __global int *tracked) {
  VIEW
  if (i >= NODES) return;
  STEPS(last + view * NODES)
  const int near[4] = {before, behind, above, below};
  float2 mean = 0;
  int known = 0;
  for (int k = 0; k < 4; ++k) {
    const int j = nearest[view * NODES + near[k]];
    if (near[k] == i || j < 0 || claims[CORNERS + j] != 1) continue;
    mean += residual[view * NODES + near[k]];
    ++known;
  }
  if (known > 0) mean /= (float)known;
  const float cell_2 = fmin(dot(along, along), dot(down, down));
  const float2 off = residual[OF_NODE] - mean;
  const int j = nearest[OF_NODE];
  const int good = j >= 0 && claims[CORNERS + max(j, 0)] == 1 && known > 0 &&
                   dot(off, off) < ALIKE_CELLS * ALIKE_CELLS * cell_2;
  kept[OF_NODE] = good ? j : NONE;
  nodes[OF_NODE] = good ? corners[CORNERS + j].xy : predicted[OF_NODE] + mean;
  seen_status[OF_NODE] = good ? STATUS_OF(corners[CORNERS + j]) : MISSING;
  seen_sigma[OF_NODE] = good ? corners[CORNERS + j].w : NAN;
  if (good) return;
  __global int *own = tracked + view * COUNTED;
  atomic_inc(own + LOST);
  if (row == 0) atomic_inc(own + GONE);
  if (row == ROWS - 1) atomic_inc(own + GONE + 1);
  if (column == 0) atomic_inc(own + GONE + 2);
  if (column == COLUMNS - 1) atomic_inc(own + GONE + 3);
}

/* Where a node without a corner is: it moved from rest as the surface through the nodes around that
 * have one, those within 3 nodes, 6, 12 and so on until there are enough; far ones are taken at
 * steps. What lost nodes are taken to have done counts for nothing: they would drift away. */
float2 moved_as_others(const int i, __global const float2 *at, __global const float2 *rest,
                       __global const int *kept) {
  const int row = i / COLUMNS, column = i % COLUMNS;
  for (int size = 1;; size *= 2) {
    const int step = max(size / 2, 1);
    Surface around;
    begin_surface(&around);
    for (int y = -3 * size; y <= 3 * size; y += step)
      for (int x = -3 * size; x <= 3 * size; x += step) {
        const int r = row + y, c = column + x, j = r * COLUMNS + c;
        if (r < 0 || c < 0 || r >= ROWS || c >= COLUMNS || kept[j] < 0) continue;
        const float value[K] = {at[j].x - rest[j].x, at[j].y - rest[j].y};
        add_to_surface(&around, 3, (float)y / size, (float)x / size, value);
      }
    if (around.nodes < LEAST_AROUND && 3 * size < max(ROWS, COLUMNS)) continue;
    if (around.nodes == 0) return at[i];
    float moved[K];
    solve_surface(&around, moved);
    return rest[i] + (float2)(moved[0], moved[1]);
  }
}

/* Where the nodes along its row and its column predict node i: with two on both sides of a line the
 * cubic function through them, which weighs four times as much as the middle of one on both sides.
 * Return whether there are such nodes. */
int predicted_by_lines(const int i, __global const float2 *at, float2 *place) {
  float2 sum = 0;
  float weights = 0;
  for (int axis = 0; axis < 2; ++axis) {
    const int n = axis ? i / COLUMNS : i % COLUMNS, last = (axis ? ROWS : COLUMNS) - 1;
    const int step = axis ? COLUMNS : 1, reach = min(min(n, last - n), 2);
    if (reach == 0) continue;
    const float2 near = at[i - step] + at[i + step];
    const float2 far = at[i - reach * step] + at[i + reach * step];
    sum += reach == 2 ? 4 * (4 * near - far) / 6 : near / 2;
    weights += reach == 2 ? 4 : 1;
  }
  *place = sum / weights;
  return weights > 0;
}

/* A node that failed, or that is far from what the nodes around predict, is looked at a second
 * time: refinement starts where it is expected. For that it is listed in `looks` as
 * kernels/result.clh lists corners; `look` is its place in that list, NONE for the others.
 *
 * Free corners where a line beyond a side would be are counted, and failed nodes that have a corner
 * near: where corners moved too far they have one, where they are torn they have none. One
 * work-item a node. */
__kernel void check(CORNERS_IN_BINS, __global const int *claims, __global const int *nearest,
                    __global const int *kept, __global const float2 *nodes,
                    __global const float2 *rest,
                    const int image_rows, const int image_columns, __global float2 *expected,
                    __global int *look, __global int *looks, const uint look_length,
                    __global uint *look_counts, const uint first_count, __global int *tracked) {
  VIEW
  if (i >= NODES) return;
  __global const float2 *at = nodes + view * NODES;
  __global int *own = tracked + view * COUNTED;
  STEPS(at)
  float2 mean;
  const int between = predicted_by_lines(i, at, &mean);
  const float cell = (length(along) + length(down)) / 2, off = length(at[i] - mean);
  const int lost = kept[OF_NODE] < 0;
  const int astray = !lost && between && off > NEAR_CELLS * cell;
  look[OF_NODE] = NONE;
  if (lost) {
    NEAREST(at[i], ADRIFT_CELLS * cell, claims[CORNERS + j] == 0)
    if (best >= 0 || nearest[OF_NODE] != NONE) atomic_inc(own + ADRIFT);
  }
  if (lost || astray) {
    const float2 place =
        astray ? mean : moved_as_others(i, at, rest + view * NODES, kept + view * NODES);
    expected[OF_NODE] = place;
    const float2 last_pixel = (float2)(image_columns - 1, image_rows - 1);
    const float2 start = fmin(fmax(place, 0.0f), last_pixel); /* NaN becomes 0 */
    const int slot = (int)atomic_inc(look_counts + first_count + view);
    look[OF_NODE] = slot;
    __global int *entry = looks + view * LOOKS + slot;
    entry[0] = (int)rint(start.x);
    entry[look_length] = (int)rint(start.y);
    for (int k = 2; k < COLUMNS_OF_LOOK; ++k) entry[k * look_length] = k == 3; /* own centroid */
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

/* A node takes what its second look has found, if it is near the expected place and has the right
 * colour. A corner there that is free, or was its own, is its corner. A node that nothing is found
 * for stays at that place, INTERPOLATED between two neighbours. One work-item a node. */
__kernel void enter(__global const float *look_result, const uint look_stride,
                    CORNERS_IN_BINS, __global const int *claims, __global const int *kept,
                    __global const int *look, __global const float2 *expected,
                    __global const float2 *last, __global const int *colour,
                    __global float2 *nodes, __global uchar *seen_status,
                    __global float *seen_sigma, __global int *owner) {
  VIEW
  if (i >= NODES) return;
  const int n = look[OF_NODE], before_look = kept[OF_NODE];
  owner[OF_NODE] = before_look;
  if (n == NONE) return;
  STEPS(last + view * NODES)
  RESULT_OF_VIEW(look_result, look_stride, LOOKS)
  const float cell = (length(along) + length(down)) / 2;
  const float2 place = expected[OF_NODE];
  if (n < count && refusals[n] == 0 && methods[n] != CENTROID) {
    const float2 found = (float2)(fields[2 * n], fields[2 * n + 1]);
    if (length(found - place) < NEAR_CELLS * cell &&
        has_colour(edges[4 * n], along, down, i, colour[view])) {
      NEAREST(found, SAME_PX, claims[CORNERS + j] == 0 || j == before_look)
      owner[OF_NODE] = best;
      nodes[OF_NODE] = best >= 0 ? corners[CORNERS + best].xy : found;
      seen_status[OF_NODE] = best < 0 ? SECOND_LOOK : STATUS_OF(corners[CORNERS + best]);
      seen_sigma[OF_NODE] = best >= 0 ? corners[CORNERS + best].w : sqrt(variances[n]);
      return;
    }
  }
  const int near[4] = {before, behind, above, below};
  int there[4];
  for (int k = 0; k < 4; ++k) {
    const int j = view * NODES + near[k];
    there[k] = near[k] != i && kept[j] >= 0 && look[j] == NONE;
  }
  owner[OF_NODE] = NONE;
  nodes[OF_NODE] = place;
  seen_status[OF_NODE] = (there[0] && there[1]) || (there[2] && there[3]) ? INTERPOLATED : MISSING;
  seen_sigma[OF_NODE] = NAN;
}
