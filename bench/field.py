"""From a frame to its field: its time, its errors against exact truth, and what its sigma covers.

    python bench/field.py --quick           a film of each kind, two minutes
    python bench/field.py                   everything, about ten minutes
    python bench/field.py --endure 20000    so many frames of one press, to and fro: memory, drift

Rendered films: two views of 40 x 40 corners on 32 mm in a frame of 1600 x 1200, through cameras
that are known exactly. True strains are those of the drawn surface. A row of results/field.csv is a
figure: `what` was measured, in which `case`, over how many `frames`, its `value` and `unit`, and
the `goal`. Times are ratios to the detection of the same frame, which is measured in turns with it.
"""

import argparse
import dataclasses
import functools
import itertools
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from environment import main_of
from scenes import TEST_SEED

from cmp_cl import BinocularSplit, Detector, DetectorConfig
from cmp_cl.image import GreyImage
from cmp_cl.measure import Measured, OneView, TwoViews
from cmp_cl.measure.measurement import AUDITED
from cmp_cl.synthetic import (
    Mode,
    Rendered,
    Scene,
    binocular_frame,
    default_rig,
    random_scene,
    render,
    render_stereo,
)
from cmp_cl.synthetic.surface import derivatives, nodes_at_rest, surface

VIEW = (1200, 800)
MARKERS = 40
CELL = 17.5  # px, of such a view
SMALL, SMALL_CELL = 44, 9.0  # corners a side of a view of 640 x 480, px
SEED = TEST_SEED + 500
RIG = default_rig(VIEW)
SPLIT = BinocularSplit.halves(2 * VIEW[1], VIEW[0])
two_views = functools.partial(TwoViews, rig=RIG, split=SPLIT, shape=(MARKERS, MARKERS))
STEPS = tuple(0.05 * k for k in range(1, 31))  # a press, by at most .15 cells a frame
LIGHT = "severity to 0.5"
BOUNDS = {LIGHT: 0.5, "severity to 1": 1.0, "severity above 1": 2.0}
JUMPS = {  # severities; a jump comes before the last AFTER frames
    "sudden contact": (0.01, 0.02, 1.0, 1.01, 1.02),
    "release": (0.25, 0.5, 0.01, 0.02, 0.03),
    "slip": (0.25, 0.5, 0.1, 0.11, 0.12),
}
AFTER = 3
APART = 0.1  # um
FILE_FRAMES = 300
COLUMNS = ("what", "case", "frames", "value", "unit", "goal")


class Shot(NamedTuple):
    """A rendered frame. xyz: (N, N, 3), the nodes, mm. case: the rows in which it counts."""

    left: Rendered
    right: Rendered
    xyz: np.ndarray
    scene: Scene
    case: str

    @property
    def frame(self) -> GreyImage:
        return binocular_frame(self.left, self.right)


Film = list[Shot]  # the first is at rest
Row = tuple[str, str, int, float, str, str]


def film_of(scene: Scene, severities: Sequence[float], cases: Sequence[str]) -> Film:
    """Render a film that begins at rest; cases: of the frames after that one."""
    scenes = [dataclasses.replace(scene, severity=level) for level in (0.0, *severities)]
    named = zip(scenes, ("", *cases), strict=True)
    return [Shot(*render_stereo(each, RIG), each, case) for each, case in named]


def films(count: int) -> list[Film]:
    """Render as many films of each kind, each of a scene of its own: presses, then those that
    jump."""
    scenes = (random_scene(seed, markers=MARKERS, shape=VIEW) for seed in itertools.count(SEED))
    cases = [next(case for case, most in BOUNDS.items() if level <= most) for level in STEPS]
    made = [film_of(next(scenes), STEPS, cases) for _ in range(count)]
    for case, levels in JUMPS.items():
        named = [*[LIGHT] * (len(levels) - AFTER), *[case] * AFTER]
        for _ in range(count):
            scene = next(scenes)
            moved = dataclasses.replace(scene, mode=Mode.SHEAR) if case == "slip" else scene
            made.append(film_of(moved, levels, named))
    return made


def errors(made: Sequence[Film]) -> list[Row]:
    """Measure the films in their order; return what the fields err by, and what sigma covers.

    All frames of a film have the error of its frame at rest, so strains count by film.
    """
    found: dict[str, list[np.ndarray]] = {}
    of_films = []
    for film in made:
        with two_views(film[0].frame, strain=True) as measure:
            answers = [error_of(measure(shot.frame), film[0], shot) for shot in film[1:]]
        for shot, answer in zip(film[1:], answers, strict=True):
            found.setdefault(shot.case, []).append(answer)
        of_films.append(np.mean(answers, axis=0))
    rows: list[Row] = []
    for case in [*BOUNDS, *JUMPS]:
        count, (square, within, *_) = len(found[case]), np.mean(found[case], axis=0)
        rows.append(("displacement, RMS error", case, count, np.sqrt(square), "um", ""))
        rows.append(("displacement within 2 sigma", case, count, 100 * within, "%", "90 to 98"))
    every = np.concatenate(list(found.values()))
    count, nodes, wrong = len(every), *np.mean(every, axis=0)[-2:]
    strain, low = 100 * np.mean(of_films, axis=0)[2:4]
    return [
        *rows,
        ("strain within 2 sigma", "mean of the films", count, strain, "%", "93 to 97"),
        ("the same, lowest 5 % of sigma", "mean of the films", count, low, "%", "93 to 97"),
        ("nodes with a displacement", "all", count, 100 * nodes, "%", ""),
        ("nodes with a wrong number", "all", count, wrong * count, "", "0"),
    ]


def anew(made: Sequence[Film]) -> list[Row]:
    """Measure the films in their order, and with numbers that are found anew in each frame; return
    by how much these differ where frames were tracked."""
    frames = other = 0
    apart: list[float] = []
    for film in made:
        with two_views(film[0].frame) as following, two_views(film[0].frame) as numbering:
            for shot in film[1:]:
                numbering.skip()  # a frame after a missing one is numbered anew
                one, two = following(shot.frame), numbering(shot.frame)
                frames += one.tracked
                off = np.linalg.norm(one.field.displacement - two.field.displacement, axis=2)
                apart.append(1e3 * np.nanmax(off) if one.tracked else 0.0)
                other += one.tracked and sum(
                    np.count_nonzero(
                        (np.minimum(a.index, b.index) >= 0).all(axis=1)
                        & (a.index != b.index).any(axis=1)
                    )
                    for a, b in zip(one.grids, two.grids, strict=True)
                )
    what = "tracked, against numbered anew"
    return [
        (what, "corners of another node", frames, other, "", "0"),
        (what, "frames over .1 um apart", frames, sum(each > APART for each in apart), "", "0"),
        (what, "largest distance of a node", frames, max(apart), "um", ""),
    ]


def endure(film: Film, count: int) -> list[Row]:
    """Measure so many frames of a press, to and fro; return what memory does, and how far fields
    drift from those of the first time that a frame came after the same one."""
    from endurance import resident

    order = to_and_fro(len(film), count // (2 * len(film) - 3) + 1)[:count]
    frames, first, used, apart = [shot.frame for shot in film], {}, [], 0.0
    tracked = differing = 0
    with two_views(frames[0]) as measure:
        for before, number in zip([0, *order], order, strict=False):
            measured = measure(frames[number])
            found = measured.field.displacement
            tracked += measured.tracked
            differing += measured.differing
            then = first.setdefault((before, number), found)
            apart = max(apart, 1e3 * float(np.nanmax(np.abs(found - then))))
            used.append(resident())
    return [
        ("frames in a row", "memory after a tenth", count, used[count // 10], "MB", ""),
        ("frames in a row", "memory at the end", count, used[-1], "MB", "the same"),
        ("frames in a row", "drift of the field", count, apart, "um", "0"),
        ("frames in a row", "audits", count, tracked // AUDITED, "", ""),
        ("frames in a row", "nodes that they number otherwise", count, differing, "", "0"),
    ]


def error_of(measured: Measured, rest: Shot, now: Shot) -> np.ndarray:
    """Return of a frame: the mean squared error, um2; the shares of errors within two sigma, along
    each node's own axes, of strains within theirs, of those with the lowest sigma, of nodes with a
    displacement; and how many nodes are more than half a cell from their true place in a view."""
    field, valid = measured.field, measured.field.valid
    off = (field.displacement - (now.xyz - rest.xyz))[valid]
    values, axes = np.linalg.eigh(field.covariance[valid])
    along = np.abs(np.einsum("nij,ni->nj", axes, off))
    nodes = nodes_at_rest(now.scene)
    slopes = np.stack(derivatives(lambda at: surface(now.scene, at), nodes, 1e-4), axis=2)  # mm
    exact = (slopes @ slopes.swapaxes(2, 3) - np.eye(2))[..., [0, 1, 0], [0, 1, 1]] / 2
    strain = np.abs(field.strain - exact) <= 2 * field.strain_sigma
    low = field.strain_sigma <= np.nanpercentile(field.strain_sigma, 5, axis=(0, 1))
    return np.array(
        [
            1e6 * np.square(off).sum(axis=1).mean(),
            (along <= 2 * np.sqrt(values.clip(0))).mean(),
            strain[np.isfinite(field.strain_sigma)].mean(),
            strain[low].mean(),
            valid.mean(),
            sum(
                np.count_nonzero(np.linalg.norm(grid.xy - view.truth, axis=2) > view.cell / 2)
                for grid, view in zip(measured.grids, (now.left, now.right), strict=True)
            ),
        ]
    )


def times(presses: Sequence[Film], rounds: int) -> list[Row]:
    """Time detection and fields in turns, to and fro through each press."""
    spent: dict[bool, list[list[float]]] = {True: [], False: []}  # by whether the press is light
    for film in presses:
        frames = [shot.frame for shot in film]
        with (
            Detector(shape=frames[0].shape, config=DetectorConfig.for_cell(CELL)) as detector,
            two_views(frames[0]) as plain,
            two_views(frames[0], strain=True) as strained,
        ):
            used = detector, plain, strained
            in_turn(used, frames[0])  # compiles what is left
            for number in to_and_fro(len(frames), rounds):
                spent[film[number].case == LIGHT].append(in_turn(used, frames[number]))
            launches = plain.launches
    rows = ratios("two views", LIGHT, spent[True], "at most 1.6")
    rows += ratios("two views", "severity 0.5 to 1.5", spent[False], "at most 2")
    detection, field, strain = np.transpose(spent[True] + spent[False])
    more = np.median((strain - field) / detection)
    rows.append(("strain on top", "two views", len(detection), more, "times", "at most 1"))
    rows.append(("launches of a tracked frame", "two views", 1, launches, "", ""))
    scene = random_scene(SEED, markers=SMALL, severity=0.0)
    frames = [render(dataclasses.replace(scene, severity=level)).image for level in STEPS[:10]]
    with (
        Detector(shape=frames[0].shape, config=DetectorConfig.for_cell(SMALL_CELL)) as detector,
        OneView(frames[0], shape=(SMALL, SMALL)) as measure,
    ):
        in_turn((detector, measure), frames[0])
        order = to_and_fro(len(frames), 4 * rounds)
        small = [in_turn((detector, measure), frames[number]) for number in order]
    return rows + ratios("one view", "640 x 480, 44 x 44", small, "at most 1.8")


def to_and_fro(count: int, rounds: int) -> list[int]:
    """Return the numbers of frames in an order in which no motion is larger than a step."""
    return [*range(1, count), *range(count - 2, 0, -1)] * rounds


def in_turn(used: Sequence[Callable[[GreyImage], Any]], frame: GreyImage) -> list[float]:
    """Return the time of each with the same frame, ms."""
    moments = [time.perf_counter()]
    for each in used:
        each(frame)
        moments.append(time.perf_counter())
    return [1e3 * took for took in np.diff(moments)]


def ratios(what: str, case: str, spent: Sequence[Sequence[float]], goal: str) -> list[Row]:
    """Return the second time over the first: the median, its ms, and the 99th percentile."""
    detection, field = np.array(spent)[:, :2].T
    middle, late = np.median(field), np.percentile(field, 99)
    what = f"frame to field, {what}"
    return [
        (what, case, len(field), middle / np.median(detection), "times", goal),
        (what, case, len(field), middle, "ms", ""),
        (f"{what}, 99 %", case, len(field), late / np.median(detection), "times", ""),
        (f"{what}, 99 %", case, len(field), late, "ms", ""),
    ]


def from_a_file(film: Film) -> Row:
    """Measure a film of MJPG with `cmp-cl run`; return its frames a second."""
    import av

    light = sum(shot.case == LIGHT for shot in film)
    order = [0, *to_and_fro(light, FILE_FRAMES)][:FILE_FRAMES]
    with tempfile.TemporaryDirectory() as folder:
        RIG.save(Path(folder, "rig.yaml"))
        with av.open(str(Path(folder, "film.avi")), "w") as container:
            stream = container.add_stream("mjpeg", rate=100)
            stream.height, stream.width = film[0].frame.shape
            stream.pix_fmt, stream.codec_context.qmax = "yuvj420p", 4
            for number in order:
                picture = av.VideoFrame.from_ndarray(film[number].frame, "gray")
                container.mux(stream.encode(picture.reformat(format="yuvj420p")))
            container.mux(stream.encode())
        command = [sys.executable, "-m", "cmp_cl", "run", "film.avi", "--stereo", "rig.yaml"]
        command += ["--grid", f"{MARKERS}x{MARKERS}", "--out", "film.h5"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    rate = re.search(r"([\d.]+) frames a second", done.stdout)[1]
    return (
        "cmp-cl run from MJPG",
        "two views, to .h5",
        FILE_FRAMES,
        float(rate),
        "1/s",
        "at least 100",
    )


def measured(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    if arguments.endure:
        return
    made = films(1 if arguments.quick else 4)
    presses = [film for film in made if len(film) > len(STEPS)]
    parts: Sequence[Callable[[], list[Row]]] = (
        lambda: times(presses[:3], 1 if arguments.quick else 4),
        lambda: [from_a_file(presses[0])],
        lambda: errors(made),
        lambda: anew(made),
    )
    for row in itertools.chain.from_iterable(part() for part in parts):
        yield dict(zip(COLUMNS, row, strict=True))


def endured(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    if arguments.endure:
        for row in endure(films(1)[0], arguments.endure):
            yield dict(zip(COLUMNS, row, strict=True))


TABLES = {"field": measured, "field_endured": endured}
FRAMES = {"metavar": "FRAMES", "type": int, "help": "measure so many, alone"}
main = main_of(__doc__, TABLES, quick="two minutes", options={"endure": FRAMES})

if __name__ == "__main__":
    raise SystemExit(main())
