"""`cmp-cl calibrate`: two cameras from views of a rigid board."""

import argparse
import itertools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl import media
from cmp_cl.cli import calibrate_cameras
from cmp_cl.cli.arguments import (
    add_device,
    add_full_scale,
    add_region,
    add_split,
    check_files,
    distinct_inputs,
    grid_shape,
    positive_number,
    regions_in,
    split_of,
    unit_name,
    views_of,
    whole,
)
from cmp_cl.cli.messages import counted, one_line, shown
from cmp_cl.cli.progress import Progress
from cmp_cl.errors import CalibrationError, ConfigError, GridError, ImageError
from cmp_cl.grid import Grid
from cmp_cl.image import GreyImage
from cmp_cl.measure import MAX_SIGMA, Region, find_boards, square_sides
from cmp_cl.opencl.device import select_device
from cmp_cl.space import StereoCalibration, calibrate
from cmp_cl.space.exports import cameras_of, check_cameras, save_cameras
from cmp_cl.space.joint import MisfitError


def add_parser(commands: Any) -> None:
    """Add `calibrate` to the commands of an argparse parser."""
    parser = commands.add_parser(
        "calibrate",
        help="calibrate one, two or more cameras from views of a rigid board",
        description="Finds the corners of a flat, rigid checkerboard in at least three views or "
        "pairs of views, tilted in different directions, calibrates the cameras and the poses "
        "between them, and prints the reprojection error of every view. Corners that were "
        "not detected directly, or whose standard deviation is above --max-sigma, are "
        "left out.",
    )
    parser.add_argument(
        "images",
        nargs="*",
        metavar="IMAGE",
        help="frames, or folders of them, that show both views",
    )
    parser.add_argument("--left", nargs="+", metavar="IMAGE", default=[], help="left views")
    parser.add_argument(
        "--right", nargs="+", metavar="IMAGE", default=[], help="right views, in the same order"
    )
    parser.add_argument(
        "--board",
        metavar="9x6",
        type=grid_shape,
        required=True,
        help="inner corners of the board, either number first",
    )
    parser.add_argument(
        "--square", metavar="LENGTH", type=positive_number, required=True, help="side of a square"
    )
    parser.add_argument(
        "--unit",
        metavar="UNIT",
        type=unit_name,
        default="mm",
        help="unit of --square and of the result; default: mm",
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        required=True,
        help="the calibration to write: .yaml or .yml (OpenCV, for cmp-cl run), .camera_info.yaml "
        "(ROS), or .camchain.yaml (Kalibr)",
    )
    add_split(
        parser,
        help_="where the views are in a frame that shows both: halves (the default), or "
        "X,Y,WIDTH,HEIGHT:X,Y,WIDTH,HEIGHT, left and right, px",
    )
    add_region(
        parser,
        help_="which of several patterns to use: X,Y,WIDTH,HEIGHT:X,Y,WIDTH,HEIGHT, px, in "
        "the left and in the right view of the frame, or in left and in right images; corners "
        "outside are left out in all of them",
    )
    parser.add_argument(
        "--max-sigma",
        metavar="PX",
        type=positive_number,
        default=MAX_SIGMA,
        help=f"use only corners with at most this standard deviation; default: {MAX_SIGMA:g} px",
    )
    parser.add_argument(
        "--free-board",
        action="store_true",
        help="find the nodes of the board too, for a print that is bent or not exact; at least "
        "four pairs of views, of a board whose rows and columns add up to an odd number, such as "
        "9x6",
    )
    calibrate_cameras.add_arguments(parser)
    add_full_scale(parser)
    add_device(parser)
    parser.set_defaults(run=run)


class _Pair(NamedTuple):
    """The two views of one moment. name: as messages call it. regions: where the board is."""

    name: str
    left: GreyImage
    right: GreyImage
    regions: tuple[Region | None, ...]


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    if arguments.camera:
        _check_free_board(arguments)
        return calibrate_cameras.run(arguments)
    _check(arguments)
    names = _names(arguments)
    check_files(itertools.chain(*names), [arguments.out])
    device = select_device(arguments.device)
    views: list[tuple[Grid, Grid]] = []
    used: list[str] = []
    size: tuple[int, ...] | None = None
    with Progress(len(names), "views") as progress:
        for name in names:
            try:
                pair = _read(name, arguments)
                if size is not None and pair.left.shape != size:
                    raise ImageError(
                        f"its views have the shape {pair.left.shape}, the others {size}"
                    )
                grids = find_boards(
                    (pair.left, pair.right),
                    arguments.board,
                    max_sigma=arguments.max_sigma,
                    full_scale=arguments.full_scale,
                    regions=pair.regions,
                    device=device,
                )
                size = pair.left.shape
            except (GridError, ImageError) as error:
                progress.say(f"cmp-cl: left out {name[0]}: {one_line(error)}", sys.stderr)
            else:
                views.append(grids)
                used.append(pair.name)
            progress.step()
    if size is None:
        hint = ""
        if not arguments.left:
            hint = (
                "; IMAGE is a frame that shows both views side by side: for the views of one "
                "camera give --camera NAME=IMAGE..., for those of two --left and --right"
            )
        raise CalibrationError(f"no view shows the board ({len(names)} given){hint}")
    try:
        found = calibrate(
            views,
            spacing=arguments.square,
            image_size=(size[1], size[0]),
            unit=arguments.unit,
            free_board=arguments.free_board,
        )
    except MisfitError as error:
        raise calibrate_cameras.with_files(error, {"left": used, "right": used}) from error
    if check_cameras(arguments.out) in (".yaml", ".yml"):
        found.rig.save(arguments.out)
    else:
        save_cameras(arguments.out, cameras_of(found.rig, (size[1], size[0])))
    _report(found, views, used, arguments)
    print(f"wrote {shown(arguments.out)}: {counted(len(views), 'view')} on {device}")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    if bool(arguments.images) == bool(arguments.left or arguments.right):
        raise ConfigError("give frames that show both views, or --left and --right")
    if bool(arguments.left) != bool(arguments.right):
        raise ConfigError(
            "--left and --right need each other; --camera NAME=IMAGE... calibrates one camera"
        )
    if len(arguments.left) != len(arguments.right):
        raise ConfigError(
            f"{counted(len(arguments.left), 'left view')} and "
            f"{counted(len(arguments.right), 'right view')} do not form pairs"
        )
    if arguments.left and (arguments.split or arguments.mirror):
        raise ConfigError("--split and --mirror are for frames that show both views")
    if arguments.corners or arguments.picture or arguments.lens != "pinhole":
        raise ConfigError("--corners, --picture and --lens need --camera NAME=IMAGE...")
    _check_free_board(arguments)
    check_cameras(arguments.out)


def _check_free_board(arguments: argparse.Namespace) -> None:
    if arguments.free_board and arguments.camera:
        raise ConfigError("--free-board is for pairs of views, not for --camera")
    if arguments.free_board and sum(arguments.board) % 2 == 0:
        rows, columns = arguments.board
        raise ConfigError(
            f"--free-board: a board of {rows} x {columns} corners looks the same after half a "
            "turn, so that its nodes cannot be told apart; one such as 9x6 is needed"
        )


def _names(arguments: argparse.Namespace) -> list[tuple[Path, ...]]:
    """Return the file or the two files of each pair of views."""
    groups = (arguments.left, arguments.right) if arguments.left else (arguments.images,)
    return list(zip(*distinct_inputs(*groups), strict=True))


def _read(paths: tuple[Path, ...], arguments: argparse.Namespace) -> _Pair:
    name = ", ".join(shown(path.name) for path in paths)
    images = [media.read_image(path) for path in paths]
    if len(images) == 2:
        left, right = images
        regions = regions_in(arguments.region, whole(left), whole(right))
    else:
        split = split_of(arguments.split or "halves", arguments.mirror, images[0].shape)
        left, right = split(images[0])
        regions = regions_in(arguments.region, *views_of(split))
    if left.shape != right.shape:
        raise ImageError(f"the two views are {left.shape} and {right.shape}, not of one size")
    return _Pair(name, left, right, regions)


def _report(
    found: StereoCalibration,
    views: Sequence[tuple[Grid, Grid]],
    names: Sequence[str],
    arguments: argparse.Namespace,
) -> None:
    print("corners used in the left and right view, and RMS reprojection errors, px:")
    for (left, right), errors, name in zip(views, found.view_errors, names, strict=True):
        print(
            f"  {left.valid.sum():4} {right.valid.sum():4}  {errors[0]:.3f} {errors[1]:.3f}  {name}"
        )
    everything = len(views) * arguments.board[0] * arguments.board[1]
    kept = [sum(int(grid.valid.sum()) for grid in side) for side in zip(*views, strict=True)]
    print(
        f"all views: {found.error:.3f} px (left alone {found.left.error:.3f}, right alone "
        f"{found.right.error:.3f}); left out as not detected or uncertain: {everything - kept[0]} "
        f"and {everything - kept[1]} of {everything} corners"
    )
    rig, unit = found.rig, arguments.unit
    for name, matrix, camera in (("left", rig.K1, found.left), ("right", rig.K2, found.right)):
        print(f"{name}: {calibrate_cameras.described(matrix, camera.focal_sigma)}")
    angle = calibrate_cameras.degrees_of(rig.R)
    if found.board is not None:
        _report_board(found.board, arguments)
    sides = np.concatenate([square_sides(rig.triangulate(*pair)) for pair in views])
    print(
        f"between the cameras: {np.linalg.norm(rig.T):.3f} {unit}, {angle:.2f} degrees; the "
        f"squares measure {sides.mean():.3f} {unit} with a standard deviation of {sides.std():.3f}"
    )


def _report_board(board: NDArray[np.float64], arguments: argparse.Namespace) -> None:
    """Print by how much the nodes of a free board lie off those of a flat and exact one."""
    row, column = np.indices(board.shape[:2])
    off = board - arguments.square * np.stack([column, row, np.zeros(row.shape)], axis=-1)
    inside, height = np.linalg.norm(off[..., :2], axis=2), np.abs(off[..., 2])
    print(
        f"the board: its nodes lie up to {np.nanmax(height):.3f} {arguments.unit} off its plane "
        f"({np.sqrt(np.nanmean(height**2)):.3f} RMS), and up to {np.nanmax(inside):.3f} off their "
        f"nominal positions in it ({np.sqrt(np.nanmean(inside**2)):.3f} RMS)"
    )
