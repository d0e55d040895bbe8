"""Measuring from Python: a film of two views to fields, a pattern in one view, aligned views."""

import dataclasses
import re
import textwrap
from pathlib import Path

import cv2
import numpy as np
import pytest
from stereo_data import grid_of

import cmp_cl
from cmp_cl import GridError, StereoRig, measure
from cmp_cl.media import read_frames
from cmp_cl.synthetic import Indenter, Mode, Scene, binocular_frame, default_rig, render_stereo

VIEW = (240, 216)
RIG = default_rig(VIEW)
GEL = Scene(markers=12, shape=VIEW, indenter=Indenter.TORUS, mode=Mode.TWIST, seed=5)


@pytest.fixture(scope="module")
def shots():
    """Two frames, at rest and pressed: both views in one image, and the nodes in space, mm."""
    found = []
    for severity in (0.0, 0.4):
        left, right, xyz = render_stereo(dataclasses.replace(GEL, severity=severity), RIG)
        found.append((binocular_frame(left, right), xyz))
    return found


def example():
    """The code in the module's docstring."""
    _, code, _ = re.split(r"\n\n(?=    import)|\n\n(?=`)", measure.__doc__, maxsplit=2)
    return textwrap.dedent(code)


def test_the_readme_shows_the_same_lines():
    readme = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    assert f"```python\n{example()}\n```" in readme


def test_the_ten_lines_of_the_docstring_turn_a_film_into_fields(shots, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    StereoRig(*RIG).save("rig.yaml")
    rows, columns = shots[0][0].shape
    film = cv2.VideoWriter(
        "press.mp4", cv2.VideoWriter_fourcc(*"mp4v"), 25, (columns, rows), isColor=False
    )
    film.set(cv2.VIDEOWRITER_PROP_QUALITY, 100)
    for frame, _ in shots:
        film.write(frame)
    film.release()
    assert len([line for line in example().splitlines() if line]) <= 10
    exec(example(), {})
    assert [path.name for path in sorted(tmp_path.glob("*.vtp"))] == ["press-0001.vtp"]
    frames = [frame.image for frame in read_frames("press.mp4")]
    split = cmp_cl.BinocularSplit.halves(columns, rows)
    rig = StereoRig.load("rig.yaml")
    with measure.TwoViews(frames[0], rig, split, shape=(12, 12)) as against_rest:
        field = against_rest(frames[1]).field
    truth = shots[1][1] - shots[0][1]
    assert np.count_nonzero(field.valid) > 0.95 * field.status.size
    off = np.linalg.norm(field.displacement - truth, axis=2)[field.valid]
    assert np.sqrt(np.mean(off**2)) < 0.1 * np.linalg.norm(truth, axis=2).max()


def test_a_view_is_measured_against_the_view_at_rest(shots):
    half = shots[0][0].shape[1] // 2
    rest, now = (frame[:, :half] for frame, _ in shots)
    with measure.OneView(rest, shape=(12, 12)) as against_rest:
        still, moved = against_rest(rest), against_rest(now)
        empty = against_rest(np.zeros_like(rest))
    assert against_rest.unit == "px"
    assert still.largest == 0
    assert still.nodes == against_rest.nodes == 144
    np.testing.assert_array_equal(still.grids[0].xy, against_rest.rest_grid.xy)
    assert moved.largest > 1
    assert (empty.nodes, empty.largest) == (0, 0)
    assert np.isnan(empty.arrays["xy"]).all()
    with pytest.raises(cmp_cl.DeviceError, match="closed"):
        against_rest(rest)


def test_both_the_filtered_and_the_raw_values_are_there_and_said_which(shots):
    rest, now = (frame for frame, _ in shots)
    split, rig = cmp_cl.BinocularSplit.halves(*rest.shape[::-1]), StereoRig(*RIG)
    views = [(frame, frame[:, : frame.shape[1] // 2]) for frame in (rest, now)]
    for k, kind, name, extra in (
        (0, measure.TwoViews, "displacement", (rig, split)),
        (1, measure.OneView, "xy", ()),
    ):
        with (
            kind(views[0][k], *extra, shape=(12, 12)) as filtering,
            kind(views[0][k], *extra, shape=(12, 12), raw=True) as plain,
        ):
            filtered, raw = filtering(views[1][k]).arrays, plain(views[1][k]).arrays
        assert filtering.constants["filtered"]
        assert not plain.constants["filtered"]
        assert "raw_rest" not in plain.constants
        assert f"raw_{name}" not in raw
        np.testing.assert_array_equal(filtering.constants["raw_rest"], plain.constants["rest"])
        np.testing.assert_array_equal(filtered[f"raw_{name}"], raw[name])
        np.testing.assert_array_equal(filtered["raw_sigma"], raw["sigma"])
        assert (filtered[name] != raw[name])[np.isfinite(raw[name])].any()
        assert np.nanmedian(filtered["sigma"]) < np.nanmedian(raw["sigma"])


def test_a_pattern_is_found_without_its_cell(shots):
    view = shots[0][0][:, : shots[0][0].shape[1] // 2]
    cell, grid = measure.find_pattern(view, shape=(12, 12))
    assert grid.shape == (12, 12)
    assert cell == pytest.approx(measure.cell_of(grid))
    with pytest.raises(GridError, match="of 12 x 12 corners"):
        measure.find_pattern(np.zeros_like(view), shape=(12, 12))


def test_a_turned_grid_is_the_same_grid():
    row, column = np.indices((3, 4))
    grid = grid_of(np.stack([column * 10.0, row * 10.0], axis=-1))
    corners = grid.xy.reshape(-1, 2)
    for quarters in range(4):
        other = grid.turned(quarters)
        assert other.shape == ((3, 4) if quarters % 2 == 0 else (4, 3))
        np.testing.assert_array_equal(other.xy[tuple(other.index.T)], corners)
    half = grid.turned(2)
    np.testing.assert_array_equal(half.xy, grid.xy[::-1, ::-1])
    assert half.parity == 1  # 3 + 4 is odd: the other colour comes first
    assert grid.turned(1).turned(3).parity == grid.parity


def test_two_views_are_numbered_alike():
    row, column = np.indices((3, 4))
    left = grid_of(np.stack([column * 10.0, row * 10.0], axis=-1))
    right = measure.align_views(left, left.turned(2))
    np.testing.assert_array_equal(right.xy, left.xy)
    with pytest.raises(GridError, match="alike"):
        measure.align_views(left, dataclasses.replace(left, parity=1))
    across = grid_of(np.stack([-row * 10.0, column * 10.0], axis=-1))
    with pytest.raises(GridError, match="alike"):
        measure.align_views(left, across)
    with pytest.raises(GridError, match="shows no node"):
        measure.align_views(left, grid_of(np.full((3, 4, 2), np.nan)))
