"""Plots and videos of a series."""

import os
import stat
import sys

import cv2
import numpy as np
import pytest
from stereo_data import grid_of

from cmp_cl.cli.main import main
from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.series import SeriesWriter, read_series
from cmp_cl.viz.plots import Quantity, Recorded, curve_figure, map_figure, sheet_figure
from cmp_cl.viz.video import OverlayVideo


def record(path, *, views):
    """Write a series of 8 x 10 nodes that stretch by 1 % a frame along x, without (2, 3)."""
    row, column = np.mgrid[:8, :10]
    rest = np.stack([5.0 * column, 5.0 * row, 0 * row + 40.0], axis=-1)[..., : views + 1]
    constants = {"rest": rest, "unit": "px" if views == 1 else "mm"}
    with SeriesWriter(path, **constants) as series:
        for number in range(5):
            shift = 0 * rest
            shift[..., 0] = 0.01 * number * rest[..., 0]
            if views == 2:
                shift[4, 5, 2] = -0.5 * number
            shift[2, 3] = np.nan
            moved = {"xy": rest + shift} if views == 1 else {"displacement": shift}
            sigma = np.full((8, 10), 0.02)
            series.append(index=3 + number, time_ms=40.0 * number, sigma=sigma, **moved)
    return path


@pytest.fixture(params=[1, 2])
def recorded(request, tmp_path):
    return Recorded.of(read_series(record(tmp_path / "press.npz", views=request.param)))


def test_maps_show_what_was_recorded(recorded):
    last = recorded.frame_of(7)
    length, unit = recorded.values(Quantity.DISPLACEMENT, last)
    assert length[0, 9] == pytest.approx(0.04 * 45)
    assert unit in ("px", "mm")
    assert np.isnan(length[2, 3])
    strain, unit = recorded.values(Quantity.STRAIN, last)
    assert unit == "1"
    assert strain[7, 0] == pytest.approx(0.04 + 0.04**2 / 2)
    assert recorded.values(Quantity.SIGMA, last)[0][0, 0] == 0.02


def test_height_is_towards_the_cameras_and_needs_two_views(tmp_path):
    two = Recorded.of(read_series(record(tmp_path / "two.npz", views=2)))
    height, unit = two.values(Quantity.HEIGHT, 4)
    assert unit == "mm"
    assert height[4, 5] == pytest.approx(2)
    assert height[0, 9] == pytest.approx(0, abs=1e-9)
    one = Recorded.of(read_series(record(tmp_path / "one.npz", views=1)))
    with pytest.raises(FieldError, match="--stereo"):
        one.values(Quantity.HEIGHT, 0)


def test_the_frame_and_the_node_that_move_most_are_drawn_by_default(recorded):
    assert recorded.frame_of(None) == 4
    assert recorded.node_of(None) == ((0, 9) if recorded.unit == "px" else (4, 5))
    with pytest.raises(FieldError, match="from 3 to 7"):
        recorded.frame_of(9)
    with pytest.raises(FieldError, match="8 x 10"):
        recorded.node_of((8, 0))


def test_a_map_has_a_cell_of_colour_for_every_whole_cell_and_a_bar_with_its_unit(recorded):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    figure = map_figure(recorded, Quantity.DISPLACEMENT, index=7)
    axes, bar = figure.axes
    (cells,) = axes.collections
    assert len(cells.get_array()) == 7 * 9 - 4
    assert bar.get_ylabel() == f"displacement / {recorded.unit}"
    assert "frame 7" in axes.get_title()


def test_a_curve_has_its_time_in_seconds_and_its_sigma(recorded):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    (axes,) = curve_figure(recorded, node=(0, 9)).axes
    assert axes.get_xlabel() == "time / s"
    line = axes.lines[0]
    assert line.get_xdata()[-1] == pytest.approx(0.16)
    assert line.get_ydata()[-1] == pytest.approx(1.8)
    assert len(axes.collections) == len(axes.lines) == (2 if recorded.unit == "px" else 3)
    titles = [axes.get_title() for axes in sheet_figure(recorded).axes]
    assert sum("frame" in title for title in titles) == (3 if recorded.unit == "px" else 4)


def test_the_command_writes_a_picture_or_says_why_not(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    series, out = str(record(tmp_path / "press.npz", views=1)), str(tmp_path / "press.png")
    assert main(["plot", series, "--out", out, "--what", "strain", "--frame", "5"]) == 0
    assert "frame 5 of 5 frames" in capsys.readouterr().out
    assert cv2.imread(out).std() > 10
    for wrong, why in (
        (["--what", "height"], "--stereo"),
        (["--frame", "99"], "no frame 99"),
        (["--node", "9,0"], "no node"),
    ):
        (tmp_path / "press.png").write_bytes(b"old")
        assert main(["plot", series, "--out", out, *wrong]) == 2
        err = capsys.readouterr().err
        assert why in err
        assert err.count("\n") == 1
        assert (tmp_path / "press.png").read_bytes() == b"old"
    assert main(["plot", series, "--out", series]) == 2
    assert main(["plot", str(tmp_path / "gone.npz"), "--out", out]) == 2


def test_without_matplotlib_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    one = Recorded.of(read_series(record(tmp_path / "one.npz", views=1)))
    with pytest.raises(ConfigError, match=r"cmp-cl\[plot\]"):
        curve_figure(one)


def test_a_file_that_is_no_series_of_nodes_is_refused(tmp_path):
    with pytest.raises(FieldError, match="no displacement or xy"):
        Recorded.of({"index": np.arange(2), "time_ms": np.arange(2.0), "rest": np.zeros((3, 3, 2))})
    with pytest.raises(FieldError, match="no rest"):
        Recorded.of(
            {"index": np.arange(2), "time_ms": np.arange(2.0), "xy": np.zeros((2, 3, 3, 2))}
        )
    with SeriesWriter(tmp_path / "none.npz", rest=np.zeros((2, 2, 2))):
        pass
    with pytest.raises(FieldError, match="no frame"):
        Recorded.of(read_series(tmp_path / "none.npz"))
    rest, xy = np.zeros((2, 2, 2)), np.zeros((0, 2, 2, 2))
    with pytest.raises(FieldError, match="no frame"):
        Recorded.of({"index": np.arange(0), "time_ms": np.zeros(0), "rest": rest, "xy": xy})


# videos


def write_video(path, frames=3, shape=(240, 320)):
    xy = np.stack(np.meshgrid(np.arange(40, 281, 24.0), np.arange(30, 211, 20.0)), axis=-1)
    xy[4, 5] = np.nan
    moved = np.linalg.norm(xy - [160, 120], axis=-1) / 100
    with OverlayVideo(path, fps=10, unit="mm") as writer:
        for number in range(frames):
            image = np.full(shape, 90 + number, np.uint8)
            writer.frame(image, grid_of(xy), moved, text=f"frame {number}")
    return xy


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
def test_a_video_shows_nodes_by_their_displacement(tmp_path, suffix):
    path = tmp_path / f"press{suffix}"
    xy = write_video(path)
    capture = cv2.VideoCapture(str(path))
    read, picture = capture.read()
    assert read
    assert capture.get(cv2.CAP_PROP_FPS) == pytest.approx(10)
    assert picture.shape[1] == 640  # small images are enlarged

    def colour(node):
        x, y = np.rint((xy[node] + 0.5) * 2 - 0.5).astype(int)
        return picture[y - 1 : y + 2, x - 1 : x + 2].reshape(-1, 3).mean(axis=0)

    near, far = colour((4, 4)), colour((0, 0))
    assert near[0] > near[1] + 40  # dark blue, BGR
    assert far[2] > 150  # yellow
    assert far[1] > 150
    assert picture[480:].std() > 10  # the bar
    assert sum(capture.read()[0] for _ in range(3)) == 2


@pytest.mark.skipif(os.name == "nt", reason="modes and devices are others on Windows")
def test_a_video_keeps_the_mode_of_an_older_one_and_replaces_no_device(tmp_path):
    path = tmp_path / "press.mp4"
    path.touch(mode=0o600)
    write_video(path)
    assert path.stat().st_mode & 0o777 == 0o600
    os.mkfifo(tmp_path / "pipe.mp4")
    with pytest.raises(OSError, match=r"regular.*pipe\.mp4"):
        write_video(tmp_path / "pipe.mp4")
    assert stat.S_ISFIFO(os.stat(tmp_path / "pipe.mp4").st_mode)


def test_pyav_reads_the_video(tmp_path):
    import av

    write_video(tmp_path / "press.mp4", frames=4)
    with av.open(str(tmp_path / "press.mp4")) as container:
        times = [float(frame.time) for frame in container.decode(video=0)]
    assert times == pytest.approx([0, 0.1, 0.2, 0.3])


def test_a_video_that_cannot_be_written_is_refused_and_leaves_the_old_file(tmp_path):
    with pytest.raises(ConfigError, match=r"\.mp4"):
        OverlayVideo(tmp_path / "press.gif")
    with pytest.raises(OSError, match="nothere"):
        OverlayVideo(tmp_path / "nothere" / "press.mp4")
    (tmp_path / "press.mp4").write_bytes(b"old")
    grid = grid_of(np.zeros((2, 2, 2)))
    with OverlayVideo(tmp_path / "press.mp4") as writer, pytest.raises(FieldError, match="2"):
        writer.frame(np.zeros((50, 50), np.uint8), grid, np.zeros((3, 3)))
    assert (tmp_path / "press.mp4").read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1
