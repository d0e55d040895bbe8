"""What the views of a calibration lack, in words."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.grid import Grid
from cmp_cl.space.calibration.calibrate import ENOUGH_VIEWS, Calibration, Camera
from cmp_cl.space.lens import Lens, rays_of

_PARTS = [
    ["top left", "top", "top right"],
    ["left", "middle", "right"],
    ["bottom left", "bottom", "bottom right"],
]
COVERAGE = 90  # cells along each side of an image
_PROBES = 41  # pixels along each side of an image
_COVERED = 0.3  # share of a part that boards cover; less is worth a word
_ODD = 3.0  # times the median error of a camera's views: a view with more is worth a word
_TILT, _EITHER_TILT = 15.0, 7.0  # degrees: the largest tilt, and the typical one about each axis


def advice(found: Calibration, names: Mapping[str, Sequence[str]] | None = None) -> list[str]:
    """Return what would make a calibration better, a sentence each; [] if nothing is missing.

    found: the calibration. names: by camera, the name of each view; None means their numbers.

    It tells which views fit much worse than the others; whether a lens model fails in the image;
    which parts of an image show no board, of three by three; whether the boards are hardly tilted
    (the focal length is then uncertain) or about one axis only; which views are alike; whether
    there are few; and whether a board that is not square is the same way up in all.
    """
    said = []
    for name in found.cameras:
        error = found.view_errors[name]
        usual = float(np.nanmedian(error))
        odd = np.flatnonzero(error > _ODD * usual).tolist()
        if odd:
            said.append(
                f"{name}: {_listed([str(i) if names is None else names[name][i] for i in odd])} "
                f"miss by up to {error[odd].max():.2g} px, others by {usual:.2g}: leave them out "
                "if the board bent, or moved between the cameras' images"
            )
        blind = _blind(found.cameras[name])
        if blind > 0:
            said.append(
                f"{name}: the lens model turns back inside the image, so that {blind:.1%} of it "
                "give no ray: add views with the board near all borders, or choose another lens"
            )
        side = COVERAGE // len(_PARTS)
        parts = covered(found, name).reshape(len(_PARTS), side, len(_PARTS), side)
        lacking = np.argwhere(parts.mean(axis=(1, 3)) < _COVERED)
        unseen = [_PARTS[row][column] for row, column in lacking]
        if unseen:
            said.append(f"{name}: add views with the board at the {_listed(unseen)} of the image")
        across, down = tilts(found, name).T
        largest = float(np.hypot(across, down).max())
        typical = [float(np.sqrt(np.mean(np.square(each)))) for each in (across, down)]
        if largest < _TILT:
            said.append(
                f"{name}: the boards are tilted by at most {largest:.0f} degrees; add views tilted "
                "by 20 to 40 degrees, which the focal length needs"
            )
        elif min(typical) < _EITHER_TILT:
            way = "to the left and right" if typical[0] < typical[1] else "up and down"
            said.append(f"{name}: add views of the board tilted {way} by 20 to 40 degrees")
    first = next(iter(found.cameras))
    for group in found.alike:
        which = _listed([str(each) if names is None else names[first][each] for each in group])
        said.append(f"{which} show the same and count as one view; move and tilt the board")
    count = int(np.isfinite(found.normals[:, 0]).sum())
    if count < ENOUGH_VIEWS:
        said.append(
            f"{count} different views, too few to tell whether the board is flat; {ENOUGH_VIEWS} "
            "or more are better"
        )
    ways = np.array([_long_side(grid) for grid in found.grids[first] if grid is not None])
    if (np.real(ways * ways.mean().conj()) > 0).all():
        said.append(
            "the board is the same way up in all views; turn it by quarters between them, so that "
            "errors of its print cancel"
        )
    return said


def _blind(camera: Camera) -> float:
    """Return the share of the image in which the lens model cannot be inverted."""
    if camera.lens is Lens.FISHEYE:
        return 0.0
    x, y = np.meshgrid(*(np.linspace(0, length - 1, _PROBES) for length in camera.size))
    pixels = np.column_stack([x.ravel(), y.ravel()])
    return 1.0 - float(rays_of(pixels, camera.matrix, camera.distortion)[1].mean())


def tilts(found: Calibration, name: str) -> NDArray[np.float64]:
    """Return how far the boards are turned from facing a camera, (N, 2), degrees.

    The first number is the turn to the left or right, the second up or down. N: the views of the
    camera that are used.
    """
    used = [moment for moment, grid in enumerate(found.grids[name]) if grid is not None]
    normals = found.normals[used] @ found.cameras[name].R.T
    across, down, ahead = normals.T
    length = np.hypot(across, down)
    angle = np.degrees(np.arctan2(length, ahead))
    turned: NDArray[np.float64] = normals[:, :2] * (angle / np.maximum(length, 1e-12))[:, None]
    return turned


def covered(found: Calibration, name: str) -> NDArray[np.bool_]:
    """Return where a camera saw a board: a raster over its image, (COVERAGE, COVERAGE)."""
    raster = np.zeros((COVERAGE, COVERAGE), np.uint8)
    for grid in found.grids[name]:
        if grid is not None:
            xy = (grid.xy[grid.valid] + 0.5) / np.array(found.cameras[name].size) * COVERAGE
            hull = cv2.convexHull(np.floor(xy).astype(np.int32))
            cv2.fillConvexPoly(raster, hull, 1)
    return raster.astype(bool)


def _long_side(grid: Grid) -> complex:
    """Return the square of the direction of the longer side of a board, 0 if it is square."""
    rows, columns = grid.shape
    steps = np.diff(grid.xy.astype(np.float64), axis=int(columns > rows))
    way = complex(*np.nanmean(steps, axis=(0, 1)))
    return way**2 / abs(way**2) * (rows != columns)


def _listed(words: Sequence[str]) -> str:
    *others, last = words
    return f"{', '.join(others)} and {last}" if others else last
