"""`cmp-cl render`: a frame of a pressed gel with known corners."""

import argparse
from typing import Any

import numpy as np

from cmp_cl import media
from cmp_cl.cli.arguments import check_files
from cmp_cl.cli.messages import shown
from cmp_cl.files import write_csv
from cmp_cl.synthetic import Indenter, Mode, Scene, render


def add_parser(commands: Any) -> None:
    """Add `render` to the commands of an argparse parser."""
    usual = Scene()
    parser = commands.add_parser(
        "render",
        help="draw a frame of a pressed gel with known corners",
        description="Draws one frame of a pressed gel that carries a checkerboard, and writes "
        "the true corners with --truth. The same options give the same image.",
    )
    parser.add_argument("--out", metavar="PNG", required=True, help="the image to write")
    parser.add_argument("--truth", metavar="CSV", help="write the true corners, px")
    numbers = (
        ("markers", int, usual.markers, "corners along each side"),
        (
            "severity",
            float,
            usual.severity,
            "0 to 2; 1 presses 2 mm, shears 1.2 or twists 20 degrees",
        ),
        ("corrosion", float, usual.corrosion, "wear of the print, 0 to 3"),
        ("noise", float, usual.noise, "standard deviation of the noise, 1/255 of white"),
        ("seed", int, usual.seed, "seed of noise, tears and light"),
    )
    for name, kind, default, what in numbers:
        parser.add_argument(
            f"--{name}",
            metavar="N" if kind is int else "VALUE",
            type=kind,
            default=default,
            help=f"{what}; default: {default:g}",
        )
    for name, member, what in (
        ("indenter", usual.indenter, "object that presses on the gel"),
        ("mode", usual.mode, "motion of this object"),
    ):
        parser.add_argument(
            f"--{name}",
            choices=[each.value for each in type(member)],
            default=member.value,
            help=f"{what}; default: {member.value}",
        )
    parser.add_argument(
        "--shape",
        type=int,
        nargs=2,
        metavar=("ROWS", "COLUMNS"),
        default=usual.shape,
        help="size of the image, px; default: {} {}".format(*usual.shape),
    )
    parser.add_argument(
        "--bits",
        type=int,
        choices=(8, 12),
        default=usual.bits,
        help=f"bits of a grey level; default: {usual.bits}",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Render the scene that the arguments describe; return the exit status."""
    check_files([], [arguments.out, arguments.truth])
    rendered = render(_scene(arguments))
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


def _scene(arguments: argparse.Namespace) -> Scene:
    return Scene(
        markers=arguments.markers,
        shape=tuple(arguments.shape),
        indenter=Indenter(arguments.indenter),
        mode=Mode(arguments.mode),
        severity=arguments.severity,
        corrosion=arguments.corrosion,
        noise=arguments.noise,
        bits=arguments.bits,
        seed=arguments.seed,
    )
