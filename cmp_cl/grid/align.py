"""Views of the same pattern are numbered alike here."""

from collections.abc import Sequence

import numpy as np

from cmp_cl.errors import GridError, listed
from cmp_cl.grid.grid import Grid

# Degrees, if colours do not decide: between the rows of two views, and between the best two turns.
MOST_TURNED, UNDECIDED = 60, 10


def align(grids: Sequence[Grid], *, ahead: complex | None = None) -> list[Grid]:
    """Return the grids of several views of one board with the numbers of the first view.

    If a quarter or half turn of the board changes its colours, the colours decide, however the
    cameras are rotated: with 9 x 6 corners the cell between nodes (0, 0) and (1, 1) has the same
    colour in all views. If several turns have the same colours, the one that leaves the rows most
    parallel to those of the first view is taken.

    ahead: the direction of the first view's rows in the other views, x + 1j y, where a camera is
        rolled; None means that all have the same side up.

    Raises GridError if a grid has no node, if shapes or colours do not agree, or if several turns
    have the same colours and none leaves the rows within 60 degrees, or two leave them equally
    parallel within 10 degrees.
    """
    grids = listed("grids", grids, Grid, GridError)
    for number, grid in enumerate(grids, 1):
        if not grid.valid.any():
            raise GridError(f"view {number} of {len(grids)} shows no node, and cannot be numbered")
    if not grids:
        return []
    along = row_direction(grids[0]) if ahead is None else ahead
    return [grids[0], *(_like(grids[0], grid, along) for grid in grids[1:])]


def _like(first: Grid, grid: Grid, ahead: complex) -> Grid:
    """Return the grid with the numbers of the first one."""
    turned = [grid.turned(quarters) for quarters in range(4)]
    fitting = [turn for turn in turned if turn.shape == first.shape and turn.parity == first.parity]
    if len(fitting) == 1:
        return fitting[0]
    off = [abs(float(np.angle(row_direction(turn) / ahead, deg=True))) for turn in fitting]
    if not off or not min(off) <= MOST_TURNED:
        raise GridError(
            "the views cannot be numbered alike: their shapes, their checker colours or the "
            "directions of their rows do not agree"
        )
    best, second = sorted(off)[:2]
    if second - best <= UNDECIDED:
        raise GridError(
            f"the views cannot be numbered alike: the board looks the same after a quarter turn, "
            f"and its rows are rotated by {best:.0f} degrees or by {second:.0f}"
        )
    return fitting[off.index(best)]


def row_direction(grid: Grid) -> complex:
    """Return the mean step of a grid from one column to the next, x + 1j y, px; NaN if it has
    none."""
    step = np.diff(grid.xy.astype(np.float64), axis=1)
    known = step[np.isfinite(step).all(axis=2)]
    return complex(*known.mean(axis=0)) if len(known) else complex(np.nan, np.nan)
