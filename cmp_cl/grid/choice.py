"""Which board of a view is meant: by its size, by its print, or because it is the largest."""

import dataclasses
import functools
import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import cv2
import numpy as np

from cmp_cl.corners import Corners
from cmp_cl.errors import GridError
from cmp_cl.grid.grid import MEASURED, Grid, NodeStatus, Others, Sides
from cmp_cl.lattice.arrays import NONE, NOT_SEEN, Board, Border, Mask, Whole
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.joins import goes_on
from cmp_cl.lattice.numbers import (
    Decision,
    Numbering,
    Reference,
    in_shape,
    like_rest,
)
from cmp_cl.lattice.printing import prints_of

K = LatticeConstants()


class Asked(NamedTuple):
    """What is known of the numbers, as in `build_grid`."""

    shape: tuple[int, int] | None = None
    like: Grid | None = None
    previous: Grid | None = None


class Told(NamedTuple):
    """What speaks for other numbers than a grid's, see `Grid.others`."""

    number: int
    what: Others


NOTHING = Told(0, Others.NONE)


@dataclasses.dataclass(frozen=True, eq=False)
class Found:
    """A board in a view, upright; the number of its first node and how sure it is; the corners that
    are none of its own and go on its lattice."""

    board: Board
    decision: Decision
    beyond: int

    @functools.cached_property
    def size(self) -> int:
        """Return the number of its corners."""
        return int(np.count_nonzero(self.board.owner >= 0))

    @functools.cached_property
    def box(self) -> tuple[float, float, float, float]:
        """Return the least x and y, and the greatest, of its nodes, px."""
        mine = self.board.owner >= 0
        x, y = self.board.x[mine], self.board.y[mine]
        return float(x.min()), float(y.min()), float(x.max()), float(y.max())

    def is_comparable(self, other: "Found") -> bool:
        """Return whether it has about as many nodes as another, which are no texture far smaller
        than the other's."""
        own, its = (np.subtract(each.box[2:], each.box[:2]) for each in (self, other))
        return 2 * self.size >= other.size and bool((2 * own >= its).any())

    @property
    def extent(self) -> float:
        """Return the diagonal of its box, px."""
        return math.dist(self.box[:2], self.box[2:])

    @property
    def across(self) -> int:
        """Return the nodes on the smaller side of lines without a node, as behind a bar, if it is
        not sure that the board goes on there; 0 if it is."""
        board, unsure = self.board, 0
        for axis, lines in enumerate(board.lines):
            if lines.all():
                continue
            held = np.flatnonzero(lines)
            for last in held[:-1][np.diff(held) > 1]:
                after = np.indices(board.owner.shape)[axis] > last
                if not goes_on(board, after, K):
                    count = int(np.count_nonzero(after & (board.owner >= 0)))
                    unsure = max(unsure, min(count, self.size - count))
        return unsure

    @property
    def gap(self) -> int:
        """Return the number of places between nodes of its rows and of its columns that show no
        corner, 0 if they are few."""
        there = self.board.there
        if there.all():
            return 0
        inside = _between(there) & _between(there.T).T
        missing = int(np.count_nonzero(inside & ~there))
        return missing if missing >= max(K.least_board, K.gap * np.count_nonzero(inside)) else 0

    @property
    def hanging(self) -> int:
        """Return the corners of the second largest region of its firm cells, 0 if they are few: it
        may have joined the others by chance."""
        return self.board.hanging if self.board.hanging >= K.least_board else 0

    @property
    def is_whole(self) -> bool:
        """Return whether it is a full rectangle whose border is seen, but for one side."""
        return self.board.ended >= 3

    def fills(self, shape: tuple[int, int]) -> bool:
        """Return whether it has nearly all nodes of a known size."""
        return self.fits and self.size >= K.least_line * shape[0] * shape[1]

    @property
    def fits(self) -> bool:
        """Return whether nothing speaks against the known size."""
        return self.decision.best.nats > -K.end_nats


def found_in(boards: Iterable[Board], asked: Asked, corners: Corners) -> Iterator[Found]:
    """Yield the boards of a view with their numbers.

    Where corners go on a board's lattice, lines may follow that are not seen, and it does not end
    on their side; without a known size that is told.
    """
    for board in boards:
        if not (board.owner >= 0).any():
            continue
        count, lines = _corners_beyond(board, corners)
        if count:
            none = lines == 0
            reach = np.where(none, board.border.reach, np.nan)
            follows = board.border.follows & none
            board.border = Border(reach, follows, np.zeros(4, np.bool_), lines)
        yield Found(board, _decided(board, asked, corners), count)


def by_size(found: Iterable[Found]) -> list[Found]:
    """Return boards, those of more corners first."""
    return sorted(found, key=lambda each: -each.size)


def by_extent(found: Iterable[Found]) -> list[Found]:
    """Return boards, those that are larger in the image first."""
    return sorted(found, key=lambda each: -each.extent)


def _between(there: Mask) -> Mask:
    """Return which places lie between nodes of their row, (R, C)."""
    after = np.logical_or.accumulate(there[:, ::-1], axis=1)[:, ::-1]
    return np.logical_or.accumulate(there, axis=1) & after


def _corners_beyond(board: Board, corners: Corners) -> tuple[int, Whole]:
    """Return how many corners are none of a board's and lie on its lattice, up to a way beside it;
    and how many lines they reach above it, below it, before and after it, (4,).

    A hand, or noise, parts a board. The lattice is continued as if it were flat. All are 0 if the
    corners are few, or if others are near it that lie anywhere.
    """
    none, mine = (0, np.zeros(4, np.int64)), board.owner >= 0
    nodes, free = board.owner[mine], np.ones(len(corners), np.bool_)
    free[nodes] = False
    least = max(K.beside, K.gap * len(nodes))
    if np.count_nonzero(free) < least or len(nodes) < K.least_board:
        return none
    number = np.argwhere(mine)[:, ::-1].astype(np.float64)
    some = np.random.default_rng(0).permutation(len(nodes))[: K.tear_most]  # not all of one line
    plane, _ = cv2.findHomography(corners.xy[nodes[some]].astype(np.float64), number[some])
    if plane is None:
        return none
    wide = np.pad(~mine, K.span, constant_values=True)  # places without a node
    others = corners.xy[free].astype(np.float64)
    at = cv2.perspectiveTransform(others[None], plane)[0] + K.span
    place = np.rint(np.clip(at, 0, np.array(wide.shape[::-1]) - 1)).astype(np.int64)
    apart = np.abs(at - place).max(axis=1)
    empty = wide[place[:, 1], place[:, 0]] & (apart <= 0.5)
    near = empty & (apart < K.reach_cells)
    if np.count_nonzero(near) < max(least, K.least_line * np.count_nonzero(empty)):
        return none
    (column, row), (top, bottom, left, right) = place[near].T - K.span, board.outer_lines
    away = np.stack([top - row, row - bottom, left - column, column - right])
    few = np.count_nonzero(away > 0, axis=1) < K.beside
    return len(row), np.where(few, 0, away.max(axis=1))


def _decided(board: Board, asked: Asked, corners: Corners) -> Decision:
    if asked.like is not None:
        rest = reference_of(asked.like)
        before = None if asked.previous is None else reference_of(asked.previous)
        if asked.previous is asked.like:
            before = rest._replace(sure=True)
        decision = like_rest(board, rest, before, K)
        here = board.turned(decision.best.quarters), decision.best, asked.like
        slid = _nodes_beyond(*here) + _free_beyond(*here, corners)
        return decision._replace(margin=0.0) if slid >= K.least_board else decision
    if asked.shape is not None:
        return in_shape(board, asked.shape, K)
    return Decision(Numbering(0.0, 0.0, 0, 0, 0), None, math.inf)


def _nodes_beyond(board: Board, best: Numbering, rest: Grid) -> int:
    """Return the nodes of a board beyond sides on which the pattern ended at rest: a part of it has
    slid by cells, or its end was hidden then."""
    ends = rest.border or Sides()
    outside = np.zeros(board.owner.shape, np.bool_)
    for axis, start in enumerate((best.row, best.column)):
        line = np.indices(outside.shape)[axis] + start - rest.origin[axis]
        outside |= (line < 0) & ends[2 * axis]
        outside |= (line >= rest.shape[axis]) & ends[2 * axis + 1]
    return int(np.count_nonzero(outside & (board.owner >= 0)))


def _free_beyond(board: Board, best: Numbering, rest: Grid, corners: Corners) -> int:
    """Return the corners that are no nodes and lie where lines beyond such sides would be; 0 if
    others near there lie anywhere. An outer line with few of its places is no line of a board."""
    free = np.ones(len(corners), np.bool_)
    free[board.owner[board.owner >= 0]] = False
    at = corners.xy[free].astype(np.float64) @ [1, 1j]
    away = np.full(len(at), np.inf)
    for side, ended in enumerate(rest.border or Sides()):
        axis, last = divmod(side, 2)
        lines = board.at if axis == 0 else board.at.T
        outer = rest.origin[axis] - (best.row, best.column)[axis] + last * (rest.shape[axis] - 1)
        inner = outer + 1 - 2 * last
        if ended and min(outer, inner) >= 0 and max(outer, inner) < len(lines):
            step = lines[outer] - lines[inner]
            there = ~np.isnan(step)
            for place, cell in zip((lines[outer] + step)[there], np.abs(step[there]), strict=True):
                away = np.minimum(away, np.abs(at - place) / cell)
    beyond = int(np.count_nonzero(away < K.reach_cells))
    return beyond if beyond >= K.least_line * np.count_nonzero(away < 0.5) else 0


@functools.lru_cache(maxsize=8)
def reference_of(grid: Grid) -> Reference:
    """Return a grid as a reference for other views. The last few are kept for a recording."""
    board = Board(
        x=grid.xy[..., 0],
        y=grid.xy[..., 1],
        owner=np.where(np.isin(grid.status, MEASURED), 0, NONE),
        torn=grid.status == NodeStatus.ATTACHED,
        sign=1 - 2 * grid.parity,
        border=NOT_SEEN._replace(reach=np.array(grid.reach)),
    )
    prints = prints_of(board.at, K.print_clip)
    return Reference(board, prints, grid.origin, not grid.ambiguous)


def chosen_of(boards: Iterable[Found], asked: Asked, count: int) -> tuple[Found | None, Told]:
    """Return the board that is meant, None without any, and what speaks for other numbers.

    count: corners in the view.

    Raises GridError if two are comparable, or the board holds few of the corners that no other has.
    """
    found = by_size(boards if asked.like else _until_two(boards, asked.shape))
    if not found:
        return None, NOTHING
    others = 0
    if asked.like is not None:
        chosen, others = _alike(found)
        sure = False
    elif asked.shape is not None:
        chosen, others = _fitting(found, asked.shape)
        sure = chosen.fills(asked.shape)
    else:
        chosen, others = _alone(found)
        sure = chosen.is_whole
    free = count - sum(each.size for each in found if each is not chosen)
    if not sure and chosen.size < K.few * free:
        raise GridError(
            f"the board has {chosen.size} of {free} corners that no other has, expected at least "
            f"{math.ceil(K.few * free)}; give the shape, or a cut-out of the image"
        )
    filled = asked.shape is not None and chosen.fills(asked.shape)
    fits = asked.shape is not None and chosen.fits
    told = (
        Told(others, Others.PATTERN),
        Told(0 if sure or chosen.is_whole else chosen.hanging, Others.HANGING),
        Told(0 if filled else chosen.across, Others.ACROSS),
        Told(chosen.gap, Others.GAP),
        Told(0 if fits else chosen.beyond, Others.BESIDE),
    )
    return chosen, next((each for each in told if each.number), NOTHING)


def _until_two(found: Iterable[Found], shape: tuple[int, int] | None) -> Iterator[Found]:
    """Yield the boards, up to the second of two that leave no choice: those after it need not be
    laid out."""
    whole: list[Found] = []
    for each in found:
        yield each
        if each.is_whole if shape is None else each.fills(shape):
            if any(each.is_comparable(other) and other.is_comparable(each) for other in whole):
                return
            whole.append(each)


def _alike(found: list[Found]) -> tuple[Found, int]:
    """Return the board that fits the print and the borders of the pattern at rest; and the corners
    of the largest other that fits about as well, 0 without one."""
    best = max(each.decision.best.nats for each in found)
    chosen, *others = [each for each in found if each.decision.best.nats > best - K.sure_nats]
    return chosen, others[0].size if others else 0


def _fitting(found: list[Found], shape: tuple[int, int]) -> tuple[Found, int]:
    """Return the board that fills the known size, else the largest; and the corners of the next
    that fills it, as in a mirror, 0 without one.

    Raises GridError if that is comparable.
    """
    chosen, *others = by_extent(each for each in found if each.fills(shape)) or found[:1]
    if others and others[0].is_comparable(chosen):
        raise _two(chosen, others[0])
    return chosen, others[0].size if others else 0


def _alone(found: list[Found]) -> tuple[Found, int]:
    """Return the largest board. If that ends nowhere, it is the ground behind the largest full
    rectangle with a border. Return also the corners of the largest other that may be meant
    instead, 0 without one.

    The ground is told, but behind a whole board; beside that, only other whole ones are told.

    Raises GridError if another is comparable, and is not the ground.
    """
    chosen = found[0]
    if chosen.board.ends_nowhere:
        chosen = next((each for each in found if each.board.ended), chosen)
    others = [each for each in found if each is not chosen]
    for each in others:
        if each.is_comparable(chosen) and not (each.board.ends_nowhere and chosen.board.ended):
            raise _two(chosen, each)
    told = [each.size for each in others if each.is_whole or not chosen.is_whole]
    return chosen, told[0] if told else 0


def _two(one: Found, other: Found) -> GridError:
    places = []
    for each in (one, other):
        x, y, right, bottom = map(round, each.box)
        places.append(f"{x},{y},{right - x},{bottom - y}")
    return GridError(
        f"two patterns are seen, of {one.size} and {other.size} corners, within "
        f"{' and '.join(places)} (X,Y,WIDTH,HEIGHT); give a cut-out of the image with one of them"
    )
