"""Pictures: each shows every corner, node and value where it is, with its unit."""

import dataclasses
import os
import urllib.error
import urllib.request

import av
import cv2
import numpy as np
import pytest
from children import full_after
from lattices import corners_at
from stereo_data import grid_of

from cmp_cl.cli.main import main
from cmp_cl.corners import Method
from cmp_cl.errors import FieldError
from cmp_cl.grid import NodeStatus
from cmp_cl.media import read_frames
from cmp_cl.series import SeriesWriter, read_series
from cmp_cl.viz import (
    STATUS_COLOURS,
    Quantity,
    corner_overlay,
    grid_overlay,
    map_figure,
    save_figure,
    sheet_figure,
)
from cmp_cl.viz.live import LiveView
from cmp_cl.viz.moments import Summary, moments_of
from cmp_cl.viz.overlays import moved_overlay
from cmp_cl.viz.video import VideoFile

# images with marks


def test_the_centre_of_a_mark_is_the_corner():
    image = np.full((100, 200), 128, np.uint8)
    xy = [[40.25, 50.5], [159.6, 20.0]]
    picture = corner_overlay(image, corners_at(xy, method=Method.MIDLINE))
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


# figures


def record(path, *, views, frames=5):
    """Write a series of 8 x 10 nodes that stretch by 1 % a frame along x, without (2, 3)."""
    row, column = np.mgrid[:8, :10]
    rest = np.stack([5.0 * column, 5.0 * row, 0 * row + 40.0], axis=-1)[..., : views + 1]
    with SeriesWriter(path, rest=rest, unit="px" if views == 1 else "mm") as series:
        for number in range(frames):
            shift = 0 * rest
            shift[..., 0] = 0.01 * number * rest[..., 0]
            if views == 2:
                shift[4, 5, 2] = -0.5 * number
            shift[2, 3] = np.nan
            sigma = np.full((8, 10), 0.02)
            series.append(index=3 + number, time_ms=40.0 * number, sigma=sigma, displacement=shift)
    return path


@pytest.fixture(params=[1, 2])
def recorded(request, tmp_path):
    return moments_of(read_series(record(tmp_path / "press.npz", views=request.param)))


def shown(figure):
    """Return what each map of a figure shows, by the label of its bar: values, ends, colours."""
    found = {}
    for axes in figure.axes:
        for each in axes.collections:
            if each.colorbar is not None:
                label = each.colorbar.ax.get_ylabel()
                found[label] = each.get_array(), each.get_clim(), each.get_cmap().name
    return found


def test_maps_have_the_recorded_values_with_their_units(recorded):
    last = recorded[-1]
    figure = map_figure(last, Quantity.DISPLACEMENT)
    values, ends, colours = shown(figure)[f"displacement / {recorded[0].unit}"]
    assert values.count() == 7 * 9 - 4  # the cells around the missing node have no value
    assert values[0, 8] == pytest.approx(0.04 * 42.5)
    assert (ends[0], colours) == (0, "plasma")
    assert figure.axes[0].yaxis_inverted()  # y points down, as in the image
    arrows = figure.axes[0].collections[1]
    enlarged = float(figure.axes[0].get_title().split("arrows ")[1].split(" x")[0])
    assert arrows.scale == pytest.approx(1 / enlarged, rel=0.05)
    assert figure.get_suptitle() == "frame 7"
    both = shown(map_figure(last, Quantity.STRAIN))
    larger, ends, colours = both["larger principal strain / %"]
    assert larger.compressed()[-9 if recorded[0].unit == "px" else 0] == pytest.approx(
        4.08, abs=0.01
    )
    assert ends[0] == -ends[1]
    assert colours == "RdBu_r"
    smaller, other_ends, _ = both["smaller principal strain / %"]
    assert other_ends == ends
    assert smaller.compressed()[0] == pytest.approx(0, abs=0.01)
    sigma = shown(map_figure(last, Quantity.SIGMA))[f"standard deviation / {recorded[0].unit}"]
    assert set(sigma[0].compressed()) == {0.02}
    if recorded[0].unit == "mm":
        height, ends, colours = shown(map_figure(last, Quantity.HEIGHT))["height / mm"]
        assert height.max() == pytest.approx(0.5)  # towards the cameras, the mean of a cell
        assert ends[0] == -ends[1]
    else:
        with pytest.raises(FieldError, match="--stereo"):
            map_figure(last, Quantity.HEIGHT)


@pytest.mark.parametrize("size", [0.0, 1e-320])
@pytest.mark.parametrize("recorded", [1], indirect=True)
def test_pixels_that_a_damaged_file_has_at_one_place_are_drawn(recorded, size, tmp_path):
    last = dataclasses.replace(recorded[-1], rest=size * recorded[-1].rest)
    save_figure(tmp_path / "map.png", map_figure(last, Quantity.DISPLACEMENT))


def test_the_frame_that_moves_most_is_on_the_sheet_with_the_curves_of_all(recorded, tmp_path):
    summary = Summary(recorded)
    assert summary.moment.index == 7
    _, times, largest, median = np.transpose(summary.curves)
    assert largest[0] == 0
    assert largest[4] == pytest.approx(1.8 if recorded[0].unit == "px" else np.sqrt(5))
    assert median[4] == pytest.approx(1.0)
    assert summary.top == largest[4]
    figure = sheet_figure(summary.moment, summary)
    titles = " ".join(axes.get_title() for axes in figure.axes)
    wanted = "displacement, standard deviation, larger, smaller, over time"
    wanted += ", height, surface" if recorded[0].unit == "mm" else ""
    assert all(word in titles for word in wanted.split(", "))
    (curve,) = (axes for axes in figure.axes if "over time" in axes.get_title())
    assert curve.get_xlabel() == "time / s"
    np.testing.assert_allclose(curve.lines[0].get_xydata()[-1], [times[4] / 1e3, largest[4]])
    two = sheet_figure(recorded[1], Summary(recorded[:2]))
    titles = [axes.get_title() for axes in two.axes]
    assert not [title for title in titles if "over time" in title]  # two frames make no curve
    save_figure(tmp_path / "a sheet.svg", figure)  # as .png by the commands
    assert (tmp_path / "a sheet.svg").read_bytes().startswith(b"<?xml")


def test_a_frame_that_may_be_wrong_is_marked_and_not_what_a_series_shows(tmp_path, capsys):
    path, out = tmp_path / "press.npz", tmp_path / "press.png"
    whole = read_series(record(path, views=2))
    whole["ambiguous"] = np.array([False, True, False, False, False])
    whole["misfit"] = np.array([False, False, False, False, True])
    np.savez(path, **whole)
    moments = moments_of(read_series(path))
    summary = Summary(moments)
    assert summary.moment.index == 6
    assert summary.top == pytest.approx(summary.curves[3][2])
    figure = sheet_figure(summary.moment, summary)
    assert figure.get_suptitle() == "frame 6; 2 of 5 frames may be wrong"
    (curve,) = (axes for axes in figure.axes if "over time" in axes.get_title())
    assert np.isnan(curve.lines[0].get_ydata()).tolist() == [False, True, False, False, True]
    np.testing.assert_allclose(curve.lines[1].get_xdata(), [0.04, 0.16])
    assert curve.lines[1].get_markerfacecolor() == "none"
    assert "largest, where all may be wrong" in curve.get_legend_handles_labels()[1]
    title = map_figure(moments[4], Quantity.DISPLACEMENT).get_suptitle()
    assert title == "frame 7: all of it may be wrong"
    assert Summary(moments[4:]).moment.index == 7  # there is no other
    assert main(["plot", str(path), "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert "frame 6, one of 5 frames" in said.out
    assert "in 2 frames all displacements may be wrong" in said.err


def test_a_unit_is_no_formula(tmp_path):
    rest = np.dstack([lattice(), np.full((4, 5), 90.0)])
    with SeriesWriter(tmp_path / "press.npz", rest=rest, unit="$_$") as series:
        series.append(index=0, time_ms=0, displacement=np.ones_like(rest))
    assert main(["plot", str(tmp_path / "press.npz"), "--out", str(tmp_path / "p.png")]) == 0


def test_a_frame_without_the_pattern_has_no_map(recorded):
    first = recorded[0]
    none = dataclasses.replace(first, rest=np.full_like(first.rest, np.nan))
    with pytest.raises(FieldError, match="nodes are valid"):
        sheet_figure(none)


# the command


def test_the_command_writes_a_picture_or_says_why_not(tmp_path, capsys):
    series, out = str(record(tmp_path / "press.npz", views=1)), str(tmp_path / "press.png")
    for options in ([], ["--what", "strain", "--frame", "5"]):
        assert main(["plot", series, "--out", out, *options]) == 0
        assert "of 5 frames" in capsys.readouterr().out
        assert cv2.imread(out).std() > 10
    for wrong, why in (
        (["--what", "height"], "--stereo"),
        (["--frame", "99"], "no frame 99: those from 3 to 7"),
        (["--out", series], "must end in .png"),
    ):
        (tmp_path / "press.png").write_bytes(b"old")
        assert main(["plot", series, "--out", out, *wrong]) == 2
        err = capsys.readouterr().err
        assert why in err
        assert err.count("\n") == 1
        assert (tmp_path / "press.png").read_bytes() == b"old"
    with SeriesWriter(tmp_path / "empty.npz", rest=lattice()):
        pass
    assert main(["plot", str(tmp_path / "empty.npz"), "--out", out]) == 2
    assert "the series has no frame" in capsys.readouterr().err
    with SeriesWriter(tmp_path / "live.npz", rest=lattice()) as live:
        live.append(index=0, time_ms=np.nan, displacement=0.5 * lattice())
        assert main(["plot", str(tmp_path / "live.npz.part"), "--out", out]) == 0


# videos and the live view


def moved_nodes():
    """Return a grid of nodes, and how far they have moved: up to 1.5 from the middle outwards."""
    xy = np.stack(np.meshgrid(np.arange(40, 281, 24.0), np.arange(30, 211, 20.0)), axis=-1)
    xy[4, 5] = np.nan
    moved = np.linalg.norm(xy - [160, 120], axis=-1) / 100
    moved[1, 1] = np.nan
    return grid_of(xy), moved


@pytest.mark.parametrize(("width", "factor"), [(320, 2), (640, 1), (3840, 0.5)])
def test_nodes_are_coloured_by_their_displacement_on_an_image_of_any_size(width, factor):
    grid, moved = moved_nodes()
    size = max(width // 640, 1)
    grid = grid_of((grid.xy + 0.5) * size - 0.5)
    image = np.full((size * 240, width), 90, [np.uint8, np.uint16][size > 1])
    picture = moved_overlay(image, grid, moved, top=1.5, unit="mm", text="frame 7")
    assert picture.shape[1] == width * factor

    def colour(node):
        x, y = np.rint((grid.xy[node] + 0.5) * factor - 0.5).astype(int)
        return picture[y - 1 : y + 2, x - 1 : x + 2].reshape(-1, 3).mean(axis=0)

    near, far = colour((4, 4)), colour((0, 0))
    assert near[0] > near[1] + 40  # dark blue, BGR
    np.testing.assert_allclose(colour((1, 1)), 128, atol=25)  # unknown
    assert min(far[1:]) > 150  # yellow
    assert picture[-20:].std() > 10  # the bar
    with pytest.raises(FieldError, match="3"):
        moved_overlay(image, grid, np.zeros((3, 3)), top=1, unit="mm")


def test_a_video_has_every_picture_and_the_rights_of_the_old_file(tmp_path):
    path = tmp_path / "press.mp4"
    path.touch(mode=0o600)
    with VideoFile(path, fps=10) as video:
        for number in range(3):
            video.add(np.full((49, 65, 3), 60 * number, np.uint8))
    frames = list(read_frames(path))
    assert [frame.time_ms for frame in frames] == [0, 100, 200]
    assert [frame.image.shape for frame in frames] == [(48, 64)] * 3
    assert [round(frame.image.mean() / 60) for frame in frames] == [0, 1, 2]
    assert os.name == "nt" or path.stat().st_mode & 0o777 == 0o600


def test_a_video_that_cannot_be_written_is_refused_and_leaves_the_old_file(tmp_path, monkeypatch):
    with pytest.raises(OSError, match="nothere"):
        VideoFile(tmp_path / "nothere" / "press.mp4", fps=10)
    (tmp_path / "press.mp4").write_bytes(b"old")
    with VideoFile(tmp_path / "press.mp4", fps=10):
        pass  # no picture

    def write_noise():
        with VideoFile(tmp_path / "press.mp4", fps=10) as video:
            for number in range(50):
                draw = np.random.default_rng(number)
                video.add(draw.integers(0, 255, (200, 200, 3), np.uint8))

    with full_after(20_000), pytest.raises(OSError, match="large"):
        write_noise()

    def interrupted():
        with VideoFile(tmp_path / "press.mp4", fps=10) as video:
            video.add(np.zeros((64, 64, 3), np.uint8))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()

    def failing(*_):
        raise av.error.ExternalError(0, "Generic error in an external library")

    monkeypatch.setattr(VideoFile, "_write", failing)
    with pytest.raises(OSError, match=r"press\.mp4.*external"):
        write_noise()
    assert (tmp_path / "press.mp4").read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_browser_gets_the_latest_picture():
    with LiveView() as view, LiveView() as other:
        assert view.address != other.address  # two runs at the same time
        with urllib.request.urlopen(view.address) as page:
            assert b'src = "picture?' in page.read()
        with pytest.raises(urllib.error.HTTPError, match="no picture yet"):
            urllib.request.urlopen(f"{view.address}/picture?0")
        for level in (40, 200):
            view.show(lambda level=level: np.full((30, 50, 3), level, np.uint8))
            with urllib.request.urlopen(f"{view.address}/picture?1") as picture:
                found = cv2.imdecode(np.frombuffer(picture.read(), np.uint8), 1)
            assert found.shape == (30, 50, 3)
            assert abs(found.mean() - level) < 2
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(view.address)
