"""The frames that are measured: rendered from seeds, with exact truth, and photographs."""

import functools
import hashlib
import json
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from environment import DATA

from cmp_cl import synthetic
from cmp_cl.image import GreyImage
from cmp_cl.synthetic import (
    Rendered,
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
    """Return a frame with one view of the gel; kept in the folder for temporary files."""
    return _kept(f"one {scene}", lambda: _frame(render(scene), scene.markers))


def vga(seed: int) -> Frame:
    """Return a frame of 640 x 480 with 44 x 44 corners."""
    return rendered(random_scene(seed, markers=44, **MILD))


def wide(seed: int) -> Frame:
    """Return a frame of 1600 x 1200 with two views of 40 x 40 corners side by side."""
    scene = random_scene(seed, markers=40, shape=(1200, 800), **MILD)
    return _kept(f"two {scene}", lambda: _binocular(scene))


def read_listed(name: str) -> tuple[dict[str, Any], GreyImage]:
    """Return what is listed of a photograph of `DATA`, and the photograph."""
    path = (DATA / name).with_suffix(".json")
    listed = json.loads(path.read_text())
    return listed, cv2.imread(str(path.with_name(listed["image"])), cv2.IMREAD_GRAYSCALE)


@functools.cache
def _folder() -> Path:
    """Return where rendered scenes are kept; another renderer has another folder."""
    sources = sorted(Path(synthetic.__file__).parent.glob("*.py"))
    version = hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:12]
    folder = Path(tempfile.gettempdir()) / f"cmp_cl-scenes-{version}"
    folder.mkdir(exist_ok=True)
    return folder


def _kept(key: str, make: Callable[[], Frame]) -> Frame:
    path = _folder() / f"{hashlib.sha256(key.encode()).hexdigest()[:24]}.npz"
    if path.is_file():
        with np.load(path) as kept:
            values = {name: kept[name] for name in Frame._fields}
        numbers = {name: values[name].item() for name in ("cell", "markers", "views")}
        return Frame(**(values | numbers))
    frame = make()
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as unfinished:
        np.savez(unfinished, **frame._asdict())
    os.replace(unfinished.name, path)  # another process may have rendered the same scene
    return frame


def _binocular(scene: Scene) -> Frame:
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
