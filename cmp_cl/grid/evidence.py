"""Nodes at the rim of a grid are checked here: four sectors, edges in line, and the position."""

from typing import NamedTuple

import numpy as np

from cmp_cl.grid.grid import NodeStatus
from cmp_cl.grid.lattice import Complex
from cmp_cl.grid.nodes import Float, Index, Mask, Nodes, Points, kept_by_mask, median, turned_lines
from cmp_cl.grid.predict import Steps, predict_some
from cmp_cl.image import GreyImage

# Shares of a cell's diagonal: points at which its grey level is sampled.
WITHIN = np.array([0.2, 0.3])
HOLE = 6  # nodes: those beside a larger hole count as nodes at the rim
SAMPLE = 64  # inner nodes whose contrast is that of the pattern


class Least(NamedTuple):
    """The least evidence for a node: shares of the span of its four cells and of the pattern's
    contrast, the cosine between its edges and the lattice's steps, and the cells from its
    prediction."""

    span: float
    contrast: float
    cosine: float
    off: float


USUAL = Least(0.4, 0.2, 0.85, 0.12)
ALONE = Least(0.8, 0.7, 0.95, 0.12)  # for a node without a whole cell
# A shadow divides the levels of a bright and of a dark cell alike: it changes their difference, but
# hardly their ratio. Corners with the pattern's ratio need no more evidence than this.
SHADED = Least(0.1, 0.1, 0.95, 0.12)
SHADED_ALONE = Least(0.4, 0.1, 0.95, 0.12)  # for one without a whole cell
RATIOS = 0.7, 1.3  # least and greatest multiple of the logarithm of the pattern's ratio
BLANK = 0.1  # share of the pattern's contrast; a second look with less is none
# px: a node in a whole cell may be so far from its prediction, however small the cells are.
NEAR = 1.5
HIDDEN = 0.4  # cells: nodes nearer to the edge of the image than that may be missed
STRAY = 0.5  # px: stragglers may be so far from their predictions
BESIDE = 2  # nodes to each side whose distances from their predictions are compared
SHARE, ALIKE = 0.25, 4.0  # quantile of these distances, and the largest multiple of it
BENT = 0.25  # cells: largest distance that a bend of the surface explains
EDGE_PIXELS, EDGE_OFF = 3.0, 2.0  # px from the edge of the image, and from the prediction there
EDGE_CELLS, EDGE_OFF_CELLS = 0.25, 0.12  # the same in cells


def reject(nodes: Nodes, image: GreyImage, lines: Complex) -> bool:
    """Reject nodes at the rim that do not look like the pattern's; return whether there were any.

    Junctions with the surround, dots and codes in cells, T junctions and the corners of a room fail
    in one of two ways: they do not have four sectors with the colours of their number, or their
    edges do not lead to their neighbours. lines: of the corners, see `lines_of`.
    """
    dropped = False
    usual: _Usual | None = None
    while True:
        row, column, whole = _rim(nodes.there)
        if not len(row):
            return dropped
        if usual is None:
            every = _look(nodes, image, *_rim_and_inside(nodes.there))
            usual = _Usual.of(every, len(row))
            look = every.first(len(row))
        else:
            look = _look(nodes, image, row, column)
        kept = _convincing(nodes, image, lines, look, whole, usual)
        if kept.all():
            return dropped
        nodes.drop(row[~kept], column[~kept])
        dropped = True


def are_blank(nodes: Nodes, image: GreyImage, row: Index, column: Index) -> Mask:
    """Return a mask of the nodes around which the image does not show the four cells of their
    number.

    The noise of a plain spot in front of the pattern, and its edge, look like corners to a search
    for one. The contrast is that of Michelson, which a shadow does not change.
    """
    if not len(row):
        return np.zeros(0, np.bool_)
    inside = _look(nodes, image, *_some_inside(nodes.there))
    look = _look(nodes, image, row, column)
    usual = median(inside.michelson[inside.known]) if inside.known.any() else 0.0
    blank: Mask = look.known & (look.michelson < BLANK * usual)
    return blank


def reject_stragglers(nodes: Nodes, image: GreyImage, lines: Complex) -> bool:
    """Reject stragglers that are not as good as other nodes; return whether there were any.

    Where a board touches things behind it, some of these complete its outer squares by chance. A
    last line that has at most half of the nodes in view is probably beyond the border; its nodes
    are stragglers. If at most one is a corner, and the others second looks, there is no such line.
    lines: of the corners, see `lines_of`.
    """
    dropped = False
    while _has_few(nodes.there):
        row, column, guessed = _stragglers(nodes, image)
        place = row, column
        if not len(row):
            return dropped
        look = _look(nodes, image, *place)
        inside = _look(nodes, image, *_some_inside(nodes.there))
        off, others = (
            np.abs(predict_some(nodes, *each)[0] - nodes.at[each])
            for each in (place, _rim(nodes.there)[:2])
        )
        others = others[~np.isnan(others)]
        contrast, usual = look.bright - look.dark, median(inside.bright - inside.dark)
        kept = look.known & ~guessed
        kept &= contrast >= np.maximum(ALONE.span * look.span, ALONE.contrast * usual)
        kept &= off <= np.minimum(np.maximum(STRAY, ALIKE * median(others)), ALONE.off * look.cell)
        kept &= ~(_cosine(nodes, lines, row, column, look.along, look.down) < ALONE.cosine)
        if kept.all():
            return dropped
        nodes.drop(row[~kept], column[~kept])
        nodes.crop()
        dropped = True
    return dropped


@kept_by_mask
def _has_few(there: Mask) -> bool:
    """Return whether a last line has at most half as many nodes as the line inside."""
    ways = (turned_lines(there, quarters) for quarters in range(4))
    return any(len(way) > 2 and 2 * way[0].sum() <= way[1].sum() for way in ways)


def _stragglers(nodes: Nodes, image: GreyImage) -> tuple[Index, Index, Mask]:
    """Return the nodes of the last lines that have at most half of the nodes in view, and a mask of
    those on a line of a single corner or none."""
    few, guessed = np.zeros((2, *nodes.at.shape), np.bool_)
    for quarters in range(4):
        at, owner = turned_lines(nodes.at, quarters), turned_lines(nodes.owner, quarters)
        if len(at) > 2:
            there = ~np.isnan(at[0].real)
            beyond = in_view(at[1] + (1 + HIDDEN) * (at[1] - at[2]), image)
            if 2 * np.count_nonzero(there) <= np.count_nonzero(there | beyond):
                turned_lines(few, quarters)[0] |= there
                turned_lines(guessed, quarters)[0] |= there & (np.count_nonzero(owner[0] >= 0) < 2)
    row, column = np.nonzero(few)
    return row, column, guessed[row, column]


@kept_by_mask
def _rim(seen: Mask) -> tuple[Index, Index, Mask]:
    """Return the nodes with a neighbour, of eight, that is neither there nor bracketed, and a mask
    of those in a whole cell.

    An index is bracketed if it lies in a small hole, between nodes of its row and of its column.
    """
    there = seen if seen.all() else seen | (_hole(seen) & _hole(seen.T).T)
    around = np.zeros(np.add(seen.shape, 2), np.bool_)
    around[1:-1, 1:-1] = there
    whole = around[:-2] & around[1:-1] & around[2:]
    whole = whole[:, :-2] & whole[:, 1:-1] & whole[:, 2:]
    row, column = np.nonzero(seen & ~whole)
    around[1:-1, 1:-1] = seen
    cell = around[:-1, :-1] & around[1:, :-1] & around[:-1, 1:] & around[1:, 1:]
    inside = cell[row, column] | cell[row + 1, column]
    inside |= cell[row, column + 1] | cell[row + 1, column + 1]
    return row, column, inside


def _hole(seen: Mask) -> Mask:
    """Return (R, C) bool: True between two nodes of a row that are at most HOLE nodes apart."""
    columns = seen.shape[1]
    place = np.arange(columns)
    before = np.maximum.accumulate(np.where(seen, place, -columns), axis=1)
    after = np.minimum.accumulate(np.where(seen, place, 2 * columns)[:, ::-1], axis=1)[:, ::-1]
    hole: Mask = after - before <= HOLE
    return hole


def _some_inside(seen: Mask) -> tuple[Index, Index]:
    """Return some nodes, all of them inside the grid if any are."""
    inner = seen[1:-1, 1:-1] & seen[:-2, 1:-1] & seen[2:, 1:-1] & seen[1:-1, :-2] & seen[1:-1, 2:]
    row, column = np.nonzero(inner)
    row, column = (row + 1, column + 1) if len(row) else np.nonzero(seen)
    count = min(SAMPLE, len(row))
    some = np.arange(count) * (len(row) - 1) // max(count - 1, 1)
    return row[some], column[some]


@kept_by_mask
def _rim_and_inside(seen: Mask) -> tuple[Index, Index, Steps]:
    """Return the nodes at the rim, then some inside, and the steps around them."""
    row, column = np.concatenate([_rim(seen)[:2], _some_inside(seen)], axis=1)
    return row, column, Steps.of(seen, row, column)


class _Look(NamedTuple):
    """The image around some nodes, each (M,).

    along, down, cell: as in `mean_steps`, 0 where steps are not known. bright, dark: the grey
    levels of the darker bright cell and of the brighter dark one. span: of the four cells. ratio:
    logarithm of the product of the bright cells over that of the dark ones.
    """

    row: Index
    column: Index
    along: Points
    down: Points
    cell: Float
    known: Mask
    bright: Float
    dark: Float
    span: Float
    ratio: Float

    @property
    def michelson(self) -> Float:
        """Return the contrast as a share of the sum of both levels."""
        michelson: Float = (self.bright - self.dark) / np.maximum(self.bright + self.dark, 1)
        return michelson

    def first(self, count: int) -> "_Look":
        """Return the first of them."""
        return _Look._make(values[:count] for values in self)


class _Usual(NamedTuple):
    """The median contrast and ratio of nodes inside the grid, as in `_Look`; 0 if none is known."""

    contrast: float = 0.0
    ratio: float = 0.0

    @classmethod
    def of(cls, look: _Look, first: int) -> "_Usual":
        """Return those of the nodes from that one on."""
        known = look.known[first:]
        if not known.any():
            return cls()
        contrast = (look.bright - look.dark)[first:][known]
        return cls(median(contrast), median(look.ratio[first:][known]))


def _look(
    nodes: Nodes, image: GreyImage, row: Index, column: Index, steps: Steps | None = None
) -> _Look:
    """Look at the four cells around nodes; steps: those around them, if they are known."""
    along, down, cell = (steps or Steps.of(nodes.there, row, column)).mean(nodes.at)
    known = ~np.isnan(along.real + down.real)
    along[~known] = down[~known] = 0
    falling, rising = along + down, along - down
    step = np.array([falling, rising, -falling, -rising])  # to the four cells
    at = nodes.at[row, column] + WITHIN[:, None, None] * step
    level = grey(image, at).sum(axis=0)
    high, low = np.maximum(level[:2], level[2:]), np.minimum(level[:2], level[2:])
    black = (nodes.parity + row + column) % 2 == 0  # the cells after and before on the diagonal
    dark, bright = np.where(black, *high), np.where(black, *low[::-1])
    span = np.maximum(*high) - np.minimum(*low)
    log = np.log(np.maximum(level, 1))
    ratio = log[1] + log[3] - log[0] - log[2]
    ratio = np.where(black, ratio, -ratio)
    return _Look(row, column, along, down, cell, known, bright, dark, span, ratio)


def grey(image: GreyImage, at: Points) -> Float:
    """Return the grey levels of the nearest pixels; beyond the image those of its border.

    An image that is not contiguous takes longer: it is copied.
    """
    rows, columns = image.shape
    x = np.rint(at.real).clip(0, columns - 1)
    y = np.rint(at.imag).clip(0, rows - 1)
    level: Float = image.take((y * columns + x).astype(np.int64)).astype(np.float64)
    return level


def in_view(at: Points, image: GreyImage) -> Mask:
    """Return a mask of the points that lie in the image."""
    rows, columns = image.shape
    inside: Mask = (at.real >= 0) & (at.real < columns) & (at.imag >= 0) & (at.imag < rows)
    return inside


def _convincing(
    nodes: Nodes,
    image: GreyImage,
    lines: Complex,
    look: _Look,
    in_cell: Mask,
    usual: _Usual,
) -> Mask:
    """Return a mask of the nodes that look like corners of the pattern."""
    row, column, along, down, cell, known, bright, dark, span, ratio = look
    contrast = bright - dark
    cosine = _cosine(nodes, lines, row, column, along, down)
    at = nodes.at[row, column]
    far = np.array(image.shape[::-1]) - 1
    inward = np.minimum(
        np.minimum(at.real, far[0] - at.real), np.minimum(at.imag, far[1] - at.imag)
    )
    off = np.abs(predict_some(nodes, row, column)[0] - at)
    off[np.isnan(off)] = np.inf
    typical = _typical(off, cell, row, column, nodes.at.shape)
    near = np.maximum(NEAR, np.minimum(ALIKE * typical, BENT * cell))

    def fits(least: Least, near: Float) -> Mask:
        return (
            (contrast >= least.span * span)
            & (contrast >= least.contrast * usual.contrast)
            & ~(cosine < least.cosine)
            & (off <= np.maximum(least.off * cell, near))
        )

    # Near the edge of the image, the rings of a corner reach outside it.
    guessed = nodes.status[row, column] == NodeStatus.SECOND_LOOK.value
    beside = (inward < 0) | ((inward < EDGE_PIXELS) & (guessed | (off > EDGE_OFF)))
    beside |= (inward < EDGE_CELLS * cell) & (off > EDGE_OFF_CELLS * cell)
    usually = fits(USUAL, near)
    if not in_cell.all():
        usually &= in_cell | fits(ALONE, np.zeros(1))
    if not usually.all():
        low, high = RATIOS
        alike = (ratio >= low * usual.ratio) & (ratio <= high * usual.ratio)
        alike &= nodes.owner[row, column] >= 0
        usually |= alike & fits(SHADED, np.zeros(1)) & (in_cell | fits(SHADED_ALONE, np.zeros(1)))
    kept: Mask = known & usually & ~beside
    return kept


def _typical(off: Float, cell: Float, row: Index, column: Index, shape: tuple[int, ...]) -> Float:
    """Return the typical distance from their predictions of the nodes around each node, px.

    Where the surface bends away, all nodes at the rim are far from their predictions. It is
    computed only for nodes that are farther than USUAL.off; the others get 0.
    """
    typical = np.zeros(len(off))
    asked = np.flatnonzero((off > USUAL.off * cell) & np.isfinite(off))
    if not len(asked):
        return typical
    every = np.full(np.add(shape, 2 * BESIDE), np.nan)
    every[row + BESIDE, column + BESIDE] = np.where(np.isfinite(off), off, np.nan)
    reach = np.arange(2 * BESIDE + 1)
    rows = row[asked, None, None] + reach[:, None]
    columns = column[asked, None, None] + reach
    around = np.sort(every[rows, columns].reshape(len(asked), -1), axis=1)  # unknown ones are last
    place = SHARE * (np.count_nonzero(around == around, axis=1) - 1)
    before = place.astype(np.int64)
    number = np.arange(len(asked))
    low, high = around[number, before], around[number, np.ceil(place).astype(np.int64)]
    typical[asked] = low + (high - low) * (place - before)  # as np.nanquantile, which is slow
    return typical


def _cosine(
    nodes: Nodes, lines: Complex, row: Index, column: Index, along: Points, down: Points
) -> Float:
    """Return the smaller |cos| of the angles between a corner's two lines and the steps, or NaN."""
    owner = nodes.owner[row, column]
    level = (nodes.parity + row + column) % 2 == 0  # e0 and e2 lie along the row
    steps = np.array([along, down])
    steps = np.where(level, steps, steps[::-1]).conj()
    ahead = np.abs((lines.take(owner, axis=1) * steps).real)
    cosine = ahead / np.maximum(np.abs(steps), 1e-9)
    least: Float = np.minimum(*cosine)
    least[owner < 0] = np.nan
    return least
