"""The four sides of a board: whether the pattern ends there, how far its last squares reach, and
what lies past them.

A side is read along squares that share the last two lines of nodes. From one square to the next the
colours change, so the difference of two neighbours, with its sign, is the pattern's own signal: it
is there inside, it is gone where the pattern ends, and it comes back where cells follow.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from cmp_cl.image import GreyImage
from cmp_cl.lattice.arrays import Float, Mask, Numbers
from cmp_cl.lattice.constants import LatticeConstants

SIDES = 4  # top, bottom, left, right
STEP = 0.1  # cells, between the depths at which squares are read
DEPTHS = np.arange(0.3, 1.45, STEP)  # cells from the last nodes, where the last squares may end
# Cells from the last nodes: the middle of the cells that a longer pattern has there, and how far
# the image must reach; where it ends before, just beyond the corners that it has there.
FAR = np.array([[1.5, 1.75], [1.15, 1.2]])
SPOTS = np.array([-0.15, 0.0, 0.15])  # cells along the side, that are read in each square
PAIRS = 16  # pairs of neighbouring squares of a side that are read
PAST = np.array([0.3, 0.6, 0.9])  # cells past the corner of the pattern, along the border's line
ACROSS = np.array([[-0.3], [0.3]])  # cells to either side of that line
HIDDEN = 0.4  # cells: a place nearer to the edge of the image may be missed


class Border(NamedTuple):
    """The sides of a board: top, bottom, left, right, each (4,).

    reach: cells, of its last squares beyond its last nodes, 1 if they are whole; NaN where the
    pattern is not seen to end. past: difference of the image between the two sides of the border's
    line past the pattern, as a share of the pattern's contrast; NaN where that is not seen.
    follows: the pattern goes on. room: most places of a further line lie in the image.
    """

    reach: Float
    past: Float
    follows: Mask
    room: Mask

    @property
    def ends(self) -> Mask:
        ends: Mask = ~np.isnan(self.reach)
        return ends

    def turned(self, quarters: int) -> "Border":
        """Return the same after as many quarter turns of the board, as np.rot90 turns arrays."""
        order = np.arange(SIDES)
        for _ in range(quarters % 4):
            order = order[[3, 2, 0, 1]]
        return Border._make(values[order] for values in self)

    def nats(self, k: LatticeConstants) -> Float:
        """Return the log-odds that the pattern, and no object before it, ends at each side, (4,).

        The edge of an object continues past the pattern. It is 0 where no end is seen.
        """
        nats = np.where(np.abs(self.past) > k.passing, k.edge_nats, k.end_nats)
        return np.where(self.ends, nats, 0.0)


def border_of(at: Numbers, image: GreyImage, k: LatticeConstants) -> Border:
    """Measure the sides of a board; at: (R, C) complex, px, NaN where a node is missing."""
    room = np.array([_has_room(way, image) for way in _ways(at)])
    reach, follows = np.full(SIDES, np.nan), np.zeros(SIDES, np.bool_)
    if min(at.shape) < 2:
        return Border(reach, reach.copy(), follows, room)
    pairs = [_pairs(way) for way in _ways(at)]
    side = np.repeat(np.arange(SIDES), [each.shape[1] for each in pairs])
    middle, out, along = np.concatenate(pairs, axis=1)  # (pairs, 2) each
    in_sight = [in_view(middle + depth * out, image).all(axis=1) for depth in FAR[:, 1]]
    asked, most = (np.bincount(each, minlength=SIDES) for each in (side, side[in_sight[0]]))
    near = (2 * most < asked)[side]
    shown = np.where(near, in_sight[1], in_sight[0])
    far = np.where(near, FAR[1, 0], FAR[0, 0])[shown, None, None]
    side = side[shown]
    middle, out, along = (each[shown, :, None] for each in (middle, out, along))
    depth = np.broadcast_to(DEPTHS, (len(side), 1, len(DEPTHS)))
    depth = np.concatenate([np.full_like(far, -0.5), far, depth], axis=2)
    spots = middle + depth * out + SPOTS[:, None, None, None] * along
    level = grey(image, spots).sum(axis=0)  # (pairs, 2, depths)
    contrast = level[:, 0] - level[:, 1]
    change = np.abs(level[..., 0] - level[..., 1]).mean(axis=1)
    for s in range(SIDES):
        mine = side == s
        if not mine.any() or 2 * np.count_nonzero(mine) < asked[s]:
            continue
        inside, beyond = np.abs(contrast[mine, :2].mean(axis=0))
        follows[s] = change[mine].mean() < k.follow_share * inside
        if beyond < k.end_share * inside:
            reach[s] = _common_reach(np.abs(contrast[mine]), at.shape[s < 2], k)
    return Border(reach, _past(at, image, reach), follows, room)


def in_view(at: Numbers, image: GreyImage) -> Mask:
    """Return a mask of the points that lie in the image."""
    rows, columns = image.shape
    inside: Mask = (at.real >= 0) & (at.real < columns) & (at.imag >= 0) & (at.imag < rows)
    return inside


def grey(image: GreyImage, at: Numbers) -> Float:
    """Return the grey levels of the nearest pixels; beyond the image those of its border."""
    rows, columns = image.shape
    x = np.rint(at.real).clip(0, columns - 1).astype(np.int64)
    y = np.rint(at.imag).clip(0, rows - 1).astype(np.int64)
    level: Float = image[y, x].astype(np.float64)
    return level


def _ways(at: Numbers) -> list[Numbers]:
    """Return the board as seen from each side: row 0 is the last line there."""
    return [at, at[::-1], at.T, at.T[::-1]]


def _pairs(way: Numbers) -> Numbers:
    """Return pairs of neighbouring squares at the last line of a board, (3, P, 2): the middle of
    their side on that line, the steps out of the board, and along it, px.

    There are none where less than half of the board's lines end. The first square of each pair has
    the same colour.
    """
    middle = (way[:2, 1:] + way[:2, :-1]) / 2
    square = ~np.isnan(middle.real.sum(axis=0))
    first = np.flatnonzero(square[:-1] & square[1:])
    lines = np.count_nonzero(~np.isnan(way.real).all(axis=0))
    if 2 * np.count_nonzero(square) < lines - 1:
        first = first[:0]
    first = first[np.arange(min(PAIRS, len(first))) * len(first) // max(min(PAIRS, len(first)), 1)]
    both = np.stack([first, first + 1], axis=1)
    both = np.where(first[:, None] % 2, both[:, ::-1], both)
    along = way[0, 1:] - way[0, :-1]
    return np.stack([middle[0][both], (middle[0] - middle[1])[both], along[both]])


def _common_reach(contrast: Float, lines: int, k: LatticeConstants) -> float:
    """Return the median reach of pairs of squares, cells; NaN if they do not reach equally far.

    contrast: (P, depths): half a cell inside, beyond, and at DEPTHS. The reach of a pair is the sum
    of its contrast over the depths, as a share of that inside. Three of four must be near the
    median, and the medians of both halves near each other, because along an oblique edge they
    differ. A single pair of a longer side shows nothing.
    """
    count = len(contrast)
    if count < max(min(2, lines - 2), 1):
        return float("nan")
    share = np.minimum(contrast[:, 2:] / np.maximum(contrast[:, :1], 1), 1)
    around = np.pad(share, ((0, 0), (2, 2)))
    before = np.maximum(around[:, :-4], around[:, 1:-3])
    after = np.maximum(around[:, 3:-1], around[:, 4:])
    share = np.maximum(share, np.minimum(before, after))  # where black and white change places
    reach = DEPTHS[0] - STEP / 2 + STEP * share.sum(axis=1)
    common, half = float(np.median(reach)), count // 2
    halves = (reach[:half], reach[-half:]) if half > 2 else (reach, reach)
    off = np.sort(np.abs(reach - common))[(3 * count - 1) // 4]
    apart = abs(np.median(halves[0]) - np.median(halves[1]))
    return common if max(off, apart) <= k.parallel_cells else float("nan")


def _past(at: Numbers, image: GreyImage, reach: Float) -> Float:
    """Return the difference of the image between the two sides of each border's line, past the
    pattern, (4,), as a share of the pattern's contrast.

    If both corners of a side are in view it is the smaller of two differences, or 0 if their signs
    differ: the edge of an object before the pattern continues past both.
    """
    past = np.full(SIDES, np.nan)
    half = len(at) // 2
    middle = (at[half - 1, 1:] + at[half, :-1]) / 2
    level = grey(image, middle[~np.isnan(middle)])
    if len(level) < 2:
        return past
    level.sort()
    contrast = max(float(level[3 * len(level) // 4] - level[len(level) // 4]), 1.0)
    corner, out, along, first, other = (
        np.array(each) for each in zip(*_corners(at, reach), strict=True)
    )
    spots = corner[:, None, None] + (first[:, None, None] + ACROSS) * out[:, None, None]
    spots = spots + (other[:, None, None] + PAST) * along[:, None, None]
    shown = np.asarray(np.all(in_view(spots, image), axis=(1, 2)))  # NaN is not
    near, far = grey(image, np.where(shown[:, None, None], spots, 0)).mean(axis=2).T
    step = np.where(shown, (far - near) / contrast, np.nan).reshape(SIDES, 2)
    for s in range(SIDES):
        found = step[s, ~np.isnan(step[s])]
        if len(found):
            past[s] = found[np.abs(found).argmin()] if (found * found[0] > 0).all() else 0.0
    return past


def _corners(at: Numbers, reach: Float) -> Iterator[tuple[complex, complex, complex, float, float]]:
    """Yield the two corners of a board at the ends of each side: their node, the steps out of the
    board and along the side, px, and the reach of that side and of the one that it meets there."""
    for s, way in enumerate(_ways(at)):
        aside = (2, 3) if s < 2 else (0, 1)
        for other, (end, inner) in zip(aside, ((0, 1), (-1, -2)), strict=True):
            node = complex(way[0, end])
            out, along = node - way[1, end], node - way[0, inner]
            yield node, complex(out), complex(along), float(reach[s]), float(reach[other])


def _has_room(way: Numbers, image: GreyImage) -> bool:
    """Return whether most places of a line before the first row lie in the image."""
    there = ~np.isnan(way.real)
    column = np.flatnonzero(there.any(axis=0))
    first = there.argmax(axis=0)[column]
    second = np.minimum(first + 1, len(way) - 1)
    one, two = way[first, column], way[second, column]
    known = ~np.isnan(two.real) & (second > first)
    beyond = in_view((one + (1 + HIDDEN) * (one - two))[known], image)
    return 2 * int(np.count_nonzero(beyond)) > len(beyond)
