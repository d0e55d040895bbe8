"""The last step of a calibration: all views are adjusted together, each node weighted by its own
sigma. It also gives the covariance of the result."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CAMERA = 8  # fx fy cx cy k1 k2 p1 p2
POSE = 6  # rotation vector, translation
OF_CAMERA = slice(POSE, POSE + CAMERA)  # columns of the derivatives of cv2.projectPoints
_STEPS = 20
_SMALL = 1e-9  # relative decrease of the cost at which the iteration ends
_RANGE = 5.0  # the most by which the sigma of a node counts as larger or smaller than the median
ROUNDS = 2  # of the adjustment and the variance of the misfit


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """A view of a board by one or two cameras.

    It holds the nodes on the board (N, 3), their positions in each image (N, 2), px, the standard
    deviations of these (N,), px, NaN where unknown, and the board's pose in the first camera, (6,).
    """

    board: NDArray[np.floating[Any]]
    seen: tuple[Array, ...]
    sigma: tuple[Array, ...]
    pose: Array


@dataclasses.dataclass(frozen=True, eq=False)
class Adjusted:
    """The result of an adjustment.

    parameters: 8 for each camera, and with two cameras the pose of the second, 6. covariance: of
    these parameters. errors: (V, cameras), root mean square reprojection errors by view, px.
    """

    parameters: Array
    covariance: Array
    errors: Array


def adjust(views: Sequence[View], start: Array) -> Adjusted:
    """Minimize the weighted reprojection error of all views by Gauss-Newton, from a near solution.

    start: as `Adjusted.parameters`. Weights are those of `node_weights`. The covariance is scaled
    by the residuals, so a factor that all sigmas share does not matter.
    """
    parameters, poses = start, [view.pose for view in views]
    for _ in range(ROUNDS):
        weights = node_weights(views, residuals(views, parameters, poses), len(start))
        parameters, poses, cost, normal = _settled(views, weights, parameters, poses)
    covariance = np.linalg.pinv(normal, hermitian=True) * cost / freedom(views, len(start))
    return Adjusted(parameters, covariance, root_mean_squares(residuals(views, parameters, poses)))


def _settled(
    views: Sequence[View],
    weights: Sequence[tuple[Array, ...]],
    parameters: Array,
    poses: list[Array],
) -> tuple[Array, list[Array], float, Array]:
    """Take steps until the cost no longer falls; return the parameters, the poses, the cost and the
    normal matrix of the parameters alone.
    """
    cost, step = _system(views, weights, parameters, poses)
    for _ in range(_STEPS):
        by_parameters, by_poses, _ = step()
        moved = [pose + change for pose, change in zip(poses, by_poses, strict=True)]
        lower, next_step = _system(views, weights, parameters + by_parameters, moved)
        if not lower < cost:
            break
        done = cost - lower < _SMALL * cost
        parameters, poses, cost, step = parameters + by_parameters, moved, lower, next_step
        if done:
            break
    return parameters, poses, cost, step()[2]


def freedom(views: Sequence[View], unknown: int) -> int:
    """Return the degrees of freedom: residuals minus parameters, poses included; at least 1."""
    count = sum(2 * len(view.board) * len(view.seen) for view in views)
    return max(count - unknown - POSE * len(views), 1)


def residuals(
    views: Sequence[View], parameters: Array, poses: Sequence[Array]
) -> list[tuple[Array, ...]]:
    """Return seen minus projected, px, (N, 2) for each view and camera."""
    return [
        tuple(off for off, *_ in seen_by(view, parameters, pose))
        for view, pose in zip(views, poses, strict=True)
    ]


def root_mean_squares(offs: Sequence[tuple[Array, ...]]) -> Array:
    """Return the root mean square lengths of residuals, (V, cameras), px."""
    return np.array(
        [[float(np.sqrt(np.square(off).sum(axis=1).mean())) for off in each] for each in offs]
    )


def node_weights(
    views: Sequence[View], offs: Sequence[tuple[Array, ...]], unknown: int
) -> list[tuple[Array, ...]]:
    """Return 1 / sqrt(sigma^2 + t^2) of each node, 1 / px.

    offs: residuals near the solution, see `residuals`. unknown: how many parameters are
    adjusted beside the poses. t^2 is the variance that no image shows: the print is not exact, the
    board is not flat, or the model does not describe the lens. It is the same for all nodes. Nodes
    of unknown sigma have the median one.
    """
    given = np.concatenate([sigma for view in views for sigma in view.sigma])
    known = np.isfinite(given) & (given > 0)
    middle = float(np.median(given[known])) if known.any() else 1.0
    variance = np.square(np.clip(np.where(known, given, middle), middle / _RANGE, middle * _RANGE))
    square = np.concatenate([np.square(off).sum(axis=1) for each in offs for off in each])
    weights = 1 / np.sqrt(variance + misfit(square, variance, freedom(views, unknown)))
    ends = np.cumsum([len(sigma) for view in views for sigma in view.sigma])
    parts = iter(np.split(weights, ends))
    return [tuple(next(parts) for _ in view.sigma) for view in views]


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


def _system(
    views: Sequence[View],
    weights: Sequence[tuple[Array, ...]],
    parameters: Array,
    poses: list[Array],
) -> tuple[float, Any]:
    """Return the cost, and a function that returns the steps of the parameters and of each pose,
    and the normal matrix of the parameters alone."""
    cost = 0.0
    parts = []
    for view, weight, pose in zip(views, weights, poses, strict=True):
        rows = []
        for (off, by_parameters, by_pose, _), each in zip(
            seen_by(view, parameters, pose), weight, strict=True
        ):
            scale = np.repeat(each, 2)[:, None]
            rows.append((off.reshape(-1, 1) * scale, by_parameters * scale, by_pose * scale))
        off, by_parameters, by_pose = (np.concatenate(each) for each in zip(*rows, strict=True))
        cost += float(np.square(off).sum())
        parts.append((off[:, 0], by_parameters, by_pose))

    def step() -> tuple[Array, list[Array], Array]:
        normal = np.zeros((len(parameters), len(parameters)))
        right = np.zeros(len(parameters))
        kept = []
        for off, by_parameters, by_pose in parts:
            own = np.linalg.pinv(by_pose)
            free = by_parameters - by_pose @ (own @ by_parameters)
            normal += free.T @ free
            right += free.T @ off
            kept.append(own)
        change = np.linalg.pinv(normal, hermitian=True) @ right
        moves = [
            own @ (off - by_parameters @ change)
            for own, (off, by_parameters, _) in zip(kept, parts, strict=True)
        ]
        return change, moves, normal

    return cost, step


def seen_by(view: View, parameters: Array, pose: Array) -> list[tuple[Array, Array, Array, Array]]:
    """Return the residuals of a view in each camera, and the derivatives of its projection.

    A residual is measured minus projected, (N, 2), px. The derivatives are (2 N, ...) by the
    parameters and by the pose, and (N, 2, 3) by the node on the board.
    """
    found: list[tuple[Array, Array, Array, Array]] = []
    for camera, seen in enumerate(view.seen):
        own = slice(CAMERA * camera, CAMERA * (camera + 1))
        matrix, distortion = matrix_of(parameters[own]), parameters[own][4:]
        here, chain = pose, None
        if camera:
            here, chain = composed(pose, parameters[2 * CAMERA :])
        projected, slopes = cv2.projectPoints(
            view.board.astype(np.float64), here[:3], here[3:], matrix, distortion
        )
        by_parameters: Array = np.zeros((len(slopes), len(parameters)))
        by_parameters[:, own] = slopes[:, OF_CAMERA]
        by_pose = np.asarray(slopes[:, :POSE], np.float64)
        by_node = by_pose[:, 3:].reshape(-1, 2, 3) @ cv2.Rodrigues(here[:3])[0]
        if chain is not None:
            by_parameters[:, 2 * CAMERA :] = by_pose @ chain[1]
            by_pose = by_pose @ chain[0]
        off = np.asarray(seen - projected.reshape(-1, 2), np.float64)
        found.append((off, by_parameters, by_pose, by_node))
    return found


def matrix_of(parameters: Array) -> Array:
    """Return the camera matrix of parameters that begin with fx, fy, cx, cy."""
    fx, fy, cx, cy = parameters[:4]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def composed(first: Array, second: Array) -> tuple[Array, tuple[Array, Array]]:
    """Return the pose that applies `first`, then `second`, (6,), and its derivatives, (6, 6)
    each."""
    turn, shift, *slopes = cv2.composeRT(first[:3], first[3:], second[:3], second[3:])
    by = [np.asarray(each, np.float64) for each in slopes]
    return np.concatenate([turn.ravel(), shift.ravel()]), (
        np.block([[by[0], by[1]], [by[4], by[5]]]),
        np.block([[by[2], by[3]], [by[6], by[7]]]),
    )
