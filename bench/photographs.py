"""Real photographs with truth: recall, precision, and difference from the listed positions.

    python bench/photographs.py

The pictures lie in ../shared/data beside the repository and are not part of it. Their truth is a
saddle fitted to the grey image, so that differences below 0.2 px between methods are meaningless.
Small rendered boards, whose truth is exact, stand in front of enlarged photographs of rooms: wide,
soft shapes, which can be taken for cells. Peers have the settings of the density with the nearest
cell, found on rendered scenes.
"""

import time
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import cv2
import methods
import numpy as np
from environment import DATA, run
from peers import Pattern, available, keep_freed_memory
from scenes import read_listed

from cmp_cl.image import GreyImage
from cmp_cl.synthetic import boards
from cmp_cl.synthetic.scoring import match

PICTURES = ("water/reference_df", "water/ellipse_10", "puzzleboard/example1", "curved/curve_4")
BOARDS = ("stereo_opencv", "stereo_bumblebee2")  # folders of boards in a room
CELLS = {20: 21.0, 30: 14.2, 40: 10.8, 44: 9.8}  # px, of the densities that were searched
SMALL = "small boards before photographs"
ROOMS = "stereo_opencv"  # the photographs behind the small boards
ENLARGED = 4
FIRST_SEED = 21_000  # of the small boards
AT_ONCE = ("find_chessboard", "find_chessboard_sb")  # ask for whole boards of known size


Row = dict[str, Any]


class Photograph(NamedTuple):
    """image; truth (N, 2) px; sure (N,) bool, the others are not scored as missed; region
    (H, W) bool, where a detection that is no listed corner is false; cell, px."""

    name: str
    image: GreyImage
    truth: np.ndarray
    sure: np.ndarray
    region: np.ndarray
    cell: float

    @classmethod
    def read(cls, name: str) -> "Photograph":
        listed, image = read_listed(name)
        region = np.zeros_like(image)  # nowhere, if not every corner is listed
        if listed["region"] is not None:
            region = cv2.imread(str(DATA / f"{name}.region.png"), cv2.IMREAD_GRAYSCALE)
        corners = listed["corners"]
        return cls(
            name=name,
            image=image,
            truth=np.array([(corner["x"], corner["y"]) for corner in corners]),
            sure=np.array([corner.get("sure", True) for corner in corners]),
            region=region > 0,
            cell=listed["cell_px"]["median"],
        )

    def judge(self, xy: np.ndarray) -> "Judged":
        """Return missed, false and distances; matched within a quarter of a cell, at most 3 px."""
        partner = match(xy, self.truth, min(3, self.cell / 4))
        hit = partner >= 0
        missed = np.ones(len(self.truth), np.bool_)
        missed[partner[hit]] = False
        rows, columns = self.region.shape
        x, y = np.rint(xy[~hit]).astype(int).T
        x, y = x.clip(0, columns - 1), y.clip(0, rows - 1)
        false = int(self.region[y, x].sum())
        return Judged(
            expected=int(self.sure.sum()),
            missed=int((missed & self.sure).sum()),
            false=false,
            outside=int(len(xy) - hit.sum()) - false,
            apart=np.hypot(*(xy[hit] - self.truth[partner[hit]]).T),
        )


def small_boards() -> list[Photograph]:
    """Return a small board in front of two parts of each photograph of a room, enlarged."""
    found = []
    for path in sorted((DATA / ROOMS).glob("*.json")):
        room = Photograph.read(f"{ROOMS}/{path.stem}").image
        for _ in range(2):
            found.append(before(room, FIRST_SEED + len(found)))
    return found


def before(room: GreyImage, seed: int) -> Photograph:
    """Return a view of a board in front of a part of a photograph, in the photograph's size.

    Beyond half a cell outside the board's corners nothing is scored.
    """
    draw = np.random.default_rng(seed)
    high, wide = room.shape
    rows, columns = int(draw.integers(5, 9)), int(draw.integers(7, 12))
    cell = float(draw.uniform(7, 14))
    top, left = (int(draw.integers(size - size // ENLARGED + 1)) for size in room.shape)
    part = room[top : top + high // ENLARGED, left : left + wide // ENLARGED]
    turn = cell * np.exp(1j * draw.uniform(-0.4, 0.4))
    to_view = np.array([[turn.real, -turn.imag, 0], [turn.imag, turn.real, 0], [0, 0, 1]])
    to_view[2, :2] = draw.normal(0, 0.004, 2)  # perspective
    to_view[:2] += np.outer(draw.uniform([0.35, 0.35], [0.65, 0.65]) * (wide, high), to_view[2])
    to_cells = np.array([[1, 0, -(columns - 1) / 2], [0, 1, -(rows - 1) / 2], [0, 0, 1]])
    camera = boards.homography(to_view @ to_cells)
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
    truth = seen.corners[:, :2]
    return Photograph(
        name=f"{SMALL} {seed}",
        image=seen.image,
        truth=truth,
        sure=np.ones(len(truth), np.bool_),
        region=boards.covered(*camera(*boards.samples(room.shape)), seen.shape, -0.5),
        cell=cell,
    )


class Judged(NamedTuple):
    """Counts of a photograph, and distances of what was found from the truth, px."""

    expected: int
    missed: int
    false: int
    outside: int
    apart: np.ndarray


def summary(parts: Sequence[Judged]) -> dict[str, Any]:
    """Return the sums over some photographs."""
    expected, missed, false, outside = (
        int(sum(column)) for column in list(zip(*parts, strict=True))[:4]
    )
    apart = np.concatenate([part.apart for part in parts])
    return {
        "expected": expected,
        "missed": missed,
        "false": false,
        "outside": outside,
        "median": float(np.median(apart)) if len(apart) else float("nan"),
        "p95": float(np.percentile(apart, 95)) if len(apart) else float("nan"),
    }


def rows_of(name: str, photographs: Sequence[Photograph], names: Sequence[str]) -> Iterator[Row]:
    """Run every method on some photographs of one size."""
    first = photographs[0]
    cell = float(np.median([each.cell for each in photographs]))
    nearest = min(CELLS, key=lambda markers: abs(CELLS[markers] - cell))
    used = methods.own(Pattern(nearest, views=2), first.image.shape)  # without a grid
    pattern = Pattern(round(len(first.truth) ** 0.5))
    used += [methods.peer(each, pattern, nearest) for each in names]
    for method in used:
        spent, judged = [], []
        for photograph in photographs:
            for _ in range(1 if method.slow else 4):
                start = time.perf_counter()
                xy = np.asarray(method.detect(photograph.image))
                spent.append(getattr(method.detect, "seconds", time.perf_counter() - start))
            judged.append(photograph.judge(xy))
        row = {"photograph": name, "photographs": len(photographs), "method": method.name}
        yield {**row, "ms": 1e3 * float(np.median(spent[1:] or spent)), **summary(judged)}


def rows(names: Sequence[str]) -> Iterator[Row]:
    groups = {name: [Photograph.read(name)] for name in PICTURES}
    for folder in BOARDS:
        files = sorted((DATA / folder).glob("*.json"))
        groups[folder] = [Photograph.read(f"{folder}/{path.stem}") for path in files]
    groups[SMALL] = small_boards()
    for name, photographs in groups.items():
        yield from rows_of(name, photographs, names)


def main(argv: Sequence[str] | None = None) -> int:
    if not DATA.is_dir():
        print(f"there are no photographs: {DATA} is missing")
        return 2
    keep_freed_memory()
    names = [name for name in available()[0] if name not in AT_ONCE]
    return run(__doc__, "photographs", lambda quick: rows(names), argv=argv)


if __name__ == "__main__":
    raise SystemExit(main())
