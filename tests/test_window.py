"""Two cameras that look through a window: rays, points in space, and what a rig knows of it."""

import dataclasses
import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stereo_data import gel, toed_in_rig, views_of

from cmp_cl import CalibrationError, StereoRig, Window
from cmp_cl.space import Bias, PointStatus
from cmp_cl.synthetic.camera import straightened

GEL = Window((0.02, -0.03, 1.0), 20.0, ((5.0, 1.49),), 1.41)


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
    seen, _ = GEL.apparent(np.zeros(3), np.array([[0, 0, 24.9], [0, 0, 25.1]]))
    assert np.isnan(seen).all(axis=1).tolist() == [True, False]
    at, ahead = GEL.refracted(np.zeros(3), np.array([[0, 1.0, 0.01], [0, 0, -1.0], [0, 0, 1]]))
    for values in (at, ahead):
        assert np.isnan(values).all(axis=1).tolist() == [True, True, False]
    rig = rig_behind(GEL)
    beyond = dataclasses.replace(rig, window=dataclasses.replace(GEL, distance=80.0))
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
        dataclasses.replace(GEL, **changes)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("layers", [(), ((5.0, 1.49),), ((5.0, 1.49), (0.1, 1.33))])
def test_a_window_survives_the_file_of_its_rig(tmp_path, layers):
    window = dataclasses.replace(GEL, layers=layers)
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
    rig = rig_behind(GEL)
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
            window=GEL.moved(error[22:]),
        )
        seen = [np.hstack(each.project(rest.reshape(-1, 3))) for each in (rig, wrong)]
        slope = rig.slopes(rest.reshape(-1, 3))[1][..., number]
        np.testing.assert_allclose(seen[1] - seen[0], step * slope, rtol=0.02, atol=1e-3)
        wrong_before, wrong_now = (wrong.triangulate(*pair).xyz for pair in views)
        off = np.linalg.norm((wrong_now - wrong_before) - (now - before), axis=2)
        known = dataclasses.replace(rig, covariance=np.outer(error, error))
        stated = Bias(known, before).sigma(now - before)
        np.testing.assert_allclose(stated, off, rtol=0.1, atol=2e-5)
