"""The frames that speed and error are measured on: rendered from seeds, with exact truth."""

import functools
from typing import NamedTuple

import numpy as np

from cmp_cl.results import GreyImage
from cmp_cl.scoring import Score, score
from cmp_cl.synthetic import (
    Rendered,
    Scene,
    binocular_frame,
    default_rig,
    random_scene,
    render,
    render_stereo,
)

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
        """How right the detections (N, 2) are."""
        return score(xy, self.truth, self.cell, self.junctions)


def single(scene: Scene) -> Frame:
    """A frame with one view of the gel."""
    return _frame(render(scene), scene.markers)


@functools.cache
def vga(seed: int) -> Frame:
    """640 x 480 with 44 x 44 corners."""
    return single(random_scene(seed, markers=44, **MILD))


@functools.cache
def wide(seed: int) -> Frame:
    """1600 x 1200 with two views of 40 x 40 corners beside each other."""
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


def _frame(view: Rendered, markers: int) -> Frame:
    return Frame(view.image, _flat(view.truth), view.junctions, view.cell, markers)


def _flat(truth: np.ndarray) -> np.ndarray:
    return truth.reshape(-1, 2)
