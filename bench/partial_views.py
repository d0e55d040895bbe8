"""Boards partly out of view, torn gels, boards of a wrong size, and an island: which nodes are
found, and how they are numbered.

    python bench/partial_views.py           writes results/partial_views.json

Photographs and gels are cut at each of their four sides, so that a part of the board is missing,
and given to each method; torn gels are given whole. A node is right if it lies within 3 px of a
corner and its number fits the lattice of the others, false if no corner lies within a quarter of a
cell. A view is silently wrong if its numbers are not those of the whole board and no warning says
so; only methods that are told the size of the board give such numbers. The photographs lie in
../shared/data beside the repository and are not part of it.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from environment import DATA, environment, parser_of, write_result
from scenes import read_listed

from cmp_cl import Detector, DetectorConfig, build_grid, detect
from cmp_cl.errors import GridError
from cmp_cl.grid import Grid
from cmp_cl.grid.grid import MEASURED
from cmp_cl.image import GreyImage
from cmp_cl.synthetic import Indenter, Rendered, random_scene, render

SETS: dict[str, tuple[tuple[str, ...], tuple[float, ...], tuple[int, int] | None]] = {
    "stereo_opencv": (
        tuple(f"{side}{number:02}" for number in range(1, 6) for side in ("left", "right")),
        (0.25,),
        (6, 9),
    ),
    "stereo_bumblebee2": (
        tuple(f"{side}{number:02}" for number in range(1, 5) for side in ("left", "right")),
        (0.2, 0.4),
        None,
    ),
    "puzzleboard": (("example1",), (0.2, 0.4), None),
    "curved": (("curve_4",), (0.2, 0.4), None),
}
GELS = 3  # presses of each severity
TORN = 40  # gels that a ring tears


class View(NamedTuple):
    """A cut photograph. truth: (N, 4), x, y, row and column of each corner in view. region:
    where a node that is no listed corner is false, (H, W) bool. whole: rows and columns of the
    board, None if they are not asked for."""

    name: str
    image: GreyImage
    truth: np.ndarray
    region: np.ndarray
    cell: float
    whole: tuple[int, int] | None


class Found(NamedTuple):
    """The answer of a method: positions (M, 2), numbers (M, 2) (row, column), and doubts."""

    xy: np.ndarray
    number: np.ndarray
    doubts: bool = False
    sized: bool = False  # whether the numbers are meant to be those of the whole board


Method = Callable[[View], Found | None]


def views(folder: str) -> Iterator[View]:
    """Yield the cut photographs of a folder."""
    names, shares, whole = SETS[folder]
    for name in names:
        listed, image = read_listed(f"{folder}/{name}")
        truth = np.array([[c["x"], c["y"], c["j"], c["i"]] for c in listed["corners"]])
        region = np.ones(image.shape, np.bool_)
        drawn = DATA / folder / f"{name}.region.png"
        if drawn.is_file():
            region = cv2.imread(str(drawn), cv2.IMREAD_GRAYSCALE) > 0
        cell = listed["cell_px"]["median"]
        for share in shares:
            title = f"{folder}/{name}, {share:g}"
            yield from _cuts(title, image, truth, region, cell, whole, share)
    if folder == "stereo_opencv":
        yield from gels()
        yield from torn_gels()


def gels() -> Iterator[View]:
    """Yield pressed gels cut at four sides, by a quarter."""
    for severity in (0.5, 1.0, 1.5):
        for seed in range(1700, 1700 + GELS):
            scene = random_scene(seed, markers=40, severity=severity)
            shot = render(scene)
            name = f"gels/severity {severity:g}, {seed}"
            yield from _cuts(*_whole(name, shot), 0.25)


def torn_gels() -> Iterator[View]:
    """Yield whole gels that are pressed by a ring so hard that the pattern is torn around it."""
    for seed in range(1800, 1800 + TORN):
        markers = 40 + seed % 13
        scene = random_scene(seed, markers=markers, indenter=Indenter.TORUS, severity=2.0)
        yield _whole(f"torn gels/{seed}", render(scene))


def _whole(name: str, shot: Rendered) -> View:
    """Return the view of a whole gel."""
    index = np.indices(shot.truth.shape[:2]).transpose(1, 2, 0)
    truth = np.concatenate([shot.truth, index], axis=-1).reshape(-1, 4)
    region = np.ones(shot.image.shape, np.bool_)
    rows, columns = shot.truth.shape[:2]
    return View(name, shot.image, truth, region, shot.cell, (rows, columns))


def _cuts(
    name: str,
    image: GreyImage,
    truth: np.ndarray,
    region: np.ndarray,
    cell: float,
    whole: tuple[int, int] | None,
    share: float,
) -> Iterator[View]:
    low, high = truth[:, :2].min(axis=0), truth[:, :2].max(axis=0)
    near, far = np.rint(low + share * (high - low)), np.rint(high - share * (high - low))
    rows, columns = image.shape
    boxes = {
        "left": (near[0], 0, columns, rows),
        "top": (0, near[1], columns, rows),
        "right": (0, 0, far[0], rows),
        "bottom": (0, 0, columns, far[1]),
    }
    for side, box in boxes.items():
        x0, y0, x1, y1 = map(int, box)
        cut = np.ascontiguousarray(image[y0:y1, x0:x1])
        moved = truth - np.array([x0, y0, 0, 0])
        inside = (moved[:, :2] >= 0).all(axis=1)
        inside &= (moved[:, :2] <= np.array(cut.shape[::-1]) - 1).all(axis=1)
        yield View(f"{name}, {side}", cut, moved[inside], region[y0:y1, x0:x1], cell, whole)


# methods


def own(*, sized: bool) -> Method:
    """Return our default for the cell, with the board's size or without."""

    def find(view: View) -> Found | None:
        if sized and view.whole is None:
            return None
        config = DetectorConfig.for_cell(view.cell)
        try:
            with Detector(shape=view.image.shape, config=config) as detector:
                grid = detector.grid(view.image, shape=view.whole if sized else None)[1]
        except GridError:
            return Found(np.zeros((0, 2)), np.zeros((0, 2), int))
        return found(grid)._replace(sized=sized)

    return find


def found(grid: Grid) -> Found:
    row, column = np.nonzero(np.isin(grid.status, MEASURED))
    number = np.stack([row, column], axis=1) + np.array(grid.origin)
    return Found(grid.xy[row, column].astype(np.float64), number, bool(grid.doubts))


def calib_targets(view: View) -> Found | None:
    import calib_targets as peer

    answer = peer.detect_chessboard(view.image)
    if answer is None:
        return Found(np.zeros((0, 2)), np.zeros((0, 2), int))
    xy, number = [], []
    for corner in answer.corners:
        xy.append(_pair(corner.position))
        number.append(_pair(corner.grid)[::-1])
    return Found(np.array(xy).reshape(-1, 2), np.array(number, int).reshape(-1, 2))


def _pair(value: Any) -> tuple[float, float]:
    """Return two numbers from a tuple or from an object with x and y, or i and j."""
    for names in (("x", "y"), ("i", "j"), ("u", "v")):
        if hasattr(value, names[0]):
            return getattr(value, names[0]), getattr(value, names[1])
    return value[0], value[1]


def sector_based(view: View) -> Found | None:
    """Run cv2.findChessboardCornersSB with LARGER, beginning with the smallest board.

    It draws random numbers; the seed makes its answer the same in every run.
    """
    cv2.setRNGSeed(0)
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
    hit, xy, meta = cv2.findChessboardCornersSBWithMeta(view.image, (3, 3), flags)
    if not hit:
        return Found(np.zeros((0, 2)), np.zeros((0, 2), int))
    row, column = np.indices(meta.shape)
    return Found(
        xy.reshape(-1, 2).astype(np.float64), np.stack([row.ravel(), column.ravel()], axis=1)
    )


def libcbdetect(view: View) -> Found | None:
    """Return libcbdetect's largest board, with its own settings."""
    import libCBDetect as peer

    board = peer.Checkerboard()
    board.show_processing = False
    board.array_to_image(view.image.astype(np.float64).ravel(), *view.image.shape)
    board.find_corners()
    board.refine_corners()
    board.find_board_from_corners()
    shape = board.rows, board.cols
    x, y = np.zeros((2, shape[0] * shape[1]))
    if len(x):
        board.get_board_corners(x, y)
    return Found(np.stack([x, y], axis=1), np.indices(shape).reshape(2, -1).T)


METHODS: dict[str, Method] = {
    "cmp_cl": own(sized=False),
    "cmp_cl, size known": own(sized=True),
    "calib-targets": calib_targets,
    "cv2 SB, LARGER": sector_based,
    "libcbdetect": libcbdetect,
}


# answers


def scored(view: View, answer: Found) -> dict[str, int]:
    """Return the corners in view, the nodes that are right, false and neither, and the numbers that
    are silently wrong."""
    row = dict.fromkeys(
        ("right", "false", "other", "refused", "with a warning", "silently wrong"), 0
    )
    row["visible"] = len(view.truth)
    if not len(answer.xy):
        row["refused"] = 1
        return row
    real = (np.abs(answer.xy) < 1e5).all(axis=1)
    row["false"] = int(np.count_nonzero(~real))
    answer = answer._replace(xy=answer.xy[real], number=answer.number[real])
    away = np.linalg.norm(answer.xy[:, None] - view.truth[None, :, :2], axis=2)
    nearest, distance = away.argmin(axis=1), away.min(axis=1)
    x, y = np.rint(answer.xy).astype(int).T
    rows, columns = view.region.shape
    counts = view.region[y.clip(0, rows - 1), x.clip(0, columns - 1)]
    hit = distance < 3
    false = int(np.count_nonzero((distance >= max(3, view.cell / 4)) & counts))
    right, identity = agreeing(answer.number[hit], view.truth[nearest[hit], 2:].astype(int), view)
    row["right"] = right
    row["other"] = int(np.count_nonzero(hit | counts)) - false - right
    row["false"] += false
    row["with a warning"] = int(answer.doubts)
    row["silently wrong"] = int(answer.sized and not identity and not answer.doubts)
    return row


def agreeing(number: np.ndarray, truth: np.ndarray, view: View) -> tuple[int, bool]:
    """Return how many numbers differ from the true ones by one motion, and whether by one of the
    board."""
    if not len(number):
        return 0, False
    here, there = number[:, 1] + 1j * number[:, 0], truth[:, 1] + 1j * truth[:, 0]
    best, of_board = 0, False
    for mirrored in (here, here.conj()):
        for quarter in range(4):
            shift = np.rint(mirrored * 1j**quarter - there)
            values, counts = np.unique(shift, return_counts=True)
            best = max(best, int(counts.max()))
            if view.whole is not None and counts.max() == len(number):
                placed = mirrored * 1j**quarter
                of_board |= _onto_itself(placed - values[0], here, mirrored, quarter, view.whole)
    return best, of_board


def _onto_itself(
    moved: np.ndarray, here: np.ndarray, mirrored: np.ndarray, quarter: int, whole: tuple[int, int]
) -> bool:
    """Return whether that motion maps the numbers of a whole board onto themselves."""
    rows, columns = whole
    shape = (columns - 1) + 1j * (rows - 1)
    flipped = not np.array_equal(mirrored, here)
    shift = (mirrored[0] * 1j**quarter) - moved[0]
    for size in (shape, shape.imag + 1j * shape.real):  # as asked, or across
        ends = np.array([0, size.real, 1j * size.imag, size])
        ends = (ends.conj() if flipped else ends) * 1j**quarter - shift
        for target in (shape, shape.imag + 1j * shape.real):
            wanted = {0j, complex(target.real), 1j * target.imag, complex(target)}
            if {complex(round(e.real), round(e.imag)) for e in ends} == wanted:
                return True
    return False


def each_answer(view: View, reasons: dict[str, str]) -> Iterator[tuple[str, Found]]:
    """Yield the name and the answer of each method that is installed and can be asked.

    reasons: why the others are not installed, by name; new ones are added.
    """
    for name in [name for name in METHODS if name not in reasons]:
        try:
            answer = METHODS[name](view)
        except (ImportError, AttributeError) as error:
            reasons[name] = str(error)
            continue
        if answer is not None:
            yield name, answer


def partial(reasons: dict[str, str]) -> list[dict[str, Any]]:
    """Run every method on every cut photograph, and sum by folder."""
    totals: dict[tuple[str, str], dict[str, int]] = {}
    for folder in SETS:
        for view in views(folder):
            for name, answer in each_answer(view, reasons):
                group = totals.setdefault((view.name.split("/")[0], name), {})
                for key, value in scored(view, answer).items():
                    group[key] = group.get(key, 0) + value
                group["views"] = group.get("views", 0) + 1
    return [{"set": key[0], "method": key[1], **values} for key, values in totals.items()]


def wrong_sizes() -> list[dict[str, Any]]:
    """Ask for whole boards in a size that is wrong by one or two lines."""
    rows = []
    for name in SETS["stereo_opencv"][0]:
        listed, image = read_listed(f"stereo_opencv/{name}")
        config = DetectorConfig.for_cell(listed["cell_px"]["median"])
        corners = detect(image, config)
        for asked in ((6, 9), (6, 8), (5, 9), (5, 8), (4, 7), (7, 9), (6, 10), (7, 10)):
            try:
                grid = build_grid(corners, image, shape=asked)
            except GridError:
                rows.append({"view": name, "asked": asked, "answer": "refused"})
                continue
            told = sorted(grid.seen_shape or asked) == [6, 9]
            answer = "right size named" if told else "warning" if grid.doubts else "silently wrong"
            rows.append({"view": name, "asked": asked, "answer": answer})
    return rows


def island() -> dict[str, Any]:
    """Return the corners of ellipse_10 that have a node, alone and like the frame at rest."""
    answers: dict[str, Any] = {}
    grids: dict[str, Grid] = {}
    for name in ("reference_df", "ellipse_10"):
        listed, image = read_listed(f"water/{name}")
        config = DetectorConfig.for_cell(listed["cell_px"]["median"])
        corners = detect(image, config)
        grids[name] = build_grid(corners, image)
    truth = np.array([[c["x"], c["y"], c["j"], c["i"], c["board"]] for c in listed["corners"]])
    liked = build_grid(corners, image, like=grids["reference_df"])
    for word, grid in (("alone", grids["ellipse_10"]), ("like the frame at rest", liked)):
        answers[word] = {"corners": len(truth), "ambiguous": grid.ambiguous}
        every = found(grid)
        for part, board in (("outside", 1), ("island", 0)):
            corner = truth[truth[:, 4] == board]
            view = View(part, image, corner[:, :4], np.ones(image.shape, bool), 9.1, None)
            away = np.linalg.norm(every.xy[:, None] - corner[None, :, :2], axis=2).min(axis=1)
            near = Found(every.xy[away < 2.3], every.number[away < 2.3])
            answers[word][part] = scored(view, near)["right"]
    return answers


def show(result: dict[str, Any]) -> None:
    keys = ("views", "visible", "right", "false", "other", "refused")
    keys += ("with a warning", "silently wrong")
    print(f"{'set':20}{'method':22}" + "".join(f"{key:>10}" for key in keys))
    for row in result["partial"]:
        print(f"{row['set']:20}{row['method']:22}" + "".join(f"{row[key]:10}" for key in keys))
    counts: dict[str, int] = {}
    for row in result["wrong_sizes"]:
        kind = "right size" if tuple(row["asked"]) == (6, 9) else "wrong size"
        counts[f"{kind}: {row['answer']}"] = counts.get(f"{kind}: {row['answer']}", 0) + 1
    print(counts)
    print(result["island"])


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parser_of(__doc__).parse_args(argv)
    if not DATA.is_dir():
        print(f"there are no photographs: {DATA} is missing")
        return 2
    reasons: dict[str, str] = {}
    result = {
        "kind": "partial_views",
        "environment": environment(),
        "partial": partial(reasons),
        "unavailable": reasons,
        "wrong_sizes": wrong_sizes(),
        "island": island(),
    }
    show(result)
    write_result(result, arguments.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
