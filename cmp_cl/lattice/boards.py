"""From the parts of a frame to its boards, the largest first; the host's share of the work."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Board, Mask, Numbers, Units, Whole
from cmp_cl.lattice.joins import joined
from cmp_cl.lattice.kernels import ROUNDS, TAKEN
from cmp_cl.lattice.plan import LatticePlan


def boards(
    plan: LatticePlan, xy: NDArray[np.float32], shape: tuple[int, int] | None = None
) -> Iterator[Board]:
    """Yield the boards of a frame that was started, upright, with their borders, the largest part's
    first.

    xy: (N, 2), the corners of the plan, px. shape: rows and columns of the one that is meant. A
    corner is a node of one board at most. A part of fewer than `least_board` faces, or of that
    shape if it has fewer, begins no board, but for the largest one; nor does one of fewer than
    `least_board` corners that no board has.
    """
    taken = np.zeros(len(xy), np.bool_)
    alone = plan.alone()
    if alone is not None:
        alone = _grown(plan, alone, taken)
    for joint, smaller in _joined(plan, xy, taken, shape) if alone is None else ((alone, []),):
        for board in _apart(plan, joint, smaller, taken):
            if np.count_nonzero(board.there) >= plan.constants.least_board:
                taken[board.owner[board.owner >= 0]] = True
                yield board


def _joined(
    plan: LatticePlan, xy: NDArray[np.float32], taken: Mask, shape: tuple[int, int] | None
) -> Iterator[tuple[Board, list[Units]]]:
    """Yield the boards of parts that are joined; and of each the smaller parts that have some of
    its corners. taken: (N,), the corners of the boards so far."""
    k = plan.constants
    faces = k.least_board if shape is None else min(k.least_board, (shape[0] - 1) * (shape[1] - 1))
    units = joined(*plan.parts(xy), dataclasses.replace(k, least_board=faces))
    first = np.unique(units.part, return_index=True)[1].tolist()
    parts = [units.chosen(slice(*ends)) for ends in zip(first, [*first[1:], None], strict=True)]
    for rank, part in enumerate(parts):
        if np.count_nonzero(~taken[part.corner]) < k.least_board:
            continue
        numbers = _numbers(part.corner, part.number, part.rotation, taken)
        joint = _grown(plan, plan.settle(numbers), taken)
        mine = np.zeros(len(xy), np.bool_)
        mine[joint.owner[joint.owner >= 0]] = True
        yield joint, [each for each in parts[rank + 1 :] if mine[each.corner].any()]


def _grown(plan: LatticePlan, board: Board, taken: Mask) -> Board:
    """Return the board that was laid out last, and again until it stops growing.

    The rounds in which nodes are looked for add a line on a side each, and can end before the board
    does: one that began as a single face, as of a pattern that closes on itself.
    """
    while plan.gained >= ROUNDS:
        larger = plan.settle(_numbers(*board.layout(board.owner >= 0), taken))
        if np.count_nonzero(larger.owner >= 0) <= np.count_nonzero(board.owner >= 0):
            break
        board = larger
    return board


def _apart(plan: LatticePlan, joint: Board, smaller: list[Units], taken: Mask) -> list[Board]:
    """Return a board; or boards and the ground behind them, if its squares go on as theirs by
    chance.

    Few firm cells lead from one to the other then, or smaller parts have some of its corners. Each
    region of firm cells, and each such part, is laid out by itself. It is a board if it is a full
    rectangle with an end and with firm sides, and if what is left is large enough for one and ends
    nowhere.
    """
    k = plan.constants
    if joint.ended:
        return [joint]
    layouts = [(each.corner, each.number, each.rotation) for each in smaller]
    if joint.hanging >= k.least_board:
        layouts += [joint.layout(np.isin(joint.owner, region)) for region in joint.regions]
    found, others = [], taken.copy()
    for layout in layouts:
        board = plan.settle(_numbers(*layout, others))
        if board.ended and board.has_firm_sides:
            found.append(board)
            others[board.owner[board.owner >= 0]] = True
    if found:
        ground = plan.settle(_numbers(*joint.layout(joint.owner >= 0), others))
        if np.count_nonzero(ground.there) >= k.least_board and ground.ends_nowhere:
            return [*found, ground]
    return [joint]


def _numbers(corner: Whole, number: Numbers, turn: Whole, taken: Mask) -> NDArray[np.int32]:
    """Return numbered corners as `LatticePlan.settle` takes them."""
    numbers = np.zeros((len(taken), 4), np.int32)
    columns = number.real, number.imag, turn, np.ones(len(corner))
    numbers[corner] = np.rint(np.stack(columns, axis=1))
    numbers[taken, 3] = TAKEN
    return numbers
