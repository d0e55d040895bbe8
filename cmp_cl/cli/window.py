"""The options of `cmp-cl calibrate` for a window, and the window from a pattern seen through it."""

import argparse
import itertools
from pathlib import Path

import numpy as np

from cmp_cl.cli.arguments import add, grid_shape, positive_number, views_of
from cmp_cl.cli.messages import one_line, shown
from cmp_cl.errors import CalibrationError, ConfigError, GridError
from cmp_cl.grid import Grid, align
from cmp_cl.measure import find_pattern
from cmp_cl.measure.patterns import align_views
from cmp_cl.opencl.device import Device
from cmp_cl.points import sides
from cmp_cl.space import StereoRig, calibrate_window

# Share by which the thickness of the last medium may differ from the given one without advice.
_THICKNESS = 0.1


def add_window(parser: argparse.ArgumentParser) -> None:
    """Add the options of a window."""
    group = parser.add_argument_group(
        "a window: two cameras that see the pattern through flat layers, such as acrylic and gel"
    )
    what = (
        "thickness, mm, and refractive index of each layer, from the cameras to the pattern, as in "
        "5:1.49,20:1.41; the last one holds it. The views of the board are in air"
    )
    add(group, "--window LENGTH:INDEX,...", what, type=media)
    what = (
        "the pattern at rest, seen through the window: an image of each camera, or one that shows "
        "both views"
    )
    add(group, "--rest IMAGE", what, nargs="+")
    add(group, "--grid 40x40", "rows and columns of its corners", type=grid_shape)
    add(group, "--pitch LENGTH", "side of its squares, mm", type=positive_number)
    what = (
        "the pattern when a flat punch has moved by a known length, as in --step 1.0 step.png; the "
        "index of the last layer, known to 0.01 without it, is then measured too"
    )
    add(group, "--step LENGTH IMAGE", what, nargs="+")


def media(text: str) -> tuple[tuple[float, float], ...]:
    """Parse thickness and index of each layer from a text such as 5:1.49,20:1.41; raises
    ArgumentTypeError."""
    try:
        pairs = [tuple(map(float, layer.split(":"))) for layer in text.split(",")]
        return tuple((thickness, index) for thickness, index in pairs)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not LENGTH:INDEX of each layer, such as 5:1.49,20:1.41"
        ) from None


def window_files(arguments: argparse.Namespace) -> list[Path]:
    """Return the images of the window's options; raises ConfigError if these do not fit
    together."""
    needed = {"--rest": arguments.rest, "--grid": arguments.grid, "--pitch": arguments.pitch}
    given = [name for name, value in needed.items() if value is not None]
    if arguments.window is None:
        given += ["--step"] if arguments.step else []
        if given:
            raise ConfigError(f"{given[0]} needs --window LENGTH:INDEX,...: what the layers are")
        return []
    if len(given) < len(needed):
        missing = ", ".join(name for name in needed if name not in given)
        raise ConfigError(
            f"--window needs --rest IMAGE, --grid 40x40 and --pitch LENGTH: {missing}"
        )
    images = [arguments.rest]
    if arguments.step:
        length, *views = arguments.step
        try:
            positive_number(length)
        except argparse.ArgumentTypeError as error:
            raise ConfigError(f"--step LENGTH IMAGE: {error}") from error
        images.append(views)
    count = 1 if arguments.stereo else 2
    if any(len(views) != count for views in images):
        raise ConfigError(
            f"--rest and --step need {count} image{'s' if count > 1 else ''} each: "
            + ("one that shows both views" if arguments.stereo else "of the left and right camera")
        )
    return [Path(path) for path in itertools.chain(*images)]


def through_window(rig: StereoRig, arguments: argparse.Namespace, device: Device) -> StereoRig:
    """Return a rig with the window of the options. device: that finds the corners.

    Raises CalibrationError if a view does not show the pattern, or the views do not fix the window.
    """

    def seen(paths: list[str]) -> list[Grid]:
        grids = []
        for path in paths:
            for view in views_of(path, arguments):
                try:
                    _, grid = find_pattern(
                        view,
                        shape=arguments.grid,
                        full_scale=arguments.full_scale,
                        device=device,
                    )
                except GridError as error:
                    raise CalibrationError(f"{shown(path)}: {one_line(error)}") from error
                grids.append(grid)
        return grids

    left, right = seen(arguments.rest)
    rest = left, align_views(left, right, rig.R)
    stepped = None
    if arguments.step:
        length, *paths = arguments.step
        left, right = (align([still, now])[1] for still, now in zip(rest, seen(paths), strict=True))
        stepped = float(length), left, right
    found = calibrate_window(
        rig, rest, pitch=arguments.pitch, media=arguments.window, stepped=stepped
    )
    _report(found, rest, arguments)
    return found


def _report(rig: StereoRig, rest: tuple[Grid, Grid], arguments: argparse.Namespace) -> None:
    window, covariance = rig.window, rig.covariance
    assert window is not None
    assert covariance is not None
    tilt, other, distance, index = np.sqrt(np.diag(covariance)[-4:])
    points = rig.triangulate(*rest)
    behind = points.xyz[points.valid] @ window.normal - window.distance - window.thickness
    lengths = sides(points.xyz)
    normal = ", ".join(f"{each:.4f}" for each in window.normal)
    print(
        f"window: normal ({normal}) (+- {np.degrees(max(tilt, other)):.2g} degrees), "
        f"{window.distance:.3f} {rig.unit} (+- {distance:.2g}) from the left camera"
        f", index behind it {window.index:.4f} (+- {index:.2g}"
        + ("" if arguments.step else "; --step measures it")
        + ")"
    )
    print(
        f"the pattern at rest lies {behind.mean():.3f} {rig.unit} deep in the last layer; "
        f"its squares measure {lengths.mean():.4f} with a standard deviation "
        f"of {lengths.std():.4f}"
    )
    thickness = arguments.window[-1][0]
    if abs(behind.mean() - thickness) > _THICKNESS * thickness:
        print(
            f"advice: the last layer of --window is {thickness:g} thick; if that is certain, an "
            "index or another thickness is wrong"
        )
