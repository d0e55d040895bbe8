"""The frames that are measured: rendered from seeds, with exact truth, and photographs."""

import json
from typing import NamedTuple

import cv2
import numpy as np
from environment import DATA

from cmp_cl.image import GreyImage
from cmp_cl.synthetic import (
    Indenter,
    Scene,
    binocular_frame,
    default_rig,
    random_scene,
    render,
    render_stereo,
)
from cmp_cl.synthetic.scoring import Score, match, reach, score

TEST_SEED = 1000  # scenes of the report: 1000 and up
SEARCH_SEED = 900_000  # scenes that peer settings are searched on: never those of the report
DENSITIES = (20, 30, 40, 44)  # corners a side
SEVERITIES = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
INDENTERS = [kind for kind in Indenter if kind is not Indenter.NONE]
MILD = {"severity": 0.25, "corrosion": 0.3}  # hardly pressed, the print nearly new


class View(NamedTuple):
    """An image and its true corners.

    truth: (N, 2), x and y, px, or (N, 4), with row and column.
    cell: px.
    whole: rows and columns of the pattern; None if it has none, or they are unknown.
    region: (H, W) bool, where a detection that is no corner is false; None: everywhere.
    ignored: (K, 2), px, where a detection is neither true nor false.
    pictures: of the pattern, in the image.
    within: largest distance of a detection from its corner, px; None: .35 cells, at most 3.
    """

    image: GreyImage
    truth: np.ndarray
    cell: float
    whole: tuple[int, int] | None = None
    region: np.ndarray | None = None
    ignored: np.ndarray = np.empty((0, 2))
    pictures: int = 1
    within: float | None = None

    def counted(self, xy: np.ndarray) -> np.ndarray:
        """Return which detections are false if they are no corners."""
        if self.region is None:
            return np.ones(len(xy), np.bool_)
        last = np.array(self.image.shape[::-1]) - 1
        x, y = np.rint(xy).astype(int).clip(0, last).T
        return self.region[y, x]

    def score(self, xy: np.ndarray) -> Score:
        """Score detections (N, 2)."""
        corners = self.truth[:, :2]
        within = reach(self.cell) if self.within is None else self.within
        known = match(xy, corners, within) >= 0
        seen = xy[known | self.counted(xy)]
        return score(seen, corners, self.cell, self.ignored, within=within)


def rendered(scene: Scene) -> View:
    """Return a view of the gel, its corners row by row, with their numbers."""
    view, size = render(scene), (scene.markers, scene.markers)
    numbers = np.indices(size).reshape(2, -1).T
    truth = np.hstack([view.truth.reshape(-1, 2), numbers])
    return View(view.image, truth, view.cell, size, ignored=view.junctions)


def vga(seed: int) -> View:
    """Return a frame of 640 x 480 with 44 x 44 corners."""
    return rendered(random_scene(seed, markers=44, **MILD))


def wide(seed: int) -> View:
    """Return a frame of 1600 x 1200 with two views of 40 x 40 corners side by side."""
    scene = random_scene(seed, markers=40, shape=(1200, 800), **MILD)
    left, right, _ = render_stereo(scene, default_rig((1200, 800)))
    shift = (left.image.shape[1], 0)
    return View(
        image=binocular_frame(left, right),
        truth=np.concatenate([left.truth, right.truth + shift]).reshape(-1, 2),
        cell=(left.cell + right.cell) / 2,
        whole=(40, 40),
        ignored=np.concatenate([left.junctions, right.junctions + shift]),
        pictures=2,
    )


def photograph(name: str) -> View:
    """Return a photograph of `DATA` and its corners."""
    path = (DATA / name).with_suffix(".json")
    listed, region = json.loads(path.read_text()), None
    if listed["region"] is not None:
        region = cv2.imread(str(DATA / f"{name}.region.png"), cv2.IMREAD_GRAYSCALE) > 0
    image = cv2.imread(str(path.with_name(listed["image"])), cv2.IMREAD_GRAYSCALE)
    truth = np.array([[c["x"], c["y"], c["j"], c["i"]] for c in listed["corners"]])
    whole = (6, 9) if name.startswith("stereo_opencv") else None
    return View(image, truth, listed["cell_px"]["median"], whole, region)
