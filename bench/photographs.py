"""Real photographs with truth: recall, precision, and difference from the listed positions.

    python bench/photographs.py

The pictures lie in ../shared/data beside the repository and are not part of it. Their truth is a
saddle fitted to the grey image, so that differences below 0.2 px between methods are meaningless.
Small rendered boards, whose truth is exact, stand in front of enlarged photographs of rooms: wide,
soft shapes, which can be taken for cells. Peers have the settings of the density with the nearest
cell, found on rendered scenes.
"""

import argparse
from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import methods
import numpy as np
from environment import DATA, main_of
from peers import Pattern, available
from scenes import View, photograph

from cmp_cl.image import GreyImage
from cmp_cl.synthetic import boards
from cmp_cl.synthetic.scoring import total

PICTURES = ("water/reference_df", "water/ellipse_10", "puzzleboard/example1", "curved/curve_4")
BOARDS = ("stereo_opencv", "stereo_bumblebee2")  # folders of boards in a room
CELLS = {20: 21.0, 30: 14.2, 40: 10.8, 44: 9.8}  # px, of the densities that were searched
SMALL = "small boards before photographs"
ROOMS = "stereo_opencv"  # the photographs behind the small boards
ENLARGED = 4
FIRST_SEED = 21_000  # of the small boards
AT_ONCE = ("find_chessboard", "find_chessboard_sb")  # ask for whole boards of known size
Row = dict[str, Any]


def listed(*names: str) -> list[View]:
    """Return photographs. Nothing is false in those of which not every corner is listed."""
    views = [photograph(name) for name in names]
    return [
        view._replace(region=np.zeros(view.image.shape, np.bool_)) if view.region is None else view
        for view in views
    ]


def folder(name: str) -> list[View]:
    """Return all photographs of a folder."""
    return listed(*(f"{name}/{path.stem}" for path in sorted((DATA / name).glob("*.json"))))


def small_boards() -> list[View]:
    """Return a small board in front of two parts of each photograph of a room, enlarged."""
    rooms = [view.image for view in folder(ROOMS) for _ in range(2)]
    return [before(room, seed) for seed, room in enumerate(rooms, FIRST_SEED)]


def before(room: GreyImage, seed: int) -> View:
    """Return a view of a board in front of a part of a photograph, in the photograph's size.

    Beyond half a cell outside the board's corners nothing is scored.
    """
    draw = np.random.default_rng(seed)
    high, wide = room.shape
    rows, columns = int(draw.integers(5, 9)), int(draw.integers(7, 12))
    cell = float(draw.uniform(7, 14))
    top, left = (int(draw.integers(size - size // ENLARGED + 1)) for size in room.shape)
    part = room[top : top + high // ENLARGED, left : left + wide // ENLARGED]
    turn = draw.uniform(-0.4, 0.4)
    lean = complex(*draw.normal(0, 0.004, 2)) * np.exp(1j * turn) / cell
    camera = boards.plane(
        cell=cell,
        about=((columns - 1) / 2, (rows - 1) / 2),
        turn=np.degrees(turn),
        tilt=(lean.real, lean.imag),
        middle=tuple(draw.uniform(0.35, 0.65, 2) * (wide, high)),
    )
    margin, paper, ink = (float(draw.uniform(*ends)) for ends in ((0.3, 1), (140, 240), (10, 60)))
    seen = boards.drawn(
        camera,
        room.shape,
        (rows, columns),
        levels=(ink, paper),
        margin=margin,
        ground=cv2.resize(part, (3 * wide, 3 * high), interpolation=cv2.INTER_CUBIC),
        blur=draw.uniform(0.5, 1),
        noise=draw.uniform(1, 5),
        seed=draw,
        count=3,
    )
    region = boards.covered(*camera(*boards.samples(room.shape)), seen.shape, -0.5)
    return View(seen.image, seen.corners, cell, seen.shape, region)


def rows_of(name: str, views: Sequence[View], names: Sequence[str]) -> Iterator[Row]:
    """Run every method on some photographs of one size."""
    cell = float(np.median([view.cell for view in views]))
    nearest = min(CELLS, key=lambda markers: abs(CELLS[markers] - cell))
    used = methods.used(Pattern(nearest, views=2), views[0].image.shape, ())  # without a grid
    pattern = Pattern(round(len(views[0].truth) ** 0.5))
    used += [methods.peer(each, pattern, nearest) for each in names]
    for method in used:
        spent, scores, outside = [], [], 0
        for view in views:
            for _ in range(1 if method.slow else 4):
                xy, ms = method.timed(view.image)
                spent.append(ms)
            scores.append(view.score(xy))
            outside += len(xy) - scores[-1].found - scores[-1].false
        whole = total(scores)
        yield {
            "photograph": name,
            "photographs": len(views),
            "method": method.name,
            "ms": float(np.median(spent[1:] or spent)),
            "expected": whole.expected,
            "missed": whole.missed,
            "false": whole.false,
            "outside": outside,
            "median": float(np.median(whole.errors)) if whole.found else float("nan"),
        }


def rows(_: argparse.Namespace) -> Iterator[Row]:
    if not DATA.is_dir():
        raise SystemExit(f"there are no photographs: {DATA} is missing")
    names = [name for name in available() if name not in AT_ONCE]
    groups = {name: listed(name) for name in PICTURES} | {name: folder(name) for name in BOARDS}
    for name, views in (groups | {SMALL: small_boards()}).items():
        yield from rows_of(name, views, names)


main = main_of(__doc__, {"photographs": rows})

if __name__ == "__main__":
    raise SystemExit(main())
