"""`cmp-cl pattern`: the checkerboard to print."""

import argparse

from cmp_cl.cli.arguments import grid_shape, positive_number
from cmp_cl.cli.messages import shown
from cmp_cl.pattern import Checkerboard

HELP = "draw the checkerboard to print"
DESCRIPTION = """\
Draws a checkerboard to scale. Print it at 100 % ('actual size', not 'fit to page'), and measure
the print.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "--grid",
        metavar="ROWSxCOLUMNS",
        type=grid_shape,
        required=True,
        help="inner corners; there is one cell more along each side",
    )
    parser.add_argument(
        "--cell", metavar="MM", type=positive_number, required=True, help="side of a cell"
    )
    parser.add_argument(
        "--out", metavar="FILE", required=True, help="what to write: .svg, or .png of 600 dpi"
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the pattern that the arguments describe; return the exit status."""
    board = Checkerboard(shape=arguments.grid, cell=arguments.cell)
    board.save(arguments.out)
    rows, columns = board.shape
    width, height = board.size
    print(
        f"wrote {shown(arguments.out)}: {rows} x {columns} corners, cells of {board.cell:.4g} mm, "
        f"{width:.1f} x {height:.1f} mm in all; print it at 100 %"
    )
    return 0
