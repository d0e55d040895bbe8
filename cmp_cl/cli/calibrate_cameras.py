"""`cmp-cl calibrate --camera`: one camera, two or more, with a choice of lens."""

import argparse
import itertools
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cmp_cl import media
from cmp_cl.cli.arguments import check_files, check_suffix, distinct_inputs
from cmp_cl.cli.messages import counted, one_line, shown
from cmp_cl.cli.progress import Progress
from cmp_cl.errors import CalibrationError, ConfigError, GridError, ImageError
from cmp_cl.grid import Grid
from cmp_cl.measure import align_views, find_board, trusted
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.space.cameras import CamerasCalibration, Lens, calibrate_cameras
from cmp_cl.space.exports import check_cameras, check_corners, save_cameras, save_corners
from cmp_cl.space.joint import MisfitError
from cmp_cl.viz import save_figure
from cmp_cl.viz.calibration import residual_figure


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that only this form takes."""
    parser.add_argument(
        "--camera",
        nargs="+",
        action="append",
        default=[],
        metavar=("NAME=IMAGE", "IMAGE"),
        help="the views of one camera, in place of IMAGE, --left and --right; given again for "
        "every other camera, with the views of the same moments in the same order",
    )
    parser.add_argument(
        "--lens",
        choices=[lens.value for lens in Lens],
        default=Lens.PINHOLE.value,
        help="with --camera: model of the lenses; default: pinhole",
    )
    parser.add_argument(
        "--corners",
        metavar="FILE",
        help="with --camera: write the corners, .vnl (mrcal), or .yaml or .yml (OpenCV)",
    )
    parser.add_argument(
        "--picture",
        metavar="PNG",
        help="with --camera: draw the residual of every corner and view",
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    files = _files(arguments.camera)
    _check(arguments, files)
    device = select_device(arguments.device)
    views: dict[str, list[Grid | None]] = {name: [] for name in files}
    sizes: dict[str, tuple[int, int]] = {}
    moments = list(zip(*files.values(), strict=True))
    with Progress(len(moments), "moments") as progress:
        for moment in moments:
            first: Grid | None = None
            for name, path in zip(files, moment, strict=True):
                grid = None
                try:
                    grid = _board(path, name, sizes, first, arguments, device)
                except (GridError, ImageError) as error:
                    progress.say(f"cmp-cl: left out {shown(path)}: {one_line(error)}", sys.stderr)
                views[name].append(grid)
                first = grid if first is None else first
            progress.step()
    unseen = [name for name in files if name not in sizes]
    if unseen:
        raise CalibrationError(f"no view of {', '.join(unseen)} shows the board")
    kept = {
        name: [None if grid is None else trusted(grid, arguments.max_sigma) for grid in grids]
        for name, grids in views.items()
    }
    try:
        found = calibrate_cameras(
            kept,
            spacing=arguments.square,
            sizes=sizes,
            lens=Lens(arguments.lens),
            unit=arguments.unit,
        )
    except MisfitError as error:
        shorter = {name: [path.name for path in paths] for name, paths in files.items()}
        raise with_files(error, shorter) from error
    written = [shown(path) for path in save_cameras(arguments.out, found.cameras)]
    if arguments.corners is not None:
        pictures = itertools.chain.from_iterable(
            zip(map(str, files[name]), kept[name], strict=True) for name in files
        )
        save_corners(arguments.corners, dict(pictures), spacing=arguments.square)
        written.append(shown(arguments.corners))
    if arguments.picture is not None:
        save_figure(arguments.picture, residual_figure(found))
        written.append(shown(arguments.picture))
    _report(found, kept, files, arguments.board)
    each = " of each camera" if len(files) > 1 else ""
    print(f"wrote {', '.join(written)}: {counted(len(moments), 'view')}{each} on {device}")
    return 0


def _files(cameras: list[list[str]]) -> dict[str, list[Path]]:
    """Return the files of each camera by its name."""
    names: dict[str, list[str]] = {}
    for first, *others in cameras:
        name, equals, path = first.partition("=")
        if not (equals and name.isidentifier()):
            raise ConfigError(
                f"--camera must begin with NAME=IMAGE, such as left=l1.png: {first!r}"
            )
        if name in names:
            raise ConfigError(f"--camera {name} is given twice")
        names[name] = [path, *others]
    files = dict(zip(names, distinct_inputs(*names.values()), strict=True))
    if len({len(paths) for paths in files.values()}) > 1:
        counts = ", ".join(f"{name} {len(paths)}" for name, paths in files.items())
        raise ConfigError(
            f"--camera: all cameras need the same number of views, but here there are: {counts}"
        )
    return files


def _check(arguments: argparse.Namespace, files: Mapping[str, list[Path]]) -> None:
    if arguments.images or arguments.left or arguments.right:
        raise ConfigError("--camera cannot be combined with IMAGE, --left and --right")
    if arguments.split or arguments.mirror or arguments.region:
        raise ConfigError("--split, --mirror and --region cannot be combined with --camera")
    check_cameras(arguments.out)
    if arguments.corners is not None:
        check_corners(arguments.corners)
    check_suffix("--picture", arguments.picture, ".png")
    outputs = arguments.out, arguments.corners, arguments.picture
    check_files(itertools.chain(*files.values()), outputs)


def _board(
    path: Path,
    name: str,
    sizes: dict[str, tuple[int, int]],
    first: Grid | None,
    arguments: argparse.Namespace,
    device: Device,
) -> Grid:
    """Return the board in a view, numbered like the first one of this moment."""
    image = media.read_image(path)
    size = (image.shape[1], image.shape[0])
    if sizes.get(name, size) != size:
        raise ImageError(f"it is {size[0]} x {size[1]} px, not {sizes[name][0]} x {sizes[name][1]}")
    grid = find_board(image, arguments.board, full_scale=arguments.full_scale, device=device)
    sizes[name] = size
    return grid if first is None else align_views(first, grid)


def _report(
    found: CamerasCalibration,
    views: Mapping[str, list[Grid | None]],
    files: Mapping[str, list[Path]],
    board: tuple[int, int],
) -> None:
    print("corners used, and RMS reprojection error, px:")
    for name, grids in views.items():
        for path, grid, error in zip(files[name], grids, found.view_errors[name], strict=True):
            if grid is None:
                print(f"  {name}  not seen         {shown(path.name)}")
            elif np.isnan(error):
                print(f"  {name}  {grid.valid.sum():4}  too few  {shown(path.name)}")
            else:
                print(f"  {name}  {grid.valid.sum():4}  {error:.3f}  {shown(path.name)}")
    for name, camera in found.cameras.items():
        counts = [int(seen.valid.sum()) for seen in views[name] if seen is not None]
        left_out = len(counts) * board[0] * board[1] - sum(counts)
        pose = ""
        if name != next(iter(found.cameras)):
            away, angle = np.linalg.norm(camera.T), degrees_of(camera.R)
            pose = f"; {away:.3f} {camera.unit} and {angle:.2f} degrees from the first"
        print(
            f"{name}: {camera.lens.value}, {described(camera.matrix, found.focal_sigma[name])}; "
            f"corners in {found.coverage[name]:.0%} of the image; left out as not detected or "
            f"uncertain: {left_out}{pose}"
        )
    print(f"all views: {found.error:.3f} px")


def with_files(error: MisfitError, names: Mapping[str, Sequence[str]]) -> CalibrationError:
    """Return the error with the files of the views that do not fit; names: by camera and moment."""
    odd = [names[name][moment] for moment, cameras in error.odd.items() for name in cameras]
    files = ", ".join(shown(name) for name in dict.fromkeys(odd))
    return CalibrationError(f"{error}; these views are {files}" if odd else str(error))


def described(matrix: NDArray[np.float64], sigma: float) -> str:
    """Return a camera matrix as text; sigma: of the focal lengths, px."""
    return (
        f"focal lengths {matrix[0, 0]:.1f} and {matrix[1, 1]:.1f} px (+- {sigma:.2g}), centre "
        f"({matrix[0, 2]:.1f}, {matrix[1, 2]:.1f})"
    )


def degrees_of(rotation: NDArray[np.float64]) -> float:
    """Return the angle of a rotation matrix, degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))
