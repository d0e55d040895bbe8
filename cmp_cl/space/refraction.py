"""Where the window of a rig is, from the pattern that is seen through it.

Behind a wrong window the squares of the pattern have different sides, and the rays of both views
miss each other. Gauss-Newton steps change the window until the squares of the differences are
least. Each kind of difference is weighted by its own scatter.
"""

import dataclasses
import math
from collections.abc import Sequence
from numbers import Real
from typing import NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError, check_kind, check_positive, listed
from cmp_cl.grid.grid import Grid
from cmp_cl.space.lens import ESTIMATED, POSE
from cmp_cl.space.rig import StereoRig, points_by_image
from cmp_cl.space.window import WINDOW, Window

Array = NDArray[np.float64]

_STEPS = 30
_DONE = 1e-3  # share of its sigma by which a parameter still moves
_BLOCKS = 6  # of the pattern along each side, see `_with_neighbours`
_GROSS = 10.0  # times the scatter: a difference beyond is left out; errors of cameras reach 5
# Share of the step by which the motion of nodes under a punch differs; or times its sigma, if more.
_UNDER, _UNDER_SIGMA = 0.02, 3.0
_FEWEST = 9  # nodes
_SMOOTH = 5  # sides along each axis, whose mean direction is that of the middle one
_LEAST_NODES = 0.75  # share of the nodes that must lie behind the window
# With the largest sigma of one of these, a displacement errs by about half a percent.
_LARGEST_TILT = 0.015  # rad
_LARGEST_DISTANCE = 0.02  # share of the depth of the pattern
_LARGEST_INDEX = 0.01
_HOPELESS = 30.0  # times the largest sigma: the search ends
_LARGEST_SCALE = 0.01  # share of the pitch by which the mean side may differ


class _Differences(NamedTuple):
    """Differences between what is seen and what is known, (N,), the derivatives of what is seen by
    the parameters of the rig's covariance, (N, P), and the block of the pattern of each, (N,)."""

    off: Array
    slopes: Array
    block: NDArray[np.intp]


class _Surface(NamedTuple):
    """The pattern at one moment: points (R, C, 3), and their derivatives by the pixels of both
    views, (R, C, 3, 4), and by the parameters of the rig, (R, C, 3, P). missed, (R, C): by how much
    the rays miss each other, px, with derivatives (R, C, P). covariance, (R, C, 3, 3): of the
    points by the noise of the corners, 0 where that is unknown."""

    points: Array
    by_image: Array
    by_rig: Array
    missed: Array
    missed_by_rig: Array
    covariance: Array


def calibrate_window(
    rig: StereoRig,
    rest: tuple[Grid, Grid],
    *,
    pitch: float,
    media: Sequence[tuple[float, float]],
    index_sigma: float = 0.01,
    stepped: tuple[float, Grid, Grid] | None = None,
) -> StereoRig:
    """Return a rig with the window through which it sees a pattern.

    rig: calibrated in air, without a window. rest: the grids of the left and the right view of the
    pattern at rest.
    pitch: side of its squares, in the unit of the rig.
    media: (thickness, index) of all that lies between the cameras and the pattern beside air; the
        last one is the medium that holds the pattern, such as the gel. The thickness of that one is
        only where the search begins; the other layers are taken as exact.
    index_sigma: standard deviation of the index of the last medium, unless a step measures it.
    stepped: the length by which a stage has pressed a flat punch into the pattern, which is taken
        as exact, and the grids of both views then. The index of the last medium is found too. Nodes
        that moved as far as most of those that moved farthest, to 2 % or three sigma, are under the
        punch.

    The surface of the pattern may be of any form. The rig's covariance has 26 parameters, see
    `StereoRig`; it includes what the errors of the cameras and of the index do to the window.
    Cameras without a covariance count as exact.

    Raises CalibrationError if an argument is malformed, the pattern does not lie behind the window,
    or the views do not fix a parameter.
    """
    _check(rig, rest, stepped)
    check_positive("pitch", pitch, CalibrationError)
    if not (isinstance(index_sigma, Real) and 0 <= cast(float, index_sigma) < math.inf):
        raise CalibrationError(f"index_sigma must be a number from 0, not {index_sigma!r}")
    window = _start(rig, rest, media)
    rig = dataclasses.replace(rig, window=window)
    size = 2 * ESTIMATED + POSE  # parameters of the cameras
    free = np.arange(size, size + WINDOW - (stepped is None))
    given = np.delete(np.arange(size + WINDOW), free)
    covariance = np.zeros((len(free), len(free)))
    known = np.zeros((size + WINDOW, size + WINDOW))
    if rig.covariance is not None:
        known[:size, :size] = rig.covariance[:size, :size]
    if stepped is None:
        known[-1, -1] = index_sigma**2
    for _ in range(_STEPS):
        before = _surface(rig, rest)
        kinds = [_sides(before, pitch), _misses(before)]
        if stepped is not None:
            after = _surface(rig, stepped[1:])
            kinds += [_misses(after), _steps(before, after, stepped[0])]
        off, slopes, block = map(np.concatenate, zip(*map(_weighted, kinds), strict=True))
        normal = slopes.T @ slopes
        inverse = np.linalg.pinv(normal[np.ix_(free, free)], hermitian=True)
        by_known = np.eye(size + WINDOW)
        by_known[np.ix_(free, given)] = -inverse @ normal[np.ix_(free, given)]
        left = off - _explained(off, slopes @ by_known[:, given], known[np.ix_(given, given)])
        covariance = _with_neighbours(inverse, left[:, None] * slopes[:, free], block)
        _check_sigma(np.sqrt(np.diag(covariance)), rig, _HOPELESS)
        move = np.zeros(WINDOW)
        move[: len(free)] = inverse @ slopes[:, free].T @ off
        assert rig.window is not None
        rig = dataclasses.replace(rig, window=rig.window.moved(move))
        if (np.abs(move[: len(free)]) < _DONE * np.sqrt(np.diag(covariance))).all():
            break
    else:
        raise CalibrationError(
            "the search for the window does not end; check the pitch, the layers and the rig"
        )
    by_index = known[-1, -1] * np.outer(by_known[:, -1], by_known[:, -1])
    known[-1, -1] = 0
    whole = by_known @ known @ by_known.T
    whole[np.ix_(free, free)] += covariance
    _check_sigma(np.sqrt(np.diag(whole)[free]), rig)
    whole += by_index
    _check_sigma(
        np.sqrt(np.diag(whole)[free]),
        rig,
        what=f"an index of the last layer that is known to {index_sigma:g} does",
        cure="measure it (stepped), or give a smaller index_sigma",
    )
    mean = float(np.nanmean(np.concatenate([_side(before, axis)[0].ravel() for axis in (0, 1)])))
    if abs(mean / pitch - 1) > _LARGEST_SCALE:
        raise CalibrationError(
            f"the squares of the pattern measure {mean:.4g} {rig.unit}, not {pitch:g}; check the "
            "pitch, and the squares of the board that calibrated the cameras"
        )
    return dataclasses.replace(rig, covariance=whole)


def _check(
    rig: StereoRig, rest: tuple[Grid, Grid], stepped: tuple[float, Grid, Grid] | None
) -> None:
    check_kind("rig", rig, StereoRig, CalibrationError)
    if rig.window is not None:
        raise CalibrationError("rig has a window; give the rig that was calibrated in air")
    views = {"rest": rest}
    if stepped is not None:
        if len(listed("stepped", stepped, object, CalibrationError)) != 3:
            raise CalibrationError("stepped must be a length and the grids of both views")
        check_positive("the length of stepped", stepped[0], CalibrationError)
        views["the views of stepped"] = stepped[1:]
    for name, grids in views.items():
        if len(listed(name, grids, Grid, CalibrationError)) != 2:
            raise CalibrationError(f"{name} must be the grids of the left and the right view")
    if stepped is not None and (stepped[1].origin, stepped[1].shape) != (
        rest[0].origin, rest[0].shape
    ):  # fmt: skip
        raise CalibrationError(f"rest has {rest[0].extent}, stepped {stepped[1].extent}")


def _start(rig: StereoRig, rest: tuple[Grid, Grid], media: Sequence[tuple[float, float]]) -> Window:
    """Return a window that is parallel to the pattern, at the distance that the thicknesses give.

    Seen along the normal, a medium seems thinner by its index.
    """
    if not media:
        raise CalibrationError("media must be (thickness, index) of at least the pattern's medium")
    probe = Window(np.array([0, 0, 1.0]), 1.0, media, 1.0)  # it checks them
    index = probe.layers[-1][1]
    points = rig.triangulate(*rest).xyz
    found = points[np.isfinite(points[..., 0])]
    if len(found) < _FEWEST:
        raise CalibrationError(
            f"both views at rest show {len(found)} nodes that fit the rig, at least {_FEWEST} are "
            "needed; check the rig, the split, and which view is the left one"
        )
    middle = found.mean(axis=0)
    normal = np.linalg.svd(found - middle)[2][2]
    normal *= np.sign(normal @ middle)
    apparent = sum(t / n for t, n in probe.layers)
    distance = float(normal @ middle) - apparent
    if not distance > 0:
        raise CalibrationError(
            f"the window would lie {-distance:.3g} {rig.unit} behind the left camera: the pattern "
            f"seems {normal @ middle:.3g} {rig.unit} away, and the layers {apparent:.3g} thick; "
            "check their thicknesses and the unit"
        )
    return Window(normal, distance, probe.layers[:-1], index)


def _surface(rig: StereoRig, grids: tuple[Grid, Grid]) -> _Surface:
    found = rig.triangulate(*grids)
    points = found.xyz
    there = np.isfinite(points[..., 0])
    both = grids[0].valid & grids[1].valid
    if not there.sum() >= _LEAST_NODES * both.sum():
        raise CalibrationError(
            f"{both.sum() - there.sum()} of the {both.sum()} nodes do not fit the rig, or do not "
            "lie behind the window; check the thicknesses of its layers and the rig"
        )
    shape, flat = points.shape[:2], points.reshape(-1, 3)
    by_point, by_rig = rig.slopes(flat)
    by_image = points_by_image(by_point)
    # What no point explains of an error of the pixels is along one direction, one one^T.
    left_over = np.eye(4) - by_point @ by_image
    largest = np.argmax(np.einsum("nii->ni", np.nan_to_num(left_over)), axis=1)
    one = left_over[np.arange(len(flat)), largest][:, None]
    one /= np.linalg.norm(one, axis=2, keepdims=True)
    seen = np.dstack([grids[0].xy, grids[1].xy]).reshape(-1, 4) - np.hstack(rig.project(flat))
    return _Surface(
        points=points,
        by_image=by_image.reshape(*shape, 3, 4),
        by_rig=(-by_image @ by_rig).reshape(*shape, 3, -1),
        missed=(one @ seen[..., None]).reshape(shape),
        missed_by_rig=(one @ by_rig).reshape(*shape, -1),
        covariance=np.nan_to_num(found.covariance),
    )


def _sides(surface: _Surface, pitch: float) -> _Differences:
    """Compare the sides of all squares with the pitch; each over its noise at 1 px."""
    found = []
    for axis in (0, 1):
        length, along = _side(surface, axis)
        slopes = (along @ np.diff(surface.by_rig, axis=axis))[..., 0, :]
        ends = _ends(surface.by_image, axis)
        noise = np.sqrt(sum(np.square(along @ end).sum(axis=(2, 3)) for end in ends))
        found.append(_listed((pitch - length) / noise, slopes / noise[..., None]))
    return _Differences(*map(np.concatenate, zip(*found, strict=True)))


def _side(surface: _Surface, axis: int) -> tuple[Array, Array]:
    """Return the lengths of the sides along an axis of the pattern, and their directions, see
    `_along`.

    Noise of variance v across a side makes it longer by v / (2 length) on average, which is
    subtracted. The directions are means of neighbours: noise of the depth would turn a side as it
    makes it longer.
    """
    way = np.diff(surface.points, axis=axis)
    sums = cv2.blur(np.nan_to_num(way), (_SMOOTH, _SMOOTH), borderType=cv2.BORDER_CONSTANT)
    along = _along(np.asarray(sums, np.float64))
    far, near = _ends(surface.covariance, axis)
    across = np.trace(far + near, axis1=2, axis2=3) - _variance(along, far + near)
    seen = np.linalg.norm(way, axis=2)
    return seen - across / (2 * seen), along


def _along(way: Array) -> Array:
    """Return the directions of vectors (R, C, 3), (R, C, 1, 3), NaN of those without length."""
    with np.errstate(invalid="ignore"):
        along: Array = (way / np.linalg.norm(way, axis=2, keepdims=True))[..., None, :]
    return along


def _variance(along: Array, covariance: Array) -> Array:
    """Return the variance of vectors of covariance (R, C, 3, 3) along a direction, (R, C)."""
    variance: Array = (along @ covariance @ along.swapaxes(2, 3))[..., 0, 0]
    return variance


def _ends(values: Array, axis: int) -> tuple[Array, Array]:
    """Return the values of nodes (R, C, ...) at both ends of all sides along an axis."""
    nodes = np.arange(values.shape[axis])
    return np.take(values, nodes[1:], axis=axis), np.take(values, nodes[:-1], axis=axis)


def _misses(surface: _Surface) -> _Differences:
    """Compare what the rays of both views miss each other by with 0."""
    return _listed(surface.missed, surface.missed_by_rig)


def _steps(before: _Surface, after: _Surface, step: float) -> _Differences:
    """Compare the motion of the nodes under a punch with its step."""
    way = after.points - before.points
    length, along = np.linalg.norm(way, axis=2), _along(way)
    sigma = np.sqrt(_variance(along, after.covariance + before.covariance))
    far = length[length > 0.9 * np.nanpercentile(length, 98)]
    most = np.median(far) if len(far) else 0.0
    under = np.abs(length - most) < np.maximum(_UNDER * most, _UNDER_SIGMA * sigma)
    if under.sum() < _FEWEST:
        raise CalibrationError(
            f"{under.sum()} nodes moved as one between rest and stepped, at least {_FEWEST} are "
            "needed; press with a flat punch"
        )
    slopes = (along @ (after.by_rig - before.by_rig))[..., 0, :]
    return _listed(np.where(under, step - length, np.nan), slopes)


def _listed(off: Array, slopes: Array) -> _Differences:
    """Return the differences (R, C) and their derivatives (R, C, P) one after the other."""
    row, column = np.indices(off.shape)
    blocks = [each * _BLOCKS // n for each, n in zip((row, column), off.shape, strict=True)]
    return _Differences(
        off.ravel(), slopes.reshape(off.size, -1), (blocks[0] * _BLOCKS + blocks[1]).ravel()
    )


def _weighted(kind: _Differences) -> _Differences:
    """Return the differences over their scatter, without gross ones and those that are unknown."""
    known = np.isfinite(kind.off) & np.isfinite(kind.slopes).all(axis=1)
    middle = np.median(kind.off[known])
    scatter = 1.4826 * np.median(np.abs(kind.off[known] - middle))
    good = known & (np.abs(kind.off - middle) <= _GROSS * scatter)
    scale = max(float(np.sqrt(np.square(kind.off[good]).mean())), 1e-12)
    return _Differences(kind.off[good] / scale, kind.slopes[good] / scale, kind.block[good])


def _explained(off: Array, slopes: Array, covariance: Array) -> Array:
    """Return what errors of given parameters explain of differences (N,), (N,).

    slopes: (N, n), by these parameters, what the others then make of them included. covariance: of
    these errors, (n, n); they are their most likely values, by Bayes.
    """
    normal = slopes.T @ slopes
    likely = np.linalg.solve(np.eye(len(normal)) + normal @ covariance, slopes.T @ off)
    return slopes @ (covariance @ likely)


def _with_neighbours(inverse: Array, scores: Array, block: NDArray[np.intp]) -> Array:
    """Return the covariance of the parameters, (n, n), where neighbours may share errors.

    inverse: that of the normal equations, their covariance if all differences were independent.
    scores: (N, n), what each difference adds to the right side. The scatter of their sums over
    blocks of the pattern shows by how much the standard deviations are larger.
    """
    sums = np.zeros((_BLOCKS**2, scores.shape[1]))
    np.add.at(sums, block, scores)
    scattered = inverse @ sums.T @ sums @ inverse / (1 - len(inverse) / len(sums))
    larger = np.sqrt(np.maximum(np.diag(scattered) / np.diag(inverse), 1))
    covariance: Array = inverse * np.outer(larger, larger)
    return covariance


def _check_sigma(
    sigma: Array,
    rig: StereoRig,
    times: float = 1.0,
    *,
    what: str = "the views do",
    cure: str = (
        "show more of the pattern at rest, sharper, or calibrate the cameras on more views"
    ),
) -> None:
    """Raise CalibrationError if the sigma of a parameter is `times` too large.

    what, cure: says what leaves it so large, and what helps.
    """
    window = rig.window
    assert window is not None
    depth = window.distance + window.thickness
    limits = {
        "tilt about its second axis": (sigma[0], _LARGEST_TILT, "rad"),
        "tilt about its first axis": (sigma[1], _LARGEST_TILT, "rad"),
        "distance": (sigma[2], _LARGEST_DISTANCE * depth, rig.unit),
    }
    if len(sigma) == WINDOW:
        limits["last index"] = sigma[3], _LARGEST_INDEX, ""
    wide = [
        f"{name} ({f'+- {sigma:.2g} {unit}'.strip() if sigma < _HOPELESS * largest else 'free'})"
        for name, (sigma, largest, unit) in limits.items()
        if not sigma <= times * largest
    ]
    if wide:
        raise CalibrationError(f"{what} not fix the window's {', '.join(wide)}: {cure}")
