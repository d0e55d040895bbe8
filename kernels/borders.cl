#include "lattice.clh"

/* The sides of a board (13.6): whether the pattern ends there, and how far its last squares reach.
 *
 * A side is read along squares that share its last two lines of nodes. From one square to the next
 * the colours change, so the difference of two neighbours, with its sign, is the pattern's own
 * signal: it is there inside, it is gone where the pattern ends, and it comes back where cells
 * follow. Decisions rest on sums of levels.
 *
 * Only nodes with a corner are read here. Sides are top, bottom, left, right; line 0 of a side is
 * its last one. */
#define SIDES 4
#define PAIRS 16 /* pairs of neighbouring squares of a side that are read */
#define FIRST_DEPTH 2 /* steps, where the last squares may end */
#define LAST_DEPTH 9
#define UNSEEN INT_MIN
#define WHOLE 4096 /* a share of 1 */
#define REACH(doubled) (BORDER_STEP_CELLS * (1.5f + (float)(doubled) * (0.5f / WHOLE))) /* cells */

/* What is found: the lines of the board, and values of its sides, see `Border`. */
#define BOX_OF 0 /* the first row, one past the last one, and so for columns */
#define ROOM_OF 4
#define FOLLOWS_OF 8
#define REACH_OF 12
#define IN_32THS(v) floor_of(32 * (v) + 0.5f)
#define MAGNITUDE_OF(v) ((int)abs(v))

/* A place, by its line from a side and its number there. box: top, bottom, left, right, the ends
 * not included. */
int place_on(const int side, const int line, const int k, const int4 box, const int width) {
  const int row = side == 0 ? box.x + line : side == 1 ? box.y - 1 - line : box.x + k;
  const int column = side == 2 ? box.z + line : side == 3 ? box.w - 1 - line : box.z + k;
  return row * width + column;
}
#define LINES_OF(side) ((side) < 2 ? box.y - box.x : box.w - box.z)
#define LENGTH_OF(side) LINES_OF((side) ^ 2)

/* Take off the outer lines of a board that hold too few of their places in view. Things beside a
 * pattern continue some of its columns, a further line of the pattern continues all of them; where
 * a thing hides some, half of them are firm. One work-group. */
__kernel void cut_board(const uint rows, const uint columns, __global const int *restrict layout,
                        __global const float2 *restrict result,
                        __global const int *restrict owner, __global const uchar *restrict kind,
                        __global int *restrict border) {
  const int width = layout[BOARD_COLUMNS];
  int4 box = (int4)(0, layout[BOARD_ROWS], 0, width);
  __local int there[SIDES], asked[SIDES], firm[SIDES];
  for (;;) {
    ALL_TOGETHER;
    if (LINES_OF(0) <= 0 || LINES_OF(2) <= 0) {
      box = (int4)(0);
      break;
    }
    FOR_ALL(side, SIDES) there[side] = asked[side] = firm[side] = 0;
    ALL_TOGETHER;
    FOR_ALL(m, SIDES * LARGER(LINES_OF(0), LINES_OF(2))) {
      const int side = m & 3, k = m >> 2;
      if (k >= LENGTH_OF(side)) continue;
      const int place = place_on(side, 0, k, box, width);
      const bool is_here = owner[place] != NONE;
      bool counts = is_here;
      if (!counts && LINES_OF(side) >= 3) {
        const int one = place_on(side, 1, k, box, width);
        const int two = place_on(side, 2, k, box, width);
        const float2 p = 2.0f * result[one] - result[two];
        counts = owner[one] != NONE && owner[two] != NONE && is_readable(p, rows, columns);
      }
      if (is_here) atomic_inc(there + side);
      if (counts) atomic_inc(asked + side);
      if (is_here && kind[place] == FIRM) atomic_inc(firm + side);
    }
    ALL_TOGETHER;
    bool any = false; /* of the lines without a node */
    for (int side = 0; side < SIDES; ++side) any |= !there[side];
    float worst = 0;
    int line = NONE;
    for (int side = 0; side < SIDES && !any; ++side) {
      const float lack = LEAST_LINE * (float)asked[side] - (float)there[side];
      const bool is_hidden = 2 * firm[side] >= asked[side];
      if (lack > worst && !is_hidden && LINES_OF(side) >= 3) {
        worst = lack;
        line = side;
      }
    }
    if (!any && line == NONE) break;
    box.x += any ? !there[0] : line == 0;
    box.y -= any ? !there[1] : line == 1;
    box.z += any ? !there[2] : line == 2;
    box.w -= any ? !there[3] : line == 3;
  }
  if (get_local_id(0) == 0) vstore4(box, 0, border + BOX_OF);
}

/* The position of a corner's node, NAN without one. */
#define NODES_OF_BOARD                                                              \
  __global const float2 *result, __global const int *owner, const int4 box, const int width
#define OF_BOARD result, owner, box, width
#define ON(side, line, k) corner_at(result, owner, place_on(side, line, k, box, width))
float2 corner_at(__global const float2 *result, __global const int *owner, const int place) {
  return owner[place] >= 0 ? result[place] : (float2)(NAN, NAN);
}

bool is_in_view(const float2 p, const uint rows, const uint columns) {
  return p.x >= 0 && p.y >= 0 && p.x < (float)columns && p.y < (float)rows;
}

/* A square at a side: the middle of its side on the last line, and the steps out of the board and
 * along the line, px. */
typedef struct {
  float2 middle, out, along;
} Square;
Square square_at(NODES_OF_BOARD, const int side, const int k) {
  const float2 a = ON(side, 0, k + 1), b = ON(side, 0, k);
  const float2 middle = 0.5f * (a + b), inner = 0.5f * (ON(side, 1, k + 1) + ON(side, 1, k));
  Square found = {middle, middle - inner, a - b};
  return found;
}
#define SQUARE_AT(side, k) square_at(OF_BOARD, side, k)

/* The steps of a tilted board grow from line to line: the last one of a side, in cells that lie
 * past it, if they grow on as they do before. */
float last_over_next(NODES_OF_BOARD, const int side) {
  int last = 0, before = 0; /* 1/32 px */
  for (int k = 0; k < LENGTH_OF(side) && LINES_OF(side) > 2; ++k) {
    const float2 inner = ON(side, 1, k), a = ON(side, 0, k) - inner, b = inner - ON(side, 2, k);
    if (!IS_HERE(a) || !IS_HERE(b)) continue;
    last += IN_32THS(length_of(a));
    before += IN_32THS(length_of(b));
  }
  const float root = inverse_root((float)last);
  return last ? (float)before * (root * root) : 1.0f;
}

/* Twice the median of some numbers. */
int doubled_median(__local const int *values, const int count) {
  int low = 0, high = 0;
  for (int k = 0; k < count; ++k) {
    int less = 0, equal = 0;
    for (int n = 0; n < count; ++n) {
      less += values[n] < values[k];
      equal += values[n] == values[k];
    }
    if (less <= (count - 1) / 2 && (count - 1) / 2 < less + equal) low = values[k];
    if (less <= count / 2 && count / 2 < less + equal) high = values[k];
  }
  return low + high;
}

/* Whether most places of a line before the first one lie in the image; one near to its edge may
 * be missed. */
bool has_room(NODES_OF_BOARD, const int side, const uint rows, const uint columns) {
  int known = 0, inside = 0;
  for (int k = 0; k < LENGTH_OF(side); ++k) {
    int line = 0;
    while (line < LINES_OF(side) - 1 && !IS_HERE(ON(side, line, k))) ++line;
    if (line == LINES_OF(side) - 1) continue;
    const float2 one = ON(side, line, k), two = ON(side, line + 1, k);
    if (!IS_HERE(two)) continue;
    ++known;
    inside += is_in_view(one + BEYOND_CELLS * (one - two), rows, columns);
  }
  return 2 * inside > known;
}

/* How far pairs of squares reach, twice the sum of their shares; UNSEEN if the medians of both
 * halves of a side differ by over a step, as along an oblique edge. */
int common_reach(__local const int *reach, const int count) {
  const int common = doubled_median(reach, count), part = (count + 1) / 2;
  const int apart = doubled_median(reach, part) - doubled_median(reach + count - part, part);
  return MAGNITUDE_OF(apart) <= 2 * WHOLE ? common : UNSEEN;
}

/* The level of a square so many steps out of the board, summed over three spots. */
int level_of(LEVELS_OF_IMAGE, const Square square, const float out) {
  int sum = 0;
  for (int spot = -1; spot <= 1; ++spot) {
    const float2 p =
        (square.middle + out * square.out) + BORDER_STEP_CELLS * (float)spot * square.along;
    sum += level_at(LEVELS, p.x, p.y);
  }
  return sum;
}

/* What is read of a pair of squares: their differences half a cell inside and beyond, how much both
 * change from there to there, and the share of the depths at which they differ. */
int4 read_pair(LEVELS_OF_IMAGE, const Square one, const Square two) {
  const int a = level_of(LEVELS, one, -0.5f), b = level_of(LEVELS, two, -0.5f);
  const int c = level_of(LEVELS, one, BEYOND_CELLS), d = level_of(LEVELS, two, BEYOND_CELLS);
  const int inside = LARGER(MAGNITUDE_OF(a - b), 1);
  int reach = 0;
  for (int k = FIRST_DEPTH; k <= LAST_DEPTH; ++k) {
    const float out = BORDER_STEP_CELLS * (float)k;
    const int apart = MAGNITUDE_OF(level_of(LEVELS, one, out) - level_of(LEVELS, two, out));
    reach += SMALLER(apart, inside) * WHOLE / inside;
  }
  return (int4)(a - b, c - d, MAGNITUDE_OF(a - c) + MAGNITUDE_OF(b - d), reach);
}

/* Measure the sides of a board. One work-group. */
__kernel void measure_border(LEVELS_OF_IMAGE, __global const int *restrict layout,
                             __global const float2 *restrict result,
                             __global const int *restrict owner, __global int *restrict border) {
  const int width = layout[BOARD_COLUMNS];
  const int4 box = vload4(0, border + BOX_OF);
  __local int4 pair[SIDES * PAIRS];
  __local int shown[SIDES * PAIRS], reaches[SIDES * PAIRS];
  FOR_ALL(m, SIDES * PAIRS) { /* as many of the pairs, evenly along their side */
    const int side = m / PAIRS, n = m % PAIRS;
    const int pairs = LINES_OF(side) > 1 ? LENGTH_OF(side) - 2 : 0;
    shown[m] = 0;
    if (n >= pairs) continue;
    const int first = n * pairs / SMALLER(pairs, PAIRS), odd = first & 1;
    const Square one = SQUARE_AT(side, first + odd), two = SQUARE_AT(side, first + !odd);
    shown[m] = is_in_view(one.middle + BEYOND_CELLS * one.out, rows, columns) &&
               is_in_view(two.middle + BEYOND_CELLS * two.out, rows, columns);
    if (shown[m]) pair[m] = read_pair(LEVELS, one, two);
  }
  ALL_TOGETHER;
  FOR_ALL(side, SIDES) {
    __local int *reach_of = reaches + side * PAIRS;
    int4 sum = (int4)(0);
    int some = 0;
    for (int m = side * PAIRS; m < (side + 1) * PAIRS; ++m) {
      if (!shown[m]) continue;
      sum += pair[m];
      reach_of[some++] = pair[m].w;
    }
    border[ROOM_OF + side] = has_room(OF_BOARD, side, rows, columns);
    const float whole = (float)MAGNITUDE_OF(sum.x);
    int reached = some && (float)MAGNITUDE_OF(sum.y) < PASSING * whole
                      ? common_reach(reach_of, some)
                      : UNSEEN;
    /* What reaches farther than a square is not the last one. */
    const float reach = REACH(reached) * last_over_next(OF_BOARD, side);
    if (reach > 1 + BORDER_STEP_CELLS) reached = UNSEEN;
    border[FOLLOWS_OF + side] = some && (float)sum.z < 2.0f * PASSING * whole;
    border[REACH_OF + side] = reached == UNSEEN ? UNSEEN : floor_of(WHOLE * reach);
  }
}
