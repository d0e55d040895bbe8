"""The paper's rule of the oracle: stored vectors, whole images."""

from pathlib import Path

import numpy as np
import pytest
from configs import rings
from corner_images import board, to_nearest

from cmp_cl import reference
from cmp_cl.config import (
    AdaptiveMean,
    BinaryRings,
    DetectorConfig,
    RapidCriteria,
    SectorContrast,
    SpectralCriteria,
)
from cmp_cl.reference.paper import ring, spectral
from cmp_cl.synthetic.boards import inside

FOLDER = Path(__file__).resolve().parents[1] / "data"
FILES = [path for path in sorted(FOLDER.glob("*.npz")) if not path.stem.startswith("harmonic-")]
assert len(FILES) == 12
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


def test_of_two_equal_rings_the_second_harmonic_decides():
    """It must exceed the first and the third, not only equal them."""
    first, second, third = spectral.magnitudes().T
    found = spectral.spectral(ring.all_rings(), ring.all_rings(), SpectralCriteria())
    exceeds = second > np.maximum(first, third) + 1e-9
    np.testing.assert_array_equal(found["candidate"], exceeds)
    assert (exceeds != (second > np.maximum(first, third) - 1e-9)).any()


# whole images

IMAGE, TRUTH = board(110, 120, 12)
CONFIGS = {
    "harmonic": DetectorConfig(),
    "rings": rings(),
    "radius 4": DetectorConfig(detection=BinaryRings(outer_radius=4)),
    "spectral": DetectorConfig(detection=BinaryRings(criteria=SpectralCriteria())),
    "no gate": DetectorConfig(detection=BinaryRings(contrast=None)),
    "paper": DetectorConfig.paper(40),
}


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_every_corner_of_a_board_is_found(config):
    corners = reference.detect(IMAGE, config)
    assert to_nearest(TRUTH, corners.xy).max() < 0.6
    assert to_nearest(corners.xy[inside(corners.xy, IMAGE.shape, 6)], TRUTH).max() < 0.6
    assert corners.device == "NumPy"
    order = corners.pixel[:, 1] * 1000 + corners.pixel[:, 0]
    assert (np.diff(order) > 0).all()


@pytest.mark.parametrize("seed", [20, 30])
def test_the_gate_rejects_salt_and_pepper(seed):
    image = IMAGE.copy()
    rng = np.random.default_rng(seed)
    hit = rng.random(IMAGE.shape) < 0.5
    image[hit] = np.where(rng.random(hit.sum()) < 0.5, 0, 255)
    gated, ungated = reference.maps(image, rings()), reference.maps(image, rings(contrast=None))
    assert not gated.maximum.any()
    assert ungated.maximum.sum() > 0
