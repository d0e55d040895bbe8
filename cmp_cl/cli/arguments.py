"""Arguments that commands share, and what follows from them."""

import argparse
import contextlib
import math
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from cmp_cl.cli.messages import shown
from cmp_cl.errors import ConfigError
from cmp_cl.files import check_target
from cmp_cl.grid.grid import MOST_NODES
from cmp_cl.image import GreyImage
from cmp_cl.media import read_image
from cmp_cl.space import BinocularSplit

_BOX = r"\d+,\d+,\d+,\d+"

Box = tuple[int, int, int, int]  # x, y, width, height, px


def check_files(inputs: Iterable[str | Path | None], outputs: Iterable[str | Path | None]) -> None:
    """Raise ConfigError if an output is an input, or two outputs are one file.

    None stands for a file that was not requested. Raises OSError if an output cannot be written.
    """
    read = {os.path.realpath(path) for path in inputs if path is not None}
    written = set()
    for path in outputs:
        if path is None:
            continue
        real = os.path.realpath(path)
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


def add(group: argparse._ActionsContainer, usage: str, what: str, **how: Any) -> None:
    """Add an argument as it is typed: "--out FILE", or "--strain", a switch.

    A positional one has its attribute in the place of the option: "series SERIES". what: its help.
    how: the other arguments of `add_argument`.
    """
    name, *values = usage.split()
    if values:
        how["metavar"] = values[0] if len(values) == 1 else tuple(values)
    elif "choices" not in how:
        how["action"] = "store_true"
    group.add_argument(name, help=what, **how)


def add_device(group: argparse._ActionsContainer) -> None:
    what = (
        "part of the name of a device or platform, an index such as 0:0, or gpu or cpu; default: "
        "the variable CMP_CL_DEVICE, else the first GPU, else the first CPU"
    )
    add(group, "--device NAME", what)


def add_full_scale(group: argparse._ActionsContainer) -> None:
    what = (
        "largest grey level of the camera, for example 4095 for 12 bits in a 16-bit file; default: "
        "from the settings, else 255 or 65535"
    )
    add(group, "--full-scale LEVEL", what, type=int)


def add_split(group: argparse._ActionsContainer) -> None:
    what = (
        "where the left and the right view are in a frame that shows both: two rectangles of one "
        "size, X,Y,WIDTH,HEIGHT:X,Y,WIDTH,HEIGHT, px; default: the two halves"
    )
    add(group, "--split BOX:BOX", what, type=_two_boxes)
    what = "the views that are seen through an odd number of mirrors, and so reversed"
    add(group, "--mirror", what, choices=("left", "right", "both"))


def check_split(arguments: argparse.Namespace, *, both: bool) -> None:
    """Raise ConfigError if --split or --mirror is given; both: whether frames show both views."""
    if (arguments.split or arguments.mirror) and not both:
        raise ConfigError("--split and --mirror need --stereo and frames that show both views")


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


def _two_boxes(text: str) -> tuple[Box, Box]:
    """Parse two rectangles such as 0,0,320,480:400,0,320,480; raises ArgumentTypeError."""
    if re.fullmatch(f"{_BOX}:{_BOX}", text) is None:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not two rectangles X,Y,WIDTH,HEIGHT:X,Y,WIDTH,HEIGHT, px"
        )
    x, y, width, height, *other = map(int, re.findall(r"\d+", text))
    return (x, y, width, height), (other[0], other[1], other[2], other[3])


def split_of(arguments: argparse.Namespace, shape: tuple[int, ...]) -> BinocularSplit:
    """Return the split that --split and --mirror describe, for frames of that shape.

    Raises ConfigError if its rectangles differ in size.
    """
    halves = BinocularSplit.halves(shape[1], shape[0])
    left, right = arguments.split or (halves.left, halves.right)
    mirror = arguments.mirror
    return BinocularSplit(left, right, mirror in ("left", "both"), mirror in ("right", "both"))


def views_of(path: str | Path, arguments: argparse.Namespace) -> tuple[GreyImage, ...]:
    """Return the image of a file, or with --stereo the two views that it shows."""
    image = read_image(path)
    return split_of(arguments, image.shape)(image) if arguments.stereo else (image,)
