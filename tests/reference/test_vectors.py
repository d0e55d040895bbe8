"""The oracle against vectors computed by an implementation that shares no code with it."""

from pathlib import Path

import numpy as np
import pytest

from cmp_cl import reference
from cmp_cl.config import AdaptiveMean, BinaryRings, DetectorConfig, RapidCriteria, SectorContrast

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "vectors"
NAMES = sorted(path.stem for path in FOLDER.glob("*.npz") if not path.stem.startswith("harmonic-"))
MAPS = (
    "binary",
    "inner",
    "outer",
    "inner_transitions",
    "outer_transitions",
    "sector_difference",
    "ring_difference",
    "corrosion",
    "candidate",
    "contrast",
    "response",
)


def load(name: str) -> tuple[dict[str, np.ndarray], DetectorConfig]:
    with np.load(FOLDER / f"{name}.npz") as file:
        vector = dict(file)
    contrast = None
    if vector["gate"].size:
        minimum, relative, noise = map(float, vector["gate"])
        contrast = SectorContrast(minimum=minimum, relative=relative, noise=noise)
    config = DetectorConfig(
        detection=BinaryRings(
            threshold=AdaptiveMean(window=int(vector["window"])),
            outer_radius=int(vector["outer_radius"]),
            criteria=RapidCriteria(corrosion_threshold=int(vector["corrosion_threshold"])),
            contrast=contrast,
        ),
        refinement=None,
        full_scale=int(vector["full_scale"]),
    )
    return vector, config


@pytest.mark.skipif(not NAMES, reason="the folder of test vectors is not beside the repository")
def test_there_are_fifteen_vectors():
    assert len(NAMES) == 15


@pytest.mark.parametrize("name", NAMES)
def test_every_map_equals_the_vector(name):
    vector, config = load(name)
    maps = reference.maps(vector["image"], config)
    for field in MAPS:
        values = getattr(maps, field)
        if field == "contrast" and config.detection.contrast is None:
            assert values is None
            continue
        assert values.dtype == vector[field].dtype, field
        np.testing.assert_array_equal(values, vector[field], err_msg=field)


@pytest.mark.parametrize("name", NAMES)
def test_the_maxima_equal_the_vector(name):
    vector, config = load(name)
    corners = reference.detect(vector["image"], config)
    np.testing.assert_array_equal(corners.pixel, vector["pixel"])
