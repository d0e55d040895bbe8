"""The frames that are measured: rendered from seeds, with exact truth, and photographs."""

import json
from typing import Any, NamedTuple

import cv2
import numpy as np
from environment import DATA

from cmp_cl.image import GreyImage
from cmp_cl.synthetic import (
    Scene,
    binocular_frame,
    default_rig,
    random_scene,
    render,
    render_stereo,
)
from cmp_cl.synthetic.scoring import Score, score

TEST_SEED = 1000  # scenes of the report: 1000 and up
SEARCH_SEED = 900_000  # scenes that peer settings are searched on: never those of the report
MILD = {"severity": 0.25, "corrosion": 0.3}  # hardly pressed, the print nearly new


class Frame(NamedTuple):
    """An image and its truth. truth, junctions: (N, 2), px; cell: px; views: pictures in it."""

    image: GreyImage
    truth: np.ndarray
    junctions: np.ndarray
    cell: float
    markers: int
    views: int = 1

    def score(self, xy: np.ndarray) -> Score:
        """Score the detections (N, 2)."""
        return score(xy, self.truth, self.cell, self.junctions)


def rendered(scene: Scene) -> Frame:
    """Return a frame with one view of the gel."""
    view = render(scene)
    return Frame(view.image, _flat(view.truth), view.junctions, view.cell, scene.markers)


def vga(seed: int) -> Frame:
    """Return a frame of 640 x 480 with 44 x 44 corners."""
    return rendered(random_scene(seed, markers=44, **MILD))


def wide(seed: int) -> Frame:
    """Return a frame of 1600 x 1200 with two views of 40 x 40 corners side by side."""
    scene = random_scene(seed, markers=40, shape=(1200, 800), **MILD)
    left, right, _ = render_stereo(scene, default_rig((1200, 800)))
    shift = (left.image.shape[1], 0)
    return Frame(
        image=binocular_frame(left, right),
        truth=np.concatenate([_flat(left.truth), _flat(right.truth) + shift]),
        junctions=np.concatenate([left.junctions, right.junctions + shift]),
        cell=(left.cell + right.cell) / 2,
        markers=scene.markers,
        views=2,
    )


def read_listed(name: str) -> tuple[dict[str, Any], GreyImage]:
    """Return what is listed of a photograph of `DATA`, and the photograph."""
    path = (DATA / name).with_suffix(".json")
    listed = json.loads(path.read_text())
    return listed, cv2.imread(str(path.with_name(listed["image"])), cv2.IMREAD_GRAYSCALE)


def _flat(truth: np.ndarray) -> np.ndarray:
    return truth.reshape(-1, 2)
