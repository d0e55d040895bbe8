"""The last step of a calibration: cameras and boards are adjusted together.

Any number of cameras look at one board at any number of moments. The unknowns are the parameters of
the cameras, the pose of the board at each moment and, if the board is free, its nodes. Each node is
weighted by its own sigma.
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.space.lens import POSE, Lens, projected, rotation_of

Array = NDArray[np.float64]

_STEPS = 30
_HALVINGS = 6
_SMALL = 1e-9  # relative decrease of the cost at which the iteration ends
_RANGE = 5.0  # the most by which the sigma of a node counts as larger or smaller than the median
_TINY = 1e-300
_ROUNDS = 2  # of the adjustment and the variance of the misfit
_LOOSE = 0.1  # share of a square: expected standard deviation of a node from its nominal position


@dataclasses.dataclass(frozen=True, eq=False)
class Look:
    """What one camera sees of the board at one moment.

    camera, moment: their numbers. nodes: (N,), indices into the board. xy: (N, 2), px. sigma: (N,),
    standard deviations of xy, px, NaN where unknown.
    """

    camera: int
    moment: int
    nodes: NDArray[np.intp]
    xy: Array
    sigma: Array


@dataclasses.dataclass(frozen=True, eq=False)
class State:
    """The cameras (C, P), see `cmp_cl.space.lens`, the poses of the board in the first camera's
    frame (M, 6), and the nodes of the board (B, 3)."""

    cameras: Array
    poses: Array
    board: Array


@dataclasses.dataclass(frozen=True, eq=False)
class Adjusted:
    """The result of an adjustment.

    state: the cameras, poses and nodes. covariance: of the camera parameters that were free.
    residuals: of each look, (N, 2), measured minus projected, px.
    """

    state: State
    covariance: Array
    residuals: Sequence[Array]


@dataclasses.dataclass(frozen=True, eq=False)
class _Problem:
    """What is adjusted, and by which data.

    free: (C, P), True for each parameter of a camera that is unknown. flat: the nominal board,
    (B, 3). loose: whether its nodes are unknown too. weights: of each look, (N,), 1 / px. spring:
    stiffness of the springs that draw the nodes to the nominal board.
    """

    lens: Lens
    looks: Sequence[Look]
    free: NDArray[np.bool_]
    flat: Array
    loose: bool
    weights: Sequence[Array]
    spring: float


@dataclasses.dataclass(frozen=True, eq=False)
class _Normal:
    """The normal equations, of a few unknowns (n) and of G groups of b unknowns each.

    The groups are the poses of a flat board, or the nodes of a free one; no two of them occur in
    one residual. cost: sum of all weighted squared residuals and of the springs. both: (n, n),
    right: (n,), cross: (G, n, b), own: (G, b, b), own_right: (G, b).
    """

    cost: float
    both: Array
    right: Array
    cross: Array
    own: Array
    own_right: Array


def adjust(
    lens: Lens,
    looks: Sequence[Look],
    start: State,
    free: NDArray[np.bool_],
    spacing: float | None = None,
) -> Adjusted:
    """Minimize the weighted reprojection error of all looks by Gauss-Newton, from a near solution.

    free: (C, P), True for each parameter of a camera that is adjusted. spacing: the side of a
        square of a free board, None for a flat one. Weights are those of `node_weights`.

    A spring draws each node of a free board to its nominal position, with a standard deviation of a
    tenth of a square. Against many residuals of a tenth of a pixel it only determines what the
    views leave open: the size, the position and the orientation of the board.

    The covariance is scaled by the residuals, so a factor that all sigmas share does not matter.
    """
    count = int(np.count_nonzero(free))
    unknown = count
    if spacing is not None:  # the position, the orientation and the size of the board are fixed
        shown = np.unique(np.concatenate([look.nodes for look in looks]))
        unknown += 3 * len(shown) - POSE - 1
    degrees = freedom(looks, unknown)
    state = start
    for _ in range(_ROUNDS):
        offs = [off for off, *_ in _seen(lens, looks, state)]
        weights = node_weights(looks, offs, degrees)
        spring = 0.0
        if spacing is not None:  # the stiffness of the springs depends on the residuals
            square = np.square(np.concatenate(offs)).sum(axis=1)
            cost = float((square * np.square(np.concatenate(weights))).sum())
            spring = cost / degrees / (_LOOSE * spacing) ** 2
        problem = _Problem(lens, looks, free, start.board, spacing is not None, weights, spring)
        state, normal = _settled(problem, state)
    covariance = _reduced(normal)[0][:count, :count] * normal.cost / degrees
    return Adjusted(state, covariance, [off for off, *_ in _seen(lens, looks, state)])


def freedom(looks: Sequence[Look], unknown: int) -> int:
    """Return the degrees of freedom: residuals minus unknowns, poses included; at least 1."""
    count = 2 * sum(len(look.nodes) for look in looks)
    return max(count - unknown - POSE * len({look.moment for look in looks}), 1)


def root_mean_square(*offs: Array) -> float:
    """Return the root mean square length of residuals (N, 2), px."""
    return math.sqrt(float(np.square(np.concatenate(offs)).sum(axis=1).mean()))


def node_weights(looks: Sequence[Look], offs: Sequence[Array], free: int) -> list[Array]:
    """Return 1 / sqrt(sigma^2 + t^2) of each node, 1 / px.

    offs: residuals near the solution. free: degrees of freedom. t^2 is the variance that no image
    shows: the print is not exact, the board is not flat, or the model does not describe the lens.
    It is the same for all nodes. Nodes of unknown sigma have the median one.
    """
    given = np.concatenate([look.sigma for look in looks])
    known = np.isfinite(given) & (given > 0)
    middle = float(np.median(given[known])) if known.any() else 1.0
    variance = np.square(np.clip(np.where(known, given, middle), middle / _RANGE, middle * _RANGE))
    square = np.square(np.concatenate(offs)).sum(axis=1)
    weights = 1 / np.sqrt(variance + misfit(square, variance, free))
    return np.split(weights, np.cumsum([len(look.sigma) for look in looks])[:-1])


def misfit(square: Array, variance: Array, free: float) -> float:
    """Return the variance t^2 that the residuals have beyond that of their nodes, at least 0.

    square: (N,), squared residuals, over both axes. variance: (N,), of a node per axis. free:
    degrees of freedom. t^2 solves sum square / (variance + t^2) = free (Paule and Mandel, 1982),
    by Newton's method, which does not overshoot here.
    """
    extra = 0.0
    for _ in range(_STEPS):
        each = square / (variance + extra)
        change = (each.sum() - free) / max(float((each / (variance + extra)).sum()), 1e-300)
        if not change > _SMALL * extra:
            break
        extra += change
    return extra


def _settled(problem: _Problem, state: State) -> tuple[State, _Normal]:
    """Take steps until the cost no longer falls; a step that raises it is halved."""
    normal = _normal(problem, state)
    for _ in range(_STEPS):
        step = _step(problem, normal)
        for halving in range(_HALVINGS):
            moved = State(
                state.cameras + step.cameras / 2**halving,
                state.poses + step.poses / 2**halving,
                state.board + step.board / 2**halving,
            )
            lower = _normal(problem, moved)
            if lower.cost <= (1 + _SMALL) * normal.cost:
                break
        else:
            break
        done = normal.cost - lower.cost < _SMALL * normal.cost
        state, normal = moved, lower
        if done:
            break
    return state, normal


def _step(problem: _Problem, normal: _Normal) -> State:
    """Return the Gauss-Newton step."""
    inverse, right, own_inverse = _reduced(normal)
    both = inverse @ right
    own = (own_inverse @ (normal.own_right - both @ normal.cross)[..., None])[..., 0]
    count = np.count_nonzero(problem.free)
    cameras = np.zeros(problem.free.shape)
    cameras[problem.free] = both[:count]
    if not problem.loose:
        return State(cameras, own, np.zeros_like(problem.flat))
    return State(cameras, both[count:].reshape(-1, POSE), own)


def _reduced(normal: _Normal) -> tuple[Array, Array, Array]:
    """Eliminate the groups.

    Returns the inverse (n, n) and the right side (n,) of the equations of the few unknowns alone,
    and the inverse blocks of the groups.
    """
    own_inverse = _inverse(normal.own, normal.own)
    through = normal.cross @ own_inverse
    reduced = normal.both - np.tensordot(through, normal.cross, axes=((0, 2), (0, 2)))
    right = normal.right - np.tensordot(through, normal.own_right, axes=((0, 2), (0, 1)))
    return _inverse(reduced, normal.both), right, own_inverse


def _inverse(matrices: Array, like: Array) -> Array:
    """Return the pseudoinverses of symmetric matrices (..., n, n), whatever the units of unknowns.

    like: (..., n, n); in the units that are used, its diagonal is 1.
    """
    unit = np.sqrt(np.maximum(np.diagonal(like, axis1=-2, axis2=-1), _TINY))
    units = unit[..., :, None] * unit[..., None, :]
    inverse: Array = np.linalg.pinv(matrices / units, hermitian=True) / units
    return inverse


def _normal(problem: _Problem, state: State) -> _Normal:
    """Return the normal equations at a state."""
    count = np.count_nonzero(problem.free)
    column = np.cumsum(problem.free).reshape(problem.free.shape) - 1
    stretched = problem.flat - state.board
    if not problem.loose:
        size, groups, width = count, len(state.poses), POSE
        own, own_right = np.zeros((groups, POSE, POSE)), np.zeros((groups, POSE))
    else:
        size, groups, width = count + state.poses.size, len(state.board), 3
        own = np.tile(problem.spring * np.eye(3), (groups, 1, 1))
        own_right = problem.spring * stretched
    cost = float(problem.spring * np.square(stretched).sum())
    both, right, cross = np.zeros((size, size)), np.zeros(size), np.zeros((groups, size, width))
    for look, weight, (off, by_camera, by_pose, by_node) in zip(
        problem.looks, problem.weights, _seen(problem.lens, problem.looks, state), strict=True
    ):
        free = problem.free[look.camera]
        columns = column[look.camera][free]
        if not problem.loose:
            group, kept, grouped = np.array([look.moment]), by_camera[..., free], by_pose
        else:
            pose = count + POSE * look.moment + np.arange(POSE)
            columns = np.concatenate([columns, pose])
            group, kept = look.nodes, np.concatenate([by_camera[..., free], by_pose], axis=2)
            grouped = by_node
        off, kept, grouped = (
            _by_group(each, weight, len(group)) for each in (off[..., None], kept, grouped)
        )
        flat, turned = kept.reshape(off.size, len(columns)), grouped.transpose(0, 2, 1)
        cost += float(np.square(off).sum())
        both[np.ix_(columns, columns)] += flat.T @ flat
        right[columns] += flat.T @ off.ravel()
        cross[np.ix_(group, columns)] += kept.transpose(0, 2, 1) @ grouped
        own[group] += turned @ grouped
        own_right[group] += (turned @ off)[..., 0]
    return _Normal(cost, both, right, cross, own, own_right)


def _by_group(values: Array, weight: Array, groups: int) -> Array:
    """Return weighted values (N, 2, k) by group, (G, 2 N / G, k)."""
    weighted: Array = values * weight[:, None, None]
    return weighted.reshape(groups, 2 * len(weight) // groups, values.shape[2])


def _seen(
    lens: Lens, looks: Sequence[Look], state: State
) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Yield the residuals of each look and the derivatives of its projection.

    A residual is measured minus projected, (N, 2), px. The derivatives are (N, 2, P) by the camera,
    (N, 2, 6) by the pose of the board, and (N, 2, 3) by the node on the board.
    """
    for look in looks:
        camera, pose = state.cameras[look.camera], state.poses[look.moment]
        nodes = state.board[look.nodes]
        turn, by_turn = (np.asarray(each, np.float64) for each in cv2.Rodrigues(pose[:3]))
        points = nodes @ turn.T + pose[3:]
        seen, by_camera = projected(lens, points, camera)
        by_point = (by_camera[..., -3:].reshape(-1, 3) @ rotation_of(camera)).reshape(-1, 2, 3)
        turning = (by_turn.reshape(9, 3) @ nodes.T).reshape(3, 3, -1)  # d (R node)_i / d turn_k
        by_pose = np.concatenate([np.einsum("nai,kin->nak", by_point, turning), by_point], axis=2)
        yield look.xy - seen, by_camera, by_pose, (by_point.reshape(-1, 3) @ turn).reshape(-1, 2, 3)
