"""`cmp-cl calibrate`: calibrate one, two or more cameras from views of a board."""

import argparse
import itertools
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cmp_cl import media
from cmp_cl.cli.arguments import (
    add,
    add_device,
    add_full_scale,
    add_split,
    check_files,
    check_split,
    check_suffix,
    grid_shape,
    positive_number,
    views_of,
)
from cmp_cl.cli.messages import one_line, shown, tell
from cmp_cl.cli.window import add_window, through_window, window_files
from cmp_cl.errors import CalibrationError, ConfigError, GridError, ImageError
from cmp_cl.grid import Grid
from cmp_cl.image import GreyImage
from cmp_cl.measure import find_board
from cmp_cl.opencl.device import Device, select_device
from cmp_cl.points import sides
from cmp_cl.space import Calibration, Lens, calibrate
from cmp_cl.space.calibration.advice import advice
from cmp_cl.space.exports import check_cameras, save_cameras, save_corners
from cmp_cl.viz import save_figure
from cmp_cl.viz.calibration import calibration_figure

DESCRIPTION = """\
Finds the corners of a rigid checkerboard in views of it, at least three, better ten or more,
tilted in different directions and in all parts of the image; calibrates the camera or cameras and
the poses between them; prints the error of every view and what would make the result better, and
draws beside the calibration where boards were seen, if matplotlib is installed.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("views: of one camera, or of several at the same moments")
    add(group, "images IMAGE", "views of one camera", nargs="*")
    add(group, "--left IMAGE", "left views", nargs="+", default=[])
    add(group, "--right IMAGE", "right views, in the same order", nargs="+", default=[])
    add(group, "--stereo", "each IMAGE shows two views, see --split")
    what = "the views of one of several cameras; given again for every other camera"
    add(group, "--camera NAME=IMAGE IMAGE", what, nargs="+", action="append", default=[])
    group = parser.add_argument_group("the board")
    what = "inner corners of the board, either number first"
    add(group, "--board 9x6", what, type=grid_shape, required=True)
    add(group, "--square LENGTH", "side of a square, mm", type=positive_number, required=True)
    group = parser.add_argument_group("output")
    what = (
        "the calibration to write: .yaml or .yml (OpenCV, for cmp-cl run), .camera_info.yaml "
        "(ROS), or .camchain.yaml (Kalibr); default: calibration.yaml"
    )
    add(group, "--out FILE", what, default="calibration.yaml")
    add(group, "--corners VNL", "write the corners too, for mrcal")
    add_window(parser)
    group = parser.add_argument_group("rarely needed")
    what = "model of the lenses; default: pinhole; rational and fisheye are for wide ones"
    lenses = [lens.value for lens in Lens]
    add(group, "--lens", what, choices=lenses, default=Lens.PINHOLE.value)
    add_split(group)
    add_full_scale(group)
    add_device(group)


def run(arguments: argparse.Namespace) -> int:
    files = _files(arguments)
    out = Path(arguments.out)
    picture = out.with_name(f"{out.name[: -len(check_cameras(out))]}.png")
    _check(arguments, files, picture)
    device = select_device(arguments.device)
    grids, sizes, left_out = _boards(arguments, files, device)
    for line in left_out:
        tell(f"left out: {line}")
    found = calibrate(grids, spacing=arguments.square, sizes=sizes, lens=Lens(arguments.lens))
    window, covariance = None, found.covariance
    if arguments.window is not None:
        rig = through_window(found.rig(), arguments, device)
        window, covariance = rig.window, rig.covariance
    names = {name: [shown(path.name) for path in paths] for name, paths in files.items()}
    _report(found, names)
    written = save_cameras(out, found.cameras, covariance=covariance, window=window)
    if arguments.corners is not None:
        corners = [zip(map(str, files[name]), grids[name], strict=True) for name in files]
        save_corners(arguments.corners, dict(itertools.chain(*corners)))
        written.append(Path(arguments.corners))
    try:
        save_figure(picture, calibration_figure(found))
        written.append(picture)
    except ConfigError as error:  # matplotlib is not installed
        tell(f"no picture: {one_line(error)}")
    print(f"wrote {', '.join(map(shown, written))}; corners found on {device}")
    return 0


def _files(arguments: argparse.Namespace) -> dict[str, list[Path]]:
    """Return the files of each camera by its name; raises ConfigError if they are not of one form.

    A file that shows two views is named for both.
    """
    forms = [arguments.images, arguments.left, arguments.camera]
    others = arguments.stereo and not arguments.images
    if sum(map(bool, forms)) != 1 or bool(arguments.left) != bool(arguments.right) or others:
        raise ConfigError(
            "give IMAGE... for one camera, with --stereo if each shows two views, --left IMAGE... "
            "--right IMAGE... for two, or --camera NAME=IMAGE... for each of several"
        )
    if arguments.images:
        files = media.find_inputs(arguments.images)
        return {"left": files, "right": files} if arguments.stereo else {"camera": files}
    names = {"left": arguments.left, "right": arguments.right}
    if arguments.camera:
        names = {}
        for first, *others in arguments.camera:
            name, equals, path = first.partition("=")
            if not (equals and name.isidentifier()) or name in names:
                raise ConfigError(
                    f"--camera must begin with NAME=IMAGE, each NAME once, not {first!r}"
                )
            names[name] = [path, *others]
    found = {name: media.find_inputs(paths) for name, paths in names.items()}
    if len({len(paths) for paths in found.values()}) > 1:
        counts = " and ".join(f"{len(paths)} of {name}" for name, paths in found.items())
        raise ConfigError(f"each camera needs a view of each moment, but there are {counts}")
    return found


def _check(arguments: argparse.Namespace, files: Mapping[str, list[Path]], picture: Path) -> None:
    check_split(arguments, both=arguments.stereo)
    if check_cameras(arguments.out) not in (".yaml", ".yml") and arguments.window is not None:
        raise ConfigError(f"--window needs a calibration in .yaml: {shown(arguments.out)}")
    check_suffix("--corners", arguments.corners, ".vnl")
    every = list(itertools.chain(*map(dict.fromkeys, files.values())))
    twice = next((path for path in every if every.count(path) > 1), None)
    if arguments.corners is not None and twice is not None:
        raise ConfigError(
            f"--corners names a view by its file, and {shown(twice)} shows two views; give a file "
            "for each view"
        )
    outputs = arguments.out, arguments.corners, picture
    inputs = *every, *window_files(arguments)
    check_files(inputs, outputs)


def _boards(
    arguments: argparse.Namespace, files: Mapping[str, list[Path]], device: Device
) -> tuple[dict[str, list[Grid | None]], dict[str, tuple[int, int]], list[str]]:
    """Return the boards in all views, the sizes of the images, and a line for each view without
    one; raises CalibrationError if a camera sees none."""
    grids: dict[str, list[Grid | None]] = {name: [] for name in files}
    sizes: dict[str, tuple[int, int]] = {}
    left_out: list[tuple[str, str]] = []  # the camera, and why
    for paths in zip(*files.values(), strict=True):
        read: dict[Path, tuple[GreyImage, ...]] = {}  # a file with two views is read once
        for side, (name, path) in enumerate(zip(files, paths, strict=True)):
            grid = None
            try:
                if path not in read:
                    read[path] = views_of(path, arguments)
                image = read[path][side if arguments.stereo else 0]
                size = (image.shape[1], image.shape[0])
                if sizes.get(name, size) != size:
                    raise GridError(
                        "it has {} x {} px, earlier views {} x {}".format(*size, *sizes[name])
                    )
                grid = find_board(
                    image, arguments.board, full_scale=arguments.full_scale, device=device
                )
                sizes[name] = size
            except ImageError as error:  # of a file, which may show two views
                left_out.append((name, one_line(error)))
            except GridError as error:
                which = f" ({name})" if arguments.stereo else ""
                left_out.append((name, f"{shown(path)}{which}: {one_line(error)}"))
            grids[name].append(grid)
    for name in files:
        if name not in sizes:
            rows, columns = arguments.board
            why = dict(reversed(left_out))[name]  # its first view's
            raise CalibrationError(
                f"no view of {name} shows a board of {rows} x {columns} corners; {why}; "
                "--board counts the inner corners, one less than the squares along each side, and "
                "--stereo is for images that show two views"
            )
    return grids, sizes, list(dict.fromkeys(line for _, line in left_out))


def _report(found: Calibration, names: Mapping[str, list[str]]) -> None:
    """Print what was found. names: of the views, by camera."""
    like = {moment: group[0] for group in found.alike for moment in group[1:]}
    print("corners used and RMS reprojection error, px:")
    for name, views in names.items():
        for moment, view in enumerate(views):
            grid, error = found.grids[name][moment], found.view_errors[name][moment]
            said = "   -  left out"
            if grid is not None:
                said = f"{grid.valid.sum():4}  {error:.3f}   "
            elif moment in like:
                said = f"   -  like {views[like[moment]]}"
            print(f"  {name}  {said}  {view}")
    for name, camera in found.cameras.items():
        matrix = camera.matrix
        pose = ""
        if camera.T.any():
            angle = np.degrees(np.arccos(np.clip((np.trace(camera.R) - 1) / 2, -1, 1)))
            pose = (
                f"; {np.linalg.norm(camera.T):.3f} mm and {angle:.2f} degrees from "
                f"{next(iter(found.cameras))}"
            )
        print(
            f"{name}: {camera.lens.value}, focal lengths {matrix[0, 0]:.1f} and {matrix[1, 1]:.1f} "
            f"px (+- {found.focal_sigma[name]:.2g}), centre ({matrix[0, 2]:.1f}, "
            f"{matrix[1, 2]:.1f}){pose}"
        )
    print(f"all views: {found.error:.3f} px")
    if np.isfinite(found.flatness):
        print(f"the board is flat to {found.flatness:.3g} mm")
    if len(names) == 2 and all(each.lens is not Lens.FISHEYE for each in found.cameras.values()):
        rig = found.rig()
        pairs = [pair for pair in zip(*found.grids.values(), strict=True) if None not in pair]
        lengths = np.concatenate([sides(rig.triangulate(*pair).xyz) for pair in pairs])
        print(
            f"the squares measure {lengths.mean():.3f} {rig.unit} with a standard deviation of "
            f"{lengths.std():.3f}"
        )
    for line in advice(found, names):
        print(f"advice: {line}")
