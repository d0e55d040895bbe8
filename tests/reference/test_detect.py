"""The oracle as a whole: symmetries, borders, tiny and flat images, masks."""

import numpy as np
import pytest
from configs import rings
from corner_images import board, corner, noise

from cmp_cl import reference
from cmp_cl.config import (
    BinaryRings,
    DetectorConfig,
    EdgeLines,
    RingHarmonic,
    SectorContrast,
    SpectralCriteria,
)

IMAGE, TRUTH = board(110, 120, 12)
CONFIGS = {
    "rings": rings(),
    "radius 4": DetectorConfig(detection=BinaryRings(outer_radius=4)),
    "spectral": DetectorConfig(detection=BinaryRings(criteria=SpectralCriteria())),
    "no gate": DetectorConfig(detection=BinaryRings(contrast=None)),
    "paper": DetectorConfig.paper(40),
}
SYMMETRIES = {  # all others of a square are combinations of these
    "quarter turn": lambda image: np.rot90(image),
    "mirror": lambda image: np.fliplr(image),
}
LAYERED = ("binary", "candidate")
SINGLE = ("response", "score")
INVARIANT = (
    "inner_transitions",
    "outer_transitions",
    "sector_difference",
    "ring_difference",
    "corrosion",
    "spectrum_12",
    "spectrum_23",
    "correlation",
    "phase",
)


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


@pytest.mark.parametrize("symmetry", SYMMETRIES.values(), ids=SYMMETRIES)
@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
@pytest.mark.parametrize("image", [IMAGE, noise((50, 61))], ids=["board", "noise"])
def test_maps_rotate_and_reflect_with_the_image(symmetry, config, image):
    before, after = (reference.maps(each, config) for each in (image, symmetry(image).copy()))
    for name in (*LAYERED, *INVARIANT, *SINGLE):
        values = getattr(before, name)
        if values is None:
            assert getattr(after, name) is None
            continue
        layers = values if values.ndim == 3 else values[None]
        moved = getattr(after, name)
        moved_layers = moved if moved.ndim == 3 else moved[None]
        for one, other in zip(layers, moved_layers, strict=True):
            np.testing.assert_array_equal(symmetry(one), other, err_msg=name)


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_inverting_keeps_the_corners(config):
    config = config.replace(refinement=EdgeLines())  # centrelines are those of black sectors
    normal, inverted = (reference.detect(each, config).xy for each in (IMAGE, 255 - IMAGE))
    distance = np.linalg.norm(normal[:, None] - inverted, axis=2)
    assert len(normal) == len(inverted)
    assert distance.min(axis=0).max() < 0.3


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
@pytest.mark.parametrize("level", [0, 130, 255])
def test_flat_images_have_no_corner(config, level):
    for shape in [(1, 1), (2, 2), (1, 40), (40, 1), (30, 33)]:
        for dtype in (np.uint8, np.uint16):
            image = np.full(shape, level, dtype)
            assert len(reference.detect(image, config)) == 0
            assert not reference.maps(image, config).candidate.any()


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (2, 2), (3, 3), (5, 4), (11, 10)])
@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_images_smaller_than_ring_and_window_have_maps_of_their_shape(config, shape):
    image = noise(shape, seed=3)
    maps = reference.maps(image, config)
    assert maps.maximum.shape == shape
    assert np.isfinite(reference.detect(image, config).xy).all()


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


def test_a_mask_follows_the_working_scale():
    image, _ = board(120, 130, 24)
    mask = np.zeros(image.shape, np.bool_)
    mask[:, :65] = True
    corners = reference.detect(
        image, DetectorConfig(detection=RingHarmonic(octaves=0), scale=0.5), mask
    )
    assert len(corners) > 3
    assert corners.pixel[:, 0].max() <= 65


def test_sixteen_bits_find_what_eight_find():
    deep = reference.detect(IMAGE.astype(np.uint16) * 257, rings())
    plain = reference.detect(IMAGE, rings())
    np.testing.assert_array_equal(deep.pixel, plain.pixel)
    np.testing.assert_allclose(deep.xy, plain.xy, atol=1e-4)


@pytest.mark.parametrize("seed", [20, 30])
def test_the_gate_rejects_salt_and_pepper(seed):
    image = IMAGE.copy()
    rng = np.random.default_rng(seed)
    hit = rng.random(IMAGE.shape) < 0.5
    image[hit] = np.where(rng.random(hit.sum()) < 0.5, 0, 255)
    gated, ungated = reference.maps(image, rings()), reference.maps(image, rings(contrast=None))
    assert not gated.maximum.any()
    assert ungated.maximum.sum() > 0
