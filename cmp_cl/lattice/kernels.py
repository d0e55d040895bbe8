"""The kernels of the lattice, in order, and over what each runs; its arguments are buffers of the
plan, or among its `values`. What the kernels do stands in kernels/.
"""

import dataclasses
import enum

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.opencl.launches import constant
from cmp_cl.stages.refine import RESULT_FIELDS, RESULT_HEAD

FILES = ("bins", "lattice")  # the type of pixels matters for the first alone
DIRECTIONS = 1024  # unit vectors in a full turn
# In the layout, see kernels/lattice.clh; numbers in all.
BOARD_ROWS, BOARD_COLUMNS, SIGN, PARTS, VOTES, LAYOUT = 3, 4, 5, 6, 8, 9
ROUNDS = 12  # times that nodes are looked for
LISTS = 8  # of places, see `settle_nodes`
ROUGH, FIRM = 1, 2  # kinds of a node
SIDES, FOUND = 4, 16  # what is found of a board: its lines, from here its sides; numbers in all
VOTE = 6  # numbers of a vote
SPOT, LANES = 6, 8  # numbers of a corner in the bins; corners that are read at a time
TAKEN = -1  # in the place of 1 that a numbered corner has: it is another board's
ROOM = 4  # votes for each corner, at first; a board that is cut into parts of 16 cells has 10


class Over(enum.Enum):
    """What the work-items of a kernel are."""

    PIXELS = enum.auto()
    CORNERS = enum.auto()
    HALF_EDGES = enum.auto()
    PLACES = enum.auto()
    GROUP = enum.auto()  # one work-group does all


Kernel = tuple[str, Over]

PARTS_OF_CORNERS: tuple[Kernel, ...] = (
    ("smooth_levels", Over.PIXELS),
    ("direct_corners", Over.CORNERS),
    ("fill_bins", Over.GROUP),
    ("choose_links", Over.CORNERS),
    ("keep_links", Over.HALF_EDGES),
    ("part_links", Over.HALF_EDGES),
    ("choose_links", Over.CORNERS),
    ("keep_links", Over.HALF_EDGES),
    ("part_links", Over.HALF_EDGES),
    ("close_faces", Over.HALF_EDGES),
    ("number_parts", Over.GROUP),
)
VOTES_OF_PARTS: tuple[Kernel, ...] = (("find_votes", Over.HALF_EDGES),)
BOARD_OF_NUMBERS: tuple[Kernel, ...] = (
    ("lay_board", Over.GROUP),
    ("blend_nodes", Over.PLACES),
    ("measure_nodes", Over.PLACES),
    ("score_nodes", Over.PLACES),
    ("settle_nodes", Over.GROUP),
    ("weigh_nodes", Over.PLACES),
    ("cut_board", Over.GROUP),
    ("measure_border", Over.GROUP),
)


def sizes(*, corners: int, places: int, rows: int, columns: int, step: int) -> dict[str, int]:
    """Return the bytes of the buffers of the lattice, of a frame with so many rows and columns, and
    elements from row to row."""
    # A bin is as large as a quarter of the area of a corner, or larger, and 4 px wide or wider.
    bins = 4 * corners + rows // 4 + columns // 4 + 2
    of_corners = {
        **dict.fromkeys(("contrast", "claim", "passes"), 4),
        **dict.fromkeys(("lines", "choice", "link", "twin", "face", "beyond", "part"), 16),
        **dict.fromkeys(("waiting", "faces_of_part", "numbers", "limit"), 16),
        **{"used": 1, "cut": 4, "steps": 64, "state": 64},
    }
    of_places = {
        **dict.fromkeys(("torn", "kind"), 1),
        **dict.fromkeys(("owner", "cell", "score", "candidate", "listed", "asked"), 4),
        **dict.fromkeys(("marks", "spread"), 4),
        **dict.fromkeys(("seen", "at", "result", "sides", "cells", "found"), 8),
        **{"predictions": 16, "lists": 4 * LISTS},
    }
    return {
        **{name: size * corners for name, size in of_corners.items()},
        **{name: size * places for name, size in of_places.items()},
        "corners": 4 * (RESULT_HEAD + RESULT_FIELDS * corners),
        "levels": 2 * rows * step,
        "starts": 4 * bins,
        "binned": 4 * (corners + LANES),
        "spots": 4 * (SPOT * corners + LANES),
        "layout": 4 * LAYOUT,
        "border": 4 * FOUND,
    }


def macros(k: LatticeConstants) -> dict[str, str]:
    """Return the constants as macros: their names in large letters, and float32 to the bit."""
    values = {name.upper(): value for name, value in dataclasses.asdict(k).items()}
    shares = ("CUBIC_WEIGHT", "MIDDLE_WEIGHT", "CELL_WEIGHT", "BEYOND_WEIGHT")
    values |= zip(shares, values.pop("PREDICTION_WEIGHTS"), strict=True)
    values |= {"PENALTY": 0.5 / k.sd_cells**2, "ROUNDS": ROUNDS}
    return {
        name: f"{value}" if isinstance(value, int) else f"{np.float32(value)}f"
        for name, value in values.items()
    }


def tables(k: LatticeConstants, context: cl.Context) -> dict[str, cl.Buffer]:
    """Return the tables of constants, by the names of the arguments."""
    return {
        "circle": constant(context, circle()),
        "tolerances": constant(context, k.face_tolerances()),
    }


def circle() -> NDArray[np.float32]:
    """Return the cosines of the directions, in steps of 2^-14."""
    cosine = np.cos(np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS))
    rounded: NDArray[np.float32] = (np.rint(16384 * cosine) / 16384).astype(np.float32)
    return rounded
