"""Corners to rows and columns: numbering, orientation, holes, second look."""

import cmath

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners
from cmp_cl.errors import GridError, ImageError
from cmp_cl.grid.grid import Grid, NodeStatus
from cmp_cl.grid.lattice import Lattice, lattice, starts
from cmp_cl.grid.limits import check_finite, check_size
from cmp_cl.grid.second_look import second_look
from cmp_cl.image import GreyImage, check_image

Points = NDArray[np.complex128]  # x + 1j y, px, NaN where there is none
Index = NDArray[np.int64]
Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

NOWHERE = complex(np.nan, np.nan)
SMALL = 0.1  # least share of the corners that the pattern must hold
RIVAL = 0.5  # a second component of this share of the first is a second pattern
NEAR = 0.3  # cells: how far from its prediction a node may be
WHOLE = 1024  # weight of a corner with straight boundaries
WEAK, BRACKETED, STRONG = 1.4, 4.0, 8.0  # weights of predictions
VOTERS = 96  # nodes that are looked up in the rest grid
HALFWAY = 0.7  # cells: half of the way to the next node of a colour
FEW = 400  # nodes that are quicker predicted one by one


def build_grid(
    corners: Corners,
    image: GreyImage | None = None,
    shape: tuple[int, int] | None = None,
    like: Grid | None = None,
    region: tuple[float, float, float, float] | None = None,
) -> Grid:
    """Number the corners of a checkerboard by row and column (section 4.3 of the paper).

    image: where the second look at missing nodes looks, (H, W) uint8 or uint16; None skips it.
    shape: rows and columns of the pattern's inner corners. The grid then has this shape, the
        fullest such window of the lattice; without it, the shape of what is seen.
    like: a grid of the same pattern, usually at rest. The result has its shape, orientation
        and origin; without it row 0 is at the top and column 0 at the left of the image.
    region: (x0, y0, x1, y1), px; corners outside belong to no node.

    Nodes that are not seen are NaN and MISSING; those that measured nodes bracket, in holes
    of the pattern, are INTERPOLATED.
    Where no closed cell is found the grid is empty, (0, 0) or of the known shape.

    Raises GridError where the corners have no edge angles, where two patterns are seen, where
    the largest lattice is small against the number of corners, where `like` is empty or
    contradicts `shape`; ImageError for an image that is not one, or not the corners' own.
    """
    if not isinstance(corners, Corners):
        raise GridError(f"expected the Corners of an image, got {type(corners).__name__}")
    check_finite(corners)
    if image is not None:
        _check_holds(check_image(image), corners)
    shape = _known_shape(shape, like)
    inside = _inside(corners, region)
    if len(inside) < 4:
        return _empty(len(corners), shape)
    edges = corners.edges.take(inside, axis=0)
    if np.isnan(edges).all():
        raise GridError(
            "the corners have no edge angles, which the grid is built from; "
            "detect them with a refinement (EdgeLines, EdgeStep or Midlines)"
        )
    seen = corners.xy.take(inside, axis=0).view(np.complex64)[:, 0]
    found = lattice(seen, edges)
    if not len(found.size):
        return _empty(len(corners), shape)
    if found.size[0] < SMALL * len(inside):
        raise GridError(
            f"the largest lattice has {found.size[0]} of {len(inside)} corners, "
            f"expected at least {SMALL:.0%}; check the detector's configuration or give a region"
        )
    z = seen.astype(np.complex128)
    nodes = _boxed(z, found)
    _drop_misfits(nodes)
    _grow(nodes, z, edges)
    if like is not None:
        nodes = _like_rest(nodes, found, like)
    elif shape is not None:
        nodes = _fullest(nodes, found.bend, shape)
    _fill(nodes, z, edges, image, BRACKETED if shape is None else WEAK)
    _refuse_rival(found, nodes, z)
    return _result(corners, inside, nodes)


class _Nodes:
    """A grid in the making.

    at: (R, C) complex128, px; owner: (R, C) number of the corner there, -1 for none;
    status: (R, C) uint8 of NodeStatus; changed: (R, C) bool, where a node was put or dropped
    since misfits were looked for; parity: as in Grid; free: (N,) bool, corners that have not
    been in the grid.
    """

    def __init__(self, shape: tuple[int, int], parity: int, free: Mask) -> None:
        self.at: Points = np.full(shape, NOWHERE)
        self.owner: Index = np.full(shape, -1)
        self.status: NDArray[np.uint8] = np.zeros(shape, np.uint8)
        self.changed: Mask = np.zeros(shape, np.bool_)
        self.parity = parity
        self.free = free

    def put(self, row: Index, column: Index, at: Points, status: NodeStatus) -> None:
        self.at[row, column] = at
        self.status[row, column] = status
        self.changed[row, column] = True

    def drop(self, row: Index, column: Index) -> None:
        self.put(row, column, np.full(len(row), NOWHERE), NodeStatus.MISSING)
        self.owner[row, column] = -1

    def pad(self) -> None:
        """A ring of missing nodes around; the parity of node (0, 0) stays."""
        self.at = np.pad(self.at, 1, constant_values=NOWHERE)
        self.owner = np.pad(self.owner, 1, constant_values=-1)
        self.status = np.pad(self.status, 1)
        self.changed = np.pad(self.changed, 1)

    def crop(self) -> None:
        """Without the empty rows and columns around."""
        seen = self.status != NodeStatus.MISSING
        rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
        box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        self.at, self.owner = self.at[box], self.owner[box]
        self.status, self.changed = self.status[box], self.changed[box]
        self.parity = (self.parity + int(rows[0]) + int(columns[0])) % 2

    def turned(self, quarters: int) -> "_Nodes":
        """The same nodes with the numbers turned: row 0 is the last column, and so on."""
        if not quarters:
            return self
        first = (0, self.at.shape[1], sum(self.at.shape), self.at.shape[0])[quarters]
        turned = _Nodes(self.at.shape, (self.parity + first) % 2, self.free)
        turned.at, turned.owner = np.rot90(self.at, quarters), np.rot90(self.owner, quarters)
        turned.status = np.rot90(self.status, quarters)
        turned.changed = np.rot90(self.changed, quarters)
        return turned

    def window(self, top: int, left: int, shape: tuple[int, int]) -> "_Nodes":
        """The nodes from that row and column on."""
        if (top, left, *shape) == (0, 0, *self.at.shape):
            return self
        cut = _Nodes(shape, (self.parity + top + left) % 2, self.free)
        rows, columns = self.at.shape
        here = np.s_[
            max(top, 0) : max(min(rows, top + shape[0]), 0),
            max(left, 0) : max(min(columns, left + shape[1]), 0),
        ]
        there = np.s_[
            max(-top, 0) : max(min(rows - top, shape[0]), 0),
            max(-left, 0) : max(min(columns - left, shape[1]), 0),
        ]
        for name in ("at", "owner", "status"):
            getattr(cut, name)[there] = getattr(self, name)[here]
        return cut


def _check_holds(image: GreyImage, corners: Corners) -> None:
    """Raise ImageError where a corner lies outside the image: it comes from another one."""
    columns, rows = (int(line.max(initial=-1)) + 1 for line in corners.pixel.T)
    if rows > image.shape[0] or columns > image.shape[1]:
        raise ImageError(
            f"the corners reach over {rows} rows and {columns} columns, the image has shape "
            f"{image.shape}; give the image that they were found in"
        )


def _known_shape(shape: tuple[int, int] | None, like: Grid | None) -> tuple[int, int] | None:
    if shape is not None and not (
        isinstance(shape, tuple | list)
        and len(shape) == 2
        and all(isinstance(n, int | np.integer) and not isinstance(n, bool) for n in shape)
        and min(shape) >= 1
    ):
        raise GridError(f"shape must be (rows, columns), each at least 1, not {shape!r}")
    if shape is not None:
        check_size(*shape)
    if like is None:
        return shape
    if not isinstance(like, Grid):
        raise GridError(f"like must be a Grid, not {type(like).__name__}")
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


def _empty(corners: int, shape: tuple[int, int] | None) -> Grid:
    rows, columns = shape or (0, 0)
    return Grid(
        xy=np.full((rows, columns, 2), np.nan, np.float32),
        status=np.zeros((rows, columns), np.uint8),
        sigma=np.full((rows, columns), np.nan, np.float32),
        index=np.full((corners, 2), -1, np.int32),
    )


def _boxed(z: Points, found: Lattice) -> _Nodes:
    """The largest component in the box that holds it, rows down and columns right."""
    member = np.flatnonzero(found.component == 0)
    member = member[np.argsort(found.support[member], kind="stable")]
    unit = (1, 1j, -1, -1j)[round(cmath.phase(found.axis) / (cmath.pi / 2)) % 4]
    node, turn = found.node[member] * unit, found.turn[member] * unit
    row, column = node.imag.astype(np.int64), node.real.astype(np.int64)
    row -= row.min()
    column -= column.min()
    odd = ((turn.imag != 0) + row + column) % 2
    free = np.ones(len(z), np.bool_)
    free[member] = False
    parity = int(2 * np.count_nonzero(odd) > len(odd))
    nodes = _Nodes((int(row.max()) + 1, int(column.max()) + 1), parity, free)
    nodes.owner[row, column] = member  # the best supported is last and stays
    seen = nodes.owner >= 0
    nodes.at = np.where(seen, z[nodes.owner], NOWHERE)
    nodes.status[seen] = NodeStatus.DETECTED
    nodes.changed[:] = True
    return nodes


def _window_weights(nodes: _Nodes, bend: NDArray[np.float32], shape: tuple[int, int]) -> Index:
    """The weight of the nodes in every window of that shape that can hold any.

    Returns (R + rows + 1, C + columns + 1); entry (i, j) is of the window whose first row is
    i - rows and whose first column is j - columns. A node weighs less the less the corner's
    boundaries are straight, as they are not where the outermost cells meet the surroundings.
    """
    weight = WHOLE - (WHOLE / 4 * np.where(np.isnan(bend), 1, bend)).astype(np.int64)
    total = np.zeros(np.add(nodes.at.shape, 1), np.int64)
    total[1:, 1:] = np.where(nodes.owner >= 0, weight[nodes.owner], 0).cumsum(0).cumsum(1)
    for axis, size in enumerate(shape):
        last = nodes.at.shape[axis]
        end = np.arange(last + size + 1)
        begin = np.maximum(end - size, 0)
        total = total.take(np.minimum(end, last), axis) - total.take(np.minimum(begin, last), axis)
    return total


def _fullest(nodes: _Nodes, bend: NDArray[np.float32], shape: tuple[int, int]) -> _Nodes:
    """The fullest window, of several the nearest to the top left corner of what is seen.

    A shape that fits better across is taken so, by the quarter turn that leaves the columns
    nearest to the image's x axis.
    """
    if nodes.at.shape[0] <= shape[0] and nodes.at.shape[1] <= shape[1]:
        return nodes.window(0, 0, shape)
    turned = [nodes]
    if shape[0] != shape[1]:
        falling = float(np.nansum((nodes.at[:, 1:] - nodes.at[:, :-1]).imag)) > 0
        turned.append(nodes.turned(3 if falling else 1))
    windows = [_window_weights(each, bend, shape) for each in turned]
    best = int(np.argmax([weights.max() for weights in windows]))
    full = np.argwhere(windows[best] == windows[best].max()) - shape
    row, column = full[np.argmin(np.abs(full).sum(1))]
    return turned[best].window(int(row), int(column), shape)


def _nearest_rest(here: NDArray[np.float32], rest: NDArray[np.float32], which: Mask) -> Index:
    """The number of the nearest one of those of the rest nodes, 0 if there is none.

    here: (M, 3), x, y, 1. rest: (3, N), -x, -y and half the square of the distance from the
    origin, so that their product grows with the distance between the two.
    """
    numbers = np.flatnonzero(which)
    if not len(numbers):
        return np.zeros(len(here), np.int64)
    nearest: Index = numbers[(here @ rest.take(numbers, axis=1)).argmin(1)]
    return nearest


def _like_rest(nodes: _Nodes, found: Lattice, like: Grid) -> _Nodes:
    """The turn and the window that agree with the rest grid.

    The turn with the most common vote wins. Among its windows of the right colour, those that
    hold about as much as the fullest compete, and the votes decide. Where most nodes are near
    their places at rest there is nothing to vote on.
    """
    if nodes.at.shape == like.shape and nodes.parity == like.parity:
        away = np.abs(nodes.at - (like.xy[..., 0] + 1j * like.xy[..., 1]))
        if 2 * np.count_nonzero(away < HALFWAY * abs(found.axis)) > away.size:
            return nodes
    turned, votes = _voted(nodes, like)
    weights = _window_weights(turned, found.bend, like.shape)
    odd = turned.parity + like.parity + sum(like.shape)
    rows, columns = (np.arange(size) % 2 for size in weights.shape)
    weights *= np.equal.outer((rows + odd) % 2, columns)
    rivals = np.flatnonzero(weights >= weights.max() - WHOLE * min(like.shape) / 2)
    choice = votes.ravel()[rivals] * (WHOLE * turned.at.size + 1) + weights.ravel()[rivals]
    top, left = divmod(int(rivals[choice.argmax()]), weights.shape[1])
    return turned.window(top - like.shape[0], left - like.shape[1], like.shape)


def _voted(nodes: _Nodes, like: Grid) -> tuple[_Nodes, Index]:
    """The turn with the most common vote, and its votes by window as in `_window_weights`.

    Some nodes vote for the numbers of the nearest rest node of their checker colour: most of
    a pressed gel stays near its place, whatever the rest does.
    """
    places = np.flatnonzero(like.valid)
    rest_row, rest_column = np.divmod(places, like.shape[1])
    rest_colour = (like.parity + rest_row + rest_column) % 2
    x, y = like.xy.reshape(-1, 2).take(places, axis=0).T
    middle = complex(x.mean(), y.mean())
    x, y = x - middle.real, y - middle.imag
    rest = np.stack([-x, -y, (x * x + y * y) / 2])
    voters = np.flatnonzero(nodes.owner >= 0)
    count = min(VOTERS, len(voters))
    voters = voters[np.arange(count) * (len(voters) - 1) // max(count - 1, 1)]
    at = nodes.at.ravel()[voters] - middle
    here = np.stack([at.real, at.imag, np.ones(count)], axis=1).astype(np.float32)
    nearest = np.stack([_nearest_rest(here, rest, rest_colour == colour) for colour in (0, 1)])
    rows, columns = nodes.at.shape
    row, column = np.divmod(voters, columns)
    turns = np.arange(4)[:, None]
    chosen = nearest[(nodes.parity + row + column + turns) % 2, np.arange(count)]
    up, back = rows - 1 - row, columns - 1 - column
    top = np.stack([row, back, up, column]) - rest_row[chosen] + like.shape[0]
    left = np.stack([column, row, back, up]) - rest_column[chosen] + like.shape[1]
    most = rows + columns + sum(like.shape) + 1
    polled = np.sort(((turns * most + top) * most + left).ravel())
    start = starts(polled)
    winner = start[np.diff(start, append=len(polled)).argmax()]
    quarters = int(polled[winner]) // most**2
    turned = nodes.turned(quarters)
    windows = np.add(turned.at.shape, like.shape) + 1
    ballots = top[quarters] * windows[1] + left[quarters]
    return turned, np.bincount(ballots, minlength=windows.prod()).reshape(windows)


# (weight, {(row, column): factor, ...}) of each prediction of a node from its neighbours
def _predictors() -> list[tuple[float, dict[tuple[int, int], float]]]:
    found: list[tuple[float, dict[tuple[int, int], float]]] = []
    for r, c in ((0, 1), (1, 0)):
        line = {(-r, -c): 4 / 6, (r, c): 4 / 6, (-2 * r, -2 * c): -1 / 6, (2 * r, 2 * c): -1 / 6}
        found.append((12, line))
        found.append((4, {(-r, -c): 0.5, (r, c): 0.5}))
    for r, c in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        found.append((1.5, {(r, 0): 1, (0, c): 1, (r, c): -1}))
    for r, c in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        found.append((0.7, {(r, c): 2, (2 * r, 2 * c): -1}))
        found.append((0.7, {(r, c): 3, (2 * r, 2 * c): -3, (3 * r, 3 * c): 1}))
    return found


PREDICTORS = _predictors()
STEPS = np.array(sorted({step for _, factors in PREDICTORS for step in factors}))
WEIGHTS = np.array([weight for weight, _ in PREDICTORS])
FACTORS = np.array([[factors.get((r, c), 0) for r, c in STEPS] for _, factors in PREDICTORS])
USES = (FACTORS != 0).astype(np.float64)
WEIGHTED = WEIGHTS[:, None] * FACTORS
ALIKE = [  # the factor of equally distant nodes in the mean of all predictors, and these
    (float(WEIGHTED[:, alike].sum(0)[0] / WEIGHTS.sum()), STEPS[alike])
    for alike in ((STEPS**2).sum(1) == away for away in (1, 2, 4, 9))
]
ALONG = np.array([(r, c) for r in (-1, 0, 1) for c in (-2, -1, 0, 1)])  # where steps begin
BEGINS = np.concatenate([ALONG, ALONG[:, ::-1]])
ENDS = BEGINS + np.repeat([[0, 1], [1, 0]], len(ALONG), axis=0)
TOUCHED = np.kron(np.eye(2), [1, 2, 2, 1] * 3)  # how many of the 3 x 3 nodes a step touches
REACHED = np.array(  # where predictions or cells change with the node in the middle
    [(r, c) for r in range(-3, 4) for c in range(-3, 4) if 0 in (r, c) or max(abs(r), abs(c)) < 3]
)


def predict(at: Points, row: Index, column: Index) -> tuple[Points, Float]:
    """Where nodes should be by their neighbours, and the weight of the prediction.

    Along a row or column (4 (L + R) - (LL + RR)) / 6 with weight 12 and (L + R) / 2 with 4,
    the parallelograms with 1.5, linear and quadratic extrapolation with 0.7 each.
    """
    padded = _bordered(at)
    width = padded.shape[1]
    near = padded.ravel()[(row + 3) * width + column + 3 + (STEPS @ [width, 1])[:, None]]
    unknown = np.isnan(near.real)
    near[unknown] = 0
    known = USES @ unknown == 0
    weight: Float = WEIGHTS @ known
    factors = WEIGHTED.T @ known
    with np.errstate(invalid="ignore"):
        return (factors * near).sum(0) / weight, weight


def predict_within(at: Points) -> Points:
    """The same for every node, (R, C); NaN where one of those around is missing."""
    padded = _bordered(at)
    rows, columns = at.shape
    total = np.zeros((rows, columns), np.complex128)
    for factor, steps in ALIKE:
        first, *others = (padded[r : r + rows, c : c + columns] for r, c in steps + 3)
        total += factor * sum(others, first)
    return total


def _bordered(at: Points) -> Points:
    """With three missing nodes around."""
    rows, columns = at.shape
    padded = np.full((rows + 6, columns + 6), NOWHERE)
    padded[3:-3, 3:-3] = at
    return padded


def mean_steps(at: Points, row: Index, column: Index) -> tuple[Points, Points, Float]:
    """The step to the next column, to the next row, and the cell there, each (M,), px.

    Means of the steps to and from the 3 x 3 nodes around; NaN where there are none.
    """
    padded = _bordered(at)
    width = padded.shape[1]
    place = (row + 3) * width + column + 3
    begin, end = (padded.ravel()[(steps @ [width, 1])[:, None] + place] for steps in (BEGINS, ENDS))
    step = end - begin
    known = ~np.isnan(step.real)
    step[~known] = 0
    with np.errstate(invalid="ignore"):
        mean: Points = TOUCHED @ step / (TOUCHED @ known)
    length = np.abs(mean)
    cell: Float = np.where(np.isnan(length), length[::-1], length).sum(0) / 2
    return mean[0], mean[1], cell


def _grow(nodes: _Nodes, z: Points, edges: NDArray[np.float32]) -> None:
    """Attach free corners, beyond the box too, as long as there are any."""
    while nodes.free.any():
        nodes.pad()
        attached = _attach(nodes, z, edges)
        nodes.crop()
        if not attached:
            return
        _drop_misfits(nodes)


def _fill(
    nodes: _Nodes,
    z: Points,
    edges: NDArray[np.float32],
    image: GreyImage | None,
    least: float,
) -> None:
    """Look again where predictions have at least that weight, attach, and interpolate."""
    looked = np.zeros(nodes.at.shape)
    while image is not None and _look_again(nodes, looked, image, least):
        _drop_misfits(nodes)
        while _attach(nodes, z, edges):
            _drop_misfits(nodes)
    _interpolate(nodes)


def _drop_misfits(nodes: _Nodes) -> None:
    """Drop nodes far from a well supported prediction, the worst of each neighbourhood first.

    Only those are looked at around which something has changed since the last time.
    """
    while nodes.changed.any():
        row, column = _near_changes(nodes)
        off = _misfits(nodes.at, row, column)
        bad = off > NEAR
        nodes.changed[:] = False
        if not bad.any():
            return
        nodes.changed[row[bad], column[bad]] = True
        padded = np.zeros((nodes.at.shape[0] + 2, nodes.at.shape[1] + 2))
        padded[row + 1, column + 1] = off
        around = [padded[row + r, column + c] for r in range(3) for c in range(3)]
        worst = bad & (off >= np.max(around, axis=0))
        nodes.drop(row[worst], column[worst])


def _near_changes(nodes: _Nodes) -> tuple[Index, Index]:
    """Rows and columns of the nodes whose misfit may have changed."""
    seen = nodes.status != NodeStatus.MISSING
    rows, columns = seen.shape
    if not nodes.changed.all():
        near = np.zeros((rows + 6, columns + 6), np.bool_)
        row, column = np.divmod(np.flatnonzero(nodes.changed), columns)
        reached = REACHED @ [columns + 6, 1]
        near.ravel()[((row + 3) * (columns + 6) + column + 3)[:, None] + reached] = True
        seen &= near[3:-3, 3:-3]
    row, column = np.divmod(np.flatnonzero(seen), columns)
    return row, column


def _misfits(at: Points, row: Index, column: Index) -> Float:
    """How far those nodes are from well supported predictions, cells; 0 below a pixel."""
    prediction = np.full(len(row), NOWHERE)
    if len(row) > FEW:
        prediction = predict_within(at)[row, column]
    rim = np.flatnonzero(np.isnan(prediction))
    prediction[rim], weight = predict(at, row[rim], column[rim])
    gap = np.abs(at[row, column] - prediction)
    gap[rim[weight < STRONG]] = 0
    far = np.flatnonzero(gap > 1)
    off = np.zeros(len(row))
    off[far] = gap[far] / mean_steps(at, row[far], column[far])[2]
    return off


def _expected(nodes: _Nodes, least: float) -> tuple[Index, Index, Points, Float, Float, Points]:
    """Missing nodes whose prediction has at least that weight.

    Returns rows, columns, predictions, their weights, cells, and the direction in which the
    boundaries e0 and e2 should lie.
    """
    missing = np.flatnonzero(nodes.status == NodeStatus.MISSING)
    row, column = np.divmod(missing, nodes.at.shape[1])
    if not len(row):
        return row, column, nodes.at[:0, 0], np.zeros(0), np.zeros(0), nodes.at[:0, 0]
    at, weight = predict(nodes.at, row, column)
    kept = weight >= least
    row, column, at, weight = row[kept], column[kept], at[kept], weight[kept]
    along, down, cell = mean_steps(nodes.at, row, column)
    level = (nodes.parity + row + column) % 2 == 0
    line = np.where(level, along, down)
    line[np.isnan(line)] = 0
    line /= np.maximum(np.abs(line), 1e-6)
    return row, column, at, weight, cell, line


def _attach(nodes: _Nodes, z: Points, edges: NDArray[np.float32]) -> bool:
    """Take free corners near the predictions of missing nodes; whether there were any.

    A corner whose boundaries lie the other way round is another one.
    """
    free = np.flatnonzero(nodes.free)
    if not len(free):
        return False
    row, column, at, _, cell, line = _expected(nodes, WEAK)
    near, corner = _nearest(at, z[free], NEAR * cell)
    corner = free[corner]
    first, third = np.exp(1j * edges[corner, 0]), np.exp(1j * edges[corner, 2])
    along = np.abs(((first - third) * line[near].conj()).real)
    near, corner = near[~(along < 1)], corner[~(along < 1)]
    nodes.put(row[near], column[near], z[corner], NodeStatus.ATTACHED)
    nodes.owner[row[near], column[near]] = corner
    nodes.free[corner] = False
    return len(near) > 0


def _nearest(at: Points, z: Points, reach: Float) -> tuple[Index, Index]:
    """Places in `at` and in `z` that are each other's nearest and within reach."""
    order = np.argsort(z.real, kind="stable")
    x = z.real[order]
    begin = np.searchsorted(x, at.real - reach)
    count = np.searchsorted(x, at.real + reach, side="right") - begin
    here = np.repeat(np.arange(len(at)), count)
    skipped = np.cumsum(count) - count
    there = order[np.arange(len(here)) + np.repeat(begin - skipped, count)]
    away = np.abs(at[here] - z[there])
    close = away < reach[here]
    here, there, away = here[close], there[close], away[close]
    best = np.full(len(at), np.inf)
    best_there = np.full(len(z), np.inf)
    np.minimum.at(best, here, away)
    np.minimum.at(best_there, there, away)
    mutual = (away == best[here]) & (away == best_there[there])
    here, there = here[mutual], there[mutual]
    here, once = np.unique(here, return_index=True)
    there, twice = np.unique(there[once], return_index=True)
    return here[twice], there


def _look_again(nodes: _Nodes, looked: Float, image: GreyImage, least: float) -> bool:
    """Refine at the predictions of missing nodes; whether any was found.

    looked: (R, C), the weight of the prediction at the last look; where it is as high, none is
    taken again.
    """
    row, column, at, weight, cell, line = _expected(nodes, least)
    new = weight > looked[row, column]
    if not new.any():
        return False
    row, column, at, cell, line = row[new], column[new], at[new], cell[new], line[new]
    looked[row, column] = weight[new]
    seen = second_look(image, at, cell, line)
    found = ~np.isnan(seen.real)
    nodes.put(row[found], column[found], seen[found], NodeStatus.SECOND_LOOK)
    return bool(found.any())


def _interpolate(nodes: _Nodes) -> None:
    """Fill missing nodes that measured neighbours bracket, inside the pattern only."""
    seen = nodes.status != NodeStatus.MISSING
    if seen.all():
        return
    inside = np.ones_like(seen)
    for axis in (0, 1):
        inside &= np.logical_or.accumulate(seen, axis)
        inside &= np.flip(np.logical_or.accumulate(np.flip(seen, axis), axis), axis)
    row, column, at, *_ = _expected(nodes, BRACKETED)
    kept = inside[row, column]
    nodes.put(row[kept], column[kept], at[kept], NodeStatus.INTERPOLATED)


def _refuse_rival(found: Lattice, nodes: _Nodes, z: Points) -> None:
    """Raise GridError where another component is comparable and was not joined."""
    if len(found.size) < 2 or found.size[1] < RIVAL * found.size[0]:
        return
    second = (found.component == 1) & nodes.free
    if np.count_nonzero(second) < RIVAL * found.size[0]:
        return
    boxes = []
    for member in (found.component == 0, second):
        x, y = z[member].real, z[member].imag
        boxes.append(f"({x.min():.0f}, {y.min():.0f}, {x.max():.0f}, {y.max():.0f})")
    raise GridError(
        f"two patterns are seen, of {found.size[0]} and {found.size[1]} corners, within "
        f"{boxes[0]} and {boxes[1]}; say which is meant with region=(x0, y0, x1, y1)"
    )


def _result(corners: Corners, inside: Index, nodes: _Nodes) -> Grid:
    owned = nodes.owner >= 0
    index = np.full((len(corners), 2), -1, np.int32)
    owner = inside[nodes.owner[owned]]
    index[owner, 0], index[owner, 1] = np.nonzero(owned)
    sigma = np.full(nodes.at.shape, np.nan, np.float32)
    sigma[owned] = corners.sigma[owner]
    return Grid(
        xy=nodes.at.astype(np.complex64, order="C").view(np.float32).reshape(*nodes.at.shape, 2),
        status=nodes.status,
        sigma=sigma,
        index=index,
        parity=nodes.parity,
    )
