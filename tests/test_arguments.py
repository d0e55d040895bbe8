"""Arguments of another type: one line names the argument, its type and the one expected."""

import numpy as np
import pytest
from stereo_data import gel, grid_of, points, toed_in_rig

from cmp_cl import (
    CalibrationError,
    CmpClError,
    ConfigError,
    FieldError,
    ImageError,
    StereoRig,
    build_grid,
    calibrate,
    detect,
    reference,
)
from cmp_cl.field import surface_normals
from cmp_cl.grid import align
from cmp_cl.measure import OneView, TwoViews, find_board
from cmp_cl.media.cameras import Source
from cmp_cl.motion import PlaneScale, contact_of, displacement, filter_positions
from cmp_cl.synthetic import random_scene
from cmp_cl.viz import Moment

GRID = grid_of(np.moveaxis(10.0 * np.mgrid[:5, :6], 0, -1))
ROW = grid_of(GRID.xy[:1])
IMAGE = np.zeros((60, 70), np.uint8)
SIZE = IMAGE.shape[::-1]
FIELD = displacement(points(gel(18, 19)), points(gel(18, 19)))


def several(views=None, **changed):
    """Calibrate a camera `a` of three views."""
    views = {"a": [GRID] * 3} if views is None else views
    return calibrate(views, **{"spacing": 1, "sizes": {"a": SIZE}, **changed})


def rig_of(matrix):
    return StereoRig(matrix, [], np.eye(3), [], np.eye(3), [1, 0, 0])


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: filter_positions(None), "grid must be of type Grid"),
        (lambda: displacement(None, GRID), "rest must be of type Points3D"),
        (lambda: displacement(GRID, IMAGE), "now must be of type Grid"),
        (lambda: displacement(GRID, GRID, scale=0.1), "scale must be of type PlaneScale"),
        (lambda: PlaneScale.of_cells(ROW, 1), "6 nodes at rest do not fix the plane"),
        (lambda: find_board(None, (9, 6)), "expected a NumPy array"),
        (lambda: find_board(np.zeros((9, 9, 3), np.uint8), (9, 6)), ".*COLOR_BGR2GRAY"),
        (lambda: TwoViews(IMAGE, None, None), "rig must be of type StereoRig"),
        (lambda: OneView(IMAGE, config="a"), "config must be of type DetectorConfig"),
        (lambda: toed_in_rig().triangulate(GRID, IMAGE), "right must be of type Grid"),
        (lambda: align([GRID, 3]), "each of grids must be of type Grid"),
        (lambda: contact_of(FIELD, deeper_than=None), "deeper_than must be of type Real"),
        (lambda: contact_of(FIELD, deeper_than=np.nan), "a depth must be a finite number"),
        (lambda: Moment.of(FIELD).maps("height"), "quantity must be of type Quantity"),
        (lambda: detect(IMAGE).advice(None), "expected a NumPy array"),
        (lambda: build_grid(GRID, IMAGE), "corners must be of type Corners"),
        (lambda: Source(0), "a source is named by a text such as '0' or .*, not 0$"),
        (lambda: reference.detect(IMAGE, "a"), "config must be of type DetectorConfig"),
        (lambda: several(lens="pinhole"), "lens must"),
        (lambda: random_scene(-1), "Scene.seed must"),
    ],
)
def test_a_wrong_argument_is_named_in_one_line(call, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CmpClError, match=f"^{said}") as refusal:
        call()
    assert "\n" not in str(refusal.value)
    assert not list(tmp_path.iterdir())


NO_NUMBERS = ("a", {}, [[1], [2, 3]], np.eye(3) * 1j)
LENGTHS = ("a", None, 0, -1, np.nan, np.inf, [1, 2])
OF_AN_ARRAY = "must be an array of numbers: .*$"
OF_A_LENGTH = "must be a positive number, not "


@pytest.mark.parametrize(
    ("call", "error", "said", "values"),
    [
        (rig_of, CalibrationError, f"K1 {OF_AN_ARRAY}", NO_NUMBERS),
        (lambda values: PlaneScale(values, "mm"), FieldError, f"matrix {OF_AN_ARRAY}", NO_NUMBERS),
        (surface_normals, FieldError, f"positions {OF_AN_ARRAY}", NO_NUMBERS),
        (lambda side: PlaneScale.of_cells(GRID, side), FieldError, f"side {OF_A_LENGTH}", LENGTHS),
        (GRID.to_opencv, ConfigError, f"spacing {OF_A_LENGTH}", LENGTHS),
        (lambda each: several(spacing=each), CalibrationError, f"spacing {OF_A_LENGTH}", LENGTHS),
    ],
)
def test_what_is_no_array_and_no_length_is_refused(call, error, said, values):
    for value in values:
        with pytest.raises(error, match=f"^{said}"):
            call(value)


def test_a_masked_image_is_refused_unless_nothing_is_masked():
    board = np.kron(np.indices((6, 7)).sum(0) % 2, np.full((16, 16), 200)).astype(np.uint8)
    found = detect(np.ma.masked_array(board, mask=False))
    np.testing.assert_array_equal(found.xy, detect(board).xy)
    assert len(found) == 30
    with pytest.raises(ImageError, match=r"got a masked array; image\.filled\(level\) converts"):
        detect(np.ma.masked_array(board, board > 100))


def test_an_image_of_the_other_byte_order_keeps_its_bits():
    swapped = np.zeros((6, 7), np.uint16).astype(np.dtype(np.uint16).newbyteorder("S"))
    with pytest.raises(ImageError, match=r"image\.astype\(numpy\.uint16\)"):
        detect(swapped)
