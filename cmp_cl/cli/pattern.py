"""`cmp-cl pattern`: the checkerboard to print."""

import argparse
from typing import Any

from cmp_cl.cli.arguments import grid_shape, positive_number
from cmp_cl.cli.messages import shown
from cmp_cl.pattern import PAPERS, Checkerboard


def add_parser(commands: Any) -> None:
    """Add `pattern` to the commands of an argparse parser."""
    parser = commands.add_parser(
        "pattern",
        help="draw the checkerboard to print",
        description="Draws a checkerboard to scale, with scale bars to check the print. Print it "
        "at 100 % ('actual size', not 'fit to page').",
    )
    parser.add_argument(
        "--grid",
        metavar="ROWSxCOLUMNS",
        type=grid_shape,
        required=True,
        help="inner corners; there is one cell more along each side",
    )
    size = parser.add_mutually_exclusive_group(required=True)
    size.add_argument("--cell", metavar="MM", type=positive_number, help="side of a cell")
    size.add_argument(
        "--size", metavar="MM", type=positive_number, help="longer side of all cells together"
    )
    parser.add_argument(
        "--out", metavar="FILE", required=True, help="what to write: .svg, or .png of 600 dpi"
    )
    parser.add_argument(
        "--paper",
        choices=list(PAPERS),
        help="centre the pattern on such a sheet; default: a sheet that just holds it",
    )
    parser.add_argument(
        "--bare",
        action="store_true",
        help="leave out the white border and the scale bars, for a mask that covers a gel",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Write the pattern that the arguments describe; return the exit status."""
    cell = arguments.cell
    if cell is None:
        cell = arguments.size / (max(arguments.grid) + 1)
    board = Checkerboard(
        shape=arguments.grid, cell=cell, bare=arguments.bare, paper=arguments.paper
    )
    board.save(arguments.out)
    rows, columns = board.shape
    width, height = board.size
    print(
        f"wrote {shown(arguments.out)}: {rows} x {columns} corners, cells of {board.cell:.4g} mm, "
        f"sheet of {width:.1f} x {height:.1f} mm; print it at 100 %"
    )
    return 0
