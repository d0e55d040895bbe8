#include "lattice.clh"

/* Nodes of a board (13.5): an array of places with a margin of missing ones. Its nodes are dropped
 * and found in rounds, by one score. A round has passes that drop nodes, until none drops any, and
 * one that looks for nodes in the places beside others. All nodes are measured at first, one
 * work-item each; then one work-group settles the board, and measures anew what changes.
 *
 * seen: the position of a node, NAN where it is missing. owner: its corner, NONE, or PLACE if no
 * corner is there. torn: refinement of that position was rejected. at: the same position, if torn
 * blended with the one that the neighbours predict; what nodes are judged by. */
#define PLACE (-2)
#define MARGIN (ROUNDS + 2) /* places beside the first board: those that are looked at last */
#define NEAR 2 /* the farthest that a node looks */

/* Where the neighbours predict a place: the mean of what some of them predict, and its weight. */
typedef struct {
  float2 at;
  float weight;
} Prediction;

/* Four cells around a place: the least bright level less the greatest dark one, and twice their
 * contrast, UNKNOWN where there is no node, or no step. */
typedef struct {
  int quality, contrast;
} Cells;
#define UNKNOWN INT_MIN

/* What is known of the places of a board. */
#define PLACES_OF_BOARD                                                             \
  __global float2 *seen, __global uchar *torn, __global float2 *at,                 \
      __global Prediction *predictions, __global float *cell, __global int2 *sides, \
      __global Cells *cells, __global float *score
#define PLACES seen, torn, at, predictions, cell, sides, cells, score

/* Lay the numbered corners out as a board, which is empty while parts wait to be placed beside
 * others. One work-group. */
#define TAKEN (-1) /* in the fourth place: a corner of another board, which the host puts */
__kernel void lay_board(__global const float *restrict corners, const uint capacity,
                        __global const int4 *restrict numbers, const int places,
                        __global int *restrict layout, __global float2 *restrict seen,
                        __global int *restrict owner, __global uchar *restrict torn,
                        __global uchar *restrict used, __global int *restrict claim,
                        __global int *restrict marks) {
  const int count = (int)COUNT(corners);
  __local int left, right, top, bottom, sum;
  if (get_local_id(0) == 0) {
    left = top = INT_MAX;
    right = bottom = INT_MIN;
    sum = 0;
  }
  ALL_TOGETHER;
  int least_x = INT_MAX, most_x = INT_MIN, least_y = INT_MAX, most_y = INT_MIN;
  FOR_ALL(i, count) {
    const int4 n = numbers[i];
    used[i] = n.w == TAKEN;
    claim[i] = INT_MAX;
    if (n.w != 1) continue;
    least_x = SMALLER(least_x, n.x);
    most_x = LARGER(most_x, n.x);
    least_y = SMALLER(least_y, n.y);
    most_y = LARGER(most_y, n.y);
  }
  atomic_min(&left, least_x);
  atomic_max(&right, most_x);
  atomic_min(&top, least_y);
  atomic_max(&bottom, most_y);
  ALL_TOGETHER;
  const long across = (long)right - left + 1 + 2 * MARGIN;
  const long down = (long)bottom - top + 1 + 2 * MARGIN;
  const bool fits = right >= left && layout[PARTS] < 2 && across * down <= places;
  const int width = fits ? across : 0, height = fits ? down : 0, all = width * height;
  const int origin_x = left - MARGIN, origin_y = top - MARGIN;
  FOR_ALL(place, all) owner[place] = INT_MAX;
  ALL_TOGETHER;
  FOR_ALL(i, all ? count : 0) {
    const int4 n = numbers[i];
    if (n.w == 1) atomic_min(owner + (n.y - origin_y) * width + n.x - origin_x, i);
  }
  ALL_TOGETHER;
  FOR_ALL(place, all) {
    const int i = owner[place];
    seen[place] = (float2)(NAN, NAN);
    torn[place] = 0;
    marks[place] = 0;
    if (i == INT_MAX) {
      owner[place] = NONE;
      continue;
    }
    const int4 n = numbers[i];
    seen[place] = POSITIONS(corners)[i];
    torn[place] = IS_TORN(i);
    used[i] = 1;
    atomic_add(&sum, (n.z ^ (n.x - origin_x + n.y - origin_y)) & 1 ? -1 : 1);
  }
  ALL_TOGETHER;
  if (get_local_id(0)) return;
  layout[BOARD_ROWS] = height;
  layout[BOARD_COLUMNS] = width;
  layout[SIGN] = sum < 0 ? -1 : 1;
}

/* The places of a board, but for some at its edge, row by row. */
#define FOR_PLACES(edge)                                                            \
  const int width = layout[BOARD_COLUMNS], height = layout[BOARD_ROWS];             \
  for (int row = (edge) + get_global_id(1); row < height - (edge); row += get_global_size(1)) \
    for (int column = (edge) + get_global_id(0); column < width - (edge);           \
         column += get_global_size(0))
#define PLACE_OF_WORK_ITEM const int place = row * width + column;

#define AT(rows, columns) at[place + (rows) * width + (columns)]
#define CUBIC(DO, r, c)                                                             \
  DO(CUBIC_WEIGHT, BY_4 * AT(-(r), -(c)) + BY_4 * AT(r, c) + BY_1 * AT(-2 * (r), -2 * (c)) + \
                       BY_1 * AT(2 * (r), 2 * (c)))                                 \
  DO(MIDDLE_WEIGHT, 0.5f * AT(-(r), -(c)) + 0.5f * AT(r, c))
#define CORNER_OF_CELL(DO, r, c) DO(CELL_WEIGHT, AT(r, 0) + AT(0, c) - AT(r, c))
#define BEYOND(DO, r, c) DO(BEYOND_WEIGHT, 2.0f * AT(r, c) - AT(2 * (r), 2 * (c)))
#define BY_4 (4.0f / 6.0f)
#define BY_1 (-1.0f / 6.0f)
#define PREDICTIONS(DO)                                                             \
  CUBIC(DO, 0, 1) CUBIC(DO, 1, 0)                                                   \
  CORNER_OF_CELL(DO, 1, 1) CORNER_OF_CELL(DO, 1, -1) CORNER_OF_CELL(DO, -1, 1)      \
  CORNER_OF_CELL(DO, -1, -1) BEYOND(DO, 0, 1) BEYOND(DO, 1, 0) BEYOND(DO, 0, -1) BEYOND(DO, -1, 0)
Prediction predicted(__global const float2 *at, const int place, const int width) {
  float2 total = (float2)(0.0f);
  float weight = 0;
#define ADD_POSITION(share, position)                                               \
  {                                                                                 \
    const float2 p = position;                                                      \
    if (IS_HERE(p)) {                                                               \
      total += share * p;                                                           \
      weight += share;                                                              \
    }                                                                               \
  }
  PREDICTIONS(ADD_POSITION)
  const float root = inverse_root(LARGER(weight, 0.5f));
  Prediction found = {total * (root * root), weight};
  return found;
}
/* The variance of what they predict, px^2 per axis. */
float scatter_of(__global const float2 *at, const int place, const int width,
                 const Prediction mean) {
  float total = 0;
#define ADD_SQUARE(share, position)                                                 \
  {                                                                                 \
    const float2 off = position - mean.at;                                          \
    if (IS_HERE(off)) total += share * (off.x * off.x + off.y * off.y);             \
  }
  PREDICTIONS(ADD_SQUARE)
  const float root = inverse_root(LARGER(mean.weight, 0.5f));
  return (0.5f * total) * (root * root);
}

/* Steps of the lattice at a place, to the next column and to the next row, and the mean of their
 * lengths, the cell. Where a place has no step of its own it is the mean of those within 3 x 3
 * places. */
typedef struct {
  float2 u, v;
  float cell;
  bool known;
} Steps;
int add_steps(__global const float2 *at, const int place, const int ahead, float2 *total) {
  const float2 here = at[place];
  if (!IS_HERE(here)) return 0;
  const float2 after = at[place + ahead] - here, before = here - at[place - ahead];
  const bool is_after = IS_HERE(after), is_before = IS_HERE(before);
  *total += (is_after ? after : (float2)(0.0f)) + (is_before ? before : (float2)(0.0f));
  return is_after + is_before;
}
bool step_of(__global const float2 *at, const int place, const int width, const int ahead,
             float2 *step) {
  *step = (float2)(0.0f);
  int count = add_steps(at, place, ahead, step);
  if (count == 2) *step *= 0.5f;
  if (count) return true;
  for (int r = -1; r <= 1; ++r)
    for (int c = -1; c <= 1; ++c) count += add_steps(at, place + r * width + c, ahead, step);
  const float root = inverse_root((float)LARGER(count, 1));
  *step *= root * root;
  return count > 0;
}
bool is_beside_nodes(__global const float2 *at, const int place, const int width) {
  return IS_HERE(at[place + 1]) || IS_HERE(at[place - 1]) || IS_HERE(at[place + width]) ||
         IS_HERE(at[place - width]);
}
Steps steps_of(__global const float2 *at, const int place, const int width) {
  Steps found;
  const bool across = step_of(at, place, width, 1, &found.u);
  const bool down = step_of(at, place, width, width, &found.v);
  found.cell = 0.5f * (length_of(found.u) + length_of(found.v));
  found.known = across && down;
  return found;
}

/* A rough position enters the mean of the predictions as one more. Its error is of some pixels,
 * that of a prediction of some share of a cell, so its weight is that of the cell's area. */
float2 blended(const float2 seen, const Prediction prediction, const float cell) {
  if (!(prediction.weight > 0)) return seen;
  const float root = inverse_root(prediction.weight + ROUGH_WEIGHT_PER_PX2 * (cell * cell));
  const float share = prediction.weight * (root * root);
  return seen + share * (prediction.at - seen);
}

/* Blend the position of a node, if torn, with its prediction. Returns whether `at` changes. */
bool blend(PLACES_OF_BOARD, const int width, const int place) {
  const float2 here = seen[place], before = at[place];
  float2 judged = here;
  if (IS_HERE(here)) {
    const Prediction prediction = predictions[place] = predicted(seen, place, width);
    if (torn[place]) judged = blended(here, prediction, steps_of(seen, place, width).cell);
  }
  at[place] = judged;
  return as_int(judged.x) != as_int(before.x) || as_int(judged.y) != as_int(before.y);
}

__kernel void blend_nodes(__global const int *restrict layout, PLACES_OF_BOARD) {
  FOR_PLACES(0) {
    PLACE_OF_WORK_ITEM
    blend(PLACES, width, place);
  }
}

/* The four cells at a point, in the diagonals of these steps. */
Cells cells_at(LEVELS_OF_IMAGE, const float2 at, const Steps steps, const int parity) {
  const float share = depth_within(CELL_DEPTH, inverse_root(LARGER(steps.cell * steps.cell, 1.0f)));
  const float2 s = share * (steps.u + steps.v), t = share * (steps.v - steps.u);
  const int a = level_at(LEVELS, at.x + s.x, at.y + s.y);
  const int b = level_at(LEVELS, at.x - s.x, at.y - s.y);
  const int c = level_at(LEVELS, at.x + t.x, at.y + t.y);
  const int d = level_at(LEVELS, at.x - t.x, at.y - t.y);
  const int least = SMALLER(c, d) - LARGER(a, b), other = SMALLER(a, b) - LARGER(c, d);
  Cells found = {parity > 0 ? least : other, ((c + d) - (a + b)) * parity};
  return found;
}

/* The side from a node to the next: near it, and if that shows less than half of the node's
 * contrast deeper in the cells too, as beside a tab, or where the side bends. */
int side_between(LEVELS_OF_IMAGE, const float2 a, const float2 b, const int sign,
                 const int contrast) {
  const int near = sign * difference(LEVELS, a, b, WHOLE_SIDE);
  if (4 * near >= 5 * contrast) return near; /* five points, and twice the contrast */
  return LARGER(near, sign * difference_within(LEVELS, a, b, WHOLE_SIDE, DEEP_CELLS));
}

/* Measure the steps, sides and cells of a node. */
#define PARITY_OF(row, column) (((row) + (column)) & 1 ? -layout[SIGN] : layout[SIGN])
void measure(LEVELS_OF_IMAGE, PLACES_OF_BOARD, const int width, const int place, const int parity) {
  int2 side = (int2)(0);
  Cells found = {0, UNKNOWN};
  const float2 here = at[place];
  if (IS_HERE(here)) {
    const Steps steps = steps_of(at, place, width);
    found = cells_at(LEVELS, here, steps, parity);
    cell[place] = steps.cell;
    for (int down = 0; down < 2; ++down) { /* a loop, since a call in it is compiled once */
      const float2 next = at[place + (down ? width : 1)];
      if (!IS_HERE(next)) continue;
      const int sign = down ? -parity : parity;
      const int sum = side_between(LEVELS, here, next, sign, found.contrast);
      side = down ? (int2)(side.x, sum) : (int2)(sum, side.y);
    }
    if (!steps.known) found.contrast = UNKNOWN;
  }
  sides[place] = side;
  cells[place] = found;
}

__kernel void measure_nodes(LEVELS_OF_IMAGE, __global const int *restrict layout,
                            PLACES_OF_BOARD) {
  FOR_PLACES(0) {
    PLACE_OF_WORK_ITEM
    measure(LEVELS, PLACES, width, place, PARITY_OF(row, column));
  }
}

/* Two over the mean contrast of the nodes within 5 x 5 places. */
float usual_share(__global const Cells *cells, const int place, const int width) {
  int sum = 0, count = 0;
  for (int r = -2; r <= 2; ++r)
    for (int c = -2; c <= 2; ++c) {
      const int contrast = cells[place + r * width + c].contrast;
      sum += contrast == UNKNOWN ? 0 : contrast;
      count += contrast != UNKNOWN;
    }
  count = LARGER(count, 1);
  sum = LARGER(sum, count);
  const float root = inverse_root((float)sum);
  return (float)(2 * count) * (root * root);
}

/* The score of a node in nats, below 0 if it is less likely than not: its sides, its cells, and its
 * distance from the prediction, which counts more if it is torn; a torn one is less likely.
 * PENALTY is 1 / (2 SD_CELLS^2). */
float score_of(const float sides, const int quality, const float share, const float2 seen,
               const bool is_torn, const Prediction prediction, const float cell) {
  const float cells = SMALLER((float)quality * share, 1.0f);
  const float2 d = seen - prediction.at;
  const float root = inverse_root(LARGER(cell * cell, 1e-6f));
  const float misfit = prediction.weight > 0 ? (d.x * d.x + d.y * d.y) * (root * root) : 0.0f;
  const float prior = is_torn ? PRIOR_NATS - TORN_NATS : PRIOR_NATS;
  return ((SIDE_NATS * sides + CELLS_NATS * cells) + prior) -
         misfit * (is_torn ? 4 * PENALTY : PENALTY);
}

/* The score of a node; no node has a score of 99. */
#define NO_SCORE 99.0f
#define ADD_SIDE(neighbour, sum)                                                    \
  if (IS_HERE(at[neighbour])) whole += SMALLER(((float)(sum) * share) * OF_POINTS, 1.0f);
void score_node(PLACES_OF_BOARD, const int width, const int place) {
  float own = NO_SCORE;
  if (IS_HERE(at[place])) {
    const float share = usual_share(cells, place, width);
    float whole = 0;
    ADD_SIDE(place + 1, sides[place].x)
    ADD_SIDE(place + width, sides[place].y)
    ADD_SIDE(place - 1, sides[place - 1].x)
    ADD_SIDE(place - width, sides[place - width].y)
    own = score_of(whole, cells[place].quality, share, seen[place], torn[place], predictions[place],
                   cell[place]);
  }
  score[place] = own;
}

__kernel void score_nodes(__global const int *restrict layout, PLACES_OF_BOARD) {
  FOR_PLACES(1) {
    PLACE_OF_WORK_ITEM
    score_node(PLACES, width, place);
  }
}

/* A node that a missing place beside another may have: its corner, PLACE or NONE, and its position.
 * nearest: the corner there that decides, NONE without one. */
typedef struct {
  int owner, nearest;
  float2 at;
} Candidate;
bool is_readable(const float2 p, const uint rows, const uint columns) {
  const float edge = CONTRAST_RADIUS_PX;
  return p.x > edge && p.y > edge && p.x < (float)((int)columns - 1) - edge &&
         p.y < (float)((int)rows - 1) - edge;
}
Candidate candidate_at(__global const float *corners, const uint capacity, LEVELS_OF_IMAGE,
                       __global const int *layout, const int width, const int place,
                       const int parity, __global const int *starts, __global const int *binned,
                       __global const float2 *at, __global const Cells *cells,
                       __global const uchar *used) {
  Candidate found = {NONE, NONE, (float2)(0.0f)};
  if (!is_beside_nodes(at, place, width)) return found;
  const Prediction prediction = predicted(at, place, width);
  const float2 p = prediction.at;
  if (!(prediction.weight > 0) || !is_readable(p, rows, columns)) return found;
  const Steps steps = steps_of(at, place, width);
  if (!steps.known) return found;
  found.nearest = nearest_corner(corners, capacity, layout, starts, binned, rows, columns, p,
                                 REACH_CELLS * steps.cell);
  const bool is_free = found.nearest != NONE && !used[found.nearest];
  float2 here = found.at = is_free ? POSITIONS(corners)[found.nearest] : p;
  const bool is_torn = !is_free || IS_TORN(found.nearest);
  if (is_free && is_torn) here = blended(here, prediction, steps.cell);
  const Cells seen = cells_at(LEVELS, here, steps, parity);
  const float share = usual_share(cells, place, width);
  float whole = 0;
  for (int side = 0; side < 4; ++side) { /* to the right, below, to the left, above */
    const int step = side & 1 ? width : 1;
    const float2 next = at[side < 2 ? place + step : place - step];
    if (!IS_HERE(next)) continue;
    const int sum = difference(LEVELS, side < 2 ? here : next, side < 2 ? next : here, WHOLE_SIDE);
    const int sign = side == 1 || side == 2 ? -parity : parity;
    whole += SMALLER(((float)(sign * sum) * share) * OF_POINTS, 1.0f);
  }
  const float score =
      score_of(whole, seen.quality, share, found.at, is_torn, prediction, steps.cell);
  if (!(score < 0)) found.owner = is_free ? found.nearest : PLACE;
  return found;
}

/* Lists of places, and the bit that a place in one of them has in `marks`, so that it is listed
 * once. One work-group. */
enum { CHANGED, MOVED, BLENDED, MEASURED, SCORED, JUDGED, LOOKED, ASKING, LISTS };
#define LIST_OF(kind) (lists + (kind) * places)
#define FOR_LISTED(kind)                                                            \
  for (int k = get_local_id(0), place; k < counts[kind]; k += get_local_size(0))    \
    if (place = LIST_OF(kind)[k], true)
#define LISTS_OF_PLACES                                                             \
  __global volatile int *marks, __global int *lists, const int places, __local volatile int *counts
#define OF_PLACES marks, lists, places, counts
__attribute__((noinline)) void list_place(LISTS_OF_PLACES, const int kind, const int place) {
  if (READ(marks + place) >> kind & 1 || atomic_or(marks + place, 1 << kind) >> kind & 1) return;
  LIST_OF(kind)[atomic_add(counts + kind, 1)] = place;
}
/* Empty a list, once all work-items have read it. */
void empty_list(LISTS_OF_PLACES, const int kind) {
  FOR_LISTED(kind) atomic_and(marks + place, ~(1 << kind));
  ALL_TOGETHER;
  if (get_local_id(0) == 0) counts[kind] = 0;
}
/* List listed places as another kind, and the nodes within so many steps of them; and the missing
 * places there, to look at. A node without a step of its own along an axis takes those of the nodes
 * near it. */
#define SQUARE(reach)                                                               \
  for (int r = -(reach); r <= (reach); ++r)                                         \
    for (int c = -(reach); c <= (reach); ++c)
bool has_steps(__global const float2 *seen, const int place, const int width) {
  return (IS_HERE(seen[place + 1]) || IS_HERE(seen[place - 1])) &&
         (IS_HERE(seen[place + width]) || IS_HERE(seen[place - width]));
}
void list_around(LISTS_OF_PLACES, const int from, const int reach, const int steps, const int kind,
                 const int width, __global const float2 *seen) {
  FOR_LISTED(from) SQUARE(reach) {
    const int other = place + r * width + c;
    const bool is_node = IS_HERE(seen[other]), is_near = r * r + c * c <= steps * steps;
    if (other == place || (is_node && (is_near || !has_steps(seen, other, width))))
      list_place(OF_PLACES, kind, other);
    if (!is_node) list_place(OF_PLACES, LOOKED, other);
  }
  ALL_TOGETHER;
}
/* Drop nodes and find others until nothing changes, or the rounds are over; the positions are
 * blended, and cells measured, once more then. One work-group.
 *
 * What is known of a place depends on `seen` near it, then on `at`, then on cells within two
 * places; so only places near a change are measured, scored, judged and looked at again. asked: the
 * corner that decided at a place without a node, and whether it was used. claim: the first of the
 * places that may take a corner. */
#define ASKED(corner) (2 * (corner) + used[corner])
__kernel void settle_nodes(__global const float *restrict corners, const uint capacity,
                           LEVELS_OF_IMAGE, __global const int *restrict starts,
                           __global const int *restrict binned,
                           __global int *restrict layout, PLACES_OF_BOARD, __global int *owner,
                           __global uchar *used, __global int *candidate,
                           __global float2 *found, __global int *listed, __global int *asked,
                           __global int *claim, __global int *marks, __global int *lists,
                           const int places) {
  const int width = layout[BOARD_COLUMNS], height = layout[BOARD_ROWS];
  __local int counts[LISTS], candidates;
  FOR_ALL(kind, LISTS) counts[kind] = 0;
  ALL_TOGETHER;
  const int edge = MARGIN - 1; /* there is no node beyond it yet */
  const int down = LARGER(height - 2 * edge, 0), across = LARGER(width - 2 * edge, 0);
  FOR_ALL(k, down * across) {
    const int place = (edge + k / across) * width + edge + k % across;
    if (!IS_HERE(seen[place])) {
      if (is_beside_nodes(seen, place, width)) list_place(OF_PLACES, LOOKED, place);
    } else if (score[place] < 0) {
      list_place(OF_PLACES, JUDGED, place);
    }
  }
  ALL_TOGETHER;
  for (int round = 1;;) {
    FOR_LISTED(JUDGED) {
      if (owner[place] >= 0) used[owner[place]] = 0;
      owner[place] = NONE;
      seen[place] = (float2)(NAN, NAN);
      torn[place] = 0;
      list_place(OF_PLACES, CHANGED, place);
    }
    if (get_local_id(0) == 0) candidates = 0;
    ALL_TOGETHER;
    empty_list(OF_PLACES, JUDGED);
    const bool looks = !counts[CHANGED];
    if (looks) {
      FOR_LISTED(ASKING)
        if (asked[place] != ASKED(asked[place] / 2)) list_place(OF_PLACES, LOOKED, place);
      ALL_TOGETHER;
      FOR_LISTED(LOOKED) {
        if (IS_HERE(at[place])) continue;
        const Candidate own = candidate_at(corners, capacity, LEVELS, layout, width, place,
                                           PARITY_OF(place / width, place % width), starts, binned,
                                           at, cells, used);
        if (own.nearest != NONE) {
          asked[place] = ASKED(own.nearest);
          list_place(OF_PLACES, ASKING, place);
        }
        if (own.owner == NONE) continue;
        candidate[place] = own.owner;
        found[place] = own.at;
        if (own.owner != PLACE) atomic_min(claim + own.owner, place);
        listed[atomic_add(&candidates, 1)] = place;
      }
      ALL_TOGETHER;
      empty_list(OF_PLACES, LOOKED);
    }
    FOR_ALL(k, candidates) {
      const int place = listed[k], own = candidate[place];
      if (own >= 0 && claim[own] != place) continue;
      owner[place] = own;
      seen[place] = found[place];
      torn[place] = own == PLACE || IS_TORN(own);
      if (own >= 0) used[own] = 1;
      list_place(OF_PLACES, CHANGED, place);
    }
    ALL_TOGETHER;
    FOR_ALL(k, candidates) {
      const int own = candidate[listed[k]];
      if (own >= 0) claim[own] = INT_MAX;
    }
    if (!counts[CHANGED]) return;
    list_around(OF_PLACES, CHANGED, NEAR, 2, BLENDED, width, seen);
    FOR_LISTED(BLENDED)
      if (blend(PLACES, width, place)) list_place(OF_PLACES, MOVED, place);
    ALL_TOGETHER;
    list_around(OF_PLACES, MOVED, NEAR, 1, MEASURED, width, seen);
    FOR_LISTED(MEASURED)
      measure(LEVELS, PLACES, width, place, PARITY_OF(place / width, place % width));
    if (looks && round++ == ROUNDS) return;
    FOR_LISTED(BLENDED) list_place(OF_PLACES, SCORED, place);
    ALL_TOGETHER;
    list_around(OF_PLACES, MEASURED, NEAR, 3, SCORED, width, seen);
    FOR_LISTED(SCORED) {
      score_node(PLACES, width, place);
      if (score[place] < 0) list_place(OF_PLACES, JUDGED, place);
    }
    ALL_TOGETHER;
    for (int kind = CHANGED; kind <= SCORED; ++kind) empty_list(OF_PLACES, kind);
    ALL_TOGETHER;
  }
}

/* Of each node of the settled board: result, its position, blended if it is rough: torn, or far from
 * its prediction; a wrong neighbour may still mislead it. spread: the variance that its neighbours
 * leave it, px^2 per axis, 0 of others. kind: ROUGH, or FIRM: a corner, not rough, whose two cells of
 * each colour are alike.
 *
 * A rough corner that fits the corner model is worn, or the surface bends sharply there: what its
 * neighbours predict scatters then, and counts as much less as it does so more than wear moves a
 * corner. */
#define ROUGH 1
#define FIRM 2
__kernel void weigh_nodes(__global const float *restrict corners, const uint capacity,
                          __global const int *restrict layout, PLACES_OF_BOARD,
                          __global const int *restrict owner, __global float2 *restrict result,
                          __global float *restrict spread, __global uchar *restrict kind) {
  FOR_PLACES(0) {
    PLACE_OF_WORK_ITEM
    const float2 here = seen[place];
    result[place] = here;
    spread[place] = kind[place] = 0;
    if (!IS_HERE(here)) continue;
    const int corner = owner[place];
    const Prediction prediction = predictions[place];
    const float size = steps_of(seen, place, width).cell, limit = NEAR_CELLS * size;
    const float2 away = here - prediction.at;
    if (!torn[place] && !(away.x * away.x + away.y * away.y > limit * limit)) {
      const float quality = 2 * cells[place].quality, contrast = cells[place].contrast;
      const bool is_alike = contrast > 0 && quality > (1.0f - PASSING) * contrast;
      if (corner >= 0 && is_alike) kind[place] = FIRM;
      continue;
    }
    kind[place] = ROUGH;
    const float2 blend = result[place] = blended(here, prediction, size);
    if (corner < 0 || IS_TORN(corner)) continue;
    const float sigma = sqrt(FIELD(corners, VARIANCE_FIELD)[corner]);
    if (!(sigma < FLT_MAX)) continue; /* unknown */
    const float worn = WORN_SIGMAS * sigma, wear = worn * worn;
    const float scatter = scatter_of(seen, place, width, prediction);
    const float root = inverse_root(LARGER(wear + scatter, 1e-12f)), share = wear * (root * root);
    result[place] = here + share * (blend - here);
    spread[place] = share * scatter;
  }
}
