"""The paper's rule against vectors computed by an implementation that shares no code with it."""

from pathlib import Path

import numpy as np
import pytest

from cmp_cl import reference
from cmp_cl.config import AdaptiveMean, BinaryRings, DetectorConfig, RapidCriteria, SectorContrast

FOLDER = Path(__file__).resolve().parents[1] / "data"
FILES = [path for path in sorted(FOLDER.glob("*.npz")) if not path.stem.startswith("harmonic-")]
MAPS = (
    *("binary", "inner", "outer", "inner_transitions", "outer_transitions"),
    *("sector_difference", "ring_difference", "corrosion", "candidate"),
)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_maps_and_maxima_equal_the_vector(path):
    """In the vectors the gate comes before suppression: there the response is that after the gate,
    and every candidate has a contrast. Here only the maxima have one."""
    with np.load(path) as file:
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
    maps = reference.maps(vector["image"], config)
    for name in MAPS:
        assert getattr(maps, name).dtype == vector[name].dtype, name
        np.testing.assert_array_equal(getattr(maps, name), vector[name], err_msg=name)
    passed = (vector["response"] > 0) | (contrast is None)
    np.testing.assert_array_equal(maps.response[passed], vector["response"][passed])
    assert not maps.response[~maps.candidate].any()
    if contrast is not None:
        seen = maps.contrast != 0
        np.testing.assert_array_equal(maps.contrast[seen], vector["contrast"][seen])
        assert (seen | ~maps.maximum).all()
    corners = reference.detect(vector["image"], config)
    np.testing.assert_array_equal(corners.pixel, vector["pixel"])


def test_there_are_twelve_vectors():
    assert len(FILES) == 12
