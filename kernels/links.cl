#include "lattice.clh"

/* Links between corners (13.1): of the neighbours along a boundary the cheapest, kept where both
 * ends choose each other, the middle of the side between them has the colours that both claim, and
 * no link as short crosses. A bar or an arm before the pattern leaves only the ends of such a
 * side. The kernels run twice: the ends of a crossed link choose once more. */

#define COSTS_PER_PX 64.0f

/* The bins that hold enough corners, in rings around the bin of a corner. */
Window window_of(__global const int *layout, __global const int *starts, const int row,
                 const int column, const int enough) {
  const int across = layout[BINS_ACROSS], down = layout[BINS_DOWN];
  for (int ring = 1;; ++ring) {
    const Window found = {LARGER(row - ring, 0), SMALLER(row + ring + 1, down),
                          LARGER(column - ring, 0), SMALLER(column + ring + 1, across), across};
    int seen = 0;
    for (int k = found.top; k < found.bottom; ++k)
      seen += starts[k * across + found.right] - starts[k * across + found.left];
    if (seen >= enough || ring >= LINK_RINGS) return found;
  }
}

/* Any corner outside of the window is farther than this, px. */
float px_outside(__global const int *layout, const Window window, const float2 at) {
  const int shift = layout[BIN_SHIFT];
  float near = 1e6f;
  if (window.left) near = SMALLER(near, at.x - (float)(window.left << shift));
  if (window.top) near = SMALLER(near, at.y - (float)(window.top << shift));
  if (window.right < layout[BINS_ACROSS])
    near = SMALLER(near, (float)(window.right << shift) - at.x);
  if (window.bottom < layout[BINS_DOWN])
    near = SMALLER(near, (float)(window.bottom << shift) - at.y);
  return near;
}

/* The boundary of each of eight corners that is nearest to (dx, dy), and the length along it, as of
 * `boundary_along`. */
typedef struct {
  int8 side;
  float8 length;
} Boundaries;
#define MAGNITUDES(v) as_float8(as_int8(v) & 0x7fffffff)
Boundaries boundaries_along(const float8 ax, const float8 ay, const float8 bx, const float8 by,
                            const float8 dx, const float8 dy) {
  const float8 first = ax * dx + ay * dy, second = bx * dx + by * dy;
  const int8 is_first = MAGNITUDES(first) >= MAGNITUDES(second);
  const float8 along = is_first ? first : second;
  Boundaries found = {(~is_first & 1) + (~(along >= 0) & 2), MAGNITUDES(along)};
  return found;
}

/* Of chords along a boundary of a corner the cheapest in each of eight lanes: how much less than
 * NO_CHORD they cost, 0 without one, and the half-edges at their other ends; and by how much the
 * squared length of the nearest is less, as bits. */
#define NO_CHORD INT_MAX
typedef struct {
  int8 saved, end, nearer;
} Chords;
void keep_cheaper(Chords *best, const int8 saved, const int8 end, const int8 nearer) {
  const int8 lower = SMALLER(end, best->end), cheaper = saved > best->saved ? end : best->end;
  best->end = saved == best->saved ? lower : cheaper;
  best->saved = LARGER(saved, best->saved);
  best->nearer = LARGER(nearer, best->nearer);
}
int least_of(const int8 v) {
  const int4 four = SMALLER(v.lo, v.hi);
  const int2 two = SMALLER(four.lo, four.hi);
  return SMALLER(two.x, two.y);
}

/* choice[4 i + s]: the half-edge 4 j + t at the other end of the cheapest chord along boundary s of
 * corner i, the lower one of equals, NONE without one. passes: whether a chord along it is nearer.
 * limit: the square that its length must be under, 0 if it has chosen. There is none if it bends
 * too much or joins boundaries of one colour. A narrow window is enough if any corner outside of it
 * is farther away than the chords in it cost. Eight corners of a row of bins at a time take .6 of
 * the time that one after the other do. One work-item per corner. */
#define NARROW 12
#define EIGHT_OF(T, p) (T)((p)[0], (p)[1], (p)[2], (p)[3], (p)[4], (p)[5], (p)[6], (p)[7])
#define SPOT(k) EIGHT_OF(float8, spots + (k) * (int)capacity + n)
#define KEEP_CHEAPER(s)                                                             \
  {                                                                                 \
    const int8 own = (near.side == s) & (squared < most[s]);                        \
    keep_cheaper(best + s, saved & own, half_edge, nearer & own);                   \
  }
__kernel void choose_links(__global const float *restrict corners, const uint capacity,
                           __global const float4 *restrict lines,
                           __global const int *restrict layout, __global const int *restrict starts,
                           __global const int *restrict binned,
                           __global const float *restrict spots,
                           const uint rows, const uint columns, __global float *restrict limit,
                           __global int *restrict choice, __global uchar *restrict passes) {
  const int i = get_global_id(0);
  if (i >= (int)COUNT(corners)) return;
  float most[4];
  bool any = false;
  for (int s = 0; s < 4; ++s) {
    most[s] = limit[4 * i + s];
    limit[4 * i + s] = 0;
    any |= most[s] > 0;
  }
  if (!any) return;
  const float4 own = lines[i];
  const float2 here = POSITIONS(corners)[i];
  const int shift = layout[BIN_SHIFT], row = BIN_ROW(here), column = BIN_COLUMN(here);
  bool sure = false;
  for (int enough = NARROW; !sure; enough = LINK_NEIGHBOURS) {
    const Window window = window_of(layout, starts, row, column, enough);
    Chords best[4];
    for (int s = 0; s < 4; ++s) best[s].saved = best[s].end = best[s].nearer = 0;
    for (int k = window.top; k < window.bottom; ++k) {
      const int end = starts[k * window.across + window.right];
      for (int n = starts[k * window.across + window.left]; n < end; n += 8) {
        const float8 dx = SPOT(0) - here.x, dy = SPOT(1) - here.y, squared = dx * dx + dy * dy;
        const float8 length = squared * inverse_roots(squared);
        const Boundaries near = boundaries_along(own.x, own.y, own.z, own.w, dx, dy);
        const Boundaries far = boundaries_along(SPOT(2), SPOT(3), SPOT(4), SPOT(5), dx, dy);
        const float8 price = length + TURN_PRICE * ((length + length) - (near.length + far.length));
        const int8 good = (SMALLER(near.length, far.length) > LEAST_COSINE * length) &
                          (((near.side ^ far.side) & 1) != 0) & (squared >= 1) &
                          ((int8)(0, 1, 2, 3, 4, 5, 6, 7) < end - n);
        const int8 saved = good & (NO_CHORD - convert_int8(price * COSTS_PER_PX));
        const int8 nearer = good & (NO_CHORD - as_int8(squared));
        const int8 half_edge = 4 * EIGHT_OF(int8, binned + n) + (far.side ^ 2); /* back along it */
        KEEP_CHEAPER(0) KEEP_CHEAPER(1) KEEP_CHEAPER(2) KEEP_CHEAPER(3)
      }
    }
    const float outside = px_outside(layout, window, here) * (COSTS_PER_PX - 0.1f);
    sure = true;
    for (int s = 0; s < 4; ++s) {
      if (!(most[s] > 0)) continue;
      const int8 costs = NO_CHORD - best[s].saved;
      const int least = least_of(costs);
      const int end = least_of(costs == least ? best[s].end : (int8)(INT_MAX));
      choice[4 * i + s] = least == NO_CHORD ? NONE : end;
      passes[4 * i + s] = 0;
      if (least != NO_CHORD) {
        const float2 way = POSITIONS(corners)[end >> 2] - here;
        const float squared = way.x * way.x + way.y * way.y;
        passes[4 * i + s] = least_of(NO_CHORD - best[s].nearer) < as_int(squared);
      }
      sure &= enough == LINK_NEIGHBOURS || (float)least < outside;
    }
  }
}

/* Whether the middle of the side from half-edge h to a higher one has the colours that both claim.
 * Tabs of a puzzle, and a side that bends, hide colours near the chord, marks those deeper in the
 * cells, and a bar both. */
#define LEAST_MIDDLE (3 * SIDE_MIDDLE) /* of the contrast, summed over three points */
bool is_side(__global const float2 *at, __global const int *contrast, LEVELS_OF_IMAGE, const int h,
             const int end) {
  const float2 a = at[h >> 2], b = at[end >> 2];
  const float product = (float)contrast[h >> 2] * (float)contrast[end >> 2];
  const float root = inverse_root(product), sign = h & 1 ? -2.0f : 2.0f;
  const int near = difference(LEVELS, a, b, MIDDLE);
  if (sign * (float)near * root > LEAST_MIDDLE) return true;
  const int far = difference_within(LEVELS, a, b, MIDDLE, DEEP_CELLS);
  return sign * (float)far * root > LEAST_MIDDLE;
}

/* Whether the line from a to b parts c from d. */
bool parts_them(const float2 a, const float2 b, const float2 c, const float2 d) {
  const float2 way = b - a, first = c - a, second = d - a;
  return (way.x * first.y < way.y * first.x) != (way.x * second.y < way.y * second.x);
}

/* Whether a link as short crosses the chord from half-edge h to a higher one. One of its ends is
 * within half the length of the chord. */
bool is_crossed(__global const float2 *at, __global const int *layout, __global const int *starts,
                __global const int *binned, const uint rows, const uint columns,
                __global const int *link, const int h, const int end) {
  const float2 a = at[h >> 2], b = at[end >> 2], way = b - a;
  const float squared = way.x * way.x + way.y * way.y;
  const Window window = window_around(layout, rows, columns, 0.5f * (a + b), length_of(way) + 1);
  bool found = false;
  FOR_CORNERS_IN(window, j) {
    for (int g = 4 * j; g < 4 * j + 4; ++g) {
      if (link[g] == NONE || j == h >> 2 || j == end >> 2) continue;
      if (link[g] >> 2 == h >> 2 || link[g] >> 2 == end >> 2) continue;
      const float2 c = at[SMALLER(g, link[g]) >> 2], d = at[LARGER(g, link[g]) >> 2], its = d - c;
      found |= its.x * its.x + its.y * its.y <= squared && parts_them(a, b, c, d) &&
               parts_them(c, d, a, b);
    }
  }
  return found;
}

/* link[h]: the half-edge at the other end of a side that both ends choose, NONE without one. One
 * work-item per half-edge; that of the lower end does the work of both, in the kernel below too. */
__kernel void keep_links(__global const float *restrict corners, const uint capacity,
                         __global const int *restrict contrast, LEVELS_OF_IMAGE,
                         __global const int *restrict choice, __global const int *restrict twin,
                         __global int *restrict link) {
  const int h = get_global_id(0);
  if (h >= 4 * (int)COUNT(corners) || twin[h] != NONE) return;
  const int end = choice[h];
  if (end == NONE || choice[end] != h) {
    link[h] = NONE;
  } else if (h < end) {
    const bool is_link = is_side(POSITIONS(corners), contrast, LEVELS, h, end);
    link[h] = is_link ? end : NONE;
    link[end] = is_link ? h : NONE;
  }
}

/* twin[h]: the half-edge at the other end of a link, but for one that passes over a nearer corner
 * and that another link as short crosses: a lattice lies in a plane. Its ends choose again, among
 * nearer corners: motion over half a cell turns edges so far that the second next row seems to lie
 * along them. One work-item per half-edge. */
__kernel void part_links(__global const float *restrict corners, const uint capacity,
                         __global const int *restrict layout, __global const int *restrict starts,
                         __global const int *restrict binned, const uint rows, const uint columns,
                         __global const uchar *restrict passes, __global const int *restrict link,
                         __global float *restrict limit, __global int *restrict twin) {
  const int h = get_global_id(0);
  if (h >= 4 * (int)COUNT(corners) || twin[h] != NONE || link[h] < h) return;
  const int end = link[h];
  __global const float2 *at = POSITIONS(corners);
  if ((passes[h] || passes[end]) &&
      is_crossed(at, layout, starts, binned, rows, columns, link, h, end)) {
    const float2 way = at[end >> 2] - at[h >> 2];
    limit[h] = limit[end] = way.x * way.x + way.y * way.y;
  } else {
    twin[h] = end;
    twin[end] = h;
  }
}
