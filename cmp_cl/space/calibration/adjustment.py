"""The last step of a calibration: cameras and boards are adjusted together.

Any number of cameras look at one board at any number of moments. The unknowns are the parameters of
the cameras, the pose of the board at each moment and, if the board is free, its nodes.
"""

import dataclasses
import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.space.lens import POSE, projected, rotation_of, unknowns

Array = NDArray[np.float64]

_STEPS = 50
_SMALL = 1e-9  # relative decrease of the cost at which the iteration ends
_DAMPING = 1e-6  # the first one, a share of the diagonal
_LOOSE = 0.1  # squares: expected standard deviation of a free node from its flat place
_SINGULAR = 1e-14  # of the scaled equations: below it, a parameter is not determined


@dataclasses.dataclass(frozen=True, eq=False)
class Look:
    """What one camera sees of the board at one moment.

    camera, moment: their numbers. nodes: (N,), indices into the board. xy: (N, 2), px.
    """

    camera: int
    moment: int
    nodes: NDArray[np.intp]
    xy: Array


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """The cameras (C, P), see `cmp_cl.space.lens`, the poses of the board in the first camera's
    frame (M, 6), and the nodes of the board (B, 3)."""

    cameras: Array
    poses: Array
    board: Array


def residuals(look: Look, state: State) -> Array:
    """Return measured minus projected, (N, 2), px."""
    return look.xy - projected(_placed(look, state), state.cameras[look.camera])[0]


def root_mean_square(offs: Sequence[Array]) -> float:
    """Return the root mean square length of residuals (..., 2), px, of those that are not NaN."""
    every = np.concatenate([off.reshape(-1, 2) for off in offs])
    return math.sqrt(float(np.nanmean(np.square(every).sum(axis=1))))


def adjust(
    looks: Sequence[Look], state: State, *, free_board: bool = False
) -> tuple[State, Array | None]:
    """Minimize the reprojection error of all looks by Levenberg's method, from a near solution.

    OpenCV adjusts two cameras that see all moments, and no others. (SciPy's sparse least squares
    takes 100 times as long: its inner iterations converge slowly where lens, pose and board can
    replace each other.)

    free_board: whether the nodes of the board are adjusted too. A weak spring draws each node to
        its place in `state`, where squares have side 1; it determines the size, the position and
        the orientation of the board, which the views leave open.

    Returns the result, and its `covariance`.
    """
    flat, stiffness = state.board, 0.0
    if free_board:
        error = root_mean_square([residuals(look, state) for look in looks])
        stiffness = (error / _LOOSE) ** 2

    def cost_of(state: State) -> float:
        squares = [np.square(residuals(look, state)).sum() for look in looks]
        return float(sum(squares) + stiffness * np.square(state.board - flat).sum())

    cost, damping = cost_of(state), _DAMPING
    equations = _equations(looks, state, flat, stiffness)
    for _ in range(_STEPS):
        moved = _moved(state, _step(*equations, damping))
        lower = cost_of(moved)
        if not lower < cost:
            damping *= 10
            if damping > 1:
                break
            continue
        done = cost - lower < _SMALL * cost
        state, cost, damping = moved, lower, damping / 10
        if done:
            break
        equations = _equations(looks, state, flat, stiffness)
    return state, covariance(looks, state, stiffness)


def covariance(looks: Sequence[Look], state: State, stiffness: float = 0.0) -> Array | None:
    """Return the covariance of the unknown parameters of the cameras, (n, n).

    stiffness: of the springs, 0 for a flat board. The variance of a corner is that of the
    residuals, per degree of freedom; for a flat board it is increased if the errors of a view are
    shared, see `_shared_variance`. Returns None if the views do not determine a parameter.
    """
    matrix, _ = _equations(looks, state, state.board, stiffness)
    unit = np.sqrt(np.diag(matrix))
    if not (unit > 0).all():
        return None
    values, axes = np.linalg.eigh(matrix / np.outer(unit, unit))
    if not values[0] > _SINGULAR:
        return None
    count = int(np.count_nonzero(unknowns(state.cameras)))
    few, unit = axes[:count], unit[:count]
    inverse = (few / values) @ few.T / np.outer(unit, unit)
    shown = len(np.unique(np.concatenate([look.nodes for look in looks])))
    board = 3 * shown - POSE - 1 if stiffness else 0
    offs = np.concatenate([residuals(look, state) for look in looks])
    variance = np.square(offs).sum() / max(offs.size - count - state.poses.size - board, 1)
    if not stiffness:
        variance = max(variance, _shared_variance(looks, state, inverse))
    found: Array = inverse * variance
    return found


def _equations(
    looks: Sequence[Look], state: State, flat: Array, stiffness: float
) -> tuple[Array, Array]:
    """Return the normal equations, (n, n) and (n,), of the unknown parameters of the cameras, of
    the poses and, with springs to the places `flat`, of the nodes."""
    free = unknowns(state.cameras)
    number = np.cumsum(free).reshape(free.shape) - 1
    poses = number[-1, -1] + 1
    nodes = poses + state.poses.size
    size = nodes + (state.board.size if stiffness else 0)
    matrix, right = np.zeros((size, size)), np.zeros(size)
    for look in looks:
        by_camera, by_pose, by_node = _slopes(look, state)
        off, chosen = residuals(look, state)[..., None], free[look.camera]
        of_pose = poses + POSE * look.moment + np.arange(POSE)
        column = np.concatenate([number[look.camera][chosen], of_pose])
        slopes = np.concatenate([by_camera[..., chosen], by_pose], axis=2)
        turned = slopes.transpose(0, 2, 1)
        matrix[np.ix_(column, column)] += (turned @ slopes).sum(axis=0)
        right[column] += (turned @ off).sum(axis=0)[:, 0]
        if stiffness:
            node = nodes + 3 * look.nodes[:, None] + np.arange(3)
            mixed, turned = turned @ by_node, by_node.transpose(0, 2, 1)
            matrix[column[:, None], node[:, None]] += mixed
            matrix[node[..., None], column] += mixed.transpose(0, 2, 1)
            matrix[node[..., None], node[:, None]] += turned @ by_node
            right[node] += (turned @ off)[..., 0]
    if stiffness:
        matrix[range(nodes, size), range(nodes, size)] += stiffness
        right[nodes:] += stiffness * (flat - state.board).ravel()
    return matrix, right


def _slopes(look: Look, state: State) -> tuple[Array, Array, Array]:
    """Return the derivatives of the projection by the camera, (N, 2, P), by the pose of the board,
    (N, 2, 6), and by the node, (N, 2, 3), px."""
    camera, pose = state.cameras[look.camera], state.poses[look.moment]
    turn, by_turn = (np.asarray(each, np.float64) for each in cv2.Rodrigues(pose[:3]))
    by_camera = projected(_placed(look, state), camera)[1]
    by_point = by_camera[..., -3:] @ rotation_of(camera)
    turning = np.einsum("kij,nj->nik", by_turn.reshape(3, 3, 3), state.board[look.nodes])
    by_pose = np.concatenate([by_point @ turning, by_point], axis=2)
    return by_camera, by_pose, by_point @ turn


def _step(matrix: Array, right: Array, damping: float) -> Array:
    """Return a step of the unknowns; damping: share that is added to the diagonal."""
    unit = np.sqrt(np.diag(matrix))
    scaled = matrix / np.outer(unit, unit) + damping * np.eye(len(unit))
    step: Array = np.linalg.solve(scaled, right / unit) / unit
    return step


def _moved(state: State, step: Array) -> State:
    """Return the state after a step of the unknowns."""
    free, cameras = unknowns(state.cameras), state.cameras.copy()
    count = int(np.count_nonzero(free))
    cameras[free] += step[:count]
    poses, nodes = np.split(step[count:], [state.poses.size])
    board = state.board + nodes.reshape(-1, 3) if len(nodes) else state.board
    return State(cameras, state.poses + poses.reshape(-1, POSE), board)


def _shared_variance(looks: Sequence[Look], state: State, inverse: Array) -> float:
    """Return the variance of a corner that the differences between the views show, px^2.

    inverse: of the normal equations of the unknown parameters of the cameras, (n, n).

    The corners of one view may have errors in common, of the lens or of the print. With A_m and g_m
    the normal equations of the cameras by view m, A = sum A_m, and independent corners of variance
    v, the mean of g_m^T A^-1 g_m is v tr(B - B^2) with B = A^-1 A_m; common errors make it larger.
    """
    count = len(inverse)
    found = expected = 0.0
    for moment in range(len(state.poses)):
        own = [dataclasses.replace(look, moment=0) for look in looks if look.moment == moment]
        there = dataclasses.replace(state, poses=state.poses[moment : moment + 1])
        both, right = _equations(own, there, state.board, 0.0)
        by_pose = both[:count, count:] @ np.linalg.inv(both[count:, count:])
        share = inverse @ (both[:count, :count] - by_pose @ both[count:, :count])
        slope = right[:count] - by_pose @ right[count:]
        found += float(slope @ inverse @ slope)
        expected += float(np.trace(share - share @ share))
    return found / expected


def _placed(look: Look, state: State) -> Array:
    """Return the nodes in the frame of the first camera, (N, 3)."""
    pose = state.poses[look.moment]
    turn = np.asarray(cv2.Rodrigues(pose[:3])[0], np.float64)
    placed: Array = state.board[look.nodes] @ turn.T + pose[3:]
    return placed
