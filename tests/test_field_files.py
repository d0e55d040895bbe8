"""A field as NumPy, a spreadsheet and ParaView read it."""

import base64
import csv
import struct
import xml.etree.ElementTree

import numpy as np
import pytest
from stereo_data import gel, grid_of, points

from cmp_cl.motion import displacement
from cmp_cl.space import PointStatus


def field(*, space):
    """Return a field of 18 x 19 nodes with its strain, without node (2, 3)."""
    rest, now = gel(18, 19, depth=0), gel(18, 19)
    rest[2, 3] = np.nan
    if space:
        return displacement(points(rest), points(now)).with_strain()
    return displacement(grid_of(rest[..., :2]), grid_of(1.01 * rest[..., :2])).with_strain()


SPACES = pytest.mark.parametrize("space", [False, True], ids=["plane", "space"])


@SPACES
def test_npz_holds_the_field(tmp_path, space):
    saved = field(space=space)
    saved.save(tmp_path / "press.npz")
    with np.load(tmp_path / "press.npz", allow_pickle=False) as data:
        for name in ("position", "displacement", "sigma", "status", "source", *saved.strains()):
            np.testing.assert_array_equal(data[name], getattr(saved, name))
        assert data["unit"] == saved.unit
        if saved.raw is not None:
            np.testing.assert_array_equal(data["raw_displacement"], saved.raw.displacement)


@SPACES
def test_csv_names_its_units_and_loses_no_digit(tmp_path, space):
    saved = field(space=space)
    saved.save(tmp_path / "press.csv")
    with open(tmp_path / "press.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    axes, unit = "xyz" if space else "xy", saved.unit
    wanted = [f"{name}_{axis}_{unit}" for name in ("position", "displacement") for axis in axes]
    wanted += [f"sigma_{unit}", f"position_sigma_{unit}", "strain_11", "strain_22", "strain_12"]
    wanted += ["principal_1", "principal_2", "direction", "status", "source"]
    assert list(rows[0])[:2] == ["row", "column"]
    assert set(wanted) <= set(rows[0])
    assert len(rows) == 18 * 19
    for row in rows:
        node = int(row["row"]), int(row["column"])
        read = [float(row[f"displacement_{axis}_{unit}"]) for axis in axes]
        np.testing.assert_array_equal(read, saved.displacement[node])
        np.testing.assert_equal(float(row["strain_12"]), saved.strain[node][2])
    assert int(rows[2 * 19 + 3]["status"]) == PointStatus.MISSING
    assert rows[2 * 19 + 3][f"position_x_{unit}"] == "nan"


def read_vtp(path):
    """Return the arrays of a .vtp by name."""
    arrays = {}
    for array in xml.etree.ElementTree.parse(path).getroot().iter("DataArray"):
        raw = base64.b64decode(array.text.strip(), validate=True)
        assert struct.unpack("<Q", raw[:8])[0] == len(raw) - 8
        dtype = {"Int32": "<i4", "Float64": "<f8"}[array.get("type")]
        values = np.frombuffer(raw[8:], dtype)
        arrays[array.get("Name")] = values.reshape(-1, int(array.get("NumberOfComponents")))
    return arrays


@SPACES
def test_vtp_holds_the_surface(tmp_path, space):
    saved = field(space=space)
    saved.save(tmp_path / "press.vtp")
    arrays, valid = read_vtp(tmp_path / "press.vtp"), saved.valid
    for name, values in (("Points", saved.position), ("displacement", saved.displacement)):
        there = np.pad(values[valid], ((0, 0), (0, 3 - values.shape[2])))
        np.testing.assert_array_equal(arrays[name], there)
    np.testing.assert_array_equal(arrays["strain"], saved.strain[valid])
    row, column = arrays["row"].ravel(), arrays["column"].ravel()
    assert list(zip(row, column, strict=True)) == list(zip(*np.nonzero(valid), strict=True))
    quads = arrays["connectivity"].reshape(-1, 4)
    np.testing.assert_array_equal(arrays["offsets"].ravel(), 4 * np.arange(1, len(quads) + 1))
    assert len(quads) == 17 * 18 - 4  # those at the missing node
    for quad in quads:  # around one cell
        assert sorted(row[quad] - row[quad].min()) == [0, 0, 1, 1]
        assert sorted(column[quad] - column[quad].min()) == [0, 0, 1, 1]
        assert (np.abs(np.diff(row[quad])) + np.abs(np.diff(column[quad])) == 1).all()
