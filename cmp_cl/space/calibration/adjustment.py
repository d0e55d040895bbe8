"""The last step of a calibration: cameras and poses of the board are adjusted together.

Any number of cameras look at one board at any number of moments. The unknowns are the parameters of
the cameras, the pose of the board at each moment, and the bend of the board, the same at all
moments. Source of the last: mrcal, https://mrcal.secretsauce.net, whose board has two curvatures.
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
BEND = 3  # parameters of a bent board
_SINGULAR = 1e-14  # of the scaled equations: below it, a parameter is not determined


@dataclasses.dataclass(frozen=True, eq=False)
class Look:
    """What one camera sees of the board at one moment.

    camera, moment: their numbers. nodes: (N, 3), of the board, squares. xy: (N, 2), px.
    """

    camera: int
    moment: int
    nodes: Array
    xy: Array


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """The cameras (C, P), see `cmp_cl.space.lens`, and the poses of the board in the first camera's
    frame (M, 6).

    bend: (3,), half the curvatures of the board, one over squares: z = bend . (x^2, xy, y^2). Where
    x and y begin does not matter: it turns and moves the board. (0,) for a flat board.
    """

    cameras: Array
    poses: Array
    bend: Array


def residuals(look: Look, state: State) -> Array:
    """Return measured minus projected, (N, 2), px."""
    return look.xy - projected(_placed(look, state), state.cameras[look.camera])[0]


def root_mean_square(offs: Sequence[Array]) -> float:
    """Return the root mean square length of residuals (..., 2), px, of those that are not NaN."""
    every = np.concatenate([off.reshape(-1, 2) for off in offs])
    return math.sqrt(float(np.nanmean(np.square(every).sum(axis=1))))


def adjust(looks: Sequence[Look], state: State) -> tuple[State, Array | None]:
    """Minimize the reprojection error of all looks by Levenberg's method, from a near solution.

    OpenCV 4 adjusts two cameras that see all moments, and no others; 5 gives no covariance. SciPy's
    MINPACK gives the same cameras and takes 2 to 8 times as long; its sparse solver does not
    converge in 50 steps, since lens and pose can nearly replace each other.

    Returns the result, and its `covariance`.
    """

    def cost_of(state: State) -> float:
        return float(sum(np.square(residuals(look, state)).sum() for look in looks))

    cost, damping = cost_of(state), _DAMPING
    equations = _equations(looks, state)
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
        equations = _equations(looks, state)
    return state, covariance(looks, state)


def covariance(looks: Sequence[Look], state: State) -> Array | None:
    """Return the covariance of the unknown parameters of the cameras, (n, n).

    The variance of a corner is that of the residuals, per degree of freedom, or the larger one that
    `_shared_variance` finds. Returns None if the views do not determine a parameter.
    """
    matrix, _ = _equations(looks, state)
    unit = np.sqrt(np.diag(matrix))
    if not (unit > 0).all():
        return None
    values, axes = np.linalg.eigh(matrix / np.outer(unit, unit))
    if not values[0] > _SINGULAR:
        return None
    count = int(np.count_nonzero(unknowns(state.cameras)))
    few, unit = axes[:count], unit[:count]
    inverse = (few / values) @ few.T / np.outer(unit, unit)
    offs = np.concatenate([residuals(look, state) for look in looks])
    variance = np.square(offs).sum() / max(offs.size - len(matrix), 1)
    found: Array = inverse * max(variance, _shared_variance(looks, state, inverse))
    return found


def _equations(looks: Sequence[Look], state: State) -> tuple[Array, Array]:
    """Return the normal equations, (n, n) and (n,), of the unknown parameters of the cameras, then
    of the poses."""
    free = unknowns(state.cameras)
    number = np.cumsum(free).reshape(free.shape) - 1
    poses = number[-1, -1] + 1
    bend = poses + state.poses.size
    size = bend + state.bend.size
    matrix, right = np.zeros((size, size)), np.zeros(size)
    for look in looks:
        by_camera, *by_board = _slopes(look, state)
        chosen = free[look.camera]
        of_pose = poses + POSE * look.moment + np.arange(POSE)
        column = np.concatenate([number[look.camera][chosen], of_pose, np.arange(bend, size)])
        slopes = np.concatenate([by_camera[..., chosen], *by_board], axis=2)
        slopes = slopes.reshape(-1, len(column))
        matrix[np.ix_(column, column)] += slopes.T @ slopes
        right[column] += slopes.T @ residuals(look, state).ravel()
    return matrix, right


def _slopes(look: Look, state: State) -> tuple[Array, Array, Array]:
    """Return the derivatives of the projection by the camera, (N, 2, P), by the pose of the board,
    (N, 2, 6), and by its bend, (N, 2, 3), px."""
    camera, pose = state.cameras[look.camera], state.poses[look.moment]
    by_turn = np.asarray(cv2.Rodrigues(pose[:3])[1], np.float64).reshape(3, 3, 3)
    by_camera = projected(_placed(look, state), camera)[1]
    by_point = by_camera[..., -3:] @ rotation_of(camera)
    turning = np.einsum("kij,nj->nik", by_turn, _bent(look, state))
    by_height = by_point @ rotation_of(pose)[:, 2:]
    by_bend = by_height * heights(look.nodes)[:, None, : len(state.bend)]
    return by_camera, np.concatenate([by_point @ turning, by_point], axis=2), by_bend


def _step(matrix: Array, right: Array, damping: float) -> Array:
    """Return a step of the unknowns; damping: share that is added to the diagonal."""
    unit = np.sqrt(np.diag(matrix))
    scaled = matrix / np.outer(unit, unit) + damping * np.eye(len(unit))
    return np.linalg.solve(scaled, right / unit) / unit


def _moved(state: State, step: Array) -> State:
    """Return the state after a step of the unknowns."""
    free, cameras = unknowns(state.cameras), state.cameras.copy()
    count = int(np.count_nonzero(free))
    cameras[free] += step[:count]
    of_poses, of_bend = np.split(step[count:], [state.poses.size])
    return State(cameras, state.poses + of_poses.reshape(-1, POSE), state.bend + of_bend)


def _shared_variance(looks: Sequence[Look], state: State, inverse: Array) -> float:
    """Return the variance of a corner that the differences between groups of corners show, px^2.

    inverse: of the normal equations of the unknown parameters of the cameras, (n, n).

    The corners of one view may have errors in common, of the lens, and those of one node in all
    views that of the print. With A_m and g_m the normal equations of the cameras by group m, A =
    sum A_m, and independent corners of variance v, the mean of g_m^T A^-1 g_m is v tr(B - B^2) with
    B = A^-1 A_m; common errors make it larger.
    """
    slopes, offs = _without_poses(looks, state)
    moments = np.concatenate([np.full(len(look.nodes), look.moment) for look in looks])
    nodes = np.unique(np.concatenate([look.nodes for look in looks]), axis=0, return_inverse=True)
    variances = []
    for groups in (moments, nodes[1].ravel()):
        found = expected = 0.0
        for group in np.unique(groups):
            own = slopes[groups == group].reshape(-1, len(inverse))
            slope = own.T @ offs[groups == group].ravel()
            share = inverse @ (own.T @ own)
            found += float(slope @ inverse @ slope)
            expected += float(np.trace(share - share @ share))
        variances.append(found / expected)
    return max(variances)


def _without_poses(looks: Sequence[Look], state: State) -> tuple[Array, Array]:
    """Return the derivatives of all corners by the unknown parameters of the cameras, (N, 2, n),
    with the board at its best poses and bend, and the residuals, (N, 2), px."""
    matrix, _ = _equations(looks, state)
    free = unknowns(state.cameras)
    count = int(np.count_nonzero(free))
    by_board = np.linalg.solve(matrix[count:, count:], matrix[count:, :count])
    by_pose, by_bend = np.split(by_board, [state.poses.size])
    by_pose = by_pose.reshape(-1, POSE, count)
    every = []
    for look in looks:
        by_camera, pose, bend = _slopes(look, state)
        slopes = -pose @ by_pose[look.moment] - bend @ by_bend
        own = np.zeros(free.shape, bool)
        own[look.camera] = free[look.camera]
        slopes[..., own[free]] += by_camera[..., free[look.camera]]
        every.append(slopes)
    return np.concatenate(every), np.concatenate([residuals(look, state) for look in looks])


def _placed(look: Look, state: State) -> Array:
    """Return the nodes in the frame of the first camera, (N, 3)."""
    pose = state.poses[look.moment]
    placed: Array = _bent(look, state) @ rotation_of(pose).T + pose[3:]
    return placed


def _bent(look: Look, state: State) -> Array:
    """Return the nodes of the bent board, (N, 3), squares."""
    nodes = look.nodes.copy()
    nodes[:, 2] += heights(nodes)[:, : len(state.bend)] @ state.bend
    return nodes


def heights(nodes: Array) -> Array:
    """Return the derivatives of the heights of nodes (N, 3) by the bend, (N, 3)."""
    x, y, _ = nodes.T
    return np.column_stack([x * x, x * y, y * y])
