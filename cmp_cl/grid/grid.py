"""The grid: corners arranged by row and column of the pattern."""

import dataclasses
import enum
import functools
import math
from numbers import Integral
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, GridError, check_kind, check_positive
from cmp_cl.files import read_npz, suffix_of, whole_file
from cmp_cl.fits import bent_sigma
from cmp_cl.grid.curves import points_between
from cmp_cl.grid.saved import SAVED, check_shapes, packed, unpacked
from cmp_cl.lattice.arrays import turned_sides
from cmp_cl.lattice.constants import LatticeConstants


class NodeStatus(enum.IntEnum):
    """The source of a node's position."""

    MISSING = 0  #: no position
    DETECTED = 1  #: a corner that the detector found
    #: a rough corner, whose refinement was rejected; or one far from where its neighbours predict
    #: it, with which a grid averages it
    ATTACHED = 2
    SECOND_LOOK = 3  #: no corner; tracking refined from where its neighbours predict it
    INTERPOLATED = 4  #: predicted from measured nodes around it
    VIRTUAL = 5  #: a marker on the edge between two neighbours


# measured in the image; the position of a torn node comes in part from its neighbours
MEASURED = (NodeStatus.DETECTED, NodeStatus.ATTACHED, NodeStatus.SECOND_LOOK)


class Others(enum.IntEnum):
    """What `Grid.others` counts."""

    NONE = 0
    PATTERN = 1  #: corners of another lattice: squares behind a board, or a part without numbers
    GAP = 2  #: places between nodes of a row and of a column that show no corner
    BESIDE = 3  #: corners that lie where its next lines would be
    HANGING = 4  #: nodes of a region whose cells share no side with the others
    ACROSS = 5  #: nodes beyond lines without a node, as behind a bar


# what a user reads of them
_SAID = {
    Others.PATTERN: "another pattern of {} corners is seen, which may be the one that is meant; "
    "give a cut-out without it",
    Others.GAP: "{} places between its nodes show no corner: two patterns may touch there, or a "
    "part may have wrong numbers",
    Others.BESIDE: "{} corners lie where its next lines would be and are no nodes: it may go on "
    "there",
    Others.HANGING: "a region of {} nodes hangs on the others by a single side or by doubtful "
    "corners, and may have wrong numbers",
    Others.ACROSS: "{} nodes lie beyond lines of which none is seen, and how many these are is not "
    "sure",
}


class Sides(NamedTuple):
    """A set of the sides top, bottom, left and right of a grid; each is True if it is in the
    set."""

    top: bool = False
    bottom: bool = False
    left: bool = False
    right: bool = False

    def turned(self, quarters: int) -> "Sides":
        """Return the same sides after `Grid.turned(quarters)`."""
        return Sides(*turned_sides(self, quarters))


NO_SIDES = Sides()
MOST_NODES = 1 << 22
SURE = LatticeConstants.sure_nats
UNSEEN = (math.nan, math.nan, math.nan, math.nan)


class Rival(NamedTuple):
    """The second best numbering: turn the grid, then add rows and columns to its numbers.

    quarters: as in `Grid.turned`.
    """

    rows: int
    columns: int
    quarters: int = 0


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Grid:
    """Corners by row and column of the pattern.

    xy: (R, C, 2) float32, px, NaN where missing.
    status: (R, C) uint8 of `NodeStatus`.
    image_sigma: (R, C) float32, the standard deviation of the position per axis that comes from the
        image of the corner, px, NaN where unknown; `sigma` is the whole one.
    index: (N, 2) int32, (row, column) in these arrays of each corner that the grid was built
        from, -1 where unassigned.
    parity: 0 where the cell between the first node and its diagonal neighbour, indices (0, 0)
        and (1, 1), is black, 1 where it is white.
    origin: number (row, column) of index (0, 0). It is not (0, 0) if nodes lie above or left of the
        first row or column at rest. The number of a node is its index + origin.
    border: sides on which the pattern ends in the view; None if that is unknown, because the grid
        was built without the image.
    reach: the reach of its last squares beyond the last nodes, cells, 1 if they are whole: top,
        bottom, left, right, NaN where it is not seen.
    seen_shape: the rows and columns that are seen, if they contradict a known shape, else None.
    confidence: by how much the numbers are more probable than the second best, nats (the logarithm
        of the ratio); inf if no others are possible, 0 if others are as probable or there is no
        node. See `ambiguous`.
    rival: the second best numbering, None if there is no other.
    others: how many corners, places or nodes speak for other numbers, 0 if none or few do;
        others_are says what they are.
    edge_radius: the `edge_radius` of the corners, px. The filters of positions and displacements
        use it to remove the effect of bent edges. NaN if unknown.
    """

    xy: NDArray[np.float32]
    status: NDArray[np.uint8]
    image_sigma: NDArray[np.float32]
    index: NDArray[np.int32]
    parity: int = 0
    origin: tuple[int, int] = (0, 0)
    border: Sides | None = None
    reach: tuple[float, float, float, float] = UNSEEN
    seen_shape: tuple[int, int] | None = None
    confidence: float = math.inf
    rival: Rival | None = None
    others: int = 0
    others_are: Others = Others.NONE
    edge_radius: float = math.nan

    def __repr__(self) -> str:
        number = np.bincount(self.status.ravel(), minlength=len(NodeStatus))
        nodes = [f"{number[kind]} {kind.name.lower()}" for kind in NodeStatus if number[kind]]
        said = ", ".join(nodes).replace("_", " ")
        return f"<Grid of {self.shape[0]} x {self.shape[1]} nodes: {said or 'none'}>"

    @property
    def shape(self) -> tuple[int, int]:
        """Return the numbers of rows and columns."""
        return self.xy.shape[0], self.xy.shape[1]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Return (R, C) bool, True where there is a position."""
        return ~np.isnan(self.xy[..., 0])

    @functools.cached_property
    def sigma(self) -> NDArray[np.float32]:
        """The standard deviation of the position per axis, (R, C) float32, px, NaN where unknown.

        It includes the shift by bent edges, see `edge_radius`.
        """
        return bent_sigma(self.xy, self.image_sigma, self.edge_radius)

    @property
    def ambiguous(self) -> bool:
        """Return whether another numbering explains the frame too: `confidence` is under 5 nats.

        The numbers are then those of the least motion, and may be wrong by `rival`. A grid without
        a node has none.
        """
        return not self.confidence >= SURE and bool(self.valid.any())

    @property
    def doubts(self) -> list[str]:
        """Return the reasons to doubt the numbers, one sentence each; empty if there are none."""
        rows, columns = self.shape
        found = []
        if not self.valid.any():
            found.append(
                "no board is seen: it has nine corners or more that sides of cells link; marks in "
                "the cells, blur and noise hide sides"
            )
        if self.seen_shape is not None:
            seen = " x ".join(map(str, self.seen_shape))
            found.append(f"the board looks like {seen} corners; {rows} x {columns} were asked for")
        if self.others:
            found.append(_SAID[self.others_are].format(self.others))
        if self.ambiguous and self.seen_shape is None:
            other = ""
            if self.rival is not None:
                turn = f", turned by {90 * self.rival.quarters} degrees" * (self.rival.quarters > 0)
                other = f" by ({self.rival.rows}, {self.rival.columns}){turn}"
            found.append(
                f"the numbers are ambiguous: they may be wrong{other}; the view shows too little "
                "of the pattern's border, and its printing errors are too small, to decide, or a "
                "part of it lies beyond its border at rest"
            )
        return found

    def turned(self, quarters: int) -> "Grid":
        """Return the grid after `quarters` quarter turns: after one, row 0 is the former last
        column. The result has no `rival`. Raises GridError if `quarters` is not whole."""
        check_kind("quarters", quarters, Integral, GridError)
        quarters %= 4
        if not quarters:
            return self
        index: NDArray[np.int32] = self.index.copy()
        known = index[:, 0] >= 0
        for turn in range(quarters):
            last = self.shape[1 - turn % 2] - 1
            index[known] = np.column_stack([last - index[known, 1], index[known, 0]])
        rows, columns = self.shape
        seen = self.seen_shape
        if seen is not None and quarters % 2:
            seen = seen[1], seen[0]
        return dataclasses.replace(
            self,
            xy=np.rot90(self.xy, quarters).copy(),
            status=np.rot90(self.status, quarters).copy(),
            image_sigma=np.rot90(self.image_sigma, quarters).copy(),
            index=index,
            parity=(self.parity + (0, columns, rows + columns, rows)[quarters]) % 2,
            origin=(0, 0),
            border=self.border and self.border.turned(quarters),
            reach=turned_sides(self.reach, quarters),
            seen_shape=seen,
            rival=None,
        )

    @property
    def extent(self) -> str:
        """Return the numbers of its rows and columns as text."""
        (top, left), (rows, columns) = self.origin, self.shape
        return f"rows {top} to {top + rows - 1} and columns {left} to {left + columns - 1}"

    def covers(self, rest: "Grid") -> bool:
        """Return whether the grid has all rows and columns of the grid `rest`, by their numbers."""
        check_kind("rest", rest, Grid, GridError)
        first = np.subtract(rest.origin, self.origin)
        last = first + rest.shape
        return bool((first >= 0).all() and (last <= self.shape).all())

    def cut_to(self, rest: "Grid") -> "Grid":
        """Return the grid cut to the rows and columns of the grid `rest`, by their numbers.

        Equal indices of the two grids then have equal numbers. Corners beyond belong to no node.
        Raises GridError if `rest` is no Grid.
        """
        check_kind("rest", rest, Grid, GridError)
        return self.within(rest.origin, rest.shape)

    def within(self, origin: tuple[int, int], shape: tuple[int, int]) -> "Grid":
        """Return the rows and columns of these numbers, empty where the grid has none; see
        `cut_to`."""
        if (self.origin, self.shape) == (origin, shape):
            return self
        top, left = np.subtract(origin, self.origin).tolist()
        rows, columns = shape
        here = np.s_[max(top, 0) : max(top + rows, 0), max(left, 0) : max(left + columns, 0)]
        size = self.xy[here].shape
        there = np.s_[
            max(-top, 0) : max(-top, 0) + size[0], max(-left, 0) : max(-left, 0) + size[1]
        ]

        def cut(values: NDArray[Any], empty: float) -> NDArray[Any]:
            whole = np.full((rows, columns, *values.shape[2:]), empty, values.dtype)
            whole[there] = values[here]
            return whole

        index: NDArray[np.int32] = self.index - np.array([top, left], np.int32)
        outside = (self.index[:, 0] < 0) | (index < 0).any(1) | (index >= shape).any(1)
        index[outside] = -1
        return dataclasses.replace(
            self,
            xy=cut(self.xy, np.nan),
            status=cut(self.status, 0),
            image_sigma=cut(self.image_sigma, np.nan),
            index=index,
            parity=(self.parity + top + left) % 2,
            origin=origin,
        )

    def save(self, path: str | PathLike[str]) -> None:
        """Write the grid to an .npz, whole or not at all; see `load`.

        Its arrays have the names of the attributes; one that is None has no elements. Raises
        GridError on another suffix, OSError if the file cannot be written.
        """
        if suffix_of(path) != ".npz":
            raise GridError(f"a grid is saved as .npz, not as {str(path)!r}")
        with whole_file(path) as file:
            np.savez(file, **packed(self))

    @classmethod
    def load(cls, path: str | PathLike[str]) -> "Grid":
        """Return the grid that `save` wrote.

        Raises OSError if the file cannot be read; GridError if it is damaged or holds no grid: the
        message says which array is wrong, what was expected and what was found.
        """
        try:
            found = unpacked(read_npz(path, SAVED, check_shapes))
        except ValueError as error:
            raise GridError(f"{str(path)!r} is damaged or holds no grid: {error}") from error
        for name, kind in (("border", Sides), ("rival", Rival)):
            found[name] = found[name] and kind(*found[name])
        found["others_are"] = Others(found["others_are"])
        return cls(**found)

    def to_opencv(self, spacing: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the valid nodes as cv2.calibrateCamera takes a view: object and image points.

        spacing: side of a square, any unit. Returns (N, 1, 3) float32, x by column, y by row and
        z = 0, in that unit, and (N, 1, 2) float32, px. Raises ConfigError if spacing is not
        positive.
        """
        check_positive("spacing", spacing, ConfigError)
        row, column = np.nonzero(self.valid)
        nodes = np.column_stack([column, row, np.zeros(len(row))]) * float(spacing)
        return nodes.astype(np.float32)[:, None], self.xy[self.valid].astype(np.float32)[:, None]

    def with_virtual_markers(self, count: int) -> "Grid":
        """Return the grid with `count` points on every edge between two neighbouring nodes.

        They lie on cubic curves through the nodes, with status VIRTUAL. Node (r, c) is at
        ((count + 1) r, (count + 1) c) of the result, ((R - 1)(count + 1) + 1,
        (C - 1)(count + 1) + 1), whose nodes inside the cells are MISSING. So two such grids
        match by equal numbers as any two grids do, and doubts remain. Raises GridError if count is
        not an integer of at least 1, or makes a grid too large.
        """
        if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 1:
            raise GridError(f"the number of markers on an edge must be at least 1, not {count!r}")
        times = int(count) + 1
        check_size(*(max(n - 1, 0) * times + 1 for n in self.shape))
        xy = points_between(self.xy.astype(np.float64), int(count)).astype(np.float32)
        there = ~np.isnan(xy[..., 0])
        status = np.where(there, NodeStatus.VIRTUAL, NodeStatus.MISSING).astype(np.uint8)
        status[::times, ::times] = self.status
        sigma = np.full(status.shape, np.nan, np.float32)
        sigma[::times, ::times] = self.sigma
        index = np.where(self.index < 0, -1, self.index * times).astype(np.int32)
        seen, rival = self.seen_shape, self.rival
        return dataclasses.replace(
            self,
            xy=xy,
            status=status,
            image_sigma=sigma,
            index=index,
            origin=(times * self.origin[0], times * self.origin[1]),
            seen_shape=seen and (times * (seen[0] - 1) + 1, times * (seen[1] - 1) + 1),
            rival=rival and Rival(times * rival.rows, times * rival.columns, rival.quarters),
            edge_radius=math.nan,
        )


def check_size(rows: int, columns: int) -> None:
    """Raise GridError for a grid of more than MOST_NODES nodes."""
    if int(rows) * int(columns) > MOST_NODES:
        raise GridError(
            f"a grid of {rows} x {columns} nodes is beyond the limit of {MOST_NODES} nodes"
        )


def empty_grid(corners: int, shape: tuple[int, ...] | None, like: Grid | None = None) -> Grid:
    """Return the grid of that many corners of which none is a node.

    shape: its rows and columns; None means (0, 0). like: a grid with the same origin.
    """
    rows, columns = shape or (0, 0)
    return Grid(
        xy=np.full((rows, columns, 2), np.nan, np.float32),
        status=np.zeros((rows, columns), np.uint8),
        image_sigma=np.full((rows, columns), np.nan, np.float32),
        index=np.full((corners, 2), -1, np.int32),
        origin=(0, 0) if like is None else like.origin,
        confidence=0.0,
    )
