"""The oracle against vectors computed by an implementation that shares no code with it."""

from pathlib import Path

import numpy as np
import pytest

from cmp_cl import reference
from cmp_cl.config import AdaptiveMean, BinaryRings, DetectorConfig, RapidCriteria, SectorContrast

FOLDER = Path(__file__).resolve().parents[1] / "data"
SHARED = (
    Path(__file__).resolve().parents[3] / "shared" / "vectors"
)  # those of photographs, if it exists
FILES = {
    path.stem: path
    for path in sorted([*FOLDER.glob("*.npz"), *SHARED.glob("water-*.npz")])
    if not path.stem.startswith("harmonic-")
}
NAMES = list(FILES)
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
)
MOVED = {"water-default": (1, 1), "water-dense": (0, 5)}  # how many corners are new, how many gone


def load(name: str) -> tuple[dict[str, np.ndarray], DetectorConfig]:
    with np.load(FILES[name]) as file:
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


def test_there_are_twelve_vectors_without_photographs():
    assert len([name for name in NAMES if not name.startswith("water-")]) == 12


@pytest.mark.parametrize("name", NAMES)
def test_every_map_before_the_gate_equals_the_vector(name):
    vector, config = load(name)
    maps = reference.maps(vector["image"], config)
    for field in MAPS:
        values = getattr(maps, field)
        assert values.dtype == vector[field].dtype, field
        np.testing.assert_array_equal(values, vector[field], err_msg=field)


@pytest.mark.parametrize("name", NAMES)
def test_the_response_and_the_contrast_equal_the_vector_where_both_have_them(name):
    """In the vectors the gate comes before suppression: there the response is that after the
    gate, and every candidate has a contrast. Here it is the response before the gate, and only
    the maxima have a contrast."""
    vector, config = load(name)
    maps = reference.maps(vector["image"], config)
    if config.detection.contrast is None:
        np.testing.assert_array_equal(maps.response, vector["response"])
        assert maps.contrast is None
        return
    passed = vector["response"] > 0
    np.testing.assert_array_equal(maps.response[passed], vector["response"][passed])
    assert not maps.response[~maps.candidate].any()
    seen = maps.contrast != 0
    np.testing.assert_array_equal(maps.contrast[seen], vector["contrast"][seen])
    assert (seen | ~maps.maximum).all()


@pytest.mark.parametrize("name", NAMES)
def test_the_maxima_equal_the_vector(name):
    """On the photograph with the gate, candidates that the gate rejects move or suppress a maximum
    beside them. With the gate after suppression, those corners differ."""
    vector, config = load(name)
    corners = reference.detect(vector["image"], config)
    if name in MOVED:
        common = set(map(tuple, corners.pixel.tolist())) & set(map(tuple, vector["pixel"].tolist()))
        assert (len(corners) - len(common), len(vector["pixel"]) - len(common)) == MOVED[name]
        return
    np.testing.assert_array_equal(corners.pixel, vector["pixel"])
