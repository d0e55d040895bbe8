"""`cmp-cl plot`: pictures of a series that `cmp-cl run` wrote."""

import argparse
from typing import Any

from cmp_cl.cli.arguments import check_files, check_suffix
from cmp_cl.cli.messages import counted, shown
from cmp_cl.series import read_series
from cmp_cl.viz import Quantity, map_figure, save_figure, sheet_figure
from cmp_cl.viz.moments import NEEDED, Recorded


def add_parser(commands: Any) -> None:
    """Add `plot` to the commands of an argparse parser."""
    parser = commands.add_parser(
        "plot",
        help="draw what a series shows: displacement, strain, height, sigma",
        description="Draws a series of cmp-cl run: by default one sheet with the maps of the "
        "frame of the largest displacement, and curves over time. With one view, lengths are in "
        "px or in the unit of --cell, and strain is in the plane; with two views, lengths are in "
        "the rig's unit, and strain is in the surface.",
    )
    parser.add_argument(
        "series",
        metavar="SERIES",
        help="the series, .npz or .h5, or its .part while it is written or after a kill",
    )
    parser.add_argument("--out", metavar="PNG", required=True, help="the picture")
    parser.add_argument(
        "--what",
        choices=[quantity.value for quantity in Quantity],
        help="one map in place of the sheet (strain is two, the principal strains)",
    )
    parser.add_argument(
        "--frame",
        metavar="N",
        type=int,
        help="number of the frame; default: that of the largest displacement",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    check_suffix("--out", arguments.out, ".png")
    check_files([arguments.series], [arguments.out])
    recorded = Recorded.of(read_series(arguments.series, NEEDED))
    frames = counted(len(recorded.index), "frame")
    moment = recorded.moment(recorded.frame_of(arguments.frame))
    figure = (
        sheet_figure(moment, recorded)
        if arguments.what is None
        else map_figure(moment, Quantity(arguments.what))
    )
    save_figure(arguments.out, figure)
    print(f"wrote {shown(arguments.out)}: frame {moment.index} of {frames}")
    return 0
