"""Corners are arranged by row and column here: numbers, orientation, holes, second look."""

import dataclasses
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners, Refusal
from cmp_cl.errors import GridError, ImageError, check_kind, check_shape
from cmp_cl.filter import bent_sigma
from cmp_cl.grid.border import Border, Ends, border_of, cut_of, full_lines
from cmp_cl.grid.detached import drop_detached
from cmp_cl.grid.dimming import is_dimmed_reflection
from cmp_cl.grid.grid import Grid, NodeStatus, Sides, empty_grid
from cmp_cl.grid.grow import BRACKETED, WEAK, Seen, extend, fill, grow
from cmp_cl.grid.islands import continued, join_islands
from cmp_cl.grid.joints import cut, cut_by_image
from cmp_cl.grid.lattice import Lattice, bends, lattice, lines_of
from cmp_cl.grid.limits import check_finite, check_size
from cmp_cl.grid.mirror import has_seam, repeats_reversed
from cmp_cl.grid.nodes import NOWHERE, Index, Mask, Nodes, boxed, check_room
from cmp_cl.grid.numbering import Numbered, like_rest
from cmp_cl.grid.seam import touch
from cmp_cl.grid.sizes import followed, in_shape
from cmp_cl.grid.skipped import skips_corners
from cmp_cl.image import GreyImage, check_image

SMALL = 0.1  # least share of the corners that the pattern must hold
RIVAL = 0.5  # a second component of this share of the first is a second pattern
# Share of the area of the first pattern; a pattern of cells a quarter as wide is texture.
RIVAL_AREA = 1 / 16
OTHER = 12  # corners: a lattice of so many may be the pattern that is meant
WHOLE = 0.9  # share of the nodes of a known shape
BORDERS = 3  # sides; the edge of the image, or things beside, may hide one
FEW = 0.01  # share of the corners that may be sparser than those of a board in fine texture
LEAST_BOARD = 9  # corners of a board among several, or among more corners that are not its own
TORN = 0.15  # px: a corner whose sigma is not below it is torn, as is one not refined as asked

Region = tuple[float, float, float, float]


class Ended(NamedTuple):
    """Properties of the pattern besides its numbers.

    sides: as `border` in `Grid`. border: the reach of its last squares.
    reflected: as in `Grid`.
    """

    sides: Sides | None = None
    border: Border = Border()
    reflected: bool = False


class Board(NamedTuple):
    """A pattern: its numbered nodes, and what is known besides."""

    numbered: Numbered
    ends: Ended

    @property
    def size(self) -> int:
        """Return the number of its nodes."""
        return int(np.count_nonzero(self.numbered.nodes.there))

    @property
    def area(self) -> float:
        """Return the area of the box around its nodes, px^2."""
        at = self.numbered.nodes.at[self.numbered.nodes.there]
        return float(np.ptp(at.real) * np.ptp(at.imag))

    def is_texture(self, first: "Board") -> bool:
        """Return whether it has gaps and is as small as texture beside the first board."""
        return self.size < self.numbered.nodes.at.size and self.area < RIVAL_AREA * first.area

    def is_whole(self, shape: tuple[int, int] | None) -> bool:
        """Return whether it is a full rectangle, or has nearly all nodes of that shape."""
        every = self.numbered.nodes.at.size
        if shape is None:
            return self.size == every >= OTHER
        return self.size >= WHOLE * every and _fills_shape(self.numbered)

    def is_bordered(self) -> bool:
        """Return whether its border is seen, but for one side at most."""
        return sum(self.ends.border.sides) >= BORDERS

    def owned(self, count: int) -> Mask:
        """Return a mask of the corners, (count,), that are its nodes."""
        owned = np.zeros(count, np.bool_)
        owner = self.numbered.nodes.owner
        owned[owner[owner >= 0]] = True
        return owned


def build_grid(
    corners: Corners,
    image: GreyImage | None = None,
    shape: tuple[int, int] | None = None,
    like: Grid | None = None,
    region: Region | None = None,
    *,
    previous: Grid | None = None,
    strict: bool = False,
) -> Grid:
    """Number the corners of a checkerboard by row and column (section 4.3 of the paper).

    image: the view, (H, W) uint8 or uint16. Missing nodes are looked for again there, and torn ones
        that are far from where their neighbours predict them. Nodes at the rim must look like
        corners of the pattern, and the border of the pattern is found. None of this is done without
        the image.
    shape: rows and columns of the pattern's inner corners. The grid then has this shape. If fewer
        are seen, the borders in view decide which part it is; if more are seen, the grid is the
        fullest window of this shape. Without it, the grid has the rows and columns that are seen.
        A side with all its nodes at the edge of the image is no border of the pattern even so: the
        shape may have been counted in this view.
    like: a grid of the same pattern, usually at rest. The result has its orientation and
        numbers, and at least its rows and columns: nodes beyond a side on which that grid
        shows no border are kept, see `Grid.origin`. Without it row 0 is at the top and column
        0 at the left of the image.
    region: (x0, y0, x1, y1), px; corners outside belong to no node.
    previous: the grid of the frame before, with the numbers of `like`, or `like` itself for the
        first frame. Its numbers are continued if `like` alone leaves them ambiguous, as long as the
        pattern as a whole moves by less than half a cell from frame to frame.
    strict: raise GridError if the result has doubts, see `Grid.doubts`.

    Nodes that are not seen are NaN and MISSING; those in holes, between measured nodes, are
    INTERPOLATED. Islands, which no neighbour links to the other nodes, get a number if their
    position among the others, or at rest, allows only one; else they are left out.

    If a pattern without a border in view moves as a whole until its cells lie on other cells, it
    looks as if it had not moved. With `like`, three things decide: the border, the printing errors,
    which are the same in both frames, and `previous`. If none of them does, the grid is ambiguous.
    It then has the numbers by which the middle of the view has moved least, which are right if it
    moved by less than half a cell.

    If the border, the colours and the printing errors allow several rotations, the smallest is
    taken: a pattern is expected to rotate by less than 40 degrees from rest. From 40 to 50 degrees
    the grid is then ambiguous. The edge of an object that hides the pattern along a row
    is taken for its border only if it leaves as much of the last squares as at rest and does not
    continue past the pattern. If no closed cell is found the grid is empty, (0, 0) or of the known
    shape.

    If several patterns are seen, the grid is that of the only one that is seen whole: with nearly
    all nodes of the known shape, or, in an image, a full rectangle with its borders. If that does
    not decide, it is the largest, unless another is comparable.

    Raises GridError if corners have no finite position or no edge angles, if two comparable
    patterns are seen, if the largest lattice or its grid holds few of the corners or leaves out
    those in the middle of its cells, if a shape is far larger than the number of corners, if `like`
    is empty or contradicts `shape`; ImageError for an image that is not one, or not the corners'
    own.
    """
    shape = _known_shape(shape, like)
    _check_previous(previous, like)
    inside, seen = _checked(corners, image, shape, region)
    found = _found(seen, sparse_boards=like is None)
    if found is None:
        return empty_grid(len(corners), shape, like)
    found, nodes = _grown(seen, found)
    numbered, ends = _numbered(nodes, seen, found, shape=shape, like=like, previous=previous)
    boards = [] if numbered is None else [Board(numbered, ends)]
    if like is None and len(found.size) > 1 and found.size[1] >= OTHER:
        taken = boards[0].owned(len(inside)) if boards else np.zeros(len(inside), np.bool_)
        boards += _boards(seen, found, shape, taken, first=1)
    whole = [each for each in boards if each.is_whole(shape) and not each.is_texture(boards[0])]
    alone = len(whole) == 1 and (shape is not None or whole[0].is_bordered())
    least = SMALL * len(inside)
    if shape is None and like is None:
        least = max(least, min(len(inside) / 2, LEAST_BOARD))
    most = int(found.size[0])
    if boards and boards[0].size < min(least, LEAST_BOARD):
        most = min(most, boards[0].size)
    if not alone and most < least:
        raise GridError(
            f"the largest lattice has {most} of {len(inside)} corners, expected at least "
            f"{math.ceil(least)}; check the detector's configuration, or give a region or the shape"
        )
    if not boards:
        return empty_grid(len(corners), shape, like)
    board = whole[0] if alone or len(whole) > 1 else boards[0]
    if skips_corners(board.numbered.nodes, seen.z):
        raise GridError(
            f"the lattice of {board.size} nodes leaves out corners that lie in the middle of its "
            "cells; the pattern is too blurred, or seen at too low an angle"
        )
    others = _others(found, board, seen, alone=alone)
    grid = _result(corners, inside, board)
    if shape is None:
        grid = dataclasses.replace(grid, others=others)
    if strict and grid.doubts:
        raise GridError("; ".join(grid.doubts))
    return grid


def build_grids(
    corners: Corners,
    image: GreyImage | None = None,
    shape: tuple[int, int] | None = None,
    region: Region | None = None,
) -> list[Grid]:
    """Number the corners of every checkerboard in a view, the one with the most nodes first.

    corners, image, shape, region: as in `build_grid`. A corner belongs to one grid at most. A
    lattice of fewer than nine corners is not a board, nor is one that has less than half the nodes
    of a known shape.

    Raises the errors of `build_grid` for its arguments.
    """
    shape = _known_shape(shape, None)
    inside, seen = _checked(corners, image, shape, region)
    found = _found(seen)
    if found is None:
        return []
    taken = np.zeros(len(inside), np.bool_)
    boards = _boards(seen, found, shape, taken)
    grids = [_result(corners, inside, board) for board in boards]
    return sorted(grids, key=lambda grid: -int(np.count_nonzero(grid.valid)))


def _boards(
    seen: Seen, found: Lattice, shape: tuple[int, int] | None, taken: Mask, first: int = 0
) -> Iterator[Board]:
    """Yield the boards in a view, those of more corners first.

    taken: (N,) bool, corners that belong to other boards. first: the component to begin with.
    """
    least = LEAST_BOARD if shape is None else max(shape[0] * shape[1] / 2, 1)
    component = first - 1
    while (component := component + 1) < np.count_nonzero(found.size >= min(least, LEAST_BOARD)):
        if 2 * np.count_nonzero(taken[found.component == component]) > found.size[component]:
            continue
        found, nodes = _grown(seen, found, component, taken)
        numbered, ends = _numbered(nodes, seen, found, shape=shape, alone=True)
        if numbered is None:
            continue
        board = Board(numbered, ends)
        if board.size < least or skips_corners(numbered.nodes, seen.z):
            continue
        taken |= board.owned(len(taken))
        yield board


def _checked(
    corners: Corners, image: GreyImage | None, shape: tuple[int, int] | None, region: Region | None
) -> tuple[Index, Seen]:
    """Check the arguments; return the indices of the corners in the region, and their data."""
    check_kind("corners", corners, Corners, GridError)
    if image is not None:
        image = check_image(image)
        _check_holds(image, corners)
    check_finite(corners)
    if shape is not None:
        check_room(shape, len(corners))
    inside = _inside(corners, region)
    edges = corners.edges.take(inside, axis=0)
    if len(inside) >= 4 and np.isnan(edges).all():
        raise GridError(
            "the corners have no edge angles, which the grid is built from; "
            "detect them with a refinement (EdgeLines, EdgeStep or Midlines)"
        )
    z = corners.xy.take(inside, axis=0).astype(np.float64).view(np.complex128)[:, 0]
    if image is not None:
        image = image if image.flags.c_contiguous else image.copy()
    torn = np.ones(len(inside) + 1, np.bool_)
    torn[:-1] = (~(corners.sigma < TORN) | (corners.refusal != Refusal.NONE.value)).take(inside)
    return inside, Seen(z, edges, lines_of(edges), image, torn)


def _found(seen: Seen, *, sparse_boards: bool = True) -> Lattice | None:
    """Return the lattice of the corners; None if no closed cell is seen.

    sparse_boards: whether a board of few corners among many others is looked for.
    """
    if len(seen.z) < 4:
        return None
    z = seen.z.astype(np.complex64)
    found = lattice(z, seen.lines)
    left = np.flatnonzero(found.component < 0)
    if sparse_boards and len(left) >= OTHER:
        found = _with_wider(found, left, lattice(z[left], seen.lines[:, left], FEW))
    return found if len(found.size) else None


def _with_wider(found: Lattice, left: Index, wider: Lattice) -> Lattice:
    """Return the lattice together with boards of wider cells among the corners that were left over.

    left: (M,), these corners. wider: their lattice. A board of few corners in front of fine texture
    is sparse: its corners are at first too far apart for neighbours.
    """
    count = int(np.count_nonzero(wider.size >= LEAST_BOARD))
    if not count:
        return found
    mine = (wider.component >= 0) & (wider.component < count)
    here, size = left[mine], np.concatenate([found.size, wider.size[:count]])
    order = np.argsort(-size, kind="stable")
    rank = np.append(np.argsort(order, kind="stable"), -1)
    label = found.component.copy()
    label[here] = len(found.size) + wider.component[mine]
    node, turn, support = found.node.copy(), found.turn.copy(), found.support.copy()
    node[here], turn[here], support[here] = (
        values[mine] for values in (wider.node, wider.turn, wider.support)
    )
    axis = np.concatenate([found.axis, wider.axis[:count]])[order]
    return Lattice(rank[label], size[order], node, turn, support, axis)


def _grown(
    seen: Seen, found: Lattice, component: int = 0, taken: Mask | None = None
) -> tuple[Lattice, Nodes]:
    """Return the lattice with that component cut until it is one pattern, and its nodes, with the
    corners that belong to them.

    taken: (N,) bool, corners that belong to other boards; None if there are no other boards.
    """
    while True:
        found, nodes = _whole(seen, found, component)
        if taken is not None:
            small = found.component >= np.count_nonzero(found.size >= LEAST_BOARD)
            nodes.free &= ~taken & ((found.component < 0) | small)
        grow(nodes, seen)
        drop_detached(nodes)
        parts = cut_by_image(found, nodes, seen.image, component)
        if parts is None:
            return found, nodes
        found = parts


def _whole(seen: Seen, found: Lattice, component: int = 0) -> tuple[Lattice, Nodes]:
    """Return the lattice with that component cut until it is one pattern, and its boxed nodes."""
    while True:
        nodes = boxed(seen.z, found, component)
        parts = cut(found, nodes, component)
        if parts is None:
            return found, nodes
        found = parts


def _numbered(
    nodes: Nodes,
    seen: Seen,
    found: Lattice,
    *,
    shape: tuple[int, int] | None,
    like: Grid | None = None,
    previous: Grid | None = None,
    alone: bool = False,
) -> tuple[Numbered | None, Ended]:
    """Return the nodes, numbered and with holes filled, and the borders; None if none is left.

    alone: whether other components are other boards.
    """
    if not nodes.there.any():
        return None, Ended()
    by_border = like is not None or shape not in (None, nodes.at.shape)
    border = _first_border(nodes, seen, shape) if by_border else Border()
    if not nodes.there.any():
        return None, Ended()
    if not alone and any(border.sides):
        border = border.without(continued(nodes, found, seen))
    if like is not None:
        numbered = like_rest(nodes, border, like, previous)
    elif shape is not None and by_border:
        numbered = in_shape(nodes, bends(seen.edges), shape, _ends(nodes, seen, border, shape))
    else:
        numbered = Numbered(nodes)
    every = np.count_nonzero(nodes.there)  # those outside the known shape too
    count = np.count_nonzero(numbered.nodes.there)
    if not alone and np.count_nonzero(found.size >= LEAST_BOARD) > 1:
        at_rest = None if like is None else like.cut_to(_framed(numbered))
        join_islands(numbered.nodes, found, seen, at_rest)
    fill(numbered.nodes, seen, BRACKETED if shape is None else WEAK)
    if not numbered.nodes.there.any():
        return None, Ended()
    same = every == count == np.count_nonzero(numbered.nodes.there)
    if seen.image is None or (by_border and same):
        border = border.turned(numbered.quarters)
    else:
        border = border_of(numbered.nodes, seen.image)
        if not alone and any(border.sides):
            border = border.without(continued(numbered.nodes, found, seen))
    if like is None and shape is not None:
        numbered = followed(numbered, border, seen)
    sides = None if seen.image is None else border.sides
    if seen.image is not None and like is None and shape is not None and _fills_shape(numbered):
        sides = _known_sides(numbered.nodes, seen.image, border.sides)
    whole = sides is not None and all(sides) and numbered.nodes.at.shape == shape
    whole &= numbered.seen_shape is None
    reflected = _reflected(numbered.nodes, seen.image, like, whole=whole)
    return numbered, Ended(sides, border, reflected)


def _first_border(nodes: Nodes, seen: Seen, shape: tuple[int, int] | None) -> Border:
    """Return the border that decides the numbers. Lines that a known shape lacks are added first,
    where no border is seen."""
    if seen.image is None:
        return Border()
    border = border_of(nodes, seen.image)
    if shape is None or not np.less(nodes.at.shape, shape).any():
        return border
    before = nodes.at
    extend(nodes, seen, border.sides)
    added = not np.array_equal(nodes.at, before, equal_nan=True)
    return border_of(nodes, seen.image) if added else border


def _ends(nodes: Nodes, seen: Seen, border: Border, shape: tuple[int, int]) -> Ends:
    """Return what is known of the sides of nodes that are to be numbered in a known shape."""
    if seen.image is None or not np.less(nodes.at.shape, shape).any():
        return Ends(border.sides)
    return Ends(border.sides, cut_of(nodes, seen.image), border.passing)


def _known_sides(nodes: Nodes, image: GreyImage, seen: Sides) -> Sides:
    """Return the borders of a pattern with all rows and columns of its known shape.

    Where the image ends beside the last nodes, the pattern may continue: the shape may have been
    counted in this view.

    seen: the borders in view.
    """
    if all(seen):
        return seen
    cut = cut_of(nodes, image)
    return Sides(*(end or not hidden for end, hidden in zip(seen, cut, strict=True)))


def _reflected(nodes: Nodes, image: GreyImage | None, like: Grid | None, *, whole: bool) -> bool:
    """Return whether a part of the nodes may be the reflection of another part, now or at rest.

    whole: whether the pattern ends on all sides, and has the known shape.
    """
    if whole or (like is not None and like.reflected):
        return like is not None and like.reflected
    at = np.where(nodes.status == NodeStatus.INTERPOLATED, NOWHERE, nodes.at)
    if has_seam(at) or (like is None and touch(at)) or repeats_reversed(at):
        return True
    return image is not None and is_dimmed_reflection(at, nodes.parity, image)


def _framed(numbered: Numbered) -> Grid:
    """Return the grid without its nodes: its rows, columns and numbers."""
    return dataclasses.replace(empty_grid(0, numbered.nodes.at.shape), origin=numbered.origin)


def _fills_shape(numbered: Numbered) -> bool:
    """Return whether nodes in a grid of known shape reach its first and last rows and columns."""
    there = numbered.nodes.there
    if numbered.seen_shape is not None or not there.any():
        return False
    top, bottom, left, right = full_lines(there)
    return (top, left, bottom + 1, right + 1) == (0, 0, *there.shape)


def _check_holds(image: GreyImage, corners: Corners) -> None:
    """Raise ImageError if a corner lies outside the image, because it is from another image."""
    columns, rows = (int(line.max(initial=-1)) + 1 for line in corners.pixel.T)
    if rows > image.shape[0] or columns > image.shape[1]:
        raise ImageError(
            f"the corners reach over {rows} rows and {columns} columns, the image has shape "
            f"{image.shape}; give the image that they were found in"
        )


def _known_shape(shape: tuple[int, int] | None, like: Grid | None) -> tuple[int, int] | None:
    if shape is not None:
        check_shape(shape, GridError)
        check_size(*shape)
    if like is None:
        return shape
    check_kind("like", like, Grid, GridError)
    if not like.valid.any():
        raise GridError("the grid given as `like` has no nodes; give one that has been found")
    if shape is not None and tuple(shape) != like.shape:
        raise GridError(f"shape is {shape}, but the grid given as `like` has {like.shape}")
    return like.shape


def _inside(corners: Corners, region: tuple[float, float, float, float] | None) -> Index:
    if region is None:
        return np.arange(len(corners))
    try:
        x0, y0, x1, y1 = map(float, region)
        sensible = x0 < x1 and y0 < y1
    except (TypeError, ValueError):
        sensible = False
    if not sensible:
        raise GridError(f"region must be (x0, y0, x1, y1) with x0 < x1 and y0 < y1, not {region!r}")
    x, y = corners.xy.T
    return np.flatnonzero((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1))


def _check_previous(previous: Grid | None, like: Grid | None) -> None:
    if previous is None:
        return
    if like is None:
        raise GridError("the grid of the frame before needs the grid at rest too")
    check_kind("previous", previous, Grid, GridError)
    if not previous.valid.any():
        raise GridError("the grid of the frame before has no nodes; give one that has been found")


def _others(found: Lattice, board: Board, seen: Seen, *, alone: bool) -> int:
    """Return the corners of the largest other lattice that may be the pattern that is meant, or 0.

    alone: whether that board alone is seen whole. If so, only a comparable lattice may be meant. If
    not, a comparable one raises GridError, and a smaller one may be meant. Lattices are compared by
    their corners and the area that these cover: fine texture in a room forms lattices too.
    """
    if len(found.size) < 2 or found.size[1] < OTHER:
        return 0
    owned = board.owned(len(seen.z))
    linked = found.component[owned]
    linked = linked[linked >= 0]  # others were attached
    if not len(linked):
        return 0
    own = int(np.bincount(linked).argmax())
    first, area = _box(seen.z[owned])
    comparable = RIVAL * (np.count_nonzero(owned) if alone else found.size[own])
    for component in range(int(np.count_nonzero(found.size >= OTHER))):
        other = (found.component == component) & ~owned
        count = int(np.count_nonzero(other))
        if component == own or count < OTHER or 2 * count < found.size[component]:
            continue
        second, covered = _box(seen.z[other])
        if covered < RIVAL_AREA * area:
            continue
        if alone:
            return count if count >= comparable else 0
        if count >= comparable:
            raise GridError(
                f"two patterns are seen, of {found.size[own]} and {found.size[component]} corners, "
                f"within {first} and {second}; give a region with one of them"
            )
        return count
    return 0


def _box(z: NDArray[np.complex128]) -> tuple[str, float]:
    """Return the box around points in words, and its area, px^2."""
    x, y = z.real, z.imag
    words = f"({x.min():.0f}, {y.min():.0f}, {x.max():.0f}, {y.max():.0f})"
    return words, float(np.ptp(x) * np.ptp(y))


def _result(corners: Corners, inside: Index, board: Board) -> Grid:
    numbered, ends = board
    nodes = numbered.nodes
    place = np.flatnonzero(nodes.owner >= 0)
    owner = inside.take(nodes.owner.take(place))
    index = np.full((len(corners), 2), -1, np.int32)
    rows, columns = index.T
    rows[owner], columns[owner] = np.divmod(place.astype(np.int32), np.int32(nodes.at.shape[1]))
    sigma = np.full(nodes.at.shape, np.nan, np.float32)
    sigma.ravel()[place] = corners.sigma.take(owner)
    xy = nodes.at.astype(np.complex64, order="C").view(np.float32).reshape(*nodes.at.shape, 2)
    return Grid(
        xy=xy,
        status=nodes.status,
        sigma=bent_sigma(xy, sigma, corners.edge_radius),
        index=index,
        parity=nodes.parity,
        origin=numbered.origin,
        border=ends.sides,
        reach=ends.border.reach,
        past=ends.border.past,
        seen_shape=numbered.seen_shape,
        confidence=0.0 if numbered.ambiguous or ends.reflected else math.inf,
        reflected=ends.reflected,
        rival=numbered.rival,
        edge_radius=corners.edge_radius,
    )
