"""`cmp-cl render`: draw a frame of a pressed gel with known corners."""

import argparse
from typing import Any

import numpy as np

from cmp_cl import media
from cmp_cl.cli.arguments import add, check_files, check_suffix
from cmp_cl.cli.messages import shown
from cmp_cl.files import write_csv
from cmp_cl.synthetic import Indenter, Mode, Scene, render

_OPTIONS = {  # each a field of Scene
    "markers": "corners along each side",
    "indenter": "object that presses on the gel",
    "mode": "motion of this object",
    "severity": "0 to 2; 1 presses 2 mm, shears 1.2 or twists 20 degrees",
    "corrosion": "wear of the print, 0 to 3",
    "noise": "standard deviation of the noise, 1/255 of white",
    "shape": "rows and columns of the image, px",
    "bits": "bits of a grey level, 8 to 16",
    "seed": "seed of noise, tears and light",
}


DESCRIPTION = """\
Draws one frame of a pressed gel that carries a checkerboard, and writes the true corners with
--truth. The same options give the same image.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add(parser, "--out PNG", "the image to write", required=True)
    add(parser, "--truth CSV", "write the true corners, px")
    for name, what in _OPTIONS.items():
        usual = getattr(Scene(), name)
        how: dict[str, Any] = {"type": type(usual), "metavar": type(usual).__name__.upper()}
        if isinstance(usual, Indenter | Mode):
            usual = usual.value
            how = {"choices": [each.value for each in type(getattr(Scene(), name))]}
        elif name == "shape":
            how = {"type": int, "nargs": 2, "metavar": ("ROWS", "COLUMNS")}
        said = " ".join(map(str, usual)) if isinstance(usual, tuple) else usual
        parser.add_argument(f"--{name}", default=usual, help=f"{what}; default: {said}", **how)


def run(arguments: argparse.Namespace) -> int:
    check_suffix("--truth", arguments.truth, ".csv")
    check_files([], [arguments.out, arguments.truth])
    options = {name: getattr(arguments, name) for name in _OPTIONS}
    options |= {"indenter": Indenter(arguments.indenter), "mode": Mode(arguments.mode)}
    rendered = render(Scene(**options | {"shape": tuple(arguments.shape)}))
    media.write_image(arguments.out, rendered.image)
    rows, columns = rendered.image.shape
    count = rendered.truth.shape[0] * rendered.truth.shape[1]
    print(
        f"wrote {shown(arguments.out)}: {columns} x {rows} px, {count} corners, "
        f"cells of {rendered.cell:.1f} px"
    )
    if arguments.truth is not None:
        write_csv(
            arguments.truth,
            ("row", "column", "x_px", "y_px"),
            ([*index, *rendered.truth[index]] for index in np.ndindex(rendered.truth.shape[:2])),
        )
        print(f"wrote {shown(arguments.truth)}: {count} corners")
    return 0
