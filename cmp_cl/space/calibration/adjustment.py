"""The last step of a calibration: cameras and boards are adjusted together.

Any number of cameras look at one board at any number of moments. The unknowns are the parameters of
the cameras, the pose of the board at each moment and, if the board is free, its nodes.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.space.lens import POSE, Lens, projected, rotation_of

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


def residuals(lens: Lens, look: Look, state: State) -> Array:
    """Return measured minus projected, (N, 2), px."""
    return look.xy - projected(lens, _placed(look, state), state.cameras[look.camera])[0]


def root_mean_square(offs: Sequence[Array]) -> float:
    """Return the root mean square length of residuals (N, 2), px."""
    return math.sqrt(float(np.square(np.concatenate(offs)).sum(axis=1).mean()))


def slopes(lens: Lens, look: Look, state: State) -> tuple[Array, Array, Array]:
    """Return the derivatives of the projection, px.

    They are (N, 2, P) by the camera, (N, 2, 6) by the pose of the board, and (N, 2, 3) by the node.
    """
    camera, pose = state.cameras[look.camera], state.poses[look.moment]
    turn, by_turn = (np.asarray(each, np.float64) for each in cv2.Rodrigues(pose[:3]))
    by_camera = projected(lens, _placed(look, state), camera)[1]
    by_point = by_camera[..., -3:] @ rotation_of(camera)
    turning = np.einsum("kij,nj->nik", by_turn.reshape(3, 3, 3), state.board[look.nodes])
    by_pose = np.concatenate([by_point @ turning, by_point], axis=2)
    return by_camera, by_pose, by_point @ turn


def adjust(
    lens: Lens,
    looks: Sequence[Look],
    state: State,
    free: NDArray[np.bool_],
    *,
    free_board: bool = False,
) -> tuple[State, Array | None]:
    """Minimize the reprojection error of all looks by Levenberg's method, from a near solution.

    OpenCV adjusts two cameras that see all moments, and no others. (SciPy's sparse least squares
    takes 100 times as long: its inner iterations converge slowly where lens, pose and board can
    replace each other.)

    free: (C, P), True for each parameter of a camera that is adjusted. free_board:
        whether the nodes of the board are adjusted too. A weak spring draws each node to its place
        in `state`, where squares have side 1; it determines the size, the position and the
        orientation of the board, which the views leave open.

    Returns the result, and its `covariance`.
    """
    flat, stiffness = state.board, 0.0
    if free_board:
        error = root_mean_square([residuals(lens, look, state) for look in looks])
        stiffness = (error / _LOOSE) ** 2

    def cost_of(state: State) -> float:
        squares = [np.square(residuals(lens, look, state)).sum() for look in looks]
        return float(sum(squares) + stiffness * np.square(state.board - flat).sum())

    cost, damping = cost_of(state), _DAMPING
    equations = _equations(lens, looks, state, free, flat, stiffness)
    for _ in range(_STEPS):
        moved = _moved(state, *_solved(equations, damping), free)
        lower = cost_of(moved)
        if not lower < cost:
            damping *= 10
            if damping > 1:
                break
            continue
        done = cost - lower < _SMALL * cost
        state, cost, damping = moved, lower, damping / 10
        equations = _equations(lens, looks, state, free, flat, stiffness)
        if done:
            break
    return state, covariance(lens, looks, state, free, stiffness)


def covariance(
    lens: Lens,
    looks: Sequence[Look],
    state: State,
    free: NDArray[np.bool_],
    stiffness: float = 0.0,
) -> Array | None:
    """Return the covariance of the free parameters of the cameras, (n, n).

    free: (C, P). stiffness: of the springs, 0 for a flat board. The variance of a corner is that of
    the residuals; for a flat board it is increased if the errors of a view are shared, see
    `_shared_variance`. Returns None if the views do not determine a parameter.
    """
    matrix = _reduced(_equations(lens, looks, state, free, state.board, stiffness), 0.0)[0]
    unit = np.sqrt(np.diag(matrix))
    if not (unit > 0).all():
        return None
    values, axes = np.linalg.eigh(matrix / np.outer(unit, unit))
    if not values[0] > _SINGULAR:
        return None
    count = int(np.count_nonzero(free))
    inverse = ((axes / values) @ axes.T)[:count, :count] / np.outer(unit[:count], unit[:count])
    shown = len(np.unique(np.concatenate([look.nodes for look in looks])))
    unknown = count + (3 * shown - POSE - 1 if stiffness else 0)
    variance = _variance(lens, looks, state, unknown)
    if not stiffness:
        variance = max(variance, _shared_variance(lens, looks, state, free, inverse))
    found: Array = inverse * variance
    return found


class _Equations(NamedTuple):
    """The normal equations, of n parameters of cameras and poses, and of the B nodes of a board.

    both: (n, n). right: (n,). cross: (B, n, 3), own: (B, 3, 3), own_right: (B, 3): of each node,
    which occurs with no other node in one residual. B is 0 for a flat board.
    """

    both: Array
    right: Array
    cross: Array
    own: Array
    own_right: Array


def _equations(
    lens: Lens,
    looks: Sequence[Look],
    state: State,
    free: NDArray[np.bool_],
    flat: Array,
    stiffness: float,
) -> _Equations:
    """Return the normal equations at a state; stiffness: of the springs, 0 for a flat board."""
    count = int(np.count_nonzero(free))
    size, nodes = count + state.poses.size, len(flat) if stiffness else 0
    both, right = np.zeros((size, size)), np.zeros(size)
    cross, own = np.zeros((nodes, size, 3)), np.tile(stiffness * np.eye(3), (nodes, 1, 1))
    own_right = stiffness * (flat - state.board)[:nodes]
    column = np.cumsum(free).reshape(free.shape) - 1
    for look in looks:
        by_camera, by_pose, by_node = slopes(lens, look, state)
        off, chosen = residuals(lens, look, state)[..., None], free[look.camera]
        pose = count + POSE * look.moment + np.arange(POSE)
        columns = np.concatenate([column[look.camera][chosen], pose])
        by_both = np.concatenate([by_camera[..., chosen], by_pose], axis=2)
        turned = by_both.transpose(0, 2, 1)
        both[np.ix_(columns, columns)] += (turned @ by_both).sum(axis=0)
        right[columns] += (turned @ off).sum(axis=0)[:, 0]
        if nodes:
            cross[np.ix_(look.nodes, columns)] += turned @ by_node
            own[look.nodes] += by_node.transpose(0, 2, 1) @ by_node
            own_right[look.nodes] += (by_node.transpose(0, 2, 1) @ off)[..., 0]
    return _Equations(both, right, cross, own, own_right)


def _reduced(equations: _Equations, damping: float) -> tuple[Array, Array, Array]:
    """Eliminate the nodes: return the matrix (n, n) and the right side (n,) of what is left, and
    the inverses (B, 3, 3). damping: share that is added to the diagonals."""
    both, right, cross, own, own_right = equations
    inverse = np.linalg.inv(own * (1 + damping * np.eye(3))).astype(np.float64)
    through = cross @ inverse
    reduced = both * (1 + damping * np.eye(len(both)))
    reduced -= np.tensordot(through, cross, axes=((0, 2), (0, 2)))
    return reduced, right - np.tensordot(through, own_right, axes=((0, 2), (0, 1))), inverse


def _solved(equations: _Equations, damping: float) -> tuple[Array, Array]:
    """Return a step of the parameters (n,) and of the nodes (B, 3)."""
    reduced, right, inverse = _reduced(equations, damping)
    step = _inverse(reduced) @ right
    nodes = inverse @ (equations.own_right - step @ equations.cross)[..., None]
    return step, nodes[..., 0]


def _inverse(matrix: Array) -> Array:
    """Return the inverse of a symmetric matrix, whatever the units of the unknowns."""
    unit = np.sqrt(np.diag(matrix))
    inverse: Array = np.linalg.inv(matrix / unit / unit[:, None]) / unit / unit[:, None]
    return inverse


def _moved(state: State, step: Array, nodes: Array, free: NDArray[np.bool_]) -> State:
    """Return the state after a step of the parameters and the nodes."""
    cameras, count = state.cameras.copy(), int(np.count_nonzero(free))
    cameras[free] += step[:count]
    board = state.board + nodes if len(nodes) else state.board
    return State(cameras, state.poses + step[count:].reshape(-1, POSE), board)


def _variance(lens: Lens, looks: Sequence[Look], state: State, unknown: int) -> float:
    """Return the variance of a corner along an axis, px^2: squared residuals by the degrees of
    freedom. unknown: the number of unknowns beside the poses of the board."""
    offs = np.concatenate([residuals(lens, look, state) for look in looks])
    degrees = offs.size - unknown - POSE * len({look.moment for look in looks})
    return float(np.square(offs).sum()) / max(degrees, 1)


def _shared_variance(
    lens: Lens, looks: Sequence[Look], state: State, free: NDArray[np.bool_], inverse: Array
) -> float:
    """Return the variance of a corner that the differences between the views show, px^2.

    inverse: of the normal equations of the free parameters, (n, n).

    The corners of one view may have errors in common, of the lens or of the print. With A_m and g_m
    the normal equations of the cameras by view m, A = sum A_m, and independent corners of variance
    v, the mean of g_m^T A^-1 g_m is v tr(B - B^2) with B = A^-1 A_m; common errors make it larger.
    """
    count = int(np.count_nonzero(free))
    found = expected = 0.0
    for moment in {look.moment for look in looks}:
        own = [dataclasses.replace(look, moment=0) for look in looks if look.moment == moment]
        there = dataclasses.replace(state, poses=state.poses[moment : moment + 1])
        both, right = _equations(lens, own, there, free, state.board, 0.0)[:2]
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
