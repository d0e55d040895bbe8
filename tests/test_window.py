"""Two cameras that look through a window: rays, points in space, what a rig knows of it, and its
calibration from the pattern that is seen through it."""

import dataclasses
import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stereo_data import gel, grid_of, toed_in_rig, views_of

from cmp_cl import CalibrationError, StereoRig, Window
from cmp_cl.space import Bias, PointStatus, calibrate_window
from cmp_cl.synthetic import default_rig
from cmp_cl.synthetic.camera import straightened

WINDOW = Window((0.02, -0.03, 1.0), 20.0, ((5.0, 1.49),), 1.41)


def rig_behind(window, **changes):
    return dataclasses.replace(toed_in_rig(), window=window, **changes)


medium = st.floats(1.0, 2.5)


@st.composite
def windows(draw):
    layers = draw(st.lists(st.tuples(st.floats(0, 30), medium), max_size=4))
    tilt = [draw(st.floats(-0.3, 0.3)) for _ in range(2)]
    return Window((*tilt, 1.0), draw(st.floats(1, 40)), layers, draw(medium))


@settings(deadline=None)
@given(windows(), st.floats(0, math.radians(60)), st.floats(-4, 4), st.floats(0, 50))
def test_a_point_on_the_ray_of_a_pixel_is_seen_at_that_pixel(window, angle, azimuth, depth):
    """Within 1e-6 px of a camera with a focal length of 1000 px, up to 60 degrees off the normal,
    and by bisection as by Newton's method."""
    one, two = window.axes
    across = math.cos(azimuth) * one + math.sin(azimuth) * two
    ray = math.cos(angle) * window.normal + math.sin(angle) * across
    centre = np.array([0.3, -0.2, 0.1])
    at, ahead = window.refracted(centre, ray[None])
    point = at[0] + (depth + 1e-9) * ahead[0]
    for seen in (
        window.apparent(centre, point[None])[0][0],
        straightened(window, centre, point),
    ):
        off = np.cross(seen - centre, ray) / np.linalg.norm(seen - centre)
        assert 1000 * np.linalg.norm(off) < 1e-6


def test_points_in_front_of_the_last_face_and_rays_that_miss_the_window_are_nan():
    seen, _ = WINDOW.apparent(np.zeros(3), np.array([[0, 0, 24.9], [0, 0, 25.1]]))
    assert np.isnan(seen).all(axis=1).tolist() == [True, False]
    at, ahead = WINDOW.refracted(np.zeros(3), np.array([[0, 1.0, 0.01], [0, 0, -1.0], [0, 0, 1]]))
    for values in (at, ahead):
        assert np.isnan(values).all(axis=1).tolist() == [True, True, False]
    rig = rig_behind(WINDOW)
    beyond = dataclasses.replace(rig, window=dataclasses.replace(WINDOW, distance=80.0))
    points = beyond.triangulate(*views_of(rig, gel()))
    assert (points.status == PointStatus.BEHIND).all()
    assert np.isnan(points.xyz).all()


def test_a_window_behind_the_right_camera_is_refused():
    with pytest.raises(CalibrationError, match="behind the right camera"):
        rig_behind(Window((1.0, 0, 0.1), 2.0, (), 1.4))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"normal": (0.0, 0.0, 0.0)}, "normal must point ahead of the left camera"),
        ({"normal": (0.0, 0.1, -1.0)}, "normal must point ahead of the left camera"),
        ({"distance": 0.0}, "lies behind the left camera"),
        ({"layers": ((-1.0, 1.49),)}, "a medium of the window has thickness -1"),
        ({"index": 0.9}, "a medium of the window has .* index 0.9"),
    ],
)
def test_an_impossible_window_is_refused_in_one_line(changes, words):
    with pytest.raises(CalibrationError, match=words) as refusal:
        dataclasses.replace(WINDOW, **changes)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("layers", [(), ((5.0, 1.49),), ((5.0, 1.49), (0.1, 1.33))])
def test_a_window_survives_the_file_of_its_rig(tmp_path, layers):
    window = dataclasses.replace(WINDOW, layers=layers)
    rig = rig_behind(window, covariance=np.diag(1 / np.arange(1.0, 27)), unit="um")
    rig.save(tmp_path / "rig.yaml")
    again = StereoRig.load(tmp_path / "rig.yaml")
    for name in ("K1", "D1", "K2", "D2", "R", "T", "unit", "covariance"):
        np.testing.assert_array_equal(getattr(again, name), getattr(rig, name))
    np.testing.assert_array_equal(again.window.normal, window.normal)
    for name in ("distance", "layers", "index"):
        assert getattr(again.window, name) == getattr(window, name)


def test_the_bias_of_a_field_is_what_an_error_of_the_rig_does_to_it():
    """For each parameter alone: a wrong one, in pixels of the right rig."""
    rest, press = gel(), gel() - np.array([0, 0, 1.0])
    rig = rig_behind(WINDOW)
    views = [views_of(rig, xyz) for xyz in (rest, press)]
    before, now = (rig.triangulate(*pair).xyz for pair in views)
    steps = {16: 1e-4, 17: 1e-4, 19: 0.02, 22: 1e-3, 23: 1e-3, 24: 0.05, 25: 1e-3}
    for number, step in steps.items():
        error = np.zeros(26)
        error[number] = step
        wrong = dataclasses.replace(
            rig,
            R=cv2.Rodrigues(cv2.Rodrigues(rig.R)[0].ravel() + error[16:19])[0],
            T=rig.T + error[19:22],
            window=dataclasses.replace(
                WINDOW.moved([*error[22:24], 0, 0]),
                distance=WINDOW.distance + error[24],
                index=WINDOW.index + error[25],
            ),
        )
        seen = [np.hstack(each.project(rest.reshape(-1, 3))) for each in (rig, wrong)]
        slope = rig.slopes(rest.reshape(-1, 3))[1][..., number]
        np.testing.assert_allclose(seen[1] - seen[0], step * slope, rtol=0.02, atol=1e-3)
        wrong_before, wrong_now = (wrong.triangulate(*pair).xyz for pair in views)
        off = np.linalg.norm((wrong_now - wrong_before) - (now - before), axis=2)
        known = dataclasses.replace(rig, covariance=np.outer(error, error))
        stated = Bias(known, before).sigma(now - before)
        np.testing.assert_allclose(stated, off, rtol=0.1, atol=2e-5)


# calibration

PITCH = 0.8  # mm
NODES = 26
FEW = 18  # enough for errors that are compared with their sigma
RIG = default_rig((1200, 800))
NORMAL = (RIG.R[2] + (0, 0, 1)) / np.linalg.norm(RIG.R[2] + (0, 0, 1))
GEL = 12.0  # mm
BEHIND = dataclasses.replace(RIG, window=Window(NORMAL, 40.0 - GEL, ((5.0, 1.49),), 1.41))
MEDIA = ((5.0, 1.49), (GEL, 1.41))
# A board of 12 views and a noise of .05 px leave about this covariance.
SIGMAS = [0.1, 0.1, 0.13, 0.1, 5e-4, 2e-3, 3e-5, 4e-5] * 2 + [1e-4, 2e-4, 3e-5, 2e-3, 1e-3, 5e-3]


def pattern(tilt=(0.0, 0.0), dome=0.0, nodes=NODES, along=NORMAL):
    """Return the nodes of a pattern at the end of the gel, tilted, rad, or on a dome, mm; along:
    the normal of the window."""
    normal = along / np.linalg.norm(along)
    row, column = np.mgrid[:nodes, :nodes] - (nodes - 1) / 2
    flat = PITCH * np.stack([column, row, np.zeros(row.shape)], axis=-1)
    if dome:  # a cylinder keeps the sides
        flat[..., 2] = dome * (1 - np.cos(flat[..., 0] / dome))
        flat[..., 0] = dome * np.sin(flat[..., 0] / dome)
    turn = cv2.Rodrigues(np.array([*tilt, 0.0]))[0]
    across = np.cross([0, 1.0, 0], normal)
    axes = np.stack([across, np.cross(normal, across), normal], axis=1)
    return flat @ (axes @ turn).T + 45.7 * normal * [0, 0, 1] / normal[2]


def views(xyz, rng, noise=0.05, rig=BEHIND, **how):
    return tuple(views_of(rig, xyz, rng, noise, **how))


def drawn(rng, true=RIG, share=1.0):
    """Return a rig in air that is off by a draw from its covariance, a share of it."""
    error = rng.normal(0, share * np.array(SIGMAS))
    focal = [np.diag([*error[k : k + 2], 0]) for k in (0, 8)]
    for matrix, k in zip(focal, (2, 10), strict=True):
        matrix[:2, 2] = error[k : k + 2]
    turn = cv2.Rodrigues(true.R)[0].ravel() + error[16:19]
    return StereoRig(
        true.K1 + focal[0],
        true.D1 + np.append(error[4:8], 0),
        true.K2 + focal[1],
        true.D2 + np.append(error[12:16], 0),
        cv2.Rodrigues(turn)[0],
        true.T + error[19:],
        covariance=np.diag(np.square(share * np.array(SIGMAS))),
    )


def fitted(rig, rest, stepped=None, **changes):
    given = {"pitch": PITCH, "media": MEDIA, "index_sigma": 0.0}
    return calibrate_window(rig, rest, stepped=stepped, **(given | changes))


def errors(window):
    """Return how far a window is off, by its estimated parameters, (4,)."""
    true = BEHIND.window
    tilt = true.axes @ (window.normal - true.normal)
    return np.array([*tilt, window.distance - true.distance, window.index - true.index])


@pytest.mark.parametrize("layers", [((5.0, 1.49),), ()], ids=["a pane", "the gel alone"])
@pytest.mark.parametrize("surface", [{"tilt": (0.03, -0.02)}, {"dome": 40.0}])
def test_the_window_is_found_from_equal_squares_of_any_surface(surface, layers):
    """However far the thickness that begins the search is off."""
    true = dataclasses.replace(BEHIND, window=dataclasses.replace(BEHIND.window, layers=layers))
    rest = views(pattern(**surface, nodes=FEW), np.random.default_rng(1), noise=0.0, rig=true)
    for thickness in (GEL - 3, GEL + 4):
        found = fitted(RIG, rest, media=(*layers, (thickness, 1.41)))
        np.testing.assert_allclose(errors(found.window), 0, atol=1e-4)  # of float32 pixels
        assert found.window.layers == layers


def pressed_by_1_mm(rig, rest, rng):
    """Return by how much a rig errs along the normal, and how much it says it may, mm."""
    before, now = (rig.triangulate(*views(xyz, rng, noise=0)).xyz for xyz in (rest, rest - NORMAL))
    shared = Bias(rig, before).covariance(now - before)
    return (now - before + NORMAL) @ NORMAL, np.sqrt(NORMAL @ shared @ NORMAL)


def test_a_press_is_right_to_a_percent_and_its_bias_sigma_covers_it():
    rng, windows, presses = np.random.default_rng(2), [], []
    for _ in range(8):
        rest = pattern(tilt=rng.normal(0, 0.02, 2), nodes=FEW)
        found = fitted(drawn(rng), views(rest, rng))
        windows.append(errors(found.window)[:3] / np.sqrt(np.diag(found.covariance)[22:25]))
        off, sigma = pressed_by_1_mm(found, rest, rng)
        assert np.abs(off).max() < 0.01
        presses.append(off / sigma)
    for scores in (windows, presses):
        assert 0.65 < np.sqrt(np.mean(np.square(scores))) < 1.4


def test_an_index_that_is_given_errs_by_what_it_is_said_to():
    rng, rest = np.random.default_rng(3), pattern()
    media = MEDIA[0], (GEL, 1.42)  # by .01 too much
    for sigma, low, high in ((0.01, 0.9, 1.1), (0.02, 0.45, 0.55), (0.0, 4.0, np.inf)):
        found = fitted(RIG, views(rest, rng), media=media, index_sigma=sigma)
        off, stated = pressed_by_1_mm(found, rest, rng)
        assert low < np.median(np.abs(off) / stated) < high
    with pytest.raises(CalibrationError, match="index_sigma must be a number from 0"):
        fitted(RIG, views(rest, rng), index_sigma=-0.1)
    with pytest.raises(CalibrationError, match=r"known to 0.5 does not fix the window's distance"):
        fitted(RIG, views(rest, rng), index_sigma=0.5)


@pytest.mark.parametrize(
    ("surface", "noise"),
    [
        ({"nodes": FEW}, {"shared": True}),
        # noise of the depth makes the sides of a square longer, and turns them as it does so
        ({"tilt": (0.0, 0.4)}, {"noise": 0.4}),
    ],
    ids=["neighbours share errors", "noise of the depth"],
)
def test_sigma_of_a_window_is_that_of_its_errors(surface, noise):
    rng, scores = np.random.default_rng(3), []
    for _ in range(8):
        found = fitted(RIG, views(pattern(**surface), rng, **noise))
        scores.append(errors(found.window)[:3] / np.sqrt(np.diag(found.covariance)[22:25]))
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.5


def test_cameras_2_mm_apart_find_a_window_though_their_errors_exceed_the_noise():
    half = math.atan2(1.0, 45.0)
    turn, at = cv2.Rodrigues(np.array([0, 2 * half, 0]))[0], np.array([0, 0, math.hypot(1.0, 45.0)])
    near = dataclasses.replace(RIG, R=turn, T=at - turn @ at)
    ahead = near.R[2] + (0, 0, 1)
    window = dataclasses.replace(BEHIND.window, normal=ahead)
    rng, scores = np.random.default_rng(801000), []
    for _ in range(8):
        rig = drawn(rng, near, 0.3)
        seen = views_of(dataclasses.replace(near, window=window), pattern(along=ahead), rng, 0.05)
        found = fitted(rig, tuple(seen))
        tilt = window.axes @ (found.window.normal - window.normal)
        off = [*tilt, found.window.distance - window.distance]
        scores.append(off / np.sqrt(np.diag(found.covariance)[22:25]))
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.5


def test_the_index_from_a_step_is_as_certain_as_it_is_said_to_be():
    """Though noise parts nodes under the punch by more than 2 % of the step."""
    rng, scores = np.random.default_rng(9), []
    for _ in range(8):
        rest, stepped = stepped_by_1_mm(rng, noise=0.2)
        found = fitted(RIG, rest, (1.0, *stepped))
        scores.append(errors(found.window)[3] / np.sqrt(found.covariance[25, 25]))
    assert 0.4 < np.sqrt(np.mean(np.square(scores))) < 1.7


def stepped_by_1_mm(rng, noise=0.05):
    """Return the views at rest, and with a flat punch in the middle of the pattern."""
    row, column = np.mgrid[:NODES, :NODES] - (NODES - 1) / 2
    under = np.clip((9 - np.hypot(row, column)) / 2, 0, 1)[..., None]
    return [views(pattern() - each * NORMAL, rng, noise=noise) for each in (0 * under, under)]


@pytest.mark.parametrize("given", [1.38, 1.44])
def test_a_known_step_of_a_flat_punch_gives_the_index_too(given):
    rng = np.random.default_rng(4)
    rest, stepped = stepped_by_1_mm(rng)
    found = fitted(RIG, rest, (1.0, *stepped), media=(MEDIA[0], (GEL, given)))
    assert abs(errors(found.window)[3]) < 0.004
    sigma = np.sqrt(np.diag(found.covariance)[22:])
    assert (np.abs(errors(found.window)) < 4 * sigma).all()
    aside = views(pattern() + np.array([0.3, 0, 0]), rng)
    fewer = [grid_of(grid.xy[1:]) for grid in stepped]
    for then, words in (
        (rest, "0 nodes moved as one"),
        (aside, r"last index \(free\)"),
        (fewer, "rest has rows 0 to 25 .*, stepped rows 0 to 24"),
    ):
        with pytest.raises(CalibrationError, match=words):
            fitted(RIG, rest, (1.0, *then))


def test_a_window_that_the_views_do_not_fix_is_refused_by_name():
    rng = np.random.default_rng(5)
    rest = views(pattern(), rng)
    with pytest.raises(CalibrationError, match=r"tilt .*free.* distance \(free\)"):
        fitted(RIG, rest, media=((5.0, 1.0), (GEL, 1.0)))
    near = np.abs(np.mgrid[:NODES, :NODES] - (NODES - 1) / 2).max(axis=0) < 3
    few = [np.where(near[..., None], grid.xy, np.nan) for grid in rest]
    with pytest.raises(CalibrationError, match=r"do not fix the window's distance \(\+- .* mm\)"):
        fitted(RIG, tuple(grid_of(xy) for xy in few))


def test_views_that_are_no_grids_are_refused_by_name():
    rest = views(pattern(nodes=FEW), np.random.default_rng(770000))
    for first, then, words in (
        (rest[:1], None, "rest must be the grids of the left and the right view"),
        (None, None, "rest must be several, not one NoneType"),
        (rest, rest, "stepped must be a length and the grids of both views"),
        (rest, (1.0, rest[0], None), "each of the views of stepped must be of type Grid"),
        (rest, (-1.0, *rest), "the length of stepped must be a positive number, not -1"),
    ):
        with pytest.raises(CalibrationError, match=words):
            fitted(RIG, first, then)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"media": ()}, "at least the pattern's medium"),
        ({"pitch": 1.6}, "the squares of the pattern measure 0.8 mm, not 1.6"),
    ],
)
def test_wrong_layers_or_a_wrong_pitch_are_refused(changes, words):
    rest = views(pattern(), np.random.default_rng(6))
    with pytest.raises(CalibrationError, match=words):
        fitted(RIG, rest, **changes)


def test_swapped_views_and_a_rig_with_a_window_are_refused():
    rest = views(pattern(), np.random.default_rng(7))
    with pytest.raises(CalibrationError, match=r"nodes that fit the rig|do not fit the rig"):
        fitted(RIG, rest[::-1])
    with pytest.raises(CalibrationError, match="calibrated in air"):
        fitted(BEHIND, rest)
