"""What is numbered, with its true corners: gels, boards before busy grounds, boards with marks,
photographs, and patterns without an end.
"""

import functools
import itertools
from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from changed import moved
from environment import DATA
from scenes import SEVERITIES, View, photograph, rendered

from cmp_cl.image import GreyImage
from cmp_cl.synthetic import Indenter, boards, random_scene

HIGH, WIDE = 420, 560  # px, of boards in clutter
SHAPE = (480, 640)  # of marked boards
SAMPLES = 3  # of a pixel, along each axis
MARKS = ("dot", "ring", "cross", "square", "code")
CELLS = (24, 36, 50)  # px, of marked boards
Views = Iterator[View]
GROUNDS = ("plain", "squares", "keys", "bars", "noise")
SETS = {  # photographs, and the shares that are cut off
    "stereo_opencv": ([f"right{number:02}" for number in range(1, 6)], (0.25,)),
    "stereo_bumblebee2": ([f"right{number:02}" for number in range(1, 5)], (0.2, 0.4)),
    "puzzleboard": (["example1"], (0.2, 0.4)),
    "curved": (["curve_4"], (0.2, 0.4)),
}


def cut(view: View, box: tuple[float, float, float, float]) -> View:
    """Return the part in a box: left, top, right, bottom, px."""
    x0, y0, x1, y1 = (round(float(each)) for each in box)
    image = np.ascontiguousarray(view.image[y0:y1, x0:x1])
    moved = view.truth - np.array([x0, y0, 0, 0])
    seen = moved[boards.inside(moved, image.shape)]
    region = None if view.region is None else view.region[y0:y1, x0:x1]
    return view._replace(image=image, truth=seen, region=region)


def cuts(view: View, share: float) -> Views:
    """Yield the view without that share of its pattern at the left, top, right and bottom."""
    low, high = view.truth[:, :2].min(axis=0), view.truth[:, :2].max(axis=0)
    near, far = low + share * (high - low), high - share * (high - low)
    rows, columns = view.image.shape
    yield cut(view, (near[0], 0, columns, rows))
    yield cut(view, (0, near[1], columns, rows))
    yield cut(view, (0, 0, far[0], rows))
    yield cut(view, (0, 0, columns, far[1]))


def gels(seed: int, count: int) -> Views:
    draw = np.random.default_rng(seed + 1)
    for n in range(count):
        yield rendered(
            random_scene(
                seed + n,
                markers=int(draw.integers(30, 45)),
                severity=SEVERITIES[n % len(SEVERITIES)],
                corrosion=(0.3, 1.0, 2.0)[n // 6 % 3],
            )
        )


def crops(seed: int, count: int) -> Views:
    """Yield gels cut at each of four sides, and windows of them."""
    draw = np.random.default_rng(seed + 2)
    while True:
        whole = rendered(
            random_scene(seed + 10_000 + count, markers=40, severity=draw.uniform(0.5, 1.5))
        )
        rows, columns = whole.image.shape
        x, y = draw.uniform(0.1, 0.35, 2)
        window = cut(whole, (x * columns, y * rows, (x + 0.5) * columns, (y + 0.5) * rows))
        for view in (*cuts(whole, 0.25), window):
            yield view
            count -= 1
            if not count:
                return


def torn(seed: int, count: int) -> Views:
    for n in range(count):
        scene = {"markers": 40 + n % 13, "indenter": Indenter.TORUS, "severity": 2.0}
        yield rendered(random_scene(seed + 20_000 + n, **scene))


def torn_otherwise(seed: int, count: int) -> Views:
    """Yield gels torn by all objects with edges, at several severities."""
    draw = np.random.default_rng(seed + 3)
    objects = (Indenter.TORUS, Indenter.CUBE, Indenter.WEDGE, Indenter.RIB)
    for n in range(count):
        yield rendered(
            random_scene(
                seed + 30_000 + n,
                markers=int(draw.integers(36, 53)),
                indenter=objects[n % 4],
                severity=float(draw.uniform(1.6, 2)),
                corrosion=float(draw.choice([1, 2])),
            )
        )


def photographs(_: int, count: int) -> Views:
    """Yield photographs cut at each of their sides. There is no chance in them: no seed."""
    if not DATA.is_dir():
        return
    every = (
        view
        for folder, (names, shares) in SETS.items()
        for name in names
        for share in shares
        for view in cuts(photograph(f"{folder}/{name}"), share)
    )
    yield from itertools.islice(every, count)


# boards before a background


def background(kind: str, draw: np.random.Generator) -> np.ndarray:
    """Return grey levels of a background, (HIGH, WIDE) times SAMPLES, float32."""
    high, wide = HIGH * SAMPLES, WIDE * SAMPLES
    size = int(draw.uniform(12, 40) * SAMPLES)
    dark, bright = draw.uniform(30, 110), draw.uniform(130, 230)
    level = np.full((high, wide), dark).astype(np.uint8)
    if kind == "squares":
        y, x = np.indices((high, wide), np.float32)
        turn = np.exp(1j * draw.uniform(-0.5, 0.5))
        u, v = x * turn.real + y * turn.imag, y * turn.real - x * turn.imag
        level[(np.floor(u / size) + np.floor(v / size)) % 2 == 0] = bright
    elif kind == "keys":
        for top in range(size // 8, high, size):
            for left in range(int(draw.integers(-size, 0)), wide, size):
                end = left + int(0.8 * size), top + int(0.8 * size)
                cv2.rectangle(level, (left, top), end, dark + 40, -1)
                letter = chr(int(draw.integers(65, 91)))
                cv2.putText(level, letter, (left + 9, end[1] - 9), 0, size / 50, bright, 4)
    elif kind == "bars":
        for top in range(0, high, 2 * size):
            left = 0
            while left < wide:
                end = left + int(draw.uniform(8, 40))
                grey = draw.uniform(20, 240)
                cv2.rectangle(level, (left, top), (end, top + 2 * size - 9), grey, -1)
                left = end
    elif kind == "noise":
        rough = draw.uniform(20, 235, (high // 16, wide // 16)).astype(np.uint8)
        level = cv2.resize(rough, (wide, high), interpolation=cv2.INTER_NEAREST)
    return level.astype(np.float32)


def clutter(seed: int, count: int) -> Views:
    return map(before_ground, range(seed + 40_000, seed + 40_000 + count))


def before_ground(seed: int) -> View:
    """Return a board before a background, the kind by the seed."""
    draw = np.random.default_rng(seed)
    rows, columns = int(draw.integers(4, 11)), int(draw.integers(5, 13))
    columns += rows == columns
    cell = draw.uniform(0.35, 0.8) * min(WIDE / (columns + 1), HIGH / (rows + 1))
    turn = draw.choice([draw.normal(0, 0.15), draw.uniform(-np.pi, np.pi)])
    camera = boards.plane(
        cell=cell,
        about=((columns - 1) / 2, (rows - 1) / 2),
        turn=np.degrees(turn),
        tilt=tuple(draw.normal(0, 0.0009, 2)),
        middle=(WIDE / 2 + draw.normal(0, 60), HIGH / 2 + draw.normal(0, 45)),
    )
    ground = background(GROUNDS[seed % len(GROUNDS)], draw)
    paper, margin = draw.uniform(140, 240), float(draw.choice([0, 0.3, 1, 2]))
    other = bool(draw.integers(2))  # the colour of the first square
    seen = boards.drawn(
        camera,
        (HIGH, WIDE),
        (rows, columns),
        levels=(draw.uniform(10, 60), paper),
        margin=margin,
        ground=ground,
        mark=lambda u, *_: np.full(u.shape, other),
        blur=draw.uniform(0.5, 1),
        noise=draw.uniform(1, 5),
        seed=draw,
        count=SAMPLES,
    )
    return View(seen.image, seen.corners, cell, seen.shape)


def behind_bars(seed: int, count: int) -> Views:
    """Yield boards with a bar before two rows, of which it hides both or the cells between them."""
    size, shape = (HIGH, WIDE), (9, 10)
    for n in range(count):
        draw = np.random.default_rng(seed + 50_000 + n)
        cell, turn = draw.uniform(14, 28), draw.uniform(-45, 45)
        camera = boards.plane(cell=cell, about=(4.5, 4), turn=turn, middle=(WIDE / 2, HIGH / 2))
        row, half = draw.integers(7) + 0.5, draw.uniform(0.35, 0.75)
        bar = np.abs(camera(*boards.samples(size, SAMPLES))[1] - row) < half
        front, noise = np.where(bar, 120.0, np.nan), draw.uniform(1, 5)
        seen = boards.drawn(camera, size, shape, front=front, noise=noise, seed=n, count=SAMPLES)
        hidden = np.abs(camera(*seen.corners[:, :2].T)[1] - row) < half
        yield View(seen.image, seen.corners[~hidden], cell, shape)


def in_motion(seed: int, count: int) -> Views:
    """Yield boards that move by .5 to .75 of a cell, 10 to 30 degrees off a row, in an exposure."""
    for n in range(count):
        draw = np.random.default_rng(seed + 60_000 + n)
        cell, turn = draw.uniform(14, 28), draw.uniform(-45, 45)
        camera = boards.plane(cell=cell, about=(4.5, 4), turn=turn, middle=(WIDE / 2, HIGH / 2))
        seen = boards.drawn(camera, (HIGH, WIDE), (9, 10), noise=0, seed=n, count=SAMPLES)
        angle = np.deg2rad(turn + draw.uniform(10, 30))
        half = draw.uniform(0.25, 0.375) * cell * np.exp(1j * angle)
        image = moved(seen.image.astype(np.float64), half) + draw.normal(0, 3, (HIGH, WIDE))
        image = np.clip(np.rint(image), 0, 255).astype(np.uint8)
        yield View(image, seen.corners, cell, seen.shape)


# boards with marks in their cells


def marked(seed: int, count: int) -> Views:
    """Yield boards that fill most of the image, seen at an angle, with a mark in most cells."""
    return (with_marks(MARKS[n % 5], CELLS[n // 5 % 3], seed + 900_000 + n) for n in range(count))


def inked(mark: str, texels: int, draw: np.random.Generator) -> np.ndarray:
    """Return which texels of a cell a mark inks, (texels, texels) bool."""
    y, x = (np.mgrid[:texels, :texels] + 0.5) / texels - 0.5
    size = draw.uniform(0.14, 0.24)
    far, near = np.hypot(x, y), np.minimum(np.abs(x), np.abs(y))
    box = np.maximum(np.abs(x), np.abs(y))
    bits = draw.random((4, 4)) < 0.5
    place = np.clip(((np.stack([y, x]) + 0.3) / 0.15).astype(int), 0, 3)
    kinds = {
        "dot": far < size,
        "ring": (far < 1.5 * size) & (far > 0.9 * size),
        "cross": (near < 0.3 * size) & (box < 1.4 * size),
        "square": box < size,
        "code": bits[tuple(place)] & (box < 0.3),
    }
    return kinds[mark]


def with_marks(mark: str, cell: float, seed: int, texels: int = 48) -> View:
    draw = np.random.default_rng(seed)
    rows, columns = int(0.75 * SHAPE[0] / cell), int(0.75 * SHAPE[1] / cell)
    ink = np.zeros((rows, columns, texels, texels), np.bool_)
    for row, column in np.argwhere(draw.random((rows, columns)) < 0.85):
        ink[row, column] = inked(mark, texels, draw)

    def of_square(u: np.ndarray, v: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        place = (np.clip(row + 1, 0, rows - 1), np.clip(column + 1, 0, columns - 1))
        inside = (np.clip((each + 0.5) * texels, 0, texels - 1) for each in (v, u))
        return ink[tuple(each.astype(int) for each in (*place, *inside))]

    squares = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]])
    ends = (squares - np.array([columns, rows]) / 2) * cell
    angle = draw.uniform(-0.3, 0.3)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    ends = ends @ turn + draw.uniform(-0.6, 0.6, (4, 2)) * cell + np.array(SHAPE[::-1]) / 2 - 0.5
    from_squares = cv2.getPerspectiveTransform(np.float32(squares - 1), np.float32(ends))
    seen = boards.drawn(
        boards.homography(from_squares),
        SHAPE,
        (rows - 1, columns - 1),
        levels=(35, 200),
        ground=200,
        mark=of_square,
        blur=0.8,
        noise=3,
        seed=draw,
        count=SAMPLES,
    )
    truth = seen.corners[boards.inside(seen.corners, SHAPE, 8)]
    return View(seen.image, truth, cell, seen.shape)


# patterns without an end


class Open(NamedTuple):
    """A frame of SIDE px. cell: px; rotation: degrees; shift, wave: cells of the frame at rest;
    hole: none, of the print, or in front of it; wear: standard deviation of the printing errors,
    cells; noise: grey levels; sheet: seed of the printing errors."""

    cell: float = 10.0
    zoom: float = 1.0
    rotation: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    wave: float = 0.0
    hole: str = "none"
    wear: float = 0.0
    noise: float = 2.0
    sheet: int = 1

    def at(self, part: float) -> "Open":
        """Return the frame at that part of the way from rest."""
        return self._replace(
            zoom=1 + (self.zoom - 1) * part,
            rotation=self.rotation * part,
            shift=(self.shift[0] * part, self.shift[1] * part),
            wave=self.wave * part,
        )


SIDE = 400  # px


def open_patterns(seed: int, count: int) -> Iterator[Open]:
    """Yield frames whose cells, zooms, rotations, shifts, waves, holes and prints are drawn."""
    draw = np.random.default_rng(seed + 4)
    for number in range(count):
        kind = draw.integers(4)  # a shift by a period, a small one, a large one, none
        across, down = draw.integers(-6, 7, 2)
        length = (0, draw.uniform(0, 0.7), draw.uniform(0, 6), 0)[kind]
        turn = np.exp(1j * draw.uniform(0, 2 * np.pi))
        period = (float(across), float(down + (across + down) % 2))
        yield Open(
            cell=float(draw.uniform(6.5, 20)),
            zoom=float(draw.choice([1, draw.uniform(0.88, 1.12)])),
            rotation=float(draw.choice([0, draw.uniform(-12, 12), draw.uniform(-60, 60)])),
            shift=period if kind == 0 else (float(length * turn.real), float(length * turn.imag)),
            wave=float(draw.choice([0, draw.uniform(0, 1.2)])),
            hole=str(draw.choice(["none", "print", "front"])),
            wear=float(draw.choice([0, draw.uniform(0, 0.05)])),
            noise=float(draw.uniform(0.5, 6)),
            sheet=seed + number,
        )


def place(case: Open, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the point (u, v) of the pattern, cells, that a pixel shows."""
    across = x - SIDE / 2 - case.shift[0] * case.cell
    down = y - SIDE / 2 - case.shift[1] * case.cell
    if case.wave:
        phase = 2 * np.pi * ((x - SIDE / 2) / 210 + (y - SIDE / 2) / 330 + 0.13)
        wave = case.wave * case.cell * np.sin(phase)
        across, down = across - wave, down - 0.4 * wave
    turned = np.exp(-1j * np.deg2rad(case.rotation)) / (case.zoom * case.cell)
    back, aside = float(turned.real), float(turned.imag)
    return back * across - aside * down + 0.37, aside * across + back * down + 0.21


def hidden(case: Open, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return at which pixels the hole is."""
    if case.hole == "front":
        return np.hypot(x - 240, y - 160) < 3 * case.cell
    u, v = place(case, x, y)
    return (np.hypot(u - 6, v + 4) < 3) & (case.hole == "print")


@functools.lru_cache(maxsize=1000)
def picture(case: Open, seed: int) -> GreyImage:
    """Return the frame, (SIDE, SIDE) uint8."""
    size = SIDE, SIDE
    hole = hidden(case, *boards.samples(size, SAMPLES))
    return boards.drawn(
        lambda x, y: place(case, x, y),
        size,
        wear=case.wear,
        sheet=case.sheet,
        front=np.where(hole, 30.0 if case.hole == "front" else 120.0, np.nan),
        blur=0,
        noise=case.noise,
        seed=seed,
        count=SAMPLES,
    ).image


@functools.lru_cache(maxsize=1000)
def corners_in(case: Open) -> np.ndarray:
    """Return the corners of the pattern that a frame shows, (N, 4), as in `View`."""
    every = boards.corners_in(lambda x, y: place(case, x, y), (SIDE, SIDE))
    return every[~hidden(case, *every.T[:2])]


def without_end(seed: int, count: int) -> Views:
    """Yield single frames of patterns without an end."""
    for number, case in enumerate(open_patterns(seed, count)):
        yield View(picture(case, seed + number), corners_in(case), case.cell * case.zoom)
