"""What is numbered, with its true corners: gels, boards before busy grounds, boards with marks,
photographs, and patterns without an end.
"""

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from environment import DATA
from scenes import read_listed

from cmp_cl.image import GreyImage
from cmp_cl.synthetic import Indenter, Scene, random_scene, render

HIGH, WIDE = 420, 560  # px, of boards in clutter
SHAPE = (480, 640)  # of marked boards
SAMPLES = 3  # of a pixel, along each axis
MARKS = ("dot", "ring", "cross", "square", "code")
CELLS = (24, 36, 50)  # px, of marked boards
GROUNDS = ("plain", "squares", "keys", "bars", "noise")
SETS = {"stereo_opencv": (0.25,), "stereo_bumblebee2": (0.2, 0.4), "puzzleboard": (0.2, 0.4)}
SETS |= {"curved": (0.2, 0.4)}  # photographs, and the shares that are cut off
NAMES = {
    "stereo_opencv": [f"right{number:02}" for number in range(1, 6)],
    "stereo_bumblebee2": [f"right{number:02}" for number in range(1, 5)],
    "puzzleboard": ["example1"],
    "curved": ["curve_4"],
}


class View(NamedTuple):
    """A picture. truth: (N, 4), x, y, row and column of each corner in view. region: where a node
    that is no listed corner is false, (H, W) bool. whole: rows and columns of the pattern, None if
    it has none or they are unknown. cell: px."""

    image: GreyImage
    truth: np.ndarray
    region: np.ndarray
    cell: float
    whole: tuple[int, int] | None = None


Views = Iterator[View]


def everywhere(
    image: GreyImage, truth: np.ndarray, cell: float, whole: tuple[int, int] | None
) -> View:
    return View(image, truth, np.ones(image.shape, np.bool_), cell, whole)


def gel(scene: Scene) -> View:
    shot = render(scene)
    number = np.indices(shot.truth.shape[:2]).transpose(1, 2, 0)
    truth = np.concatenate([shot.truth, number], axis=-1).reshape(-1, 4)
    rows, columns = shot.truth.shape[:2]
    return everywhere(shot.image, truth, shot.cell, (rows, columns))


def cut(view: View, box: tuple[float, float, float, float]) -> View:
    """Return the part in a box: left, top, right, bottom, px."""
    x0, y0, x1, y1 = (round(float(each)) for each in box)
    image = np.ascontiguousarray(view.image[y0:y1, x0:x1])
    moved = view.truth - np.array([x0, y0, 0, 0])
    inside = ((moved[:, :2] >= 0) & (moved[:, :2] <= np.array(image.shape[::-1]) - 1)).all(axis=1)
    return view._replace(image=image, truth=moved[inside], region=view.region[y0:y1, x0:x1])


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
        yield gel(
            random_scene(
                seed + n,
                markers=int(draw.integers(30, 45)),
                severity=(0.25, 0.5, 0.75, 1.0, 1.25, 1.5)[n % 6],
                corrosion=(0.3, 1.0, 2.0)[n // 6 % 3],
            )
        )


def crops(seed: int, count: int) -> Views:
    """Yield gels cut at each of four sides, and windows of them."""
    draw = np.random.default_rng(seed + 2)
    while True:
        whole = gel(
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
        yield gel(random_scene(seed + 20_000 + n, **scene))


def torn_otherwise(seed: int, count: int) -> Views:
    """Yield gels torn by all objects with edges, at several severities."""
    draw = np.random.default_rng(seed + 3)
    objects = (Indenter.TORUS, Indenter.CUBE, Indenter.WEDGE, Indenter.RIB)
    for n in range(count):
        yield gel(
            random_scene(
                seed + 30_000 + n,
                markers=int(draw.integers(36, 53)),
                indenter=objects[n % 4],
                severity=float(draw.uniform(1.6, 2)),
                corrosion=float(draw.choice([1, 2])),
            )
        )


def photograph(name: str) -> View:
    listed, image = read_listed(name)
    truth = np.array([[c["x"], c["y"], c["j"], c["i"]] for c in listed["corners"]])
    region = np.ones(image.shape, np.bool_)
    drawn = DATA / f"{name}.region.png"
    if drawn.is_file():
        region = cv2.imread(str(drawn), cv2.IMREAD_GRAYSCALE) > 0
    whole = (6, 9) if name.startswith("stereo_opencv") else None
    return View(image, truth, region, listed["cell_px"]["median"], whole)


def photographs(seed: int, count: int) -> Views:
    """Yield photographs cut at each of their sides. There is no chance in them: no seed."""
    del seed
    if not DATA.is_dir():
        return
    every = (
        view
        for folder, shares in SETS.items()
        for name in NAMES[folder]
        for share in shares
        for view in cuts(photograph(f"{folder}/{name}"), share)
    )
    for _, view in zip(range(count), every, strict=False):
        yield view


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
    for n in range(seed + 40_000, seed + 40_000 + count):
        yield before_ground(n)


def before_ground(seed: int) -> View:
    """Return a board before a background, the kind by the seed."""
    draw = np.random.default_rng(seed)
    rows, columns = int(draw.integers(4, 11)), int(draw.integers(5, 13))
    columns += rows == columns
    cell = draw.uniform(0.35, 0.8) * min(WIDE / (columns + 1), HIGH / (rows + 1))
    turn = np.exp(1j * draw.choice([draw.normal(0, 0.15), draw.uniform(-np.pi, np.pi)]))
    turn *= cell
    moved = np.array([[turn.real, -turn.imag, 0], [turn.imag, turn.real, 0], [0, 0, 1]])
    tilt, shift = np.eye(3), np.eye(3)
    tilt[2, :2] = draw.normal(0, 0.0009, 2)  # perspective
    shift[:2, 2] = WIDE / 2 + draw.normal(0, 60), HIGH / 2 + draw.normal(0, 45)
    to_view = shift @ tilt @ moved
    x, y = np.meshgrid(*((np.arange(n * SAMPLES) + 0.5) / SAMPLES - 0.5 for n in (WIDE, HIGH)))
    across, down, scale = np.tensordot(np.linalg.inv(to_view), [x, y, np.ones_like(x)], 1)
    across, down = across / scale + (columns + 1) / 2, down / scale + (rows + 1) / 2

    def within(margin: float) -> np.ndarray:
        inside = (across > -margin) & (across < columns + 1 + margin) & (scale > 0)
        return inside & (down > -margin) & (down < rows + 1 + margin)

    level = background(GROUNDS[seed % len(GROUNDS)], draw)
    level[within(float(draw.choice([0, 0.3, 1, 2])))] = paper = draw.uniform(140, 240)
    black = (np.floor(across) + np.floor(down)) % 2 == draw.integers(2)
    level[within(0) & black] = draw.uniform(10, 60)
    level[within(0) & ~black] = paper
    small = cv2.resize(level, (WIDE, HIGH), interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), draw.uniform(0.5, 1))
    small = small + draw.uniform(1, 5) * draw.standard_normal(small.shape)
    row, column = np.indices((rows, columns)).reshape(2, -1)
    flat = np.stack([column - (columns - 1) / 2, row - (rows - 1) / 2, np.ones(row.size)])
    x, y, scale = to_view @ flat
    truth = np.stack([x / scale, y / scale, row, column], axis=1)
    return everywhere(
        np.clip(np.rint(small), 0, 255).astype(np.uint8), truth, cell, (rows, columns)
    )


# boards with marks in their cells


def marked(seed: int, count: int) -> Views:
    """Yield boards that fill most of the image, seen at an angle, with a mark in most cells."""
    for n in range(count):
        yield with_marks(MARKS[n % 5], CELLS[n // 5 % 3], seed + 900_000 + n)


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
    white = np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 1
    texture = np.kron(white, np.ones((texels, texels), np.bool_))
    for row, column in np.argwhere(draw.random(white.shape) < 0.85):
        here = np.s_[row * texels :, column * texels :]
        texture[here][:texels, :texels] ^= inked(mark, texels, draw)
    sheet = np.pad(np.where(texture, 200, 35).astype(np.uint8), texels, constant_values=200)
    high, wide = rows * cell, columns * cell
    ends = np.array([[0, 0], [wide, 0], [wide, high], [0, high]]) - (wide / 2, high / 2)
    angle = draw.uniform(-0.3, 0.3)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    ends = ends @ turn + draw.uniform(-0.6, 0.6, (4, 2)) * cell + np.array(SHAPE[::-1]) / 2 - 0.5
    on_sheet = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]]) * texels + texels - 0.5
    to_fine = cv2.getPerspectiveTransform(
        on_sheet.astype(np.float32), (SAMPLES * (ends + 0.5) - 0.5).astype(np.float32)
    )
    size = (SAMPLES * SHAPE[1], SAMPLES * SHAPE[0])
    image = cv2.warpPerspective(sheet, to_fine, size, borderMode=cv2.BORDER_REPLICATE)
    image = cv2.resize(image, SHAPE[::-1], interpolation=cv2.INTER_AREA).astype(np.float32)
    image = cv2.GaussianBlur(image, (0, 0), 0.8) + 3 * draw.standard_normal(SHAPE)
    row, column = np.mgrid[1:rows, 1:columns].reshape(2, -1)
    flat = np.stack([column, row], axis=1)[None] * float(texels) + texels - 0.5
    at = (cv2.perspectiveTransform(flat, to_fine)[0] + 0.5) / SAMPLES - 0.5
    truth = np.column_stack([at, row - 1, column - 1])
    inside = ((at > 7) & (at < np.array(SHAPE[::-1]) - 8)).all(axis=1)
    image = np.rint(image).clip(0, 255).astype(np.uint8)
    return everywhere(image, truth[inside], cell, (rows - 1, columns - 1))


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


SIDE, PERIOD = 400, 256  # px; cells, after which the printing errors repeat


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


def picture(case: Open, seed: int) -> GreyImage:
    """Return the frame, (SIDE, SIDE) uint8."""
    fine = (np.arange(SIDE * SAMPLES, dtype=np.float32) + 0.5) / SAMPLES - 0.5
    x, y = np.meshgrid(fine, fine)
    u, v = (each.astype(np.float32) for each in place(case, x, y))
    error = np.random.default_rng(case.sheet).normal(0, case.wear, (PERIOD, PERIOD, 2))
    error = np.pad(error, ((0, 1), (0, 1), (0, 0)), mode="wrap").astype(np.float32)
    off = cv2.remap(error, u % PERIOD, v % PERIOD, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
    white = (np.floor(u + off[..., 0]) + np.floor(v + off[..., 1])) % 2 != 0
    level = np.where(white, np.float32(205), np.float32(45))
    if case.hole == "print":
        level[np.square(u - 6) + np.square(v + 4) < 9] = 120
    elif case.hole == "front":
        level[np.hypot(x - 240, y - 160) < 3 * case.cell] = 30
    small = cv2.resize(level, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(seed).standard_normal(small.shape, dtype=np.float32)
    return np.clip(np.rint(small + np.float32(case.noise) * noise), 0, 255).astype(np.uint8)


def corners_in(case: Open) -> np.ndarray:
    """Return the corners of the pattern that a frame shows, (N, 4), as in `View`; to a pixel."""
    y, x = (each.ravel().astype(np.float32) for each in np.indices((SIDE, SIDE)))
    u, v = place(case, x, y)
    column, row = np.rint(u).astype(int), np.rint(v).astype(int)
    off = np.hypot(u - column, v - row)
    seen = off * case.cell * case.zoom < 0.75
    if case.hole == "print":
        seen &= np.hypot(u - 6, v + 4) >= 3
    elif case.hole == "front":
        seen &= np.hypot(x - 240, y - 160) >= 3 * case.cell
    every = np.stack([x, y, row, column], axis=1)[seen][np.argsort(off[seen], kind="stable")]
    _, first = np.unique(every[:, 2:], axis=0, return_index=True)
    return every[first]


def without_end(seed: int, count: int) -> Views:
    """Yield single frames of patterns without an end."""
    for number, case in enumerate(open_patterns(seed, count)):
        image = picture(case, seed + number)
        yield everywhere(image, corners_in(case), case.cell * case.zoom, None)


def stretched(seed: int, count: int) -> Views:
    """Yield patterns without an end that waves stretch and squeeze up to three times."""
    draw = np.random.default_rng(seed + 77)
    for number in range(count):
        case = Open(
            cell=float(draw.uniform(9, 20)),
            rotation=float(draw.uniform(-60, 60)),
            wave=float(draw.uniform(0.9, 1.6)),
            noise=float(draw.uniform(0.5, 6)),
            sheet=seed + number,
        )
        yield everywhere(picture(case, seed + number), corners_in(case), case.cell, None)
