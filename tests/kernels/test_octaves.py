"""Octaves: halving, the same rule in halved frames, and refinement there, as the oracle does."""

import cv2
import images
import numpy as np
import pytest
from cases import some
from comparison import assert_corners_equal, assert_maps_equal, assert_same_bytes
from corner_images import grain, to_nearest

from cmp_cl import DetectorConfig, EdgeLines, Midlines, RingHarmonic
from cmp_cl.synthetic import boards

SHAPE = (263, 305)  # odd, also when halved
OCTAVES = DetectorConfig(detection=RingHarmonic(octaves=3))


def ink(cell, share, angle=0.2):
    """Return a board of sharp cells, whose edges the ink moves by a share of a cell, and its
    corners."""
    image, truth = images.board(*SHAPE, cell, angle=angle, blur=0.7, samples=3)
    grown = np.ones((2 * round(share * cell) + 1,) * 2)
    return cv2.erode(image, grown), truth


def drawn(seed):
    """Return a board with grown ink, blur and noise, white or correlated, of drawn sizes."""
    rng = np.random.default_rng(seed)
    image = ink(rng.uniform(8, 70), rng.uniform(0, 0.1), rng.uniform(0, 1.5))[0].astype(float)
    noise = cv2.GaussianBlur(rng.normal(0, 1, SHAPE), (0, 0), rng.uniform(0.3, 3))
    image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 4)) + 12 * noise / noise.std()
    return image.clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("seed", some([0, 1, 2, 11], (0, 11)))
@pytest.mark.parametrize(
    "config",
    [
        OCTAVES,
        OCTAVES.replace(refinement=EdgeLines()),
        OCTAVES.replace(refinement=Midlines()),
        DetectorConfig(
            detection=RingHarmonic(octaves=2, fine=False, noise=0.5, relative=0.05),
            refinement=None,
            nms_radius=7,
        ),
    ],
)
def test_corners_of_all_octaves_equal_the_oracle(detector_in_form, seed, config):
    image = drawn(seed)
    assert_corners_equal(detector_in_form(image, config), image)
    if config is OCTAVES:
        deep = image.astype(np.uint16) * 257
        assert_corners_equal(detector_in_form(deep, config), deep)


@pytest.mark.parametrize(("rows", "halved"), [(95, False), (96, True)])
def test_the_shorter_side_of_a_halved_frame_has_48_px_or_more(detector_for, rows, halved):
    image = ink(40, 0.08)[0][:rows]
    found = assert_corners_equal(detector_for(image, OCTAVES), image)
    assert (found.octave > 0).any() == halved


def test_strict_bounds_of_noise_and_of_the_wide_ring_are_the_oracles(detector_in_form):
    """The noise bound of a halved frame decides here, and so does the frame's wide ring."""
    image = drawn(7)
    config = DetectorConfig(detection=RingHarmonic(noise=20, relative=0.5), refinement=None)
    assert len(assert_corners_equal(detector_in_form(image, config), image)) > 0


def dimmed(cell, angle, blur, light):
    """Return a board of wide cells whose columns have these shares of the light."""
    image, truth = images.board(*SHAPE, cell, angle=angle, blur=blur, samples=3)
    return light * image, truth


def joined(cell, share, blur, dark, light):
    """Return squares that ink joins: halved frames have the corners, and the frame but noise."""
    image, truth = ink(cell, share, angle=0.5)
    return dark + light * cv2.GaussianBlur(image.astype(float), (0, 0), blur), truth


BRIGHT, DARK = np.linspace(0.4, 1, SHAPE[1]), np.geomspace(1, 0.1, SHAPE[1])


@pytest.mark.parametrize(
    ("scene", "inside", "strength", "smooth", "seed"),
    [
        *((dimmed(60, 0.3, 1.5, BRIGHT), 15, 12, smooth, 3) for smooth in (1, 2, 3)),
        *((joined(43, 0.09, 1.3, 13, 0.6), 20, 12, *noise) for noise in ((0.6, 3), (0.8, 24))),
        # no response of the frame is a corner's, and noise shows in the frame halved once too
        (joined(62, 0.08, 2, 40, 0.5), 20, 12, 1, 101),
        *((joined(62, 0.08, 2, 40, 0.5), 20, 9, 1.5, seed) for seed in (129, 133)),
        # noise in the dark is as strong for its grey, on one ring
        (dimmed(43, 0.38, 3, DARK), 20, 4, 2.0, 57),
        (dimmed(50, 0.64, 3, DARK), 20, 4, 1.5, 84),
    ],
)
def test_noise_beside_wide_or_joined_cells_is_no_corner(
    detector_in_form, scene, inside, strength, smooth, seed
):
    """The corners that lie so far inside are found, within 6 px, and no others."""
    grey, truth = scene
    image = (grey + strength * grain(SHAPE, smooth, seed)).clip(0, 255).astype(np.uint8)
    found = assert_corners_equal(detector_in_form(image, OCTAVES), image)
    for one, other in ((truth, found.xy), (found.xy, truth)):
        assert to_nearest(one[boards.inside(one, SHAPE, inside)], other).max() < 6
    none = DetectorConfig(detection=RingHarmonic(octaves=0))
    assert len(assert_corners_equal(detector_in_form(image, none), image)) > len(found) + 2


@pytest.mark.parametrize("cell", [9, 12, 20, 30])
def test_a_board_in_noise_that_pixels_share_keeps_its_corners(detector_in_form, cell):
    shape, (x, y) = (2 * SHAPE[0], 2 * SHAPE[1]), np.array([300, 260])
    board, truth = images.board(*shape, cell, angle=0, blur=0.7, samples=3)
    apart = np.abs(np.indices(shape)[::-1].transpose(1, 2, 0) - (x, y)).max(axis=2)
    noise = np.clip(128 + 60 * grain(shape, 1.8, 2), 0, 255).astype(np.uint8)
    image = np.where(apart < 3.4 * cell, board, noise)
    corners = truth[np.abs(truth - (x, y)).max(axis=1) < 2.9 * cell]
    found = assert_corners_equal(detector_in_form(image, OCTAVES), image)
    assert len(corners) > 20
    assert to_nearest(corners, found.xy).max() < 1


@pytest.mark.parametrize("blur", [0.8, 1.3])
def test_rows_of_a_board_seen_at_75_degrees_have_few_neighbours_and_are_found(
    detector_in_form, blur
):
    (tilt, _), (turn, _) = (
        cv2.Rodrigues(np.radians(axis)) for axis in ([75.0, 0, 0], [0, 0, 15.0])
    )
    lens = np.array([[500, 0, SHAPE[1] / 2], [0, 500, SHAPE[0] / 2], [0, 0, 1]])
    to_middle = np.array([[1, 0, -3], [0, 1, -1.5], [0, 0, 1]])
    to_image = lens @ np.column_stack([(tilt @ turn)[:, :2], [0, 0, 12]]) @ to_middle
    view = boards.drawn(boards.homography(to_image), SHAPE, (4, 7), blur=blur)
    found = assert_corners_equal(detector_in_form(view.image, OCTAVES), view.image)
    assert len(view.corners) == 28
    assert to_nearest(view.corners[:, :2], found.xy).max() < 1


@pytest.mark.parametrize(("cell", "name"), [(36, "4X4_50"), (40, "4X4_50"), (24, "6X6_250")])
def test_markers_do_not_hide_the_corners_beside_them(detector_in_form, cell, name):
    """Most neighbours of such a corner are modules of markers, whose directions differ."""
    markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name}"))
    sheet = cv2.aruco.CharucoBoard((8, 6), cell, 0.75 * cell, markers)
    image = sheet.generateImage((8 * cell + 40, 6 * cell + 40), marginSize=20)
    truth = 20 + cell * (1 + np.argwhere(np.ones((7, 5)))) - 0.5
    found = assert_corners_equal(detector_in_form(image, OCTAVES), image)
    assert np.count_nonzero(to_nearest(truth, found.xy) < 1) >= 30


@pytest.mark.parametrize("cell", [8, 12, 17])
def test_a_faint_pattern_of_small_cells_beside_wide_ones_is_found(detector_in_form, cell):
    image, _ = images.board(*SHAPE, 60, angle=0.3, blur=0.7, samples=3)
    small, truth = images.board(*SHAPE, cell, angle=0.2, blur=0.7, samples=3)
    image = np.where(np.arange(SHAPE[1]) < 150, image, 90 + 0.25 * (small - 128.0)).astype(np.uint8)
    inside = ((truth > (165, 15)) & (truth < (290, 248))).all(axis=1)
    found = assert_corners_equal(detector_in_form(image, OCTAVES), image)
    assert to_nearest(truth[inside], found.xy).max() < 1


@pytest.mark.parametrize("cell", [40, 50])
def test_squares_that_ink_joins_have_their_corners_in_a_halved_frame(detector_in_form, cell):
    image, truth = ink(cell, 0.08)
    found = detector_in_form(image, OCTAVES)(image)
    seen = truth[boards.inside(truth, SHAPE, cell / 2)]
    assert len(seen) > 8
    assert to_nearest(seen, found.xy).max() < 0.2
    inner = boards.inside(found.xy, SHAPE, cell)
    error, sigma = to_nearest(found.xy[inner], truth), found.sigma[inner]
    assert error.max() < 0.1 * cell
    assert (error < 2.5 * sigma).mean() > 0.9
    assert np.median(sigma) < 9 * np.sqrt(np.square(error).mean())  # the joints are even
    assert (found.octave > 0).any()
    order = np.lexsort((found.pixel[:, 0], found.pixel[:, 1]))
    np.testing.assert_array_equal(order, np.arange(len(found)))


def test_an_octave_keeps_to_the_mask_and_a_batch_equals_the_loop(detector_in_form):
    image, _ = ink(50, 0.08)
    mask = np.zeros(SHAPE, np.bool_)
    mask[:, :150] = True
    masked = detector_in_form(image, OCTAVES, mask)
    assert_maps_equal(masked, image, mask=mask)
    corners = assert_corners_equal(masked, image, mask=mask)
    for one in masked.batch([image] * 3):
        assert_same_bytes(one, corners)
    assert 0 < len(corners) < len(detector_in_form(image, OCTAVES)(image))
    assert (corners.pixel[:, 0] < 150).all()
    detector = detector_in_form(image, OCTAVES)
    frames = [image, drawn(5), image[::-1].copy()]
    for one, frame in zip(detector.batch(frames), frames, strict=True):
        assert_same_bytes(one, detector(frame))
    assert_maps_equal(detector, image)
