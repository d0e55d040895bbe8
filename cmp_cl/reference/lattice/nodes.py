"""From numbered corners to the nodes of a board: one prediction, one score in nats.

A board is an array of nodes, (R, C), with a margin of missing nodes. All is float32 with + - * in
a fixed order, and integers, so that the kernels give the same bits.
"""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import LOOKED, NONE, Board
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.kernels import ROUNDS
from cmp_cl.reference.lattice.parts import (
    SIDE_POINTS,
    F,
    Mask,
    Real,
    Whole,
    depth_within,
    inverse_root,
    length_of,
    read,
    side_sum,
)

Plane = NDArray[np.integer]

FOUR = ((0, 1), (1, 0), (0, -1), (-1, 0))  # (row, column) of the neighbours


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Steps:
    """Steps of the lattice at every node: (ux, uy) to the next column, (vx, vy) to the next row,
    cell: their mean length, px; known: False where no step is known within 3 x 3 nodes."""

    ux: Real
    uy: Real
    vx: Real
    vy: Real
    cell: Real
    known: Mask


def shifted(a: NDArray[Any], row: int, column: int, fill: float) -> NDArray[Any]:
    """Return a[r + row, c + column] at every (r, c); `fill` beyond the array."""
    rows, columns = a.shape
    wide = np.full((rows + 6, columns + 6), fill, a.dtype)
    wide[3:-3, 3:-3] = a
    return wide[3 + row : 3 + row + rows, 3 + column : 3 + column + columns]


def inverse(x: Real) -> Real:
    root = inverse_root(x)
    return root * root


def predictors(k: LatticeConstants) -> list[tuple[float, dict[tuple[int, int], float]]]:
    """Return the weight of each prediction, and the factors of the nodes (row, column) around that
    it is a sum of."""
    of_cubic, of_middle, of_cell, of_beyond = k.prediction_weights
    found: list[tuple[float, dict[tuple[int, int], float]]] = []
    for r, c in ((0, 1), (1, 0)):
        a, b = 4 / 6, -1 / 6
        cubic = {(-r, -c): a, (r, c): a, (-2 * r, -2 * c): b, (2 * r, 2 * c): b}
        found += [(of_cubic, cubic), (of_middle, {(-r, -c): 0.5, (r, c): 0.5})]
    for r, c in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        found.append((of_cell, {(r, 0): 1, (0, c): 1, (r, c): -1}))
    for r, c in FOUR:
        found.append((of_beyond, {(r, c): 2, (2 * r, 2 * c): -1}))
    return found


def predicted(x: Real, y: Real, k: LatticeConstants) -> tuple[Real, Real, Real]:
    """Return where the neighbours predict each node, and the weight of that; 0 where unknown."""
    total_x, total_y, weight = (np.zeros(x.shape, np.float32) for _ in range(3))
    for w, factors in predictors(k):
        px, py = np.zeros(x.shape, np.float32), np.zeros(x.shape, np.float32)
        for (r, c), factor in factors.items():
            by: Any = F(factor)
            px = px + by * shifted(x, r, c, np.nan)
            py = py + by * shifted(y, r, c, np.nan)
        seen = ~np.isnan(px)
        total_x = np.where(seen, total_x + F(w) * px, total_x)
        total_y = np.where(seen, total_y + F(w) * py, total_y)
        weight = np.where(seen, weight + F(w), weight)
    share = inverse(np.maximum(weight, F(0.5)))
    return total_x * share, total_y * share, weight


def steps_of(x: Real, y: Real) -> Steps:
    """Return the mean of the steps before and after each node, or of those within 3 x 3 nodes."""
    found, known = [], np.ones(x.shape, np.bool_)
    for r, c in ((0, 1), (1, 0)):
        after, before = (shifted(x, r, c, np.nan) - x), (x - shifted(x, -r, -c, np.nan))
        count = (~np.isnan(after)).astype(np.int64) + ~np.isnan(before)
        many = np.zeros(x.shape, np.int64)
        for i in range(-1, 2):
            for j in range(-1, 2):
                many = many + shifted(count, i, j, 0)
        for at in (x, y):
            after, before = (shifted(at, r, c, np.nan) - at), (at - shifted(at, -r, -c, np.nan))
            total = np.nan_to_num(after) + np.nan_to_num(before)
            around = np.zeros(x.shape, np.float32)
            for i in range(-1, 2):
                for j in range(-1, 2):
                    around = around + shifted(total, i, j, 0)
            own = np.where(count == 2, F(0.5) * total, total)
            wide = around * inverse(np.maximum(many, 1).astype(np.float32))
            found.append(np.where(count > 0, own, wide))
        known &= many > 0
    ux, uy, vx, vy = found
    cell = F(0.5) * (
        length_of(np.maximum(ux * ux + uy * uy, F(1e-6)))
        + length_of(np.maximum(vx * vx + vy * vy, F(1e-6)))
    )
    return Steps(ux=ux, uy=uy, vx=vx, vy=vy, cell=cell, known=known)


def blended(
    seen: tuple[Real, Real],
    rough: Mask,
    prediction: tuple[Real, Real, Real],
    cell: Real,
    k: LatticeConstants,
) -> tuple[Real, Real]:
    """Return the positions of nodes: as seen, or if rough, with the prediction of the neighbours.

    cell: px. A rough position enters the mean of the predictions as one more. Its error is of some
    pixels, that of a prediction of some share of a cell, so its weight is that of the cell's area.
    """
    (x, y), (px, py, weight) = seen, prediction
    share = weight * inverse(weight + F(k.rough_weight_per_px2) * (cell * cell))
    far = rough & (weight > 0)
    return np.where(far, x + share * (px - x), x), np.where(far, y + share * (py - y), y)


def result(board: Board, k: LatticeConstants) -> Board:
    """Return the board with the positions of rough nodes blended; rough are torn ones, and those
    far from their prediction."""
    prediction, cell = predicted(board.x, board.y, k), steps_of(board.x, board.y).cell
    dx, dy, limit = board.x - prediction[0], board.y - prediction[1], F(k.near_cells) * cell
    rough = board.there & (board.torn | (dx * dx + dy * dy > limit * limit))
    x, y = blended((board.x, board.y), rough, prediction, cell, k)
    return Board(x=x, y=y, owner=board.owner, torn=rough, sign=board.sign)


def firm(plane: Plane, board: Board, rough: Mask, k: LatticeConstants) -> Mask:
    """Return the nodes of the board that are corners, not rough, and whose two cells of each colour
    are alike."""
    at = evidence(plane, board, k)
    quality, contrast = cells_at(
        plane, np.nan_to_num(at.x), np.nan_to_num(at.y), at.steps, board.parity(), k
    )
    alike = (2 * quality).astype(np.float32) > (F(1) - F(k.passing)) * contrast.astype(np.float32)
    alike &= at.steps.known & (contrast > 0)
    found: Mask = (board.owner >= 0) & ~rough & alike
    return found


def cells_at(
    plane: Plane, x: Real, y: Real, steps: Steps, parity: Whole, k: LatticeConstants
) -> tuple[Whole, Whole]:
    """Return of the four cells at each node the least bright less the greatest dark level, and
    twice their contrast."""
    f = depth_within(k.cell_depth, inverse_root(np.maximum(steps.cell * steps.cell, F(1))), k)
    sx, sy = f * (steps.ux + steps.vx), f * (steps.uy + steps.vy)
    tx, ty = f * (steps.vx - steps.ux), f * (steps.vy - steps.uy)
    dark = read(plane, x + sx, y + sy), read(plane, x - sx, y - sy)
    bright = read(plane, x + tx, y + ty), read(plane, x - tx, y - ty)
    least = np.minimum(bright[0], bright[1]) - np.maximum(dark[0], dark[1])
    other = np.minimum(dark[0], dark[1]) - np.maximum(bright[0], bright[1])
    quality = np.where(parity > 0, least, other)
    contrast = ((bright[0] + bright[1]) - (dark[0] + dark[1])) * parity
    return quality, contrast


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Evidence:
    """Of each node, (R, C): score, nats; x, y: its position, px; steps."""

    score: Real
    x: Real
    y: Real
    steps: Steps


def evidence(
    plane: Plane,
    board: Board,
    k: LatticeConstants,
    new: tuple[Real, Real, Mask] | None = None,
) -> Evidence:
    """Return the score of each node of the board, or of new positions in their places.

    new: x, y (R, C) as seen, NaN where there is none, and which are torn. Their sides lead to the
    board's own nodes.
    """
    there, parity = board.there, board.parity()
    first = predicted(board.x, board.y, k)
    cell = steps_of(board.x, board.y).cell
    own_x, own_y = blended((board.x, board.y), board.torn, first, cell, k)
    steps = steps_of(own_x, own_y)
    seen_x, seen_y, torn, prediction, x, y = board.x, board.y, board.torn, first, own_x, own_y
    filled = np.nan_to_num(own_x), np.nan_to_num(own_y)
    quality, contrast = cells_at(plane, *filled, steps, parity, k)
    if new is not None:
        seen_x, seen_y, torn = new
        prediction = predicted(own_x, own_y, k)
        x, y = blended((seen_x, seen_y), torn, prediction, steps.cell, k)
        filled = np.nan_to_num(x), np.nan_to_num(y)
        quality = cells_at(plane, *filled, steps, parity, k)[0]
    known = there & steps.known
    share = _usual(np.where(known, contrast, 0), known)

    sides = np.zeros(x.shape, np.float32)
    own = contrast if new is None else None
    to = _sides_to(plane, (own_x, own_y), x, y, parity, own, k)
    for (r, c), each in zip(FOUR, to, strict=True):
        seen = ~np.isnan(shifted(own_x, r, c, np.nan)) & ~np.isnan(x)
        whole = np.clip((each.astype(np.float32) * share) * F(1 / len(SIDE_POINTS)), F(-1), F(1))
        sides = np.where(seen, sides + whole, sides)
    cells = np.clip(quality.astype(np.float32) * share, F(-1), F(1))
    at_x, at_y, weight = prediction
    dx, dy = np.nan_to_num(seen_x) - at_x, np.nan_to_num(seen_y) - at_y
    with np.errstate(over="ignore", invalid="ignore"):
        misfit = (dx * dx + dy * dy) * inverse(np.maximum(steps.cell * steps.cell, F(1e-6)))
    misfit = np.where(weight > 0, misfit, F(0))
    penalty = misfit * np.where(torn, F(2 / k.sd_cells**2), F(0.5 / k.sd_cells**2))
    prior = np.where(torn, F(k.prior_nats - k.torn_nats), F(k.prior_nats))
    score = ((F(k.side_nats) * sides + F(k.cells_nats) * cells) + prior) - penalty
    return Evidence(
        score=np.where(np.isnan(x), F(np.nan), score),
        x=x,
        y=y,
        steps=steps,
    )


def _usual(contrast: Whole, there: Mask) -> Real:
    """Return one over the mean contrast of the nodes within 5 x 5, (R, C)."""
    total, many = np.zeros(contrast.shape, np.int64), np.zeros(contrast.shape, np.int64)
    for i in range(-2, 3):
        for j in range(-2, 3):
            total = total + shifted(contrast, i, j, 0)
            many = many + shifted(there.astype(np.int64), i, j, 0)
    many = np.maximum(many, 1)
    total = np.maximum(total, many)
    return (2 * many).astype(np.float32) * inverse(total.astype(np.float32))


def _sides_to(
    plane: Plane,
    own: tuple[Real, Real],
    x: Real,
    y: Real,
    parity: Whole,
    contrast: Whole | None,
    k: LatticeConstants,
) -> list[Whole]:
    """Return the evidence of the four sides from positions to the board's own neighbours, (R, C)
    each, as sums of five differences, read from the upper or the left end; 0 where one is missing.

    contrast: twice that of the board's nodes, (R, C). A side that shows less than half of that of
    the end that it is read from is read deeper in the cells too; without it none is.
    """
    sums = []
    for r, c in FOUR:
        ox, oy = shifted(own[0], r, c, np.nan), shifted(own[1], r, c, np.nan)
        both = np.flatnonzero((~np.isnan(ox) & ~np.isnan(x)).ravel())
        here, there = (x.ravel()[both], y.ravel()[both]), (ox.ravel()[both], oy.ravel()[both])
        sign = (parity if r == 0 else -parity).ravel()[both]
        if r + c < 0:
            here, there, sign = there, here, -sign
        step = there[0] - here[0], there[1] - here[1]
        total = side_sum(plane, here, step, k) * sign
        if contrast is not None:
            whole = contrast if r + c > 0 else shifted(contrast, r, c, 0)
            within = np.full(len(both), k.deep_cells, np.float32)
            deep = side_sum(plane, here, step, k, depth=within) * sign
            weak = 4 * total < len(SIDE_POINTS) * whole.ravel()[both]
            total = np.where(weak, np.maximum(total, deep), total)
        every = np.zeros(x.size, np.int64)
        every[both] = total
        sums.append(every.reshape(x.shape))
    return sums


# --- rounds -------------------------------------------------------------------------------


def settled(
    plane: Plane,
    xy: NDArray[np.float32],
    torn: Mask,
    board: Board,
    k: LatticeConstants,
    taken: Mask | None = None,
) -> Board:
    """Return the board after rounds of dropping nodes and finding others, until none changes it.

    A missing place beside a node takes the free corner near its prediction, else the prediction. It
    does so once: a place whose node is dropped after that stays empty.

    xy: (N, 2), all corners. torn: (N,), those whose refinement was rejected. taken: (N,), those of
    other boards. `board` has positions as seen, and says which are torn; the result has the blended
    positions, and which are rough.
    """
    edge = F(k.contrast_radius_px)
    bottom, right = (F(size - 1) - edge for size in plane.shape)
    tried = np.zeros(board.x.shape, np.bool_)
    for _ in range(ROUNDS):
        board = dropped(plane, board, k)
        there = board.there
        if np.count_nonzero(there) < 4:
            break
        now = evidence(plane, board, k)
        px, py, weight = predicted(now.x, now.y, k)
        beside = np.zeros(there.shape, np.bool_)
        for step in FOUR:
            beside |= shifted(there, *step, False)
        inside = (px > edge) & (py > edge) & (px < right) & (py < bottom)
        want = ~there & ~tried & beside & now.steps.known & (weight > 0) & inside
        row, column = (each.astype(np.int64) for each in np.nonzero(want))
        if not len(row):
            break
        new_x, new_y = (np.full(there.shape, np.nan, np.float32) for _ in range(2))
        new_owner = np.full(there.shape, NONE)
        new_torn = np.zeros(there.shape, np.bool_)
        cell = now.steps.cell[row, column]
        nearest, square = nearest_corner(xy[:, 0], xy[:, 1], px[row, column], py[row, column])
        used = np.zeros(len(xy), np.bool_) if taken is None else taken.copy()
        used[board.owner[board.owner >= 0]] = True
        reach = F(k.reach_cells) * cell
        good = (square < reach * reach) & ~used[nearest]
        r, c = row[good], column[good]
        new_x[r, c], new_y[r, c] = xy[nearest[good]].T
        new_owner[r, c], new_torn[r, c] = nearest[good], torn[nearest[good]]
        r, c = row[~good], column[~good]
        new_x[r, c], new_y[r, c], new_owner[r, c], new_torn[r, c] = px[r, c], py[r, c], LOOKED, True
        found = evidence(plane, board, k, (new_x, new_y, new_torn))
        take = (new_owner != NONE) & (found.score >= 0)
        take &= _first_claims(new_owner, take)
        if not take.any():
            break
        tried |= take
        board = Board(
            x=np.where(take, new_x, board.x),
            y=np.where(take, new_y, board.y),
            owner=np.where(take, new_owner, board.owner),
            torn=np.where(take, new_torn, board.torn),
            sign=board.sign,
        )
    blend = result(board, k)
    return dataclasses.replace(blend, firm=firm(plane, board, blend.torn, k))


def dropped(plane: Plane, board: Board, k: LatticeConstants) -> Board:
    """Return the board without nodes that score too little, the worst of each 3 x 3 first."""
    while True:
        now = evidence(plane, board, k)
        score, there = now.score, board.there
        worst = np.full(score.shape, F(99))
        for i in range(-1, 2):
            for j in range(-1, 2):
                worst = np.fmin(worst, shifted(score, i, j, np.nan))
        bad = there & (score < 0) & (score <= worst)
        if not bad.any():
            return board
        board = Board(
            x=np.where(bad, F(np.nan), board.x),
            y=np.where(bad, F(np.nan), board.y),
            owner=np.where(bad, NONE, board.owner),
            torn=board.torn & ~bad,
            sign=board.sign,
        )


def nearest_corner(corner_x: Real, corner_y: Real, x: Real, y: Real) -> tuple[Whole, Real]:
    """Return the nearest corner to each point, the lower index of equals, and its squared
    distance."""
    best: Whole = np.zeros(len(x), np.int64)
    least = np.full(len(x), np.inf, np.float32)
    for first in range(0, len(x), 1024):
        some = np.s_[first : first + 1024]
        dx, dy = corner_x - x[some, None], corner_y - y[some, None]
        square = np.where(np.isnan(dx), np.inf, dx * dx + dy * dy)
        best[some] = square.argmin(axis=1)
        least[some] = square.min(axis=1)
    return best, least


def _first_claims(owner: Whole, take: Mask) -> Mask:
    """Return whether a node is the first of those that claim its corner."""
    claims = np.flatnonzero((take & (owner >= 0)).ravel())
    _, first = np.unique(owner.ravel()[claims], return_index=True)
    good = np.ones(take.size, np.bool_)
    good[np.delete(claims, first)] = False
    return good.reshape(take.shape)
