"""From numbered corners to the nodes of a board: one prediction, one score in nats.

A board is an array of nodes, (R, C), with a margin of missing nodes. All is float32 with + - * in
a fixed order, and integers, so that the kernels give the same bits.
"""

import dataclasses
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import LOOKED, NONE, Board
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.lattice.kernels import ROUNDS
from cmp_cl.reference.lattice.parts import (
    NOWHERE,
    SIDE_POINTS,
    F,
    Mask,
    Places,
    Real,
    Whole,
    at_of,
    depth_within,
    dot,
    inverse_root,
    length_of,
    read,
    side_sum,
)

Plane = NDArray[np.integer]

FOUR = ((0, 1), (1, 0), (0, -1), (-1, 0))  # (row, column) of the neighbours


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Steps:
    """Steps of the lattice at every node: u to the next column, v to the next row, cell: their mean
    length, px; known: False where no step is known within 3 x 3 nodes."""

    u: Places
    v: Places
    cell: Real
    known: Mask


def seen_at(board: Board) -> Places:
    """Return the positions of the nodes, (R, C)."""
    return at_of(board.x, board.y)


def replaced(board: Board, some: Mask, at: Any, owner: Any, torn: Any) -> Board:
    """Return the board with other nodes in some places."""
    at = np.where(some, at, seen_at(board))
    return dataclasses.replace(
        board,
        x=at.real,
        y=at.imag,
        owner=np.where(some, owner, board.owner),
        torn=np.where(some, torn, board.torn),
    )


def shifted(a: NDArray[Any], row: int, column: int, fill: Any) -> NDArray[Any]:
    """Return a[r + row, c + column] at every (r, c); `fill` beyond the array."""
    rows, columns = a.shape
    wide = np.full((rows + 6, columns + 6), fill, a.dtype)
    wide[3:-3, 3:-3] = a
    return wide[3 + row : 3 + row + rows, 3 + column : 3 + column + columns]


def sum_within(a: NDArray[Any], reach: int) -> NDArray[Any]:
    """Return the sum over the places up to `reach` rows and columns away, row by row."""
    total = np.zeros_like(a)
    for row, column in itertools.product(range(-reach, reach + 1), repeat=2):
        total = total + shifted(a, row, column, 0)
    return total


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


def predicted(at: Places, k: LatticeConstants) -> tuple[Places, Real]:
    """Return where the neighbours predict each node, and the weight of that; 0 where unknown."""
    total, weight = np.zeros(at.shape, np.complex64), np.zeros(at.shape, np.float32)
    for w, factors in predictors(k):
        place = np.zeros(at.shape, np.complex64)
        for (r, c), factor in factors.items():
            place = place + F(factor) * shifted(at, r, c, NOWHERE)
        seen = ~np.isnan(place)
        total = np.where(seen, total + F(w) * place, total)
        weight = np.where(seen, weight + F(w), weight)
    return total * inverse(np.maximum(weight, F(0.5))), weight


def scatter(at: Places, mean: tuple[Places, Real], k: LatticeConstants) -> Real:
    """Return the variance of what the neighbours predict about its mean, px^2 per axis."""
    place, weight = mean
    total = np.zeros(at.shape, np.float32)
    for w, factors in predictors(k):
        off = np.zeros(at.shape, np.complex64)
        for (r, c), factor in factors.items():
            off = off + F(factor) * shifted(at, r, c, NOWHERE)
        off = off - place
        total = np.where(np.isnan(off), total, total + F(w) * dot(off, off))
    return (F(0.5) * total) * inverse(np.maximum(weight, F(0.5)))


def steps_of(at: Places) -> Steps:
    """Return the mean of the steps before and after each node, or of those within 3 x 3 nodes."""
    found, known = [], np.ones(at.shape, np.bool_)
    for r, c in ((0, 1), (1, 0)):
        after, before = shifted(at, r, c, NOWHERE) - at, at - shifted(at, -r, -c, NOWHERE)
        count = (~np.isnan(after)).astype(np.int64) + ~np.isnan(before)
        total = np.nan_to_num(after) + np.nan_to_num(before)
        many = sum_within(count, 1)
        own = np.where(count == 2, F(0.5) * total, total)
        wide = sum_within(total, 1) * inverse(np.maximum(many, 1).astype(np.float32))
        found.append(np.where(count > 0, own, wide))
        known &= many > 0
    u, v = found
    cell = F(0.5) * (length_of(u, 1e-6) + length_of(v, 1e-6))
    return Steps(u=u, v=v, cell=cell, known=known)


def blended(
    seen: Places, rough: Mask, prediction: tuple[Places, Real], cell: Real, k: LatticeConstants
) -> Places:
    """Return the positions of nodes: as seen, or if rough, with the prediction of the neighbours.

    cell: px. A rough position enters the mean of the predictions as one more. Its error is of some
    pixels, that of a prediction of some share of a cell, so its weight is that of the cell's area.
    """
    place, weight = prediction
    share = weight * inverse(weight + F(k.rough_weight_per_px2) * (cell * cell))
    return np.where(rough & (weight > 0), seen + share * (place - seen), seen)


def result(board: Board, sigma: Real, k: LatticeConstants) -> Board:
    """Return the board with the positions of rough nodes blended, and `Board.spread`; rough are
    torn ones, and those far from their prediction.

    sigma: (N,), px, of each corner; NaN of one that does not fit the corner model. A rough one that
    does is worn, or the surface bends sharply there. Then the predictions scatter, and count as
    much less as they do so more than wear moves a corner.
    """
    at = seen_at(board)
    prediction, cell = predicted(at, k), steps_of(at).cell
    away, limit = at - prediction[0], F(k.near_cells) * cell
    rough = board.there & (board.torn | (dot(away, away) > limit * limit))
    blend = blended(at, rough, prediction, cell, k)
    worn = F(k.worn_sigmas) * sigma[np.maximum(board.owner, 0)]
    fits = rough & (board.owner >= 0) & np.isfinite(worn)
    wear = np.where(fits, worn * worn, F(1))
    spread = scatter(at, prediction, k)
    share = wear * inverse(np.maximum(wear + spread, F(1e-12)))
    at = np.where(fits, at + share * (blend - at), blend)
    changed = replaced(board, rough, at, board.owner, True)
    return dataclasses.replace(changed, spread=np.where(fits, share * spread, F(0)))


def firm(plane: Plane, board: Board, rough: Mask, k: LatticeConstants) -> Mask:
    """Return the nodes of the board that are corners, not rough, and whose two cells of each colour
    are alike."""
    at = evidence(plane, board, k)
    quality, contrast = cells_at(plane, np.nan_to_num(at.at), at.steps, board.parity(), k)
    alike = (2 * quality).astype(np.float32) > (F(1) - F(k.passing)) * contrast.astype(np.float32)
    alike &= at.steps.known & (contrast > 0)
    found: Mask = (board.owner >= 0) & ~rough & alike
    return found


def cells_at(
    plane: Plane, at: Places, steps: Steps, parity: Whole, k: LatticeConstants
) -> tuple[Whole, Whole]:
    """Return of the four cells at each node the least bright less the greatest dark level, and
    twice their contrast."""
    f = depth_within(k.cell_depth, inverse_root(np.maximum(steps.cell * steps.cell, F(1))), k)
    s, t = f * (steps.u + steps.v), f * (steps.v - steps.u)
    dark = read(plane, at + s), read(plane, at - s)
    bright = read(plane, at + t), read(plane, at - t)
    least = np.minimum(bright[0], bright[1]) - np.maximum(dark[0], dark[1])
    other = np.minimum(dark[0], dark[1]) - np.maximum(bright[0], bright[1])
    quality = np.where(parity > 0, least, other)
    contrast = ((bright[0] + bright[1]) - (dark[0] + dark[1])) * parity
    return quality, contrast


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Evidence:
    """Of each node, (R, C): score, nats; at: its position, px; steps."""

    score: Real
    at: Places
    steps: Steps


def evidence(
    plane: Plane,
    board: Board,
    k: LatticeConstants,
    new: tuple[Places, Mask] | None = None,
) -> Evidence:
    """Return the score of each node of the board, or of new positions in their places.

    new: (R, C) as seen, NaN where there is none, and which are torn. Their sides lead to the
    board's own nodes.
    """
    parity, seen, torn = board.parity(), seen_at(board), board.torn
    prediction = predicted(seen, k)
    own = at = blended(seen, torn, prediction, steps_of(seen).cell, k)
    steps = steps_of(own)
    quality, contrast = cells_at(plane, np.nan_to_num(own), steps, parity, k)
    if new is not None:
        seen, torn = new
        prediction = predicted(own, k)
        at = blended(seen, torn, prediction, steps.cell, k)
        quality = cells_at(plane, np.nan_to_num(at), steps, parity, k)[0]
    known = board.there & steps.known
    share = _usual(np.where(known, contrast, 0), known)

    sides = np.zeros(at.shape, np.float32)
    to = _sides_to(plane, own, at, parity, contrast if new is None else None, k)
    for (r, c), each in zip(FOUR, to, strict=True):
        both = ~np.isnan(shifted(own, r, c, NOWHERE)) & ~np.isnan(at)
        whole = np.minimum((each.astype(np.float32) * share) * F(1 / len(SIDE_POINTS)), F(1))
        sides = np.where(both, sides + whole, sides)
    cells = np.minimum(quality.astype(np.float32) * share, F(1))
    away, weight = np.nan_to_num(seen) - prediction[0], prediction[1]
    with np.errstate(over="ignore", invalid="ignore"):
        misfit = dot(away, away) * inverse(np.maximum(steps.cell * steps.cell, F(1e-6)))
    misfit = np.where(weight > 0, misfit, F(0))
    penalty = misfit * np.where(torn, F(2 / k.sd_cells**2), F(0.5 / k.sd_cells**2))
    prior = np.where(torn, F(k.prior_nats - k.torn_nats), F(k.prior_nats))
    score = ((F(k.side_nats) * sides + F(k.cells_nats) * cells) + prior) - penalty
    return Evidence(score=np.where(np.isnan(at), F(np.nan), score), at=at, steps=steps)


def _usual(contrast: Whole, there: Mask) -> Real:
    """Return one over the mean contrast of the nodes within 5 x 5, (R, C)."""
    many = np.maximum(sum_within(there.astype(np.int64), 2), 1)
    total = np.maximum(sum_within(contrast, 2), many)
    share: Real = (2 * many).astype(np.float32) * inverse(total.astype(np.float32))
    return share


def _sides_to(
    plane: Plane,
    own: Places,
    at: Places,
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
        other = shifted(own, r, c, NOWHERE)
        both = np.flatnonzero(~np.isnan(other) & ~np.isnan(at))
        here, there = at.ravel()[both], other.ravel()[both]
        sign = (parity if r == 0 else -parity).ravel()[both]
        if r + c < 0:
            here, there, sign = there, here, -sign
        step = there - here
        total = side_sum(plane, here, step, k) * sign
        if contrast is not None:
            whole = contrast if r + c > 0 else shifted(contrast, r, c, 0)
            within = np.full(len(both), k.deep_cells, np.float32)
            deep = side_sum(plane, here, step, k, depth=within) * sign
            weak = 4 * total < len(SIDE_POINTS) * whole.ravel()[both]
            total = np.where(weak, np.maximum(total, deep), total)
        every = np.zeros(at.size, np.int64)
        every[both] = total
        sums.append(every.reshape(at.shape))
    return sums


# --- rounds -------------------------------------------------------------------------------


def settled(
    plane: Plane,
    xy: NDArray[np.float32],
    torn: Mask,
    sigma: Real,
    board: Board,
    k: LatticeConstants,
    taken: Mask | None = None,
) -> Board:
    """Return the board after rounds of dropping nodes and finding others, until none changes it.

    A missing place beside a node takes the free corner near its prediction, else the prediction.

    xy: (N, 2), all corners. torn: (N,), those whose refinement was rejected. sigma: (N,), px, of
    the others, NaN where unknown. taken: (N,), those of other boards. `board` has positions as
    seen, and says which are torn; the result has the blended positions, and which are rough.
    """
    corners, edge = at_of(*xy.T), F(k.contrast_radius_px)
    bottom, right = (F(size - 1) - edge for size in plane.shape)
    for _ in range(ROUNDS):
        board = dropped(plane, board, k)
        there = board.there
        now = evidence(plane, board, k)
        place, weight = predicted(now.at, k)
        beside = np.zeros(there.shape, np.bool_)
        for step in FOUR:
            beside |= shifted(there, *step, False)
        inside = (place.real > edge) & (place.real < right)
        inside &= (place.imag > edge) & (place.imag < bottom)
        want = ~there & beside & now.steps.known & (weight > 0) & inside
        row, column = (each.astype(np.int64) for each in np.nonzero(want))
        if not len(row):
            break
        new, new_owner = np.full(there.shape, NOWHERE), np.full(there.shape, NONE)
        new_torn = np.zeros(there.shape, np.bool_)
        cell = now.steps.cell[row, column]
        nearest, square = nearest_corner(corners, place[row, column])
        used = np.zeros(len(xy), np.bool_) if taken is None else taken.copy()
        used[board.owner[board.owner >= 0]] = True
        reach = F(k.reach_cells) * cell
        good = (square < reach * reach) & ~used[nearest]
        new[row, column], new_owner[row, column], new_torn[row, column] = (
            np.where(good, corners[nearest], place[row, column]),
            np.where(good, nearest, LOOKED),
            ~good | torn[nearest],
        )
        found = evidence(plane, board, k, (new, new_torn))
        take = (new_owner != NONE) & (found.score >= 0)
        take &= _first_claims(new_owner, take)
        if not take.any():
            break
        board = replaced(board, take, new, new_owner, new_torn)
    blend = result(board, np.where(torn, F(np.nan), sigma), k)
    return dataclasses.replace(blend, firm=firm(plane, board, blend.torn, k))


def dropped(plane: Plane, board: Board, k: LatticeConstants) -> Board:
    """Return the board without nodes that score too little."""
    while True:
        bad = board.there & (evidence(plane, board, k).score < 0)
        if not bad.any():
            return board
        board = replaced(board, bad, NOWHERE, NONE, False)


def nearest_corner(corners: Places, at: Places) -> tuple[Whole, Real]:
    """Return the nearest corner to each point, the lower index of equals, and its squared
    distance."""
    away = corners - at[:, None]
    square = np.where(np.isnan(away), np.inf, dot(away, away))
    return square.argmin(axis=1), square.min(axis=1)


def _first_claims(owner: Whole, take: Mask) -> Mask:
    """Return whether a node is the first of those that claim its corner."""
    claims = np.flatnonzero((take & (owner >= 0)).ravel())
    _, first = np.unique(owner.ravel()[claims], return_index=True)
    good = np.ones(take.size, np.bool_)
    good[np.delete(claims, first)] = False
    return good.reshape(take.shape)
