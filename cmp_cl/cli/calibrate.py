"""`cmp-cl calibrate`: one, two or more cameras from views of a board."""

import argparse
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cmp_cl import media
from cmp_cl.cli.arguments import (
    add_device,
    add_full_scale,
    add_split,
    check_files,
    check_split,
    check_suffix,
    grid_shape,
    positive_number,
    split_of,
)
from cmp_cl.cli.messages import Progress, counted, one_line, shown, tell
from cmp_cl.cli.window import add_window, through_window, window_files
from cmp_cl.errors import CalibrationError, ConfigError, GridError, ImageError
from cmp_cl.grid import Grid
from cmp_cl.image import GreyImage
from cmp_cl.measure import find_board, trusted
from cmp_cl.opencl.device import select_device
from cmp_cl.points import sides
from cmp_cl.space import Calibration, Lens, MisfitError, calibrate
from cmp_cl.space.calibration.advice import advice
from cmp_cl.space.exports import check_cameras, save_cameras, save_corners
from cmp_cl.viz import save_figure
from cmp_cl.viz.calibration import calibration_figure


def add_parser(commands: Any) -> None:
    """Add `calibrate` to the commands of an argparse parser."""
    parser = commands.add_parser(
        "calibrate",
        help="calibrate one, two or more cameras from views of a board",
        description="Finds the corners of a rigid checkerboard in views of it, at least three, "
        "better ten or more, tilted in different directions and in all parts of the image; "
        "calibrates the camera or cameras and the poses between them; prints the error of every "
        "view and what would make the result better, and draws both beside the calibration, if "
        "matplotlib is installed.",
    )
    cameras = parser.add_argument_group("views: of one camera, or of several at the same moments")
    cameras.add_argument("images", nargs="*", metavar="IMAGE", help="views of one camera")
    cameras.add_argument("--left", nargs="+", metavar="IMAGE", default=[], help="left views")
    cameras.add_argument(
        "--right", nargs="+", metavar="IMAGE", default=[], help="right views, in the same order"
    )
    cameras.add_argument(
        "--stereo", action="store_true", help="each IMAGE shows two views, see --split"
    )
    cameras.add_argument(
        "--camera",
        nargs="+",
        action="append",
        default=[],
        metavar=("NAME=IMAGE", "IMAGE"),
        help="the views of one of several cameras; given again for every other camera",
    )
    board = parser.add_argument_group("the board")
    board.add_argument(
        "--board",
        metavar="9x6",
        type=grid_shape,
        required=True,
        help="inner corners of the board, either number first",
    )
    board.add_argument(
        "--square",
        metavar="LENGTH",
        type=positive_number,
        required=True,
        help="side of a square, mm",
    )
    board.add_argument(
        "--free-board",
        action="store_true",
        help="find the nodes of the board too, for a print that is bent or not exact; at least "
        "four views of a board whose rows and columns add up to an odd number, such as 9x6",
    )
    output = parser.add_argument_group("output")
    output.add_argument(
        "--out",
        metavar="FILE",
        default="calibration.yaml",
        help="the calibration to write: .yaml or .yml (OpenCV, for cmp-cl run), .camera_info.yaml "
        "(ROS), or .camchain.yaml (Kalibr); default: calibration.yaml",
    )
    output.add_argument("--corners", metavar="VNL", help="write the corners too, for mrcal")
    add_window(parser)
    rare = parser.add_argument_group("rarely needed")
    rare.add_argument(
        "--lens",
        choices=[lens.value for lens in Lens],
        default=Lens.PINHOLE.value,
        help="model of the lenses; default: pinhole; rational and fisheye are for wide ones",
    )
    add_split(rare)
    add_full_scale(rare)
    add_device(rare)
    parser.set_defaults(run=run)


class _Found(NamedTuple):
    """The boards that were found: by camera, at every moment. left_out: a line for each other."""

    grids: dict[str, list[Grid | None]]
    sizes: dict[str, tuple[int, int]]
    left_out: list[str]


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    files = _files(arguments)
    picture = Path(arguments.out).with_name(f"{Path(arguments.out).name.split('.')[0]}.png")
    _check(arguments, files, picture)
    device = select_device(arguments.device)
    boards = _boards(arguments, files, device)
    try:
        found = calibrate(
            boards.grids,
            spacing=arguments.square,
            sizes=boards.sizes,
            lens=Lens(arguments.lens),
            free_board=arguments.free_board,
        )
    except CalibrationError as error:
        raise CalibrationError(_explained(error, files, boards.left_out)) from error
    for line in boards.left_out:
        tell(f"left out {line}")
    window, covariance = None, found.covariance
    if arguments.window is not None:
        rig = through_window(
            found.rig(), arguments, lambda path, side: _view(path, side, arguments), device
        )
        window, covariance = rig.window, rig.covariance
    written = save_cameras(arguments.out, found.cameras, covariance=covariance, window=window)
    if arguments.corners is not None:
        pictures = itertools.chain.from_iterable(
            zip(map(str, files[name]), boards.grids[name], strict=True) for name in files
        )
        save_corners(arguments.corners, dict(pictures))
        written.append(Path(arguments.corners))
    try:
        save_figure(picture, calibration_figure(found, _names(files)))
        written.append(picture)
    except ConfigError as error:  # matplotlib is not installed
        tell(f"no picture: {one_line(error)}")
    _report(found, files, arguments)
    print(f"wrote {', '.join(map(shown, written))}; corners found on {device}")
    return 0


def _files(arguments: argparse.Namespace) -> dict[str, list[Path]]:
    """Return the files of each camera by its name; raises ConfigError if they are not of one form.

    A file that shows two views is named for both.
    """
    forms = [arguments.images, arguments.left or arguments.right, arguments.camera]
    if sum(map(bool, forms)) != 1:
        raise ConfigError(
            "give IMAGE... for one camera, --left IMAGE... --right IMAGE... for two, or --camera "
            "NAME=IMAGE... for each of several"
        )
    if arguments.images:
        files = media.find_inputs(arguments.images)
        return {"left": files, "right": files} if arguments.stereo else {"camera": files}
    if arguments.stereo:
        raise ConfigError("--stereo is for IMAGE..., each of which shows two views")
    names = {"left": arguments.left, "right": arguments.right}
    if arguments.camera:
        names = {}
        for first, *others in arguments.camera:
            name, equals, path = first.partition("=")
            if not (equals and name.isidentifier()):
                raise ConfigError(
                    f"--camera must begin with NAME=IMAGE, as in left=l1.png: {first!r}"
                )
            if name in names:
                raise ConfigError(f"--camera {name} is given twice; give all its views at once")
            names[name] = [path, *others]
    elif not (arguments.left and arguments.right):
        raise ConfigError("--left and --right need each other; for one camera give IMAGE... alone")
    found = {name: media.find_inputs(paths) for name, paths in names.items()}
    if len({len(paths) for paths in found.values()}) > 1:
        counts = " and ".join(f"{len(paths)} of {name}" for name, paths in found.items())
        raise ConfigError(f"each camera needs a view of each moment, but there are {counts}")
    return found


def _names(files: Mapping[str, list[Path]]) -> dict[str, list[str]]:
    """Return how messages and pictures call each view, by camera."""
    return {name: [shown(path.name) for path in paths] for name, paths in files.items()}


def _check(arguments: argparse.Namespace, files: Mapping[str, list[Path]], picture: Path) -> None:
    check_split(arguments, both=arguments.stereo)
    if arguments.free_board and sum(arguments.board) % 2 == 0:
        rows, columns = arguments.board
        raise ConfigError(
            f"--free-board: a board of {rows} x {columns} corners looks the same after half a "
            "turn, so that its nodes cannot be told apart; one such as 9x6 is needed"
        )
    if check_cameras(arguments.out) not in (".yaml", ".yml") and arguments.window is not None:
        raise ConfigError(f"--window needs a calibration in .yaml: {shown(arguments.out)}")
    check_suffix("--corners", arguments.corners, ".vnl")
    outputs = arguments.out, arguments.corners, picture
    inputs = *itertools.chain(*files.values()), *window_files(arguments, list(files))
    check_files(inputs, outputs)


def _boards(arguments: argparse.Namespace, files: Mapping[str, list[Path]], device: Any) -> _Found:
    """Find the boards in all views; raises CalibrationError if a camera sees none."""
    found = _Found({name: [] for name in files}, {}, [])
    moments = list(zip(*files.values(), strict=True))
    with Progress(len(moments), "views") as progress:
        for paths in moments:
            for side, (name, path) in enumerate(zip(files, paths, strict=True)):
                grid = None
                try:
                    image = _view(path, side, arguments)
                    size = (image.shape[1], image.shape[0])
                    if found.sizes.get(name, size) != size:
                        raise ImageError(f"it has {size} px, earlier views {found.sizes[name]}")
                    board = find_board(
                        image, arguments.board, full_scale=arguments.full_scale, device=device
                    )
                    grid, found.sizes[name] = trusted(board, device=device), size
                except (GridError, ImageError) as error:
                    which = f" ({name})" if arguments.stereo else ""
                    found.left_out.append(f"{shown(path)}{which}: {one_line(error)}")
                found.grids[name].append(grid)
            progress.step()
    for name in files:
        if name not in found.sizes:
            raise CalibrationError(_unseen(name, files, found.left_out, arguments))
    return found


def _view(path: Path, side: int, arguments: argparse.Namespace) -> GreyImage:
    """Return the view of a camera in a file; side: its number among the cameras."""
    image = media.read_image(path)
    return split_of(arguments, image.shape)(image)[side] if arguments.stereo else image


def _unseen(
    name: str,
    files: Mapping[str, list[Path]],
    left_out: Sequence[str],
    arguments: argparse.Namespace,
) -> str:
    """Return why a camera sees no board, and what to type instead."""
    rows, columns = arguments.board
    of = f" of {name}" if len(files) > 1 else ""
    hint = "--board counts the inner corners, one less than the squares along each side"
    if arguments.stereo:
        hint += "; without --stereo each IMAGE is one view"
    elif arguments.images:
        hint += "; frames that show two views side by side need --stereo"
    return (
        f"no view{of} shows a board of {rows} x {columns} corners ({len(files[name])} given); "
        f"{left_out[0]}; {hint}"
    )


def _explained(
    error: CalibrationError, files: Mapping[str, list[Path]], left_out: Sequence[str]
) -> str:
    """Return the message of an error with the names of the views that it is about."""
    text = str(error)
    if isinstance(error, MisfitError) and error.odd:
        odd = [files[name][moment].name for moment in error.odd for name in files]
        text += f"; these are {', '.join(map(shown, dict.fromkeys(odd)))}"
    if left_out:
        text += f"; {counted(len(left_out), 'view')} left out, the first {left_out[0]}"
    return text


def _report(
    found: Calibration, files: Mapping[str, list[Path]], arguments: argparse.Namespace
) -> None:
    first = {moment: group[0] for group in found.alike for moment in group[1:]}
    print("corners used and RMS reprojection error, px:")
    for name, paths in files.items():
        for moment, path in enumerate(paths):
            grid, error = found.grids[name][moment], found.view_errors[name][moment]
            said = "   -  left out"
            if grid is not None:
                said = f"{grid.valid.sum():4}  {error:.3f}   "
            elif moment in first:
                said = f"   -  like {shown(paths[first[moment]].name)}"
            print(f"  {name}  {said}  {shown(path.name)}")
    for name, camera in found.cameras.items():
        matrix = camera.matrix
        pose = ""
        if camera.T.any():
            angle = np.degrees(np.arccos(np.clip((np.trace(camera.R) - 1) / 2, -1, 1)))
            pose = (
                f"; {np.linalg.norm(camera.T):.3f} {camera.unit} and {angle:.2f} degrees from "
                f"{next(iter(found.cameras))}"
            )
        print(
            f"{name}: {camera.lens.value}, focal lengths {matrix[0, 0]:.1f} and {matrix[1, 1]:.1f} "
            f"px (+- {found.focal_sigma[name]:.2g}), centre ({matrix[0, 2]:.1f}, "
            f"{matrix[1, 2]:.1f}){pose}"
        )
    print(f"all views: {found.error:.3f} px")
    if len(files) == 2 and arguments.lens != Lens.FISHEYE.value:
        rig = found.rig()
        pairs = [pair for pair in zip(*found.grids.values(), strict=True) if None not in pair]
        lengths = np.concatenate([sides(rig.triangulate(*pair).xyz) for pair in pairs])
        print(
            f"the squares measure {lengths.mean():.3f} {rig.unit} with a standard deviation of "
            f"{lengths.std():.3f}"
        )
    if found.board is not None:
        _report_board(found, arguments)
    for line in advice(found, _names(files)):
        print(f"advice: {line}")


def _report_board(found: Calibration, arguments: argparse.Namespace) -> None:
    """Print by how much the nodes of a free board lie off those of a flat and exact one."""
    board = found.board
    assert board is not None
    row, column = np.indices(board.shape[:2])
    off = board - arguments.square * np.stack([column, row, np.zeros(row.shape)], axis=-1)
    off -= np.nanmean(off, axis=(0, 1))
    inside, height = np.linalg.norm(off[..., :2], axis=2), np.abs(off[..., 2])
    print(
        f"the board: its nodes lie up to {np.nanmax(height):.3f} mm off its plane "
        f"({np.sqrt(np.nanmean(height**2)):.3f} RMS), and up to {np.nanmax(inside):.3f} off their "
        f"nominal places in it ({np.sqrt(np.nanmean(inside**2)):.3f} RMS)"
    )
