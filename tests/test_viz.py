"""Pictures: every corner is marked at its position, in the colour of its method."""

import dataclasses
import subprocess
import sys

import cv2
import numpy as np
import pytest
from stereo_data import field_of, gel, grid_of

from cmp_cl.corners import Corners, Method
from cmp_cl.errors import FieldError
from cmp_cl.grid import NodeStatus
from cmp_cl.viz import (
    METHOD_COLOURS,
    STATUS_COLOURS,
    RerunLog,
    arrow_figure,
    corner_overlay,
    grid_overlay,
    save_figure,
    surface_figure,
)


def corners_at(xy, method):
    xy = np.asarray(xy, np.float32).reshape(-1, 2)
    count = len(xy)
    return Corners(
        xy=xy,
        pixel=np.rint(xy).astype(np.int32),
        octave=np.zeros(count, np.uint8),
        response=np.ones(count, np.float32),
        method=np.broadcast_to(np.uint8(method), (count,)).copy(),
        sigma=np.full(count, np.nan, np.float32),
        edges=np.full((count, 4), np.nan, np.float32),
        doubtful=np.zeros(count, bool),
        refusal=np.zeros(count, np.uint8),
        device="none",
    )


@pytest.mark.parametrize("method", Method)
def test_the_centre_of_the_marks_is_the_corner(method):
    image = np.full((100, 200), 128, np.uint8)
    xy = [[40.25, 50.5], [159.6, 20.0]]
    picture = corner_overlay(image, corners_at(xy, method))
    factor = 1000 // 200
    assert picture.shape == (100 * factor + 36, 1000, 3)
    rows, columns = np.nonzero((picture[: 100 * factor] != 128).any(axis=2))
    for x, y in xy:
        expected = np.array([(y + 0.5) * factor - 0.5, (x + 0.5) * factor - 0.5])
        distance = np.hypot(rows - expected[0], columns - expected[1])
        near = distance < 50
        assert distance[near].min() < 1  # the dot
        assert distance[near].max() > 10  # the circle
        centre = np.array([rows[near].mean(), columns[near].mean()])
        np.testing.assert_allclose(centre, expected, atol=0.15)


def test_colours_and_legend_tell_the_methods_apart():
    assert len(set(METHOD_COLOURS.values())) == len(Method)
    image = np.full((400, 900), 128, np.uint8)
    xy = [[100 + 120 * method, 200] for method in Method]
    picture = corner_overlay(image, corners_at(xy, list(Method)))
    for method in Method:
        marked = (picture == METHOD_COLOURS[method]).all(axis=2)
        assert marked[:-36].any(), method.name
        assert marked[-36:].any(), f"{method.name} in the legend"


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (1, 1), (3, 2000), (2500, 10)])
def test_an_image_of_any_size_can_be_drawn(shape):
    image = np.zeros(shape, np.uint8)
    picture = corner_overlay(image, corners_at([], Method.KEPT))
    assert picture.dtype == np.uint8
    assert picture.shape[0] >= shape[0] + 36
    assert picture.shape[1] >= shape[1]


def test_an_image_of_any_depth_is_stretched_to_be_seen_and_left_as_it_was():
    deep = np.full((600, 1200), 1000, np.uint16)
    deep[:, :600] = 4000
    before = deep.copy()
    picture = corner_overlay(deep, corners_at([], Method.KEPT))
    assert set(np.unique(picture[:1200])) == {64, 255}
    np.testing.assert_array_equal(deep, before)


def test_small_cells_are_enlarged_until_they_can_be_judged():
    x, y = np.meshgrid(np.arange(5, 595, 8), np.arange(5, 395, 8))
    corners = corners_at(np.column_stack([x.ravel(), y.ravel()]), Method.EDGE_LINES)
    picture = corner_overlay(np.zeros((400, 600), np.uint8), corners)
    assert picture.shape[:2] == (400 * 4 + 36, 600 * 4)


def lattice(rows=4, columns=5, step=20.0):
    row, column = np.indices((rows, columns))
    return np.stack([30 + step * column, 25 + step * row], axis=-1)


def test_nodes_have_the_colour_of_their_status_and_lines_join_neighbours():
    xy = lattice()
    xy[1, 2] = np.nan
    grid = grid_of(xy)
    grid.status[2] = list(NodeStatus)[1:]
    picture = grid_overlay(np.full((125, 250), 128, np.uint8), grid)
    factor = 4

    def pixel(x, y):
        return tuple(picture[round((y + 0.5) * factor), round((x + 0.5) * factor)].tolist())

    for (row, column), status in np.ndenumerate(grid.status):
        x, y = lattice()[row, column]
        if status != NodeStatus.MISSING:
            assert pixel(x, y) == STATUS_COLOURS[status]
    grey = (128, 128, 128)
    assert pixel(70, 45) == grey  # the missing node
    assert pixel(60, 45) == pixel(70, 35) == pixel(70, 55) == grey  # no line to it
    assert pixel(40, 45) != grey
    lines = {"first row": (40, 25), "second row": (40, 45), "first column": (30, 35)}
    blue, _, red = np.transpose([pixel(*place) for place in lines.values()]).astype(int)
    assert (red > blue).tolist() == [True, False, False]
    assert blue[2] > blue[1]


def test_corners_off_the_grid_are_faint_rings():
    grid = grid_of(lattice())
    grid = dataclasses.replace(grid, index=np.vstack([grid.index, [[-1, -1]]]).astype(np.int32))
    found = corners_at(np.vstack([lattice().reshape(-1, 2), [[180, 60]]]), Method.CENTROID)
    image = np.full((125, 250), 128, np.uint8)
    picture = grid_overlay(image, grid, corners=found)
    plain = grid_overlay(image, grid)
    changed = (picture[:500] != plain[:500]).any(axis=2)
    y, x = np.nonzero(changed)
    assert np.hypot(x / 4 - 180, y / 4 - 60).max() < 8
    assert np.abs(picture[:500].astype(int) - 128)[changed].max() < 80
    assert (picture[500:] != plain[500:]).any()  # the legend
    with pytest.raises(FieldError, match="20 corners, not 21"):
        grid_overlay(image, grid_of(lattice()), corners=found)


def test_no_two_statuses_share_a_colour():
    assert STATUS_COLOURS.keys() == set(NodeStatus)
    assert len(set(STATUS_COLOURS.values())) == len(NodeStatus)


def test_an_empty_grid_can_be_drawn():
    picture = grid_overlay(np.zeros((40, 40), np.uint16), grid_of(np.full((2, 2, 2), np.nan)))
    assert picture.shape[2] == 3
    assert not picture[: picture.shape[1]].any()


def test_arrows_go_from_rest_to_now(tmp_path):
    rest, now = lattice(), lattice() + np.array([3, -4])
    now[1, 1] = np.nan
    image = np.full((100, 140), 128, np.uint8)
    figure = arrow_figure(image, grid_of(rest), grid_of(now))
    arrows = figure.axes[0].collections[0]
    assert arrows.N == 19
    assert (arrows.angles, arrows.scale_units, arrows.scale) == ("xy", "xy", 1)
    np.testing.assert_allclose(arrows.U, 3, atol=1e-5)
    np.testing.assert_allclose(arrows.V, -4, atol=1e-5)
    np.testing.assert_allclose(arrows.get_array(), 5, atol=1e-5)
    assert figure.axes[0].child_axes[0].get_ylabel() == "displacement / px"
    save_figure(tmp_path / "a picture.png", figure)
    picture = cv2.imread(str(tmp_path / "a picture.png"))
    assert picture.shape[1] == 1080
    assert (picture != 255).any()


def test_arrows_are_coloured_by_the_displacement_in_space():
    field = field_of(gel(4, 5, depth=0), gel(4, 5, depth=0) + np.array([0, 3, 4]))
    image = np.zeros((100, 140), np.uint8)
    figure = arrow_figure(image, grid_of(lattice()), grid_of(lattice()), field=field)
    np.testing.assert_allclose(figure.axes[0].collections[0].get_array(), 5)
    assert figure.axes[0].child_axes[0].get_ylabel() == "displacement / mm"
    with pytest.raises(FieldError, match="one shape"):
        arrow_figure(image, grid_of(lattice()), grid_of(lattice(3, 5)))


def test_the_surface_shows_every_whole_cell_and_the_displacement(tmp_path):
    now = gel(9, 8)
    now[3, 3] = np.nan
    figure = surface_figure(field_of(gel(9, 8, depth=0), now))
    save_figure(tmp_path / "surface.png", figure)
    surface, arrows = figure.axes[0].collections
    assert len(surface.get_facecolor()) == 8 * 7 - 4
    assert 0 < len(arrows.get_segments()) <= 3 * 9 * 8
    height = np.nanmax(46 - now[..., 2])
    assert figure.axes[0].get_zlim()[1] == pytest.approx(height, rel=0.01)


def test_a_field_that_makes_no_surface_is_refused():
    nothing = np.full((3, 4, 3), np.nan)
    with pytest.raises(FieldError, match="0 nodes"):
        surface_figure(field_of(nothing, nothing))
    with pytest.raises(FieldError, match="line"):
        surface_figure(field_of(gel(1, 5, depth=0), gel(1, 5)))


def test_a_field_without_displacement_can_be_drawn(tmp_path):
    field = field_of(gel(3, 4, depth=0), gel(3, 4, depth=0))
    save_figure(tmp_path / "still.png", surface_figure(field))
    still = grid_of(lattice())
    save_figure(tmp_path / "arrows.png", arrow_figure(np.zeros((9, 9), np.uint8), still, still))
    for name in ("still.png", "arrows.png"):
        assert cv2.imread(str(tmp_path / name)).std() > 5


def test_a_recording_for_rerun_appears_as_a_whole(tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    path = tmp_path / "press.rrd"
    now = gel(4, 5)
    now[1, 1] = np.nan
    with pytest.raises(KeyboardInterrupt), RerunLog(path) as log:  # noqa: PT012
        for index in range(3):
            log.frame(
                index=index,
                time_ms=index * 33.3,
                image=np.zeros((100, 140), np.uint8),
                grid=grid_of(lattice()),
                field=field_of(gel(4, 5, depth=0), now),
            )
        assert not path.exists()
        raise KeyboardInterrupt
    assert path.read_bytes()[:3] == b"RRF"
    assert path.stat().st_size > 3000
    assert [entry.name for entry in tmp_path.iterdir()] == ["press.rrd"]


def recorded(path, column):
    """Return the logged values of that component, in the order of the frames."""
    chunk = pytest.importorskip("rerun.chunk", reason="this rerun-sdk reads no recordings")
    found = []
    for part in chunk.RrdReader(path).stream():
        batch = part.to_record_batch()
        if column in batch.schema.names:
            found += zip(batch["frame"].to_pylist(), batch[column].to_pylist(), strict=True)
    return [value for _, value in sorted(found)]


def test_a_recording_for_rerun_has_compressed_images_and_lines_that_end_at_gaps(tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    path = tmp_path / "press.rrd"
    noise = np.random.default_rng(0).normal(128, 40, (480, 640))
    view = cv2.GaussianBlur(noise, (0, 0), 2).astype(np.uint8)
    gap, nothing = lattice(), lattice()
    gap[1, 2] = np.nan
    nothing[:] = np.nan
    with RerunLog(path) as log:
        log.frame(index=0, time_ms=np.nan, image=view, grid=grid_of(gap))
        log.frame(index=1, time_ms=np.nan, image=view, grid=grid_of(nothing))
        log.frame(index=2, time_ms=np.nan, image=view.astype(np.uint16) * 257)
    assert path.stat().st_size < 5 * view.size / 2  # 4 as pixels
    pictures = [
        cv2.imdecode(np.array(blob[0], np.uint8), cv2.IMREAD_UNCHANGED)
        for blob in recorded(path, "EncodedImage:blob")
    ]
    for picture in pictures[:2]:
        assert np.abs(picture.astype(int) - view).max() < 12
    np.testing.assert_array_equal(pictures[2], view.astype(np.uint16) * 257)
    lines, none = recorded(path, "LineStrips2D:strips")
    assert sorted(map(len, lines)) == [2, 2, 2, 4, 4, 4, 4, 5, 5, 5]
    assert none == []


def test_a_recording_for_rerun_has_nodes_by_displacement_their_number_and_the_rate(tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    path = tmp_path / "press.rrd"
    moved = np.linspace(0, 2, 20).reshape(4, 5)
    moved[1, 1] = np.nan
    with RerunLog(path) as log:
        log.frame(index=0, time_ms=0, grid=grid_of(lattice()), moved=moved, unit="mm", rate=50.0)
    assert recorded(path, "Scalars:scalars") == [[20], [50]]
    ((scale,),) = recorded(path, "TextDocument:text")
    assert "to 2 mm (yellow)" in scale
    (colours,) = recorded(path, "Points2D:colors")
    red = [colour >> 24 for colour in colours]
    assert colours[6] == 0x808080FF  # unknown
    assert red[0] < 20
    assert red[19] > 230


def test_importing_the_modules_imports_no_extra():
    code = (
        "import sys, cmp_cl.viz, cmp_cl.space, cmp_cl.field; "
        "print([name for name in ('matplotlib', 'rerun', 'pyvista') if name in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert result.stdout.strip() == b"[]"
