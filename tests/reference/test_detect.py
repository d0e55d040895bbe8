"""The oracle as a whole: boards, borders, tiny and flat images, masks."""

import numpy as np
import pytest
from configs import rings
from corner_images import board, corner

from cmp_cl import reference
from cmp_cl.config import (
    BinaryRings,
    DetectorConfig,
    SectorContrast,
    SpectralCriteria,
)

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
    distance = np.linalg.norm(corners.xy[:, None] - TRUTH, axis=2)
    assert (distance.min(axis=0) < 0.6).all()
    inside = ((corners.xy >= 6) & (corners.xy <= (113, 103))).all(axis=1)
    assert (distance.min(axis=1)[inside] < 0.6).all()
    assert corners.device == "NumPy"
    order = corners.pixel[:, 1] * 1000 + corners.pixel[:, 0]
    assert (np.diff(order) > 0).all()


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
@pytest.mark.parametrize("level", [0, 130, 255])
def test_flat_images_have_no_corner(config, level):
    for shape in [(1, 1), (2, 2), (1, 40), (40, 1), (30, 33)]:
        for dtype in (np.uint8, np.uint16):
            image = np.full(shape, level, dtype)
            assert len(reference.detect(image, config)) == 0


@pytest.mark.parametrize("inside", range(1, 6))
def test_corners_near_the_border_are_found(inside):
    image = corner(20, 20, 0.35)
    cut = image[20 - inside :, :]
    corners = reference.detect(cut, rings())
    assert np.linalg.norm(corners.xy - [20, inside], axis=1).min() < 1.5


def test_a_mask_limits_centres_and_not_samples():
    mask = np.zeros(IMAGE.shape, np.bool_)
    mask[40:70, 30:80] = True
    everything = reference.maps(IMAGE, rings())
    part = reference.maps(IMAGE, rings(), mask)
    np.testing.assert_array_equal(part.candidate, everything.candidate & mask)
    np.testing.assert_array_equal(part.inner, everything.inner)
    corners = reference.detect(IMAGE, rings(), mask)
    assert 0 < len(corners) < len(reference.detect(IMAGE))
    assert mask[corners.pixel[:, 1], corners.pixel[:, 0]].all()
    assert len(reference.detect(IMAGE, rings(), np.zeros_like(mask))) == 0


def test_maxima_outside_the_mask_do_not_raise_the_bound():
    faint = (corner(20, 20, 0.4) // 4 + 100).astype(np.uint8)
    image = np.hstack([faint, *[corner(20, 20, 0.4)] * 3])
    config = DetectorConfig(detection=BinaryRings(contrast=SectorContrast(relative=0.9)))
    mask = np.zeros(image.shape, np.bool_)
    mask[:, :41] = True
    assert not reference.maps(image, config).maximum[:, 10:30].any()
    assert reference.maps(image, config, mask).maximum[:, 10:30].any()


@pytest.mark.parametrize("seed", [20, 30])
def test_the_gate_rejects_salt_and_pepper(seed):
    image = IMAGE.copy()
    rng = np.random.default_rng(seed)
    hit = rng.random(IMAGE.shape) < 0.5
    image[hit] = np.where(rng.random(hit.sum()) < 0.5, 0, 255)
    gated, ungated = reference.maps(image, rings()), reference.maps(image, rings(contrast=None))
    assert not gated.maximum.any()
    assert ungated.maximum.sum() > 0
