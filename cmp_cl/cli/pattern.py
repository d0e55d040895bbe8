"""`cmp-cl pattern`: draw the checkerboard to print."""

import argparse

from cmp_cl.cli.arguments import add, grid_shape, positive_number
from cmp_cl.cli.messages import shown
from cmp_cl.pattern import Checkerboard

DESCRIPTION = """\
Draws a checkerboard to scale. Print it at 100 % ('actual size', not 'fit to page'), and measure
the print.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    what = "inner corners; there is one cell more along each side"
    add(parser, "--grid ROWSxCOLUMNS", what, type=grid_shape, required=True)
    add(parser, "--cell MM", "side of a cell", type=positive_number, required=True)
    add(parser, "--out FILE", "what to write: .svg, or .png of 600 dpi", required=True)


def run(arguments: argparse.Namespace) -> int:
    board = Checkerboard(shape=arguments.grid, cell=arguments.cell)
    board.save(arguments.out)
    rows, columns = board.shape
    width, height = board.size
    print(
        f"wrote {shown(arguments.out)}: {rows} x {columns} corners, cells of {board.cell:.4g} mm, "
        f"{width:.1f} x {height:.1f} mm in all; print it at 100 %"
    )
    return 0
