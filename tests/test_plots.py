"""Pictures, animations and videos of a series."""

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
            moved = {"xy": rest + shift} if views == 1 else {"displacement": shift}
            sigma = np.full((8, 10), 0.02)
            series.append(index=3 + number, time_ms=40.0 * number, sigma=sigma, **moved)
    return path


@pytest.fixture(params=[1, 2])
def recorded(request, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    return Recorded.of(read_series(record(tmp_path / "press.npz", views=request.param)))


def shown(figure):
    """Return what each map of a figure shows, by the label of its bar: values and ends."""
    found = {}
    for axes in figure.axes:
        for bar in axes.child_axes:
            (drawn,) = [each for each in axes.collections if each.colorbar is not None]
            label = bar.get_ylabel() or bar.get_xlabel()
            found[label] = drawn.get_array(), drawn.get_clim(), drawn.get_cmap().name
    return found


def test_maps_have_the_recorded_values_with_their_units(recorded):
    last = recorded.moment(recorded.frame_of(7))
    figure = map_figure(last, Quantity.DISPLACEMENT)
    values, ends, colours = shown(figure)[f"displacement / {recorded.unit}"]
    assert values.count() == 7 * 9 - 4  # the cells around the missing node have no value
    assert values[8] == pytest.approx(0.04 * 42.5)
    assert (ends[0], colours) == (0, "plasma")
    assert figure.texts[0].get_text() == "frame 7"
    both = shown(map_figure(last, Quantity.STRAIN))
    larger, ends, colours = both["larger principal strain / %"]
    assert larger.compressed()[-9 if recorded.unit == "px" else 0] == pytest.approx(4.08, abs=0.01)
    assert ends[0] == -ends[1]
    assert colours == "RdBu_r"
    smaller, other_ends, _ = both["smaller principal strain / %"]
    assert other_ends == ends
    assert smaller.compressed()[0] == pytest.approx(0, abs=0.01)
    sigma = shown(map_figure(last, Quantity.SIGMA))[f"standard deviation / {recorded.unit}"]
    assert set(sigma[0].compressed()) == {0.02}
    if recorded.unit == "mm":
        height, ends, colours = shown(map_figure(last, Quantity.HEIGHT))["height / mm"]
        assert height.max() == pytest.approx(0.5)  # towards the cameras, the mean of a cell
        assert ends[0] == -ends[1]
    else:
        with pytest.raises(FieldError, match="--stereo"):
            map_figure(last, Quantity.HEIGHT)


def test_the_frame_that_moves_most_is_on_the_sheet_with_the_curves_of_all(recorded):
    summary = recorded.summary()
    assert summary.moment.index == 7
    assert summary.largest[0] == 0
    assert summary.largest[4] == pytest.approx(1.8 if recorded.unit == "px" else np.sqrt(5))
    assert summary.median[4] == pytest.approx(0.9, abs=0.1)
    figure = sheet_figure(summary.moment, summary)
    titles = " ".join(axes.get_title() for axes in figure.axes)
    wanted = "displacement, standard deviation, larger, smaller, over time"
    wanted += ", height, surface" if recorded.unit == "mm" else ""
    assert all(word in titles for word in wanted.split(", "))
    curve = figure.axes[-1]
    assert curve.get_xlabel() == "time / s"
    np.testing.assert_allclose(curve.lines[0].get_xydata()[-1], [0.16, summary.largest[4]])


def test_a_curve_has_the_displacement_of_its_node_and_its_sigma(recorded):
    (axes,) = curve_figure(recorded, node=(0, 9)).axes
    assert axes.lines[0].get_xdata()[-1] == pytest.approx(0.16)
    assert axes.lines[0].get_ydata()[-1] == pytest.approx(1.8)
    assert len(axes.collections) == len(axes.lines) == (2 if recorded.unit == "px" else 3)
    assert recorded.node_of(None) == ((0, 9) if recorded.unit == "px" else (4, 5))


def test_two_frames_make_no_curve(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    two = Recorded.of(read_series(record(tmp_path / "two.npz", views=1, frames=2)))
    with pytest.raises(FieldError, match="2 frames make no curve"):
        curve_figure(two)
    titles = [axes.get_title() for axes in sheet_figure(two.moment(1), two.summary()).axes]
    assert not [title for title in titles if "over time" in title]


def test_the_command_writes_a_picture_or_says_why_not(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    series, out = str(record(tmp_path / "press.npz", views=1)), str(tmp_path / "press.png")
    for options in ([], ["--what", "strain", "--frame", "5"], ["--what", "curve", "--node", "3,7"]):
        assert main(["plot", series, "--out", out, *options]) == 0
        assert "of 5 frames" in capsys.readouterr().out
        assert cv2.imread(out).std() > 10
    for wrong, why in (
        (["--what", "height"], "--stereo"),
        (["--frame", "99"], "no frame 99: those from 3 to 7"),
        (["--what", "curve", "--node", "9,0"], "8 x 10"),
        (["--node", "1,1"], "--what curve"),
    ):
        (tmp_path / "press.png").write_bytes(b"old")
        assert main(["plot", series, "--out", out, *wrong]) == 2
        err = capsys.readouterr().err
        assert why in err
        assert err.count("\n") == 1
        assert (tmp_path / "press.png").read_bytes() == b"old"
    assert main(["plot", series, "--out", series]) == 2
    assert main(["plot", str(tmp_path / "gone.npz"), "--out", out]) == 2
    assert main(["plot", series, "--out", str(tmp_path / "a.gif"), "--what", "curve"]) == 2


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_an_animation_has_every_frame_on_one_scale(tmp_path, suffix):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    series, out = record(tmp_path / "press.npz", views=2), tmp_path / f"press{suffix}"
    assert main(["plot", str(series), "--out", str(out), "--what", "height"]) == 0
    capture = cv2.VideoCapture(str(out))
    pictures = []
    while (read := capture.read())[0]:
        pictures.append(read[1].astype(int))
    capture.release()
    assert len(pictures) == 5
    green = np.array([each[..., 1].sum() for each in pictures])  # from white at 0 to dark red
    assert np.diff(green).max() < -100_000


def test_a_part_of_a_series_can_be_drawn(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    with SeriesWriter(tmp_path / "live.npz", rest=np.indices((3, 4)).T.swapaxes(0, 1)) as series:
        series.append(index=0, time_ms=np.nan, xy=1.5 * np.indices((3, 4)).T.swapaxes(0, 1))
        part = str(tmp_path / "live.npz.part")
        assert main(["plot", part, "--out", str(tmp_path / "live.png")]) == 0


def test_without_matplotlib_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    one = Recorded.of(read_series(record(tmp_path / "one.npz", views=1)))
    with pytest.raises(ConfigError, match=r"cmp-cl\[plot\]"):
        curve_figure(one)


def test_a_file_that_is_no_series_of_nodes_is_refused():
    good = {
        "index": np.arange(2),
        "time_ms": np.arange(2.0),
        "rest": np.zeros((3, 3, 2)),
        "xy": np.zeros((2, 3, 3, 2)),
    }
    for name, why in {"xy": "no displacement or xy", "rest": "no rest"}.items():
        with pytest.raises(FieldError, match=why):
            Recorded.of({key: value for key, value in good.items() if key != name})
    with pytest.raises(FieldError, match="no frame"):
        Recorded.of(good | {"index": np.arange(0), "xy": np.zeros((0, 3, 3, 2))})


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


def test_a_video_shows_nodes_by_their_displacement(tmp_path):
    path = tmp_path / "press.mp4"
    path.touch(mode=0o600)
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
    assert os.name == "nt" or path.stat().st_mode & 0o777 == 0o600


@pytest.mark.skipif(os.name == "nt", reason="devices are others on Windows")
def test_a_video_replaces_no_device(tmp_path):
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
