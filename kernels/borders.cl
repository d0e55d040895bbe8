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
#define PAIRS 16  /* pairs of neighbouring squares of a side that are read */
#define DEPTHS 10 /* half a cell inside, beyond, and in steps of levels where squares may end */
#define NEAR_DEPTH 2
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
#define IS_SQUARE(square) IS_HERE((square).out)

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

/* Which pairs of squares a side has in sight, as far as some cells beyond it. Returns their
 * number. */
#define PAIRS_IN_SIGHT(side, sight)                                                 \
  pairs_in_sight(OF_BOARD, side, own, pairs[side], sight, rows, columns, own_shown)
int pairs_in_sight(NODES_OF_BOARD, const int side, __local const int *first, const int pairs,
                   const float sight, const uint rows, const uint columns, __local int *shown) {
  int seen = 0;
  for (int n = 0; n < pairs; ++n) {
    const Square one = SQUARE_AT(side, first[n]), two = SQUARE_AT(side, first[n] + 1);
    shown[n] = is_in_view(one.middle + sight * one.out, rows, columns) &&
               is_in_view(two.middle + sight * two.out, rows, columns);
    seen += shown[n];
  }
  return seen;
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

/* Squares of a side, in pairs of neighbours; `first` has those of the pairs that are read. Returns
 * their number. */
int list_pairs(NODES_OF_BOARD, const int side, __local int *first) {
  int pairs = 0;
  bool before = false;
  for (int k = 0; k < LENGTH_OF(side) - 1; ++k) {
    const bool is_square = IS_SQUARE(SQUARE_AT(side, k));
    pairs += is_square && before;
    before = is_square;
  }
  const int read = SMALLER(pairs, PAIRS);
  before = false;
  for (int k = 0, pair = 0, n = 0; n < read; ++k) {
    const bool is_square = IS_SQUARE(SQUARE_AT(side, k));
    if (is_square && before && pair++ == n * pairs / read) first[n++] = k - 1;
    before = is_square;
  }
  return read;
}

/* Whether most places of a line before the first one lie in the image; one nearer to its edge than
 * half a cell may be missed. */
bool has_room(NODES_OF_BOARD, const int side, const uint rows, const uint columns) {
  int known = 0, inside = 0;
  for (int k = 0; k < LENGTH_OF(side); ++k) {
    int line = 0;
    while (line < LINES_OF(side) - 1 && !IS_HERE(ON(side, line, k))) ++line;
    if (line == LINES_OF(side) - 1) continue;
    const float2 one = ON(side, line, k), two = ON(side, line + 1, k);
    if (!IS_HERE(two)) continue;
    ++known;
    inside += is_in_view(one + FAR_CELL * (one - two), rows, columns);
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

/* Measure the sides of a board. One work-group. */
__kernel void measure_border(LEVELS_OF_IMAGE, __global const int *restrict layout,
                             __global const float2 *restrict result,
                             __global const int *restrict owner, __global int *restrict border) {
  const int width = layout[BOARD_COLUMNS];
  const int4 box = vload4(0, border + BOX_OF);
  __local int first[SIDES * PAIRS], pairs[SIDES], near[SIDES], shown[SIDES * PAIRS];
  __local int sums[SIDES * PAIRS * DEPTHS * 2], squares[SIDES * PAIRS];
  FOR_ALL(side, SIDES) {
    const bool has_squares = LINES_OF(side) > 1 && LENGTH_OF(side) > 1;
    border[ROOM_OF + side] = has_room(OF_BOARD, side, rows, columns);
    pairs[side] = has_squares ? list_pairs(OF_BOARD, side, first + side * PAIRS) : 0;
  }
  ALL_TOGETHER;
  FOR_ALL(side, SIDES) { /* the image may end before the cells beyond a whole square */
    __local const int *own = first + side * PAIRS;
    __local int *own_shown = shown + side * PAIRS;
    const int seen = PAIRS_IN_SIGHT(side, FAR_CELL);
    near[side] = 2 * seen < pairs[side];
    if (near[side]) PAIRS_IN_SIGHT(side, NEAR_CELL);
  }
  ALL_TOGETHER;
#define LEVEL(n, depth, square) sums[((n) * 2 + (square)) * DEPTHS + (depth)]
  FOR_ALL(m, SIDES * PAIRS * 2) {
    const int pair = m / 2, side = pair / PAIRS;
    if (pair % PAIRS >= pairs[side] || !shown[pair]) continue;
    const int k = first[pair];
    const Square square = SQUARE_AT(side, k + ((k + m) & 1)); /* an even one comes first */
    const float far = near[side] ? NEAR_CELL : FAR_CELL;
    for (int depth = 0; depth < DEPTHS; ++depth) {
      const float out = depth == 0 ? -0.5f : depth == 1 ? far : BORDER_STEP_CELLS * (float)depth;
      int sum = 0;
      const float2 at = square.middle + out * square.out;
      for (int spot = -1; spot <= 1; ++spot) {
        const float2 p = at + BORDER_STEP_CELLS * (float)spot * square.along;
        sum += level_at(LEVELS, p.x, p.y);
      }
      sums[m * DEPTHS + depth] = sum;
    }
  }
  ALL_TOGETHER;
#define DIFFERENCE(n, depth) (LEVEL(n, depth, 0) - LEVEL(n, depth, 1))
  FOR_ALL(n, SIDES * PAIRS) {
    if (n % PAIRS >= pairs[n / PAIRS] || !shown[n]) continue;
    const int inside = LARGER(MAGNITUDE_OF(DIFFERENCE(n, 0)), 1);
    int sum = 0;
    for (int k = NEAR_DEPTH; k < DEPTHS; ++k)
      sum += SMALLER(MAGNITUDE_OF(DIFFERENCE(n, k)), inside) * WHOLE / inside;
    squares[n] = sum;
  }
  ALL_TOGETHER;
  FOR_ALL(side, SIDES) {
    const int start = side * PAIRS;
    int inside = 0, beyond = 0, change = 0, some = 0;
    for (int n = start; n < start + pairs[side]; ++n) {
      if (!shown[n]) continue;
      inside += DIFFERENCE(n, 0);
      beyond += DIFFERENCE(n, 1);
      for (int k = 0; k < 2; ++k) change += MAGNITUDE_OF(LEVEL(n, 0, k) - LEVEL(n, 1, k));
      squares[start + some++] = squares[n];
    }
    const float whole = (float)MAGNITUDE_OF(inside);
    int reached = some && (float)MAGNITUDE_OF(beyond) < PASSING * whole
                      ? common_reach(squares + start, some)
                      : UNSEEN;
    /* What reaches farther than a square is not the last one. */
    const float reach = REACH(reached) * last_over_next(OF_BOARD, side);
    if (reach > 1 + BORDER_STEP_CELLS) reached = UNSEEN;
    border[FOLLOWS_OF + side] = some && (float)change < 2.0f * PASSING * whole;
    border[REACH_OF + side] = reached == UNSEEN ? UNSEEN : floor_of(WHOLE * reach);
  }
}
