"""Arguments of another type: one line names the argument, its type and the one expected."""

import numpy as np
import pytest
from stereo_data import grid_of, toed_in_rig

from cmp_cl import (
    BinocularSplit,
    CalibrationError,
    CmpClError,
    ConfigError,
    Detector,
    DetectorConfig,
    FieldError,
    ImageError,
    StereoRig,
    calibrate_camera,
    detect,
    drop_marks,
    media,
    series,
)
from cmp_cl.field import (
    PlaneScale,
    contact_of,
    displacement,
    motion_of,
    plane_displacement,
    plane_strain,
)
from cmp_cl.grid import filter_positions
from cmp_cl.measure import TwoViews

GRID = grid_of(np.moveaxis(10.0 * np.mgrid[:5, :6], 0, -1))
IMAGE = np.zeros((60, 70), np.uint8)


@pytest.mark.parametrize(
    ("call", "name", "expected"),
    [
        (lambda: filter_positions(None), "now", "Grid"),
        (lambda: filter_positions(GRID, rest=3), "rest", "Grid"),
        (lambda: plane_displacement(None, GRID), "rest", "Grid"),
        (lambda: plane_displacement(GRID, None), "now", "Grid"),
        (lambda: plane_displacement(GRID, GRID, 0.1), "scale", "PlaneScale"),
        (lambda: displacement(GRID, GRID), "rest", "Points3D"),
        (lambda: plane_strain(GRID), "field", "PlaneField"),
        (lambda: motion_of(GRID), "field", "PlaneField"),
        (lambda: contact_of(GRID, deeper_than=1.0), "field", "DisplacementField"),
        (lambda: drop_marks(GRID, IMAGE), "corners", "Corners"),
        (lambda: TwoViews(IMAGE, None, None), "rig", "StereoRig"),
        (lambda: TwoViews(IMAGE, toed_in_rig(), (0, 1)), "split", "BinocularSplit"),
        (lambda: toed_in_rig().triangulate(GRID, IMAGE), "right", "Grid"),
        (lambda: BinocularSplit.halves(width="a", height=2), "width", "int"),
        (lambda: GRID.turned("a"), "quarters", "int"),
        (lambda: GRID.cut_to(None), "rest", "Grid"),
        (lambda: PlaneScale.of_cells(None, 1), "rest", "Grid"),
    ],
)
def test_an_argument_of_another_type_is_named(call, name, expected):
    with pytest.raises(CmpClError, match=f"^{name} must be of type {expected}, not "):
        call()


@pytest.mark.parametrize("path", [None, 5, b"a.png", "", "a\0b"])
@pytest.mark.parametrize(
    ("call", "error"),
    [
        (media.read_image, ImageError),
        (lambda path: next(media.read_frames(path)), ImageError),
        (media.frame_rate, ImageError),
        (lambda path: media.write_image(path, IMAGE), ImageError),
        (lambda path: media.find_inputs([path]), FileNotFoundError),
        (lambda path: media.write_csv(path, [], []), FileNotFoundError),
        (StereoRig.load, CalibrationError),
        (toed_in_rig().save, FileNotFoundError),
        (DetectorConfig.load, ConfigError),
        (DetectorConfig().save, FileNotFoundError),
        (series.read_series, ConfigError),
        (series.open_series, ConfigError),
        (series.SeriesWriter, FileNotFoundError),
    ],
)
def test_what_names_no_file_is_refused(call, error, path):
    with pytest.raises(error, match=r"^path must be the name of a file, not "):
        call(path)


def test_frames_that_are_not_several_are_refused():
    with Detector(shape=IMAGE.shape) as detector:
        with pytest.raises(ImageError, match=r"^frames must be several images, not int$"):
            list(detector.stream(5))
        with pytest.raises(ImageError, match=r"^stack must be several images, not NoneType$"):
            detector.batch(None)


@pytest.mark.parametrize("length", ["a", None, 0, -1, np.nan, np.inf, [1, 2]])
@pytest.mark.parametrize(
    ("call", "name", "error"),
    [
        (PlaneScale.of_pixel, "length", FieldError),
        (lambda side: PlaneScale.of_cells(GRID, side), "side", FieldError),
        (GRID.to_opencv, "spacing", ConfigError),
        (
            lambda side: calibrate_camera([], spacing=side, image_size=(70, 60)),
            "spacing",
            CalibrationError,
        ),
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
