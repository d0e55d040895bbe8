"""The last step of a calibration on a board that is bent or inexact: it finds the nodes of the
board together with the cameras."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError
from cmp_cl.stereo.adjustment import (
    POSE,
    ROUNDS,
    Adjusted,
    View,
    freedom,
    node_weights,
    residuals,
    root_mean_squares,
    seen_by,
)

Array = NDArray[np.float64]
Nodes = NDArray[np.int64]

LEAST_VIEWS = 4
_STEPS = 30
_HALVINGS = 6
_SMALL = 1e-7  # relative decrease of the cost at which the iteration ends
_LOOSE = 0.1  # share of a square: expected standard deviation of a node from its nominal position


@dataclasses.dataclass(frozen=True, eq=False)
class _State:
    """The parameters of the cameras, the poses (V, 6), and the nodes of the board (P, 3)."""

    parameters: Array
    poses: Array
    board: Array


@dataclasses.dataclass(frozen=True, eq=False)
class _Problem:
    """The input of the adjustment.

    views; nodes: for each view, the rows (N,) of `flat` that it shows; weights: of these nodes;
    flat: the flat board (P, 3); spring: the stiffness of the springs to it.
    """

    views: Sequence[View]
    nodes: Sequence[Nodes]
    weights: Sequence[tuple[Array, ...]]
    flat: Array
    spring: float = 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class _Normal:
    """The normal equations, of cameras and poses (n) and of P nodes, whose blocks are 3 x 3.

    cost: sum of all weighted squared residuals and of the springs.
    """

    cost: float
    both: Array
    right: Array
    cross: Array
    own: Array
    own_right: Array


def adjust_board(
    views: Sequence[View], nodes: Sequence[Nodes], start: Array, board: Array, spacing: float
) -> tuple[Adjusted, Array]:
    """Minimize the weighted reprojection error over cameras, poses and the nodes of the board, by
    Gauss-Newton from a near solution.

    nodes: for each view, the indices (N,) into `board` (P, 3) of its nodes. start: like
        `Adjusted.parameters`. spacing: side of a square, in the unit of the board. A spring draws
        each node to its nominal position, with a standard deviation of a tenth of a square. Against
        many residuals of a tenth of a pixel it only determines what the views leave open: the size,
        the position and the orientation of the board.

    Returns the cameras and the nodes (P, 3). Raises CalibrationError if fewer than four views are
    given.
    """
    if len(views) < LEAST_VIEWS:
        raise CalibrationError(
            f"{len(views)} views of a free board, at least {LEAST_VIEWS} are needed"
        )
    shown = len(np.unique(np.concatenate(nodes)))
    unknown = len(start) + 3 * shown - POSE - 1  # the position and the size of the board are fixed
    free = freedom(views, unknown)
    state = _State(start.copy(), np.array([view.pose for view in views]), board.copy())
    for _ in range(ROUNDS):  # the stiffness of the spring depends on the residuals
        weights = node_weights(views, _residuals(views, nodes, state), unknown)
        loose = _Problem(views, nodes, weights, board)
        spring = _system(loose, state).cost / free / (_LOOSE * spacing) ** 2
        state, normal = _settled(dataclasses.replace(loose, spring=spring), state)
    reduced: Array = _reduced(normal)[0]
    covariance = np.asarray(np.linalg.pinv(reduced, hermitian=True), np.float64)
    return (
        Adjusted(
            state.parameters,
            covariance[: len(start), : len(start)] * normal.cost / free,
            root_mean_squares(_residuals(views, nodes, state)),
        ),
        state.board,
    )


def _residuals(
    views: Sequence[View], nodes: Sequence[Nodes], state: _State
) -> list[tuple[Array, ...]]:
    """Return seen minus projected at a state, px, (N, 2) for each view and camera."""
    shown = [
        dataclasses.replace(view, board=state.board[rows])
        for view, rows in zip(views, nodes, strict=True)
    ]
    return residuals(shown, state.parameters, list(state.poses))


def _settled(problem: _Problem, state: _State) -> tuple[_State, _Normal]:
    """Take steps until the cost no longer falls; a step that raises it is halved."""
    normal = _system(problem, state)
    for _ in range(_STEPS):
        step = _step(normal, state)
        for halving in range(_HALVINGS):
            moved = _State(
                *(
                    one + change / 2**halving
                    for one, change in zip(_parts(state), _parts(step), strict=True)
                )
            )
            lower = _system(problem, moved)
            if lower.cost < normal.cost:
                break
        else:
            break
        done = normal.cost - lower.cost < _SMALL * normal.cost
        state, normal = moved, lower
        if done:
            break
    return state, normal


def _parts(state: _State) -> tuple[Array, Array, Array]:
    return state.parameters, state.poses, state.board


def _step(normal: _Normal, state: _State) -> _State:
    """Return the Gauss-Newton step."""
    reduced, right, inverse = _reduced(normal)
    both = np.linalg.lstsq(reduced, right, rcond=None)[0]
    own = inverse @ (normal.own_right - normal.cross.transpose(0, 2, 1) @ both)[..., None]
    parameters, poses = np.split(both, [len(state.parameters)])
    return _State(parameters, poses.reshape(-1, POSE), own[..., 0])


def _reduced(normal: _Normal) -> tuple[Array, Array, Array]:
    """Return the equations of cameras and poses without the nodes, (n, n) and (n,), and the inverse
    blocks of the nodes."""
    inverse = np.asarray(np.linalg.inv(normal.own), np.float64)
    through = normal.cross @ inverse
    reduced = normal.both - np.tensordot(through, normal.cross, axes=((0, 2), (0, 2)))
    return (
        reduced,
        normal.right - np.tensordot(through, normal.own_right, axes=((0, 2), (0, 1))),
        inverse,
    )


def _system(problem: _Problem, state: _State) -> _Normal:
    """Return the normal equations at a state."""
    flat, spring = problem.flat, problem.spring
    first = len(state.parameters)
    size, count = first + state.poses.size, len(flat)
    both, right = np.zeros((size, size)), np.zeros(size)
    cross = np.zeros((count, size, 3))
    own = np.zeros((count, 3, 3)) + max(spring, 1e-30) * np.eye(3)
    own_right = spring * (flat - state.board)
    cost = float(spring * np.square(flat - state.board).sum())
    for number, (view, rows, weight) in enumerate(
        zip(problem.views, problem.nodes, problem.weights, strict=True)
    ):
        pose = slice(first + POSE * number, first + POSE * (number + 1))
        shown = dataclasses.replace(view, board=state.board[rows])
        for (off, by_parameters, by_pose, by_node), each in zip(
            seen_by(shown, state.parameters, state.poses[number]), weight, strict=True
        ):
            slopes = np.zeros((len(rows), 2, size))
            slopes[..., :first] = by_parameters.reshape(len(rows), 2, -1)
            slopes[..., pose] = by_pose.reshape(len(rows), 2, -1)
            slopes *= each[:, None, None]
            off, by_node = off * each[:, None], by_node * each[:, None, None]
            cost += float(np.square(off).sum())
            flat_slopes = slopes.reshape(-1, size)
            both += flat_slopes.T @ flat_slopes
            right += flat_slopes.T @ off.ravel()
            cross[rows] += slopes.transpose(0, 2, 1) @ by_node
            own[rows] += by_node.transpose(0, 2, 1) @ by_node
            own_right[rows] += (by_node.transpose(0, 2, 1) @ off[..., None])[..., 0]
    return _Normal(cost, both, right, cross, own, own_right)
