"""Views of patterns with known answers: a table of scenes by name, and the score of a grid."""

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import corner_images
import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl import Corners, DetectorConfig, Grid, detect
from cmp_cl.grid.grid import MEASURED
from cmp_cl.synthetic import Indenter, random_scene
from cmp_cl.synthetic.boards import Camera, View, drawn, inside, plane, samples
from cmp_cl.synthetic.boards import gel as rendered
from cmp_cl.synthetic.scoring import agreeing

Array = NDArray[np.float64]
EDGE = 6.0  # px: nearer to the image's edge a corner need not be found


def fisheye(
    focal: float, rotation: Array, place: Array, about: tuple[float, float], size: tuple[int, int]
) -> Camera:
    """Return an equidistant fisheye. place: where `about` lies before it, cells. size: (H, W)."""
    matrix, _ = cv2.Rodrigues(np.asarray(rotation, np.float64))
    x0, y0 = (size[1] - 1) / 2, (size[0] - 1) / 2
    normal = matrix[:, 2]

    def to_cells(x: Array, y: Array) -> tuple[Array, Array]:
        x, y = x - x0, y - y0
        far = np.maximum(np.hypot(x, y), 1e-9)
        ray = np.stack([x * np.sin(far / focal) / far, y * np.sin(far / focal) / far])
        ray = np.concatenate([ray, np.cos(far / focal)[None]])
        along = (place @ normal) / np.tensordot(normal, ray, 1)
        along = np.where(along > 0, along, np.nan)
        offset = ray * along - np.reshape(place, (3, *[1] * x.ndim))
        u, v = np.tensordot(matrix[:, :2].T, offset, 1)
        return u + about[0], v + about[1]

    return to_cells


def squares(size: tuple[int, int], seed: int) -> Array:
    """Return a turned floor of squares, (H, W) grey levels."""
    draw = np.random.default_rng(seed)
    y, x = np.indices(size).astype(float)
    turn, wide = np.exp(1j * draw.uniform(0.2, 0.6)), draw.uniform(14, 26)
    u, v = x * turn.real + y * turn.imag, y * turn.real - x * turn.imag
    return np.where((np.floor(u / wide) + np.floor(v / wide)) % 2 == 0, 190.0, 70.0)


def bars(size: tuple[int, int], seed: int) -> Array:
    """Return shelves of books, (H, W) grey levels."""
    draw, level = np.random.default_rng(seed), np.full(size, 80.0)
    for top in range(0, size[0], 50):
        left = 0
        while left < size[1]:
            end = left + int(draw.uniform(4, 14))
            level[top : top + 45, left:end] = draw.uniform(20, 240)
            left = end
    return level


def blocks(size: tuple[int, int], seed: int) -> Array:
    """Return random blocks of 6 px, (H, W) grey levels."""
    rough = np.random.default_rng(seed).uniform(20, 235, (size[0] // 6 + 1, size[1] // 6 + 1))
    return np.kron(rough, np.ones((6, 6)))[: size[0], : size[1]]


def gravel(size: tuple[int, int], seed: int, grain: float = 1.8) -> Array:
    """Return fine texture, (H, W) grey levels. grain: px."""
    return 120 + 60 * corner_images.grain(size, grain, seed)


def dots(u: Array, v: Array, row: Array, column: Array) -> NDArray[np.bool_]:
    """Mark half of the squares with a dot."""
    return (np.hypot(u, v) < 0.2) & ((97 * row + column) * 7 % 5 < 3)


def codes(share: float) -> Callable[[Array, Array, Array, Array], NDArray[np.bool_]]:
    """Return marks as ArUco's: black codes of that share of the side, in the white squares."""

    def mark(u: Array, v: Array, row: Array, column: Array) -> NDArray[np.bool_]:
        number = 97 * row + column
        column, row = (np.clip((each / share + 0.5) * 6, 0, 5).astype(int) for each in (u, v))
        bit = (row * 13 + column * 29 + number.astype(np.int64) * 31) % 7 < 3
        rim = (row % 5 == 0) | (column % 5 == 0)
        inside = np.maximum(np.abs(u), np.abs(v)) < share / 2
        return inside & (rim | bit) & (number % 2 != 0)

    return mark


def gel(markers: int = 24, size: tuple[int, int] = (300, 400), **given: object) -> View:
    """Return a rendered gel; `given` as for `random_scene`, with the seed."""
    return rendered(random_scene(markers=markers, shape=size, **given))


# changes of a view


def cut(view: View, box: tuple[float, float, float, float]) -> View:
    """Return a part of a view; box: left, top, right, bottom, as shares of the image."""
    rows, columns = view.image.shape
    x0, y0, x1, y1 = np.rint(np.multiply(box, (columns, rows, columns, rows))).astype(int).tolist()
    image = np.ascontiguousarray(view.image[y0:y1, x0:x1])
    corners = view.corners - np.array([x0, y0, 0, 0])
    return view._replace(image=image, corners=corners[inside(corners, image.shape)])


def turned(view: View, quarters: int) -> View:
    """Return the view turned as by np.rot90; the numbers stay."""
    image, corners = view.image, view.corners.copy()
    for _ in range(quarters % 4):
        x, y = corners[:, 0].copy(), corners[:, 1].copy()
        corners[:, 0], corners[:, 1] = y, image.shape[1] - 1 - x
        image = np.ascontiguousarray(np.rot90(image))
    return view._replace(image=image, corners=corners)


def mirrored(view: View) -> View:
    """Return the view mirrored left to right; the numbers stay."""
    corners = view.corners.copy()
    corners[:, 0] = view.image.shape[1] - 1 - corners[:, 0]
    return view._replace(image=np.ascontiguousarray(view.image[:, ::-1]), corners=corners)


# answers


def corners_of(view: View) -> Corners:
    """Return the corners that the detector finds with its defaults."""
    return detect(view.image, DetectorConfig(full_scale=2**view.bits - 1))


@dataclasses.dataclass(frozen=True)
class Score:
    """Measured nodes: at a corner with the right number, with a wrong one, at no corner; and the
    share of the corners in view that are right."""

    right: int
    wrong: int
    false: int
    share: float

    @property
    def clean(self) -> bool:
        """Return whether no number is wrong and no node false."""
        return self.wrong == 0 and self.false == 0


def scored(grid: Grid, view: View, *, known: str = "") -> Score:
    """Score a grid. known: whether its numbers must be those of the "board", up to the turns that
    map it onto itself, those of the "truth", or may be those of any motion."""
    row, column = np.nonzero(np.isin(grid.status, MEASURED))
    xy, number = grid.xy[row, column], np.stack([row, column], axis=1) + grid.origin
    needed = inside(view.corners, view.image.shape, EDGE)
    if not len(xy) or not needed.any():
        return Score(0, 0, len(xy), 0.0)
    away = np.linalg.norm(xy[:, None] - view.corners[None, :, :2], axis=2)
    nearest, hit = away.argmin(axis=1), away.min(axis=1) < max(3.0, view.cell / 4)
    truth = view.corners[nearest, 2:].astype(int)
    right = hit.copy()
    if known == "truth":
        right &= (number == truth).all(axis=1)
    else:
        right[hit] = agreeing(number[hit], truth[hit], view.shape if known else None)
    wrong, false = np.count_nonzero(hit & ~right), np.count_nonzero(~hit)
    found = len(np.unique(nearest[right & needed[nearest]]))
    return Score(int(np.count_nonzero(right)), int(wrong), int(false), found / needed.sum())


# the table

SIZE = (300, 400)
BOARD = (6, 9)
TILTED = functools.partial(plane, middle=(200, 150), about=(4, 2.5), tilt=(4e-4, -5e-4))
GROUNDS = {"squares": squares, "bars": bars, "blocks": blocks}


def board(number: int = 0, **given: object) -> View:
    """Return a board of 6 x 9 corners, whole in view; another number gives another camera."""
    camera = TILTED(cell=24.0 + number, turn=7.0 + 23 * number)
    return drawn(camera, SIZE, BOARD, seed=number, **given)


@functools.cache
def endless(number: int = 0, wear: float = 0.03, **camera: object) -> View:
    """Return a pattern without an end; camera: as for `plane`."""
    given = {"cell": 12.0, "middle": (200.0, 150.0), "turn": 4.0, "about": (0.3, 0.2)} | camera
    return drawn(plane(**given), SIZE, wear=wear, seed=number)


def moving(turn: float) -> View:
    """Return a turned board that moves by .7 cells to the right while it is seen."""
    view = drawn(TILTED(cell=24.0, turn=turn), SIZE, BOARD)
    return view._replace(image=cv2.blur(view.image, (17, 1)))


def bent() -> View:
    """Return wide cells, the middles of whose sides lie up to 8 px beside their chords."""

    def to_cells(x: Array, y: Array) -> tuple[Array, Array]:
        return (x + 25 * np.sin(y / 60)) / 90, (y + 25 * np.sin(x / 60)) / 90

    return drawn(to_cells, (600, 700))


def puzzle(seed: int) -> View:
    """Return cells of 60 px; a disc of one of the two colours hides the middle of each side."""
    colour = np.random.default_rng(seed).random((17, 17)) < 0.5

    def tabs(u: Array, v: Array, row: Array, column: Array) -> NDArray[np.bool_]:
        half = np.stack([2 * (row + v) + 1, 2 * (column + u) + 1])  # half cells
        side = np.rint(half).astype(int)
        disc = (np.hypot(*(half - side)) < 0.34) & (side.sum(axis=0) % 2 == 1)
        return disc & (colour[tuple(side % 17)] != ((row + column) % 2 != 0))

    return drawn(plane(cell=60, middle=(59.5, 59.5), about=(1, 1)), (480, 480), mark=tabs)


def shadowed(number: int) -> View:
    """Return a board with an eighth of the light behind the edge of a shadow."""
    view = board(number)
    light = 0.125 + 0.875 / (1 + np.exp((200.0 - np.arange(SIZE[1])) / 12))
    return view._replace(image=(light * view.image).astype(np.uint8))


def barred(shape: tuple[int, int], cell: float, turn: float, **hidden: tuple[float, float]) -> View:
    """Return a board, cells of so many px, behind a grey bar.

    hidden: the middle of the bar and its width in rows, or in columns, or both of a spot.
    """
    about = (shape[1] - 1) / 2, (shape[0] - 1) / 2
    camera = plane(cell=cell, middle=(200, 150), about=about, turn=turn)
    place = dict(zip(("columns", "rows"), camera(*samples(SIZE)), strict=True))
    within = [abs(place[name] - middle) < width / 2 for name, (middle, width) in hidden.items()]
    front = np.where(np.all(within, axis=0), 120.0, np.nan)
    return drawn(camera, SIZE, shape, front=front)


def reflecting(turn: float, glare: float) -> View:
    """Return a board at the edge of a shadow, and a lamp in it. glare: grey levels."""
    view = drawn(plane(cell=42, middle=(320, 240), about=(4, 2.5), turn=turn), (480, 640), BOARD)
    y, x = np.indices(view.image.shape)
    light = 0.2 + 0.8 / (1 + np.exp((x - 240) / 10))
    lamp = glare * np.exp(-((x - 430) ** 2 + (y - 280) ** 2) / (2 * 60**2))
    return view._replace(image=np.clip(view.image * light + lamp, 0, 255).astype(np.uint8))


def before_floor(shape: tuple[int, int]) -> View:
    """Return a board of few cells before a floor of squares."""
    camera = plane(cell=40, middle=(200, 150), about=(1, 1), turn=8)
    return drawn(camera, SIZE, shape, ground=squares(SIZE, 3))


def before_gravel(cell: float) -> View:
    """Return a board with a narrow margin before gravel."""
    size = (432, 576)
    camera = plane(cell=cell, middle=(288, 216), about=(4, 2.5), turn=3)
    return drawn(camera, size, BOARD, ground=gravel(size, 0), margin=0.4)


class Case(NamedTuple):
    """A view, and what is promised of it: the least share of right corners, and most false nodes.

    No number is wrong. asked: the size that is asked for, with which there is no doubt.
    """

    view: Callable[[], View]
    share: float = 1.0
    false: int = 0
    asked: tuple[int, int] | None = None


SCENES: dict[str, Case] = {
    **{
        f"gel, severity {severity}": Case(
            functools.partial(gel, seed=number, severity=severity, corrosion=1.0), 0.995
        )
        for number, severity in enumerate((0.0, 0.5, 1.0, 1.5), 41)
    },
    "gel of another object": Case(
        functools.partial(gel, seed=51, severity=1.2, indenter=Indenter.WEDGE), 0.99
    ),
    **{
        f"torn gel {seed}": Case(
            functools.partial(
                gel, 36, (480, 480), seed=seed, severity=2.0, indenter=Indenter.TORUS
            ),
            0.93,
            2,
        )
        for seed in (61, 62, 63)
    },
    **{
        f"gel torn all around a ring, {markers}": Case(
            functools.partial(
                gel,
                markers,
                (480, 640),
                seed=720_000 + markers - 40,
                severity=2.0,
                indenter=Indenter.TORUS,
            ),
            0.9,
        )
        for markers in (43, 48)
    },
    **{
        f"gel, cut at {side}": Case(lambda box=box: cut(gel(seed=71, severity=1.0), box), 0.99)
        for side, box in {
            "left": (0.3, 0, 1, 1),
            "top": (0, 0.3, 1, 1),
            "right and bottom": (0, 0, 0.6, 0.7),
            "all sides": (0.25, 0.25, 0.75, 0.75),
        }.items()
    },
    "board": Case(board),
    "board, cut at left": Case(lambda: cut(board(), (0.4, 0, 1, 1)), 0.95),
    "board without margin": Case(functools.partial(board, margin=0.0)),
    "board, narrow cells": Case(lambda: drawn(TILTED(cell=7.0, turn=5), SIZE, BOARD, noise=1.0)),
    "board at 17 degrees": Case(
        lambda: drawn(
            plane(cell=18, middle=(200, 150), about=(6, 6), tilt=(0, 3e-3)), SIZE, (13, 13)
        ),
        0.98,
    ),
    **{
        f"board before {kind}, {seed}": Case(
            lambda kind=kind, seed=seed: board(seed, ground=GROUNDS[kind](SIZE, seed))
        )
        for kind in GROUNDS
        for seed in range(2)
    },
    **{
        f"board in motion, turned by {turn}": Case(functools.partial(moving, turn))
        for turn in (-20, 15, 25)
    },
    "board with dots": Case(functools.partial(board, mark=dots)),
    **{
        f"board with codes of {share}": Case(
            lambda share=share: drawn(
                plane(cell=44, middle=(200, 150), about=(3, 2)), SIZE, (5, 7), mark=codes(share)
            ),
            0.9,
        )
        for share in (0.6, 0.75, 0.85)
    },
    **{
        f"board in a shadow with a reflection, turned by {turn}": Case(
            functools.partial(reflecting, turn, glare)
        )
        for turn, glare in ((20, 70), (25, 90))
    },
    **{
        f"board at the edge of a shadow, {number}": Case(functools.partial(shadowed, number))
        for number in range(1, 5)
    },
    **{
        f"board of 3 x {columns} before a floor": Case(
            functools.partial(before_floor, (3, columns)), asked=(3, columns)
        )
        for columns in (3, 4)
    },
    **{
        f"board before gravel, cells of {cell} px": Case(
            functools.partial(before_gravel, cell), asked=BOARD
        )
        for cell in (18, 36)
    },
    "endless": Case(endless, 0.99),
    "endless, turned": Case(functools.partial(endless, turn=31.0), 0.99),
    "endless, small cells in noise": Case(
        lambda: drawn(plane(cell=6, middle=(0, 0), turn=17), SIZE, noise=50, seed=1), 0.75
    ),
    "sides that bend": Case(bent, 0.93),
    **{f"puzzle {seed}": Case(functools.partial(puzzle, seed)) for seed in (0, 1, 3)},
    "12 bits": Case(functools.partial(board, 1, bits=12)),
    "16 bits": Case(functools.partial(board, 1, bits=16)),
}
