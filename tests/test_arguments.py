"""Arguments of another type: one line names the argument, its type and the one expected."""

import re
from pathlib import Path

import numpy as np
import pytest
from stereo_data import gel, grid_of, points, toed_in_rig

from cmp_cl import (
    BinocularSplit,
    CalibrationError,
    CmpClError,
    ConfigError,
    Detector,
    DetectorConfig,
    FieldError,
    GridError,
    ImageError,
    StereoRig,
    build_grid,
    calibrate,
    detect,
    media,
    reference,
    series,
)
from cmp_cl.field import green_lagrange, surface_normals
from cmp_cl.filter import filter_grid
from cmp_cl.grid import align, refine_markers
from cmp_cl.measure import (
    OneView,
    TwoViews,
    find_board,
    trusted,
)
from cmp_cl.media.cameras import CameraSettings, Source
from cmp_cl.motion import PlaneScale, contact_of, displacement, filter_positions
from cmp_cl.pattern import Checkerboard
from cmp_cl.space import Camera, Lens, undistort
from cmp_cl.space.exports import save_cameras, save_corners
from cmp_cl.synthetic import (
    Scene,
    binocular_frame,
    default_rig,
    random_scene,
    render,
    render_stereo,
)
from cmp_cl.synthetic.scoring import score
from cmp_cl.viz import Moment, corner_overlay, grid_overlay, save_figure, sheet_figure

GRID = grid_of(np.moveaxis(10.0 * np.mgrid[:5, :6], 0, -1))
IMAGE = np.zeros((60, 70), np.uint8)
SIZE = IMAGE.shape[::-1]
BOARD = Path(media.__file__).parent / "data" / "board.png"
CAMERA = Camera(
    lens=Lens.PINHOLE,
    size=SIZE,
    matrix=np.eye(3),
    distortion=np.zeros(5),
    R=np.eye(3),
    T=np.zeros(3),
    unit="mm",
)
FIELD = displacement(points(gel(4, 4)), points(gel(4, 4)))


@pytest.mark.parametrize(
    ("call", "name", "expected"),
    [
        (lambda: filter_positions(None), "now", "Grid"),
        (lambda: displacement(None, GRID), "rest", "Points3D"),
        (lambda: displacement(GRID, GRID, scale=0.1), "scale", "PlaneScale"),
        (lambda: TwoViews(IMAGE, None, None), "rig", "StereoRig"),
        (lambda: toed_in_rig().triangulate(GRID, IMAGE), "right", "Grid"),
        (lambda: BinocularSplit.halves(width="a", height=2), "width", "Integral"),
        (lambda: GRID.turned("a"), "quarters", "Integral"),
        (lambda: PlaneScale.of_cells(None, 1), "rest", "Grid"),
        (lambda: align([GRID, 3]), "each of grids", "Grid"),
        (lambda: several(["a"]), "views", "Mapping"),
        (lambda: toed_in_rig().triangulate(GRID, GRID, sigma="a"), "sigma", "Real"),
        (lambda: BinocularSplit((0, 0, 9, 9), (9, 0, 9, 9), "no"), "mirror_left", "bool"),
        (lambda: OneView(IMAGE, config="a", full_scale=255), "config", "DetectorConfig"),
        (lambda: contact_of(FIELD, deeper_than=None), "deeper_than", "Real"),
        (lambda: Moment.of(None), "field", "DisplacementField"),
        (lambda: render(None), "scene", "Scene"),
        (lambda: trusted(GRID, "a"), "max_sigma", "Real"),
        (lambda: CameraSettings(size=(9, "a")), "each of size", "Integral"),
        (lambda: media.write_image("a.png", None), "image", "ndarray"),
        (lambda: corner_overlay(IMAGE, GRID), "corners", "Corners"),
        (lambda: grid_overlay(IMAGE, None), "grid", "Grid"),
        (lambda: series.SeriesWriter("a.npz", description="mm"), "description", "Description"),
        (lambda: build_grid(GRID, IMAGE), "corners", "Corners"),
        (lambda: refine_markers(None, 1, IMAGE), "dense", "Grid"),
        (lambda: save_figure("a.png", None), "figure", "Figure"),
        (lambda: Source(0), "name", "str"),
        (lambda: binocular_frame(None, None), "left", "Rendered"),
        (lambda: reference.detect(IMAGE, "a"), "config", "DetectorConfig"),
    ],
)
def test_an_argument_of_another_type_is_named(call, name, expected):
    with pytest.raises(CmpClError, match=f"^{name} must be of type {expected}, not "):
        call()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: find_board(IMAGE, None), "shape must be (rows, columns), each at least 1"),
        (lambda: trusted(GRID, np.nan), "max_sigma must be above 0 px, not nan"),
        (lambda: refine_markers(GRID, 1, IMAGE, contrast="a"), "contrast must be a number in"),
        (lambda: Checkerboard(shape=5, cell=2), "shape must be (rows, columns), each at least 1"),
        (lambda: Checkerboard(shape=(5, 6), cell=2, paper=()), "paper must be a tuple of two"),
        (
            lambda: save_figure("a.png", sheet_figure(Moment.of(FIELD)), dpi=0),
            "dpi must be a number in",
        ),
        (lambda: score(1, [(0, 0)], 5), "found must be (N, 2), not ()"),
        (lambda: score([], [(0, 0)], "a"), "cell must be a positive number, not 'a'"),
        (lambda: media.find_inputs(None), "paths must be several names of files, not None"),
        (lambda: DetectorConfig().grey_levels(float), "dtype must be uint8 or uint16, not float64"),
    ],
)
def test_a_value_that_makes_no_sense_is_named(call, message):
    with pytest.raises((CmpClError, FileNotFoundError), match=f"^{re.escape(message)}"):
        call()


def several(views=None, sizes=None, **changed):
    """Calibrate a camera `a` of three views."""
    views, sizes = ({"a": [GRID] * 3} if views is None else views), sizes or {"a": SIZE}
    return calibrate(views, **{"spacing": 1, "sizes": sizes, **changed})


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: undistort([[1, 2]], np.eye(2), np.zeros(5)), "matrix"),
        (lambda: undistort([[1, 2]], np.eye(3), np.zeros(3)), "distortion"),
        (lambda: several([GRID]), "views"),
        (lambda: several({"a": GRID}), r"views\['a'\]"),
        (lambda: several(sizes=[SIZE]), "sizes"),
        (lambda: several(sizes={"a": (9, 0)}), r"sizes\['a'\]"),
        (lambda: several(lens="pinhole"), "lens"),
        (lambda: several(unit=3), "unit"),
        (lambda: default_rig(5), "shape"),
        (lambda: save_corners("a.vnl", {"a.png": 3}), r"views\['a.png'\]"),
        *(
            (lambda cameras=cameras: save_cameras("a.yaml", cameras), name)
            for cameras, name in [
                (None, "cameras"),
                ({}, "cameras"),
                ({"a": 3}, r"cameras\['a'\]"),
                ({3: CAMERA}, "each name of cameras"),
            ]
        ),
        (lambda: render_stereo(None, default_rig()), "scene"),
        (lambda: render_stereo(Scene(), None), "rig"),
        (lambda: render_stereo(Scene(), default_rig()._replace(K1="a")), "rig.K1"),
        (lambda: random_scene(-1), "seed"),
        (lambda: random_scene(1, indenter="a"), "Scene.indenter"),
    ],
)
def test_a_wrong_argument_is_named_in_one_line(call, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CmpClError, match=f"^{name} must (be|have) ") as refusal:
        call()
    assert "\n" not in str(refusal.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("path", [None, b"a.png", "", "a\0b"])
@pytest.mark.parametrize(
    ("call", "error"),
    [
        (media.read_image, ImageError),
        (lambda path: next(media.read_frames(path)), ImageError),
        (media.video_info, ImageError),
        (lambda path: media.write_image(path, IMAGE), ImageError),
        (lambda path: media.find_inputs([path]), FileNotFoundError),
        (StereoRig.load, CalibrationError),
        (toed_in_rig().save, FileNotFoundError),
        (DetectorConfig.load, ConfigError),
        (DetectorConfig().save, FileNotFoundError),
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
        (filter_grid, "values", GridError),
        (lambda values: filter_grid(GRID.xy, measured=values), "measured", GridError),
        (lambda values: score(values, [(0, 0)], 5), "found", FieldError),
        (lambda values: StereoRig(values, [], np.eye(3), [], np.eye(3), [1, 0, 0]), "K1", None),
        (
            lambda values: StereoRig(np.eye(3), values, np.eye(3), [], np.eye(3), [1, 0, 0]),
            "D1",
            None,
        ),
        (lambda values: PlaneScale(values, "mm"), "matrix", FieldError),
        (PlaneScale.pixels(), "xy", FieldError),
        (surface_normals, "positions", FieldError),
        (lambda values: green_lagrange(FIELD.position, values), "now", FieldError),
        (lambda values: undistort(values, np.eye(3), np.zeros(5)), "points", FieldError),
    ],
)
def test_what_is_no_array_of_numbers_is_refused_in_one_line(call, name, error, values):
    with pytest.raises(error, match=f"^{name} must be an array of numbers: .*$"):
        call(values)


@pytest.mark.parametrize(
    ("image", "hint"),
    [
        (media.Frame(0, IMAGE), "got Frame; its attribute image is one"),
        ([[1, 2], [3, 4]], "got list; numpy.asarray(image) converts"),
        (GRID, "got Grid"),
        (iter([IMAGE]), "got list_iterator"),
    ],
)
def test_what_is_no_image_gets_a_hint_that_helps(image, hint):
    with pytest.raises(ImageError, match=f"{re.escape(hint)}$"):
        detect(image)


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
        (lambda fps: CameraSettings(fps=0 if fps is None else fps), "fps", ConfigError),
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
