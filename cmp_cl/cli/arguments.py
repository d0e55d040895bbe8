"""Arguments that commands share, and the views and regions of a frame that follow from them."""

import argparse
import contextlib
import itertools
import math
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from cmp_cl import media
from cmp_cl.cli.messages import shown
from cmp_cl.errors import ConfigError
from cmp_cl.files import check_target
from cmp_cl.grid.limits import MOST_NODES
from cmp_cl.image import GreyImage
from cmp_cl.measure import Region
from cmp_cl.space import BinocularSplit

_BOX = r"\d+,\d+,\d+,\d+"

Box = tuple[int, int, int, int]  # x, y, width, height, px
View = tuple[Box, bool]  # its rectangle in the frame, and whether it is mirrored


def check_files(inputs: Iterable[str | Path | None], outputs: Iterable[str | Path | None]) -> None:
    """Raise ConfigError if an output is an input, or two outputs are one file.

    None stands for a file that was not requested. Devices and pipes may be named twice. Raises
    OSError if an output cannot be written.
    """
    read = {os.path.realpath(path) for path in inputs if path is not None}
    written = set()
    for path in outputs:
        if path is None:
            continue
        real = os.path.realpath(path)
        if os.path.isfile(path) or not os.path.exists(path):
            if real in read:
                raise ConfigError(
                    f"{shown(path)} is an input and would be overwritten; give another name"
                )
            if real in written:
                raise ConfigError(f"{shown(path)} is given for two outputs")
            written.add(real)
        check_target(path)


def check_suffix(option: str, path: str | None, *suffixes: str) -> None:
    """Raise ConfigError if the path of an option has another suffix; None was not requested."""
    if path is not None and Path(path).suffix.lower() not in suffixes:
        *others, last = suffixes
        endings = f"{', '.join(others)} or {last}" if others else last
        raise ConfigError(f"{option} {shown(path)} must end in {endings}")


def unit_name(text: str) -> str:
    """Return the name of a unit; raises ArgumentTypeError if the text is none."""
    if not text.strip() or not text.isprintable():
        raise argparse.ArgumentTypeError(f"{text!r} is not a unit such as mm")
    return text


def distinct_inputs(*groups: Sequence[str]) -> list[list[Path]]:
    """Return the files of each group, as `media.find_inputs` does.

    Raises ConfigError if a file is given twice.

    A view that counts twice makes a calibration look more certain than it is.
    """
    found = [media.find_inputs(names) for names in groups]
    read = set()
    for path in itertools.chain.from_iterable(found):
        real = os.path.realpath(path)
        if real in read:
            raise ConfigError(f"{shown(path)} is given twice")
        read.add(real)
    return found


def add_device(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--device",
        metavar="NAME",
        help="part of the name of a device or platform, an index such as 0:0, or gpu or cpu; "
        "default: the variable CMP_CL_DEVICE, else the first GPU, else the first CPU",
    )


def add_full_scale(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--full-scale",
        metavar="LEVEL",
        type=int,
        help="largest grey level of the camera, for example 4095 for 12 bits in a 16-bit file; "
        "default: from the settings, else 255 or 65535",
    )


def add_split(parser: argparse._ActionsContainer, *, help_: str) -> None:
    parser.add_argument("--split", metavar="WHERE", help=help_)
    parser.add_argument(
        "--mirror",
        choices=("left", "right", "both"),
        help="the views that are seen through an odd number of mirrors, and so reversed",
    )


def add_region(parser: argparse._ActionsContainer, *, help_: str) -> None:
    parser.add_argument("--region", metavar="WHERE", type=boxes, help=help_)


def positive_number(text: str) -> float:
    """Parse a finite number above 0; raises ArgumentTypeError."""
    with contextlib.suppress(ValueError):
        if 0 < float(text) < math.inf:
            return float(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not a positive number such as 2.5")


def grid_shape(text: str) -> tuple[int, int]:
    """Parse rows and columns from a text such as 40x40; raises ArgumentTypeError."""
    match = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text)
    if match is None or min(int(match[1]), int(match[2])) < 2:
        raise argparse.ArgumentTypeError(f"{text!r} is not a pair of counts such as 40x40")
    rows, columns = int(match[1]), int(match[2])
    if rows * columns > MOST_NODES:
        raise argparse.ArgumentTypeError(f"{text!r} is more than {MOST_NODES} nodes")
    return rows, columns


def boxes(text: str) -> tuple[Box, ...]:
    """Parse one or two rectangles from a text such as 0,0,320,480 or 0,0,320,480:400,0,320,480.

    Raises ArgumentTypeError.
    """
    numbers = [tuple(map(int, re.findall(r"\d+", box))) for box in text.split(":")]
    if not re.fullmatch(f"{_BOX}(:{_BOX})?", text) or min(min(box[2:]) for box in numbers) < 1:
        raise argparse.ArgumentTypeError(
            f"{text!r} is neither a rectangle X,Y,WIDTH,HEIGHT in px nor two of them with a colon "
            "between"
        )
    return tuple((x, y, width, height) for x, y, width, height in numbers)


def regions_in(chosen: Sequence[Box] | None, *views: View) -> tuple[Region | None, ...]:
    """Return the region that --region chooses in each view; all are None without the option.

    Raises ConfigError if there are not as many rectangles as views, or one lies outside.
    """
    if chosen is None:
        return (None,) * len(views)
    if len(chosen) != len(views):
        raise ConfigError(
            f"--region needs one rectangle per view, separated by a colon: {len(views)} here, not "
            f"{len(chosen)}"
        )
    return tuple(map(_region_in, views, chosen))


def _region_in(seen: View, box: Box) -> Region:
    """Map a rectangle from the frame to a view that was cut from it."""
    (x, y, width, height), mirrored = seen
    x0, y0 = box[0] - x, box[1] - y
    x1, y1 = x0 + box[2], y0 + box[3]
    if not (x1 > 0 and y1 > 0 and x0 < width and y0 < height):
        raise ConfigError(
            f"--region {','.join(map(str, box))} lies outside the view, which is "
            f"{x},{y},{width},{height} of the frame (X,Y,WIDTH,HEIGHT)"
        )
    if mirrored:
        x0, x1 = width - x1, width - x0
    return x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5


def whole(image: GreyImage) -> View:
    """Return the view that covers the whole frame."""
    return (0, 0, image.shape[1], image.shape[0]), False


def views_of(split: BinocularSplit) -> tuple[View, View]:
    """Return the left and the right view of a split."""
    return (split.left, split.mirror_left), (split.right, split.mirror_right)


def split_of(where: str, mirror: str | None, shape: tuple[int, ...]) -> BinocularSplit:
    """Return the split that --split and --mirror describe, for frames of that shape.

    Raises ConfigError for a text that is neither halves nor two rectangles.
    """
    mirrored = mirror in ("left", "both"), mirror in ("right", "both")
    if where == "halves":
        halves = BinocularSplit.halves(shape[1], shape[0])
        return BinocularSplit(halves.left, halves.right, *mirrored)
    try:
        left, right = boxes(where)
    except (argparse.ArgumentTypeError, ValueError) as error:
        raise ConfigError(
            f"--split {where!r} is neither halves nor two rectangles X,Y,WIDTH,HEIGHT:"
            "X,Y,WIDTH,HEIGHT in px, left and right"
        ) from error
    return BinocularSplit(left, right, *mirrored)
