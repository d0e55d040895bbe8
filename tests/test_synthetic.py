"""The scenes: the truth is where the image shows it, in both views and in space. A score tells
which corners are found, missed or false, how far off they are, and which numbers are right."""

import dataclasses
import math

import cv2
import numpy as np
import pytest
from configs import settings_of

import cmp_cl
from cmp_cl import synthetic
from cmp_cl.errors import ConfigError
from cmp_cl.synthetic import Indenter, Mode, Scene, Surround
from cmp_cl.synthetic.scoring import agreeing, match, score, total
from cmp_cl.synthetic.surface import surface

PRESSED = [kind for kind in Indenter if kind is not Indenter.NONE]
CLEAN = {"corrosion": 0.0, "noise": 0.0, "light": 0.0, "vignetting": 1.0, "bits": 12}


def saddles(image, points):
    """Return the saddle of the grey levels near each point, by quadrics over 5 x 5 samples.

    The fit is repeated around the saddle that it finds, where the symmetry of a corner cancels
    what is not quadratic.
    """
    grey = image.astype(np.float32)
    y, x = (grid.ravel() for grid in np.mgrid[-2:3, -2:3])
    fit = np.linalg.pinv(np.column_stack([np.ones(25), x, y, x * x, x * y, y * y]))
    found = []
    for point in points:
        for _ in range(4):
            window = cv2.getRectSubPix(grey, (5, 5), tuple(point)).astype(np.float64)
            _, a, b, aa, ab, bb = fit @ window.ravel()
            point = point - np.linalg.solve([[2 * aa, ab], [ab, 2 * bb]], [a, b])
        found.append(point)
    return np.array(found)


def test_the_same_seed_gives_the_same_bytes_and_another_tears_elsewhere():
    scene = synthetic.random_scene(7, markers=20, shape=(160, 200))
    first = synthetic.render(scene)
    again = synthetic.render(synthetic.random_scene(7, markers=20, shape=(160, 200)))
    other = synthetic.render(dataclasses.replace(scene, seed=8, noise=0.0))
    assert first.image.tobytes() == again.image.tobytes()
    assert first.truth.tobytes() == again.truth.tobytes() == other.truth.tobytes()
    assert np.abs(first.image.astype(int) - other.image).max() > 20


@pytest.mark.parametrize("markers", [20, 44])
@pytest.mark.parametrize(
    ("indenter", "mode", "severity"),
    [(Indenter.BALL, Mode.TWIST, 0.5), (Indenter.CUBE, Mode.SHEAR, 0.5)],
)
def test_truth_is_where_the_clean_image_shows_a_corner(markers, indenter, mode, severity):
    scene = Scene(
        markers=markers, indenter=indenter, mode=mode, severity=severity, direction=0.4, **CLEAN
    )
    rendered = synthetic.render(scene)
    assert rendered.truth.shape == (markers, markers, 2)
    truth = rendered.truth[1:-1:3, 1:-1:3].reshape(-1, 2)
    shown = saddles(rendered.image, truth)
    error = np.linalg.norm(shown - truth, axis=1)
    assert np.median(error) < 0.02
    assert error.max() < 0.1
    assert np.abs((shown - truth).mean(axis=0)).max() < 0.005


@pytest.mark.parametrize("mode", Mode)
@pytest.mark.parametrize("indenter", PRESSED)
def test_a_pattern_stays_in_the_image_unfolded_and_moves_with_severity(indenter, mode):
    scene = synthetic.random_scene(
        3, markers=20, severity=1.5, indenter=indenter, mode=mode, shape=(120, 160), corrosion=0.0
    )
    rendered = synthetic.render(scene)
    assert rendered.junctions.min() > 0
    assert (rendered.junctions < [159, 119]).all()
    down, across = np.diff(rendered.truth, axis=0)[:, :-1], np.diff(rendered.truth, axis=1)[:-1]
    area = across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0]
    assert area.min() > 0.3 * rendered.cell**2
    assert area.max() < 4 * rendered.cell**2
    moved = [
        synthetic.render(dataclasses.replace(scene, severity=severity)).truth
        for severity in (0.0, 0.25, 0.75)
    ]
    largest = [np.linalg.norm(each - moved[0], axis=-1).max() for each in (*moved, rendered.truth)]
    assert largest[0] == 0
    assert (np.diff(largest) > 0.1).all()


def test_severity_one_is_a_press_of_2_mm_a_shear_of_1_2_mm_or_a_twist_of_20_degrees():
    cube = Scene(indenter=Indenter.CUBE)
    middle, near = np.zeros((1, 2)), np.array([[0.1, 0.0]])
    np.testing.assert_allclose(surface(cube, middle)[0], [0, 0, -2], atol=1e-9)
    shear = dataclasses.replace(cube, mode=Mode.SHEAR, direction=math.pi / 2)
    np.testing.assert_allclose(surface(shear, middle)[0], [0, 1.2, -1], atol=1e-9)
    twist = surface(dataclasses.replace(cube, mode=Mode.TWIST), near)[0]
    assert math.degrees(math.atan2(twist[1], twist[0])) == pytest.approx(20, abs=0.01)


@pytest.fixture(scope="session")
def pair():
    scene = synthetic.random_scene(
        5, markers=20, indenter=Indenter.TORUS, mode=Mode.TWIST, shape=(600, 400)
    )
    rig = synthetic.default_rig((600, 400))
    return scene, rig, synthetic.render_stereo(scene, rig)


def test_points_in_space_project_to_the_truth_and_both_images_show_them(pair):
    scene, rig, (left, right, xyz) = pair
    for view, R, T, matrix, distortion in (
        (left, np.eye(3), np.zeros(3), rig.K1, rig.D1),
        (right, rig.R, rig.T, rig.K2, rig.D2),
    ):
        rotation = cv2.Rodrigues(R)[0]
        seen = cv2.projectPoints(xyz.reshape(-1, 3), rotation, T, matrix, distortion)[0]
        np.testing.assert_allclose(seen.reshape(view.truth.shape), view.truth, atol=1e-9)
        assert view.truth.min() > 0
        assert (view.truth < [399, 599]).all()
    clean = dataclasses.replace(scene, severity=0.5, **CLEAN)
    for view in synthetic.render_stereo(clean, rig)[:2]:
        truth = view.truth[1:-1:4, 1:-1:4].reshape(-1, 2)
        error = np.linalg.norm(saddles(view.image, truth) - truth, axis=1)
        assert np.median(error) < 0.03
        assert error.max() < 0.15
    frame = synthetic.binocular_frame(left, right)
    np.testing.assert_array_equal(frame, np.hstack([left.image, right.image]))


def test_the_gel_at_rest_is_a_flat_sheet_of_the_stated_size_in_front_of_the_cameras(pair):
    scene, rig, _ = pair
    rest = synthetic.render_stereo(scene.at_rest(), rig)[2]
    for axis in (0, 1):
        np.testing.assert_allclose(np.linalg.norm(np.diff(rest, axis=axis), axis=-1), 32 / 21)
    alone = synthetic.render(Scene(markers=20, indenter=Indenter.NONE, shape=(240, 320)))
    np.testing.assert_allclose(alone.truth.mean(axis=(0, 1)), [159.5, 119.5])
    np.testing.assert_allclose(np.ptp(alone.truth, axis=(0, 1)), 0.92 * 240 * 19 / 21)
    facing = Scene(markers=10, shape=(120, 80), indenter=Indenter.NONE)
    xyz = synthetic.render_stereo(facing, synthetic.default_rig((120, 80)))[2]
    np.testing.assert_allclose(xyz.mean(axis=(0, 1)), [0, 0, math.hypot(8, 45)], atol=1e-9)
    matrix = np.array([[500.0, 0, 249.5], [0, 500, 199.5], [0, 0, 1]])
    parallel = cmp_cl.StereoRig(
        matrix, np.zeros(5), matrix, np.zeros(5), np.eye(3), np.array([-6.0, 0, 0])
    )
    flat = Scene(markers=10, shape=(400, 500), indenter=Indenter.NONE)
    left, right, xyz = synthetic.render_stereo(flat, parallel)
    np.testing.assert_allclose(xyz.mean(axis=(0, 1)), [3, 0, 45], atol=1e-9)
    disparity = left.truth - right.truth
    np.testing.assert_allclose(disparity - [500 * 6 / 45, 0], 0, atol=1e-9)


def test_lenses_that_rendering_does_not_know_are_refused(pair):
    scene, rig, _ = pair
    rational = dataclasses.replace(rig, D2=[*rig.D2, 0.1, 0, 0])
    with pytest.raises(ConfigError, match="k1 k2 p1 p2 k3 only"):
        synthetic.render_stereo(scene, rational)


def other_value(scene, setting):
    """Return another value of a field than the scene's: the last of a kind, or near the middle."""
    value = getattr(scene, setting.name)
    if setting.name == "shape":
        return 160, 200
    if setting.limits is None:
        return list(type(value))[-1]
    low, high, _ = setting.limits
    middle = setting.kinds[0](low + 0.51 * (high - low))
    return (middle, middle) if isinstance(value, tuple) else middle


@pytest.fixture(scope="module")
def usual():
    """Return a scene and its image."""
    scene = Scene(markers=20, shape=(120, 160), indenter=Indenter.CUBE, surround=Surround.WHITE)
    return scene, synthetic.render(scene).image


@pytest.mark.parametrize("setting", settings_of(Scene), ids=lambda each: each.name)
def test_each_field_changes_the_image(usual, setting):
    scene, image = usual
    changed = dataclasses.replace(scene, **{setting.name: other_value(scene, setting)})
    other = synthetic.render(changed).image
    assert image.shape != other.shape or (image != other).any()


# scores

NOWHERE = (np.nan, np.nan)


@pytest.mark.parametrize(
    ("found", "truth", "partner"),
    [
        ([(1.2, 0), (0.9, 0)], [(0, 0), (2, 0)], [1, 0]),
        ([(0.9, 0), (0.1, 0)], [(0, 0), (2, 0)], [1, 0]),
        ([(0.9, 0), (0.1, 0)], [(0, 0)], [-1, 0]),
    ],
)
def test_the_nearest_pair_is_made_first(found, truth, partner):
    assert list(match(found, truth, 3)) == partner


@pytest.mark.parametrize(
    ("detections", "truth", "ignored", "counts"),
    [  # found, missed, false
        ([(0, 0), (50, 50)], [(0, 0), (10, 0), (20, 0)], [], (1, 2, 1)),
        ([(0, 0), (1, 0)], [(0, 0)], [], (1, 0, 1)),
        ([(0, 0), (30, 1)], [(0, 0)], [(30, 0)], (1, 0, 0)),
        ([(0, 0), (30, 4)], [(0, 0)], [(30, 0)], (1, 0, 1)),
        ([NOWHERE, (0, 0)], [(0, 0), NOWHERE], [], (1, 0, 0)),
        ([], [(5, 5)], [], (0, 1, 0)),
    ],
)
def test_each_detection_finds_one_corner_or_is_false(detections, truth, ignored, counts):
    one = score(detections, truth, 10, ignored=ignored)
    assert (one.found, one.missed, one.false) == counts
    assert one.success == (counts[1:] == (0, 0))


def test_a_detection_finds_a_corner_within_the_distance_that_is_asked_for():
    assert [score([(5, 0)], [(0, 0)], 40, within=most).found for most in (None, 4, 6)] == [0, 0, 1]


def test_errors_are_distances_and_frames_add_up():
    truth = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1) * 10
    one = score(truth[::-1] + np.array([0.3, 0.4]), truth, 10)
    assert one.rmse == pytest.approx(0.5)
    both = total([one, score([], [(5, 5)], 10)])
    assert (both.frames, both.success, both.expected, both.found, both.missed) == (2, 1, 13, 12, 1)
    assert len(both.errors) == 12


TRUE = np.argwhere(np.ones((4, 5)))  # numbers of a board, row by row
ASIDE = TRUE + np.array([0, 1])


@pytest.mark.parametrize(
    ("numbers", "right", "on_the_board"),
    [
        (TRUE, 20, 20),
        (np.array([3, 4]) - TRUE, 20, 20),  # turned by 180 degrees
        (TRUE[:, ::-1], 20, 20),  # mirrored
        (ASIDE, 20, 1),
        (np.where(TRUE[:, :1] < 2, TRUE, ASIDE), 10, 10),
        (np.where(TRUE[:, :1] < 1, TRUE, ASIDE), 15, 5),
    ],
)
def test_numbers_are_right_up_to_one_motion_of_the_lattice(numbers, right, on_the_board):
    assert agreeing(numbers, TRUE).sum() == right
    assert agreeing(numbers, TRUE, (4, 5)).sum() == on_the_board
    assert len(agreeing(TRUE[:0], TRUE[:0])) == 0
