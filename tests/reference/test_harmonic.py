"""The oracle of `RingHarmonic` against stored vectors, its definition, and at its limits."""

from pathlib import Path

import cv2
import images
import numpy as np
import pytest
from corner_images import board, corner, to_nearest

from cmp_cl import reference
from cmp_cl.config import DetectorConfig, RingHarmonic
from cmp_cl.reference import harmonic
from cmp_cl.synthetic.boards import inside

VECTORS = sorted((Path(__file__).resolve().parents[1] / "data").glob("harmonic-*.npz"))
DENSE = ("fine", "coarse", "coarse_response", "fine_response")


MADE_WITH = {"noise": 2.0, "relative": 24 / 128, "fine": True, "octaves": 0}  # the vectors


def corners_of(image, full_scale=None, mask=None, nms_radius=3, **rule):
    if full_scale is None:
        full_scale = 255 if image.dtype == np.uint8 else 65535
    mask = np.ones(image.shape, np.bool_) if mask is None else mask
    return harmonic.corners(image, RingHarmonic(**rule), nms_radius, full_scale, mask)


# --- against vectors -----------------------------------------------------------------------


def test_maps_numbers_and_corners_equal_the_vectors():
    assert len(VECTORS) == 9
    for path in VECTORS:
        with np.load(path) as file:
            vector = dict(file)
        image, full_scale = vector["image"], int(vector["full_scale"])
        found = corners_of(image, full_scale, **MADE_WITH)
        for ours, theirs in zip(DENSE, ("S1", "S3", "R5", "R3"), strict=True):
            np.testing.assert_array_equal(getattr(found.maps, ours), vector[theirs], err_msg=ours)
        assert found.bounds == (vector["bound5"], vector["bound3"])
        assert found.reference == vector["reference"]
        np.testing.assert_array_equal(found.fine, vector["kept"][:, 3] == 3)
        rule = RingHarmonic(**MADE_WITH)
        config = DetectorConfig(detection=rule, full_scale=full_scale, refinement=None)
        corners = reference.detect(image, config)
        np.testing.assert_array_equal(corners.pixel, vector["kept"][:, :2])
        np.testing.assert_array_equal(corners.response, vector["kept"][:, 2])


# --- by definition -------------------------------------------------------------------------


def test_the_reference_is_where_half_of_the_squares_are_reached():
    assert harmonic.reference(np.array([], np.int64)) == 0
    assert harmonic.reference(np.array([3, 5, 4])) == 5  # 2 * 25 reaches 50 exactly
    assert harmonic.reference(np.array([3, 4, 5, 1])) == 4
    many = np.concatenate([np.full(100, 1000), np.full(90_000, 30)])
    assert harmonic.reference(many) == 1000  # the 90th percentile would be 30
    assert harmonic.reference(np.full(200_000, 11_220)) == 11_220  # beyond 32 bits


# --- what each setting does ----------------------------------------------------------------


def test_squeezed_cells_are_found_by_the_small_ring_alone():
    image, truth = board(*images.SHAPE, 4.6)
    both, coarse = corners_of(image), corners_of(image, fine=False)
    assert coarse.maps.fine_response is None
    truth = truth[inside(truth, images.SHAPE, 6)]

    def seen(found):
        at = np.stack([found.x, found.y], axis=1)
        return (to_nearest(truth, at) < 2).mean()

    assert seen(both) == 1
    assert seen(coarse) < 0.1
    assert both.fine.mean() > 0.9


@pytest.mark.parametrize(
    ("angle", "x", "y", "grey"), [(0.2, 23, 18, 200), (0.4, 22, 18.5, 200), (0.6, 23, 19, 200)]
)
def test_a_corner_is_found_where_a_flake_of_the_print_beside_it_is_gone(angle, x, y, grey):
    """A flake of 3 px disturbs the ring of 4 px more than that of 5 px."""
    rows, columns = np.indices((41, 41))
    image = np.where(np.hypot(columns - x, rows - y) < 3, grey, corner(20, 20, angle))
    found = corners_of(image.astype(np.uint8), fine=False)
    assert (np.hypot(found.x - 20, found.y - 20) < 4).any()


@pytest.mark.parametrize(
    ("part", "dark", "bright"), [(6, 100, 100 + np.arange(41)), (12, 0, 100)], ids=["clean", "dark"]
)
def test_a_corner_in_a_shadow_is_kept_if_it_is_clean_or_lacks_light(part, dark, bright):
    """Of two corners with a sixth of the contrast, the one on a steep slope is not clean; of two
    with a twelfth, only the one in the dark lacks light."""
    whole = corner(20, 20, 0.4)
    image = np.hstack([whole] * 3 + [whole // part + dark, whole // part + bright])
    found = corners_of(image.astype(np.uint8), fine=False).x
    assert np.abs(found - 143).min() <= 1
    assert np.abs(found - 184).min() > 3
    if part == 6:
        clear = corners_of(image.astype(np.uint8), fine=False, relative=0.1).x
        assert np.abs(clear - 184).min() <= 1


# --- extremes ------------------------------------------------------------------------------


@pytest.mark.parametrize("blur", [0, 0.7, 1.2, 2.0])
@pytest.mark.parametrize("width", range(3, 12))
def test_stripes_at_any_angle_have_no_corner(width, blur):
    y, x = np.mgrid[:60, :70]
    for angle in np.arange(0.1, 0.8, 0.17):
        across = x * np.cos(angle) + y * np.sin(angle)
        stripes = np.where(np.floor(across / width) % 2 == 0, 30, 220).astype(np.float32)
        if blur:
            stripes = cv2.GaussianBlur(stripes, (0, 0), blur)
        found = corners_of(np.rint(stripes).astype(np.uint8))
        inside = (np.abs(found.x - 34.5) < 26) & (np.abs(found.y - 29.5) < 21)
        assert not inside.any(), angle


@pytest.mark.parametrize("cell", [6.0, 9.0, 15.0, 30.0, 60.0])
def test_boards_of_any_cell_are_found_with_one_setting(cell):
    image, truth = board(200, 220, cell, angle=0.2)
    corners = reference.detect(image, DetectorConfig())
    assert to_nearest(truth[inside(truth, image.shape, 6)], corners.xy).max() < 0.5
    assert to_nearest(corners.xy[inside(corners.xy, image.shape, 8)], truth).max() < 0.5
