"""Arguments of another type: one line names the argument, its type and the one expected."""

import numpy as np
import pytest
from stereo_data import gel, grid_of, points, toed_in_rig

from cmp_cl import (
    CalibrationError,
    CmpClError,
    ConfigError,
    DetectorConfig,
    FieldError,
    ImageError,
    StereoRig,
    build_grid,
    calibrate,
    detect,
    media,
    reference,
    series,
)
from cmp_cl.field import surface_normals
from cmp_cl.grid import align
from cmp_cl.measure import OneView, TwoViews, find_board
from cmp_cl.media.cameras import Source
from cmp_cl.motion import PlaneScale, contact_of, displacement, filter_positions
from cmp_cl.synthetic import random_scene, render
from cmp_cl.viz import Moment, corner_overlay, grid_overlay

GRID = grid_of(np.moveaxis(10.0 * np.mgrid[:5, :6], 0, -1))
IMAGE = np.zeros((60, 70), np.uint8)
SIZE = IMAGE.shape[::-1]
FIELD = displacement(points(gel(18, 19)), points(gel(18, 19)))


def several(views=None, **changed):
    """Calibrate a camera `a` of three views."""
    views = {"a": [GRID] * 3} if views is None else views
    return calibrate(views, **{"spacing": 1, "sizes": {"a": SIZE}, **changed})


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: filter_positions(None), "grid must be of type Grid"),
        (lambda: displacement(None, GRID), "rest must be of type Points3D"),
        (lambda: displacement(GRID, GRID, scale=0.1), "scale must be of type PlaneScale"),
        (lambda: find_board(None, (9, 6)), "expected a NumPy array"),
        (lambda: find_board(np.zeros((9, 9, 3), np.uint8), (9, 6)), ".*COLOR_BGR2GRAY"),
        (lambda: TwoViews(IMAGE, None, None), "rig must be of type StereoRig"),
        (lambda: OneView(IMAGE, config="a"), "config must be of type DetectorConfig"),
        (lambda: toed_in_rig().triangulate(GRID, IMAGE), "right must be of type Grid"),
        (lambda: align([GRID, 3]), "each of grids must be of type Grid"),
        (lambda: contact_of(FIELD, deeper_than=None), "deeper_than must be of type Real"),
        (lambda: Moment.of(None), "field must be of type DisplacementField"),
        (lambda: media.write_image("a.png", None), "image must be of type ndarray"),
        (lambda: corner_overlay(IMAGE, GRID), "corners must be of type Corners"),
        (lambda: grid_overlay(IMAGE, None), "grid must be of type Grid"),
        (lambda: Moment.of(FIELD).maps("height"), "quantity must be of type Quantity"),
        (lambda: detect(IMAGE).advice(None), "expected a NumPy array"),
        (lambda: build_grid(GRID, IMAGE), "corners must be of type Corners"),
        (lambda: Source(0), "a source is named by a text such as '0' or .*, not 0$"),
        (lambda: reference.detect(IMAGE, "a"), "config must be of type DetectorConfig"),
        (lambda: several({"a": GRID}), r"views\['a'\] must"),
        (lambda: several(sizes={"a": (9, 0)}), r"sizes\['a'\] must"),
        (lambda: several(lens="pinhole"), "lens must"),
        (lambda: render(None), "scene must be of type Scene"),
        (lambda: random_scene(-1), "Scene.seed must"),
    ],
)
def test_a_wrong_argument_is_named_in_one_line(call, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CmpClError, match=f"^{said}") as refusal:
        call()
    assert "\n" not in str(refusal.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("path", [None, b"a.png", "", "a\0b"])
@pytest.mark.parametrize(
    ("call", "error"),
    [
        (media.read_image, ImageError),
        (lambda path: next(media.read_frames(path)), ImageError),
        (lambda path: media.find_inputs([path]), FileNotFoundError),
        (StereoRig.load, CalibrationError),
        (toed_in_rig().save, FileNotFoundError),
        (DetectorConfig.load, ConfigError),
        (series.read_series, ConfigError),
        (series.SeriesWriter, ConfigError),
    ],
)
def test_what_names_no_file_is_refused(call, error, path):
    with pytest.raises(error, match=r"^path must be the name of a file, not .*$"):
        call(path)


@pytest.mark.parametrize("values", ["a", {}, [[1], [2, 3]], np.eye(3) * 1j])
@pytest.mark.parametrize(
    ("call", "name", "error"),
    [
        (lambda values: StereoRig(values, [], np.eye(3), [], np.eye(3), [1, 0, 0]), "K1", None),
        (lambda values: PlaneScale(values, "mm"), "matrix", FieldError),
        (surface_normals, "positions", FieldError),
    ],
)
def test_what_is_no_array_of_numbers_is_refused_in_one_line(call, name, error, values):
    with pytest.raises(error, match=f"^{name} must be an array of numbers: .*$"):
        call(values)


@pytest.mark.parametrize("length", ["a", None, 0, -1, np.nan, np.inf, [1, 2]])
@pytest.mark.parametrize(
    ("call", "name", "error"),
    [
        (lambda side: PlaneScale.of_cells(GRID, side), "side", FieldError),
        (GRID.to_opencv, "spacing", ConfigError),
        (lambda side: several(spacing=side), "spacing", CalibrationError),
    ],
)
def test_a_length_that_is_not_positive_is_refused(call, name, error, length):
    with pytest.raises(error, match=f"^{name} must be a positive number, not "):
        call(length)


def test_a_masked_image_is_refused_unless_nothing_is_masked():
    board = np.kron(np.indices((6, 7)).sum(0) % 2, np.full((16, 16), 200)).astype(np.uint8)
    found = detect(np.ma.masked_array(board, mask=False))
    np.testing.assert_array_equal(found.xy, detect(board).xy)
    assert len(found) == 30
    with pytest.raises(ImageError, match=r"got a masked array; image\.filled\(level\) converts"):
        detect(np.ma.masked_array(board, board > 100))
