"""A grid kept in a file: what comes back is what was saved, or one line says what is wrong."""

import dataclasses
import math

import numpy as np
import pytest
from lattices import drawn

from cmp_cl import Grid, GridError, build_grid, detect
from cmp_cl.grid import Rival, Sides


@pytest.fixture(scope="module")
def grid() -> Grid:
    image, _ = drawn(6, 9)
    return build_grid(detect(image), image)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"border": None, "confidence": 2.5, "rival": Rival(2, -1, 1), "origin": (-3, 4)},
        {"border": Sides(left=True), "seen_shape": (7, 9), "others": 40, "edge_radius": math.nan},
    ],
)
def test_a_saved_grid_comes_back_as_it_was(grid, changes, tmp_path):
    grid = dataclasses.replace(grid, **changes)
    grid.save(tmp_path / "rest.npz")
    found = Grid.load(tmp_path / "rest.npz")
    for field in dataclasses.fields(Grid):
        one, other = getattr(grid, field.name), getattr(found, field.name)
        assert type(one) is type(other), field.name
        np.testing.assert_array_equal(one, other, err_msg=field.name)
        assert getattr(one, "dtype", None) == getattr(other, "dtype", None)
    assert found.doubts == grid.doubts


def test_an_empty_grid_can_be_saved(grid, tmp_path):
    empty = build_grid(detect(np.zeros((40, 50), np.uint8)))
    empty.save(tmp_path / "none.npz")
    assert Grid.load(tmp_path / "none.npz").shape == (0, 0)


@pytest.mark.parametrize(
    ("name", "values", "said"),
    [
        ("sigma", np.zeros((6, 8), "f4"), r"sigma must be \(6, 9\) of float32, found \(6, 8\) of"),
        ("xy", np.zeros((6, 9, 2)), r"xy must be \(6, 9, 2\) of float32, found .* of float64"),
        ("border", np.ones(3, bool), r"border must be \(4\) of bool, found \(3\) of bool"),
        ("status", np.full((6, 9), 9, "u1"), "status must be under 6, found 9"),
        ("status", np.zeros((6, 9), "u1"), "xy must be NaN where status is 0 and finite elsewhere"),
        (
            "index",
            np.full((54, 2), 7, "i4"),
            r"index must lie in \(6, 9\) or be -1, found \[7, 7\]",
        ),
        ("parity", np.array(2), "parity must be 0 or 1, found 2"),
        ("others", np.array(-1), "others must not be negative, found -1"),
        ("origin", None, "lacks the array 'origin'"),
        ("rival", np.array([None]), "damaged or no .npz of arrays"),
    ],
)
def test_a_file_that_holds_no_grid_is_refused_in_one_line(grid, tmp_path, name, values, said):
    path = tmp_path / "rest.npz"
    grid.save(path)
    arrays = dict(np.load(path)) | {name: values}
    np.savez(path, **{key: each for key, each in arrays.items() if each is not None})
    with pytest.raises(GridError, match=said) as caught:
        Grid.load(path)
    assert "rest.npz" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_npz_is_refused_and_what_is_missing_is_not_found(grid, tmp_path):
    grid.save(tmp_path / "rest.npz")
    whole = (tmp_path / "rest.npz").read_bytes()
    for data in (b"", b"P5 2 2", whole[: len(whole) // 2]):
        (tmp_path / "rest.npz").write_bytes(data)
        with pytest.raises(GridError, match="damaged"):
            Grid.load(tmp_path / "rest.npz")
    np.savez_compressed(tmp_path / "packed.npz", **{"status": np.zeros((9, 9))})
    with pytest.raises(GridError, match="lacks the array"):
        Grid.load(tmp_path / "packed.npz")
    with pytest.raises(FileNotFoundError):
        Grid.load(tmp_path / "other.npz")
    with pytest.raises(GridError, match=r"a grid is saved as \.npz"):
        grid.save(tmp_path / "rest.csv")
    with pytest.raises(FileNotFoundError, match="there is no folder"):
        grid.save(tmp_path / "nowhere" / "rest.npz")
