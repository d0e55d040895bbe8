"""The same image gives the same whole numbers on every device, driver and machine.

The scenes are stored, because rendering may round floats differently on another machine.
A change of the algorithm changes the digests: `python tests/test_determinism.py` prints the new
ones, computed by the oracle.
"""

import dataclasses
import hashlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from comparison import FLOATS
from configs import rings

import cmp_cl
from cmp_cl import (
    AdaptiveMean,
    BinaryRings,
    Corners,
    Detector,
    DetectorConfig,
    EdgeStep,
    Fit,
    Midlines,
    RapidCriteria,
    SpectralCriteria,
    reference,
)
from cmp_cl.corners import Maps

SCENES = {
    "board": Path(cmp_cl.__file__).parent / "data" / "board.png",
    **{path.stem: path for path in sorted(Path(__file__).with_name("data").glob("*.png"))},
}
CONFIGS = {
    "default": DetectorConfig(),
    "rings": rings(),
    "paper": DetectorConfig.paper(30),
    "small cells": DetectorConfig(
        detection=BinaryRings(threshold=AdaptiveMean(window=11), outer_radius=4),
        refinement=EdgeStep(cell=9),
    ),
    "spectral": DetectorConfig(
        detection=BinaryRings(criteria=SpectralCriteria()), refinement=Midlines(fit=Fit.QUADRATIC)
    ),
    "dense, scaled": DetectorConfig(
        detection=BinaryRings(
            criteria=RapidCriteria(sector_threshold=12, corrosion_threshold=None), contrast=None
        ),
        nms_radius=2,
        scale=0.7,
    ),
}
DIGESTS = {
    ("board", "default"): "637a784ac836c086",
    ("board", "dense, scaled"): "cae281807b280ba0",
    ("deep", "default"): "82ae75654c8eafd0",
    ("deep", "paper"): "6c4b2e7e23089b5c",
    ("deep", "small cells"): "b66317f6580c8404",
    ("deep", "spectral"): "4d9033fc4b7aa6f0",
    ("deep", "dense, scaled"): "d24b6bcf53066cb2",
    ("noise", "default"): "6c62b792e7ce9729",
    ("noise", "dense, scaled"): "06f8bb55940c5632",
    ("scene", "default"): "f112fbec343cb160",
    ("scene", "paper"): "a3c04001cbe7a2dd",
    ("scene", "rings"): "5aff1259250435c6",
    ("scene", "small cells"): "84f938f9a6c622d0",
    ("scene", "spectral"): "d93a7ca9b7a3681e",
    ("scene", "dense, scaled"): "3ecf4bb86ca1d737",
    ("ties", "default"): "751379dbf95e0ea6",
    ("ties", "dense, scaled"): "0fc74481c67e6e23",
}


def load(name: str) -> np.ndarray:
    image = cv2.imread(str(SCENES[name]), cv2.IMREAD_UNCHANGED)
    assert image.ndim == 2
    return image


def config_for(name: str, image: np.ndarray) -> DetectorConfig:
    return CONFIGS[name].replace(full_scale=4095 if image.dtype == np.uint16 else None)


def digest(maps: Maps, corners: Corners) -> str:
    """Return a digest of every whole number in the maps and the corners; it does not depend on the
    byte order and width of integers."""
    hashed = hashlib.sha256()
    arrays = {f.name: getattr(maps, f.name) for f in dataclasses.fields(maps)}
    arrays |= {"pixel": corners.pixel, "method": corners.method}
    arrays |= {"R": corners.response, "doubtful": corners.doubtful}
    for name, values in arrays.items():
        if name in FLOATS or values is None:
            continue
        hashed.update(f"{name} {values.shape}".encode())
        hashed.update(np.ascontiguousarray(values).astype("<i4").tobytes())
    return hashed.hexdigest()[:16]


QUICK = (("board", "default"), ("deep", "default"), ("scene", "paper"))


@pytest.mark.parametrize(
    ("scene", "config"),
    [
        pytest.param(*case, marks=() if case in QUICK else pytest.mark.exhaustive)
        for case in DIGESTS
    ],
)
def test_whole_numbers_are_the_same_everywhere(device, scene, config):
    image = load(scene)
    settings = config_for(config, image)
    with Detector(shape=image.shape, dtype=image.dtype, config=settings, device=device) as detector:
        corners = detector(image)
        assert digest(detector.maps(image), corners) == DIGESTS[scene, config]
        assert digest(detector.maps(image), detector(image)) == DIGESTS[scene, config]


def test_scenes_have_corners_to_hash():
    assert {scene for scene, _ in DIGESTS} == set(SCENES)
    assert {config for _, config in DIGESTS} == set(CONFIGS)
    for scene in SCENES:
        image = load(scene)
        found = len(reference.detect(image, config_for("default", image)))
        assert found == 0 if scene == "noise" else found > 20


if __name__ == "__main__":
    for scene, config in DIGESTS:
        image = load(scene)
        settings = config_for(config, image)
        found = digest(reference.maps(image, settings), reference.detect(image, settings))
        print(f'    ("{scene}", "{config}"): "{found}",')
