"""`cmp-cl plot`: pictures of a series that `cmp-cl run` wrote."""

import argparse
import os
import re
from typing import Any

from cmp_cl.cli.arguments import check_suffix
from cmp_cl.cli.messages import counted, shown
from cmp_cl.errors import ConfigError
from cmp_cl.files import check_target
from cmp_cl.series import read_series
from cmp_cl.viz import save_figure
from cmp_cl.viz.plots import Quantity, Recorded, curve_figure, map_figure, sheet_figure


def add_parser(commands: Any) -> None:
    """Add `plot` to the commands of an argparse parser."""
    parser = commands.add_parser(
        "plot",
        help="draw what a series shows: displacement, strain, height, sigma, a node's curve",
        description="Draws a series of cmp-cl run: by default one sheet with the maps of the "
        "frame of the largest displacement and the curve of the node that moves most. With "
        "one view, lengths are in px or in the unit of --cell, and strain is in the plane; with "
        "two views, lengths are in the rig's unit, and strain is in the surface. A series that "
        "still grows can be drawn too.",
    )
    parser.add_argument("series", metavar="SERIES", help="the series, .npz or .h5")
    parser.add_argument("--out", metavar="PNG", required=True, help="the picture to write")
    parser.add_argument(
        "--what",
        choices=[*(quantity.value for quantity in Quantity), "curve"],
        help="one map, or the curve of a node over time, in place of the sheet",
    )
    parser.add_argument(
        "--frame", metavar="N", type=int, help="number of the frame; default: see above"
    )
    parser.add_argument(
        "--node",
        metavar="ROW,COLUMN",
        type=_node,
        help="node of the curve, counted from 0,0; default: see above",
    )
    parser.set_defaults(run=run)


def _node(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,5}),(\d{1,5})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a node such as 3,7")
    return int(match[1]), int(match[2])


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    check_suffix("--out", arguments.out, ".png")
    if os.path.realpath(arguments.out) == os.path.realpath(arguments.series):
        raise ConfigError(f"{shown(arguments.out)} is the series and would be overwritten")
    check_target(arguments.out)
    recorded = Recorded.of(read_series(arguments.series))
    frame, node = recorded.frame_of(arguments.frame), recorded.node_of(arguments.node)
    index = int(recorded.index[frame])
    if arguments.what is None:
        figure = sheet_figure(recorded, index=index, node=node)
    elif arguments.what == "curve":
        figure = curve_figure(recorded, node=node)
    else:
        figure = map_figure(recorded, Quantity(arguments.what), index=index)
    save_figure(arguments.out, figure)
    what = "" if arguments.what == "curve" else f"frame {index}"
    curve = f"node {node[0]},{node[1]}" if arguments.what in (None, "curve") else ""
    parts = ", ".join(part for part in (what, curve) if part)
    print(f"wrote {shown(arguments.out)}: {parts} of {counted(len(recorded.index), 'frame')}")
    return 0
