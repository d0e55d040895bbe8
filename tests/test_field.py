"""Displacement, strain and their files."""

import base64
import csv
import math
import struct
import xml.etree.ElementTree

import cv2
import numpy as np
import pytest
from cases import some
from stereo_data import gel, grid_of, points, project, toed_in_rig

from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.field import displacement, green_lagrange
from cmp_cl.grid import NodeStatus
from cmp_cl.space import PointStatus


def pressed(*, raw=False):
    """Return a field with a press of 2 mm, a twist, and two missing nodes."""
    rest, now = gel(12, 10, depth=0), gel(12, 10)
    now[..., :2] += 0.05 * np.stack([-now[..., 1], now[..., 0]], axis=-1)
    rest[2, 3] = now[7, 8] = np.nan
    return displacement(points(rest), points(now), raw=raw)


def test_the_raw_displacement_is_now_minus_rest():
    field = pressed(raw=True)
    assert (~field.valid).sum() == 2
    for node in ((2, 3), (7, 8)):
        assert field.status[node] == PointStatus.MISSING
        assert field.source[node] == NodeStatus.MISSING
        assert np.isnan(field.position[node]).all()
        assert np.isnan(field.displacement[node]).all()
        assert np.isnan(field.sigma[node])
    moved = (field.position + field.displacement)[field.valid]
    now = gel(12, 10)
    now[..., :2] += 0.05 * np.stack([-now[..., 1], now[..., 0]], axis=-1)
    np.testing.assert_allclose(moved, now[field.valid], atol=1e-12)
    assert field.strain is None
    assert field.raw is None


def test_the_filtered_field_keeps_the_raw_one_and_its_holes():
    field, alone = pressed(), pressed(raw=True)
    for name in ("position", "displacement", "covariance", "position_covariance", "status"):
        np.testing.assert_array_equal(getattr(field.raw, name), getattr(alone, name))
    np.testing.assert_array_equal(field.valid, alone.valid)
    assert np.array_equal(np.isnan(field.displacement), np.isnan(alone.displacement))
    apart = np.nanmax(np.abs(field.displacement - alone.displacement))
    assert 0 < apart < 0.1


def test_a_lattice_too_small_for_an_estimate_has_the_sigma_of_its_points():
    rest, now = gel(3, 3, depth=0), gel(3, 3)
    for raw in (True, False):
        field = displacement(points(rest), points(now), raw=raw)
        np.testing.assert_allclose(field.sigma, 0.01 * math.sqrt(2))
        np.testing.assert_allclose(field.position_sigma, 0.01)


def test_wear_that_travels_with_the_gel_cancels_and_sigma_covers_the_remainder():
    """Wear of 20 um that is the same at rest and now, and 3 um of noise at each moment."""
    rng = np.random.default_rng(3)
    truth = gel(40, 40, depth=0), gel(40, 40)
    wear = rng.normal(0, 0.02, truth[0].shape)
    rest, now = (xyz + wear + rng.normal(0, 0.003, wear.shape) for xyz in truth)
    field = displacement(points(rest), points(now))
    error = field.displacement - (truth[1] - truth[0])
    raw_error = field.raw.displacement - (truth[1] - truth[0])
    assert np.square(error).mean() < 0.3 * np.square(raw_error).mean()
    for each, off in ((field, error), (field.raw, raw_error)):
        axes = np.linalg.eigh(each.covariance)[1][..., 2]
        worst = np.einsum("rci,rci->rc", off, axes)
        assert np.mean(np.abs(worst) <= 2 * each.sigma) > 0.9
        assert np.mean(np.abs(worst) <= 0.5 * each.sigma) < 0.7
    position = field.position - truth[0]
    assert np.mean(np.abs(position) <= 2 * field.position_sigma[..., None]) > 0.9
    assert np.median(field.position_sigma) < 0.6 * np.median(field.raw.position_sigma)


@pytest.mark.parametrize("stretch", some([0.05, 0.4], (0.4,)))
@pytest.mark.parametrize("raw", [True, False], ids=["raw", "filtered"])
def test_the_sigma_of_a_strain_is_that_of_its_error(raw, stretch):
    """Wear that both moments share adds to the error if the strain is large."""
    rng = np.random.default_rng(5)
    flat = gel(30, 30, depth=0)
    gradient = np.array([[1 + stretch, 0.02], [0.01, 1 - stretch / 2]])
    now = flat.copy()
    now[..., :2] = flat[..., :2] @ gradient.T
    expected = ((gradient.T @ gradient - np.eye(2)) / 2)[[0, 1, 0], [0, 1, 1]]
    ratios = []
    for _ in range(4):
        wear = rng.normal(0, 0.02, flat.shape)
        noise = rng.normal(0, 0.005, now.shape)
        field = displacement(points(flat + wear), points(now + wear + noise), raw=raw).with_strain()
        ratios.append((field.strain - expected) / field.strain_sigma)
    z = np.sqrt(np.nanmean(np.square(ratios)))
    assert 0.9 < z < 1.1 if raw else 0.7 < z < 1.2


@pytest.mark.parametrize("raw", [True, False], ids=["raw", "filtered"])
def test_the_sigma_of_a_displacement_is_that_of_its_error(raw):
    rig, rng = toed_in_rig(), np.random.default_rng(2)
    truth = gel(40, 40, depth=0), gel(40, 40)
    seen = [
        rig.triangulate(
            *(grid_of(view + rng.normal(0, 0.05, view.shape), 0.05) for view in project(rig, xyz))
        )
        for xyz in truth
    ]
    field = displacement(*seen, raw=raw)
    miss = field.displacement - (truth[1] - truth[0])
    along = np.linalg.eigh(field.covariance)[1][..., 2]
    worst = np.einsum("rci,rci->rc", miss, along)
    z = np.sqrt(np.mean(np.square(worst / field.sigma)))
    assert 0.8 < z < 1.1 if raw else 0.6 < z < 1.1


def test_the_status_shows_which_moment_failed():
    rest, now = points(gel(2, 2)), points(gel(2, 2))
    rest.status[0] = PointStatus.PARALLEL, PointStatus.BEHIND
    now.status[0] = PointStatus.VALID, PointStatus.INCONSISTENT
    now.source[1, 1] = NodeStatus.INTERPOLATED
    field = displacement(rest, now)
    assert field.status.tolist() == [
        [PointStatus.PARALLEL, PointStatus.INCONSISTENT],
        [PointStatus.VALID, PointStatus.VALID],
    ]
    assert field.source[1].tolist() == [NodeStatus.DETECTED, NodeStatus.INTERPOLATED]
    assert np.isnan(field.displacement[0]).all()


def test_points_of_other_shapes_or_units_are_refused():
    with pytest.raises(FieldError, match=r"\(3, 4\)"):
        displacement(points(gel(3, 4)), points(gel(4, 3)))
    with pytest.raises(FieldError, match="um"):
        displacement(points(gel(3, 4)), points(gel(3, 4), unit="um"))


def rotated(xyz):
    rotation = cv2.Rodrigues(np.array([0.5, -0.3, 0.8]))[0]
    return xyz @ rotation.T + [3, -2, 70]


@pytest.mark.parametrize("radius", [1, 2, 3])
def test_a_homogeneous_deformation_has_its_strain_everywhere(radius):
    flat = gel(9, 11, depth=0)
    gradient = np.array([[1.10, 0.06], [-0.02, 0.93]])
    now = flat.copy()
    now[..., :2] = flat[..., :2] @ gradient.T
    expected = (gradient.T @ gradient - np.eye(2)) / 2
    strain = green_lagrange(rotated(flat), rotated(rotated(now)), radius=radius)
    inner = ~np.isnan(strain[..., 0])
    assert inner.sum() == (9 * 11 - (4 if radius == 1 else 0))
    np.testing.assert_allclose(
        strain[inner], np.tile(expected[[0, 1, 0], [0, 1, 1]], (inner.sum(), 1)), atol=1e-10
    )


def test_a_rotated_bump_has_no_strain():
    bump = gel(15, 15)
    np.testing.assert_allclose(green_lagrange(bump, rotated(bump)), 0, atol=1e-10)


def test_a_cylinder_rolled_from_a_plane_has_hardly_any_strain():
    flat = gel(30, 30, depth=0) - [0, 0, 46]
    rolled = np.stack(
        [20 * np.sin(flat[..., 0] / 20), flat[..., 1], 20 * np.cos(flat[..., 0] / 20)], axis=-1
    )
    strain = green_lagrange(flat, rolled, radius=1)
    assert np.nanmax(np.abs(strain[1:-1, 1:-1])) < 2e-3
    assert np.nanmax(np.abs(strain[1:-1, 1:-1, 1])) < 1e-12


def test_strain_smooths_noise_and_leaves_holes():
    rng = np.random.default_rng(0)
    flat = gel(20, 20, depth=0)
    noisy = flat + rng.normal(0, 0.01, flat.shape)
    rough, smooth = (green_lagrange(flat, noisy, radius=radius)[4:-4, 4:-4] for radius in (1, 3))
    assert smooth.std() < rough.std() / 3
    noisy[5, 6] = np.nan
    assert np.isnan(green_lagrange(flat, noisy)[5, 6]).all()
    assert not np.isnan(green_lagrange(flat, noisy)[5, 7]).any()
    line = np.full_like(flat, np.nan)
    line[3] = flat[3]
    assert np.isnan(green_lagrange(line, line)).all()
    collapsed = flat * [1, 0, 1]
    assert np.isnan(green_lagrange(collapsed, flat)).all()
    point = np.ones_like(flat)
    assert np.isnan(green_lagrange(point, point)).all()


@pytest.mark.parametrize("radius", [0, 51, 2.0, True])
def test_an_impossible_radius_is_refused(radius):
    with pytest.raises(ConfigError, match="radius"):
        pressed().with_strain(radius)


def test_npz_holds_the_field(tmp_path):
    field = pressed().with_strain()
    field.save(tmp_path / "press.npz")
    with np.load(tmp_path / "press.npz", allow_pickle=False) as data:
        for name in ("position", "displacement", "sigma", "status", "source", "strain"):
            np.testing.assert_array_equal(data[name], getattr(field, name))
            if name not in ("status", "source"):
                np.testing.assert_array_equal(data[f"raw_{name}"], getattr(field.raw, name))
        assert data["unit"] == "mm"
        assert data["filtered"]
    pressed(raw=True).save(tmp_path / "raw.npz")
    with np.load(tmp_path / "raw.npz", allow_pickle=False) as data:
        assert not data["filtered"]
        assert not [name for name in data if name.startswith("raw_")]


def test_csv_names_its_units_and_loses_no_digit(tmp_path):
    field = pressed().with_strain()
    field.save(tmp_path / "press.csv")
    with open(tmp_path / "press.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [
        *("row", "column", "x_mm", "y_mm", "z_mm", "ux_mm", "uy_mm", "uz_mm", "sigma_mm"),
        *("status", "source", "e11", "e22", "e12", "e11_sigma", "e22_sigma", "e12_sigma"),
        *("position_sigma_mm", "raw_x_mm", "raw_y_mm", "raw_z_mm", "raw_ux_mm", "raw_uy_mm"),
        *("raw_uz_mm", "raw_sigma_mm", "raw_e11", "raw_e22", "raw_e12"),
        *("raw_e11_sigma", "raw_e22_sigma", "raw_e12_sigma", "raw_position_sigma_mm"),
    ]
    assert len(rows) == 120
    for row in rows:
        node = int(row["row"]), int(row["column"])
        read = [float(row[f"{name}_mm"]) for name in ("ux", "uy", "uz")]
        np.testing.assert_array_equal(read, field.displacement[node])
        np.testing.assert_equal(float(row["e12"]), field.strain[node][2])
    assert rows[2 * 10 + 3]["status"] == rows[2 * 10 + 3]["source"] == "MISSING"
    assert rows[2 * 10 + 3]["x_mm"] == "nan"
    assert rows[0]["source"] == "DETECTED"


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


def read_ply(path):
    """Return the vertices and faces of a binary .ply."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    lines = header.decode().split("\n")
    dtype = [
        (line.split()[2], {"int": "<i4", "double": "<f8"}[line.split()[1]])
        for line in lines
        if line.startswith("property") and "list" not in line
    ]
    vertices, faces = (int(line.split()[2]) for line in lines if line.startswith("element"))
    nodes = np.frombuffer(body, dtype, count=vertices)
    quads = np.frombuffer(body[nodes.nbytes :], [("count", "u1"), ("nodes", "<i4", 4)])
    assert len(quads) == faces
    assert (quads["count"] == 4).all()
    return nodes, quads["nodes"]


def check_mesh(field, row, column, quads):
    """Check that each quadrilateral surrounds one cell, and that every cell with four valid nodes
    has one."""
    assert list(zip(row, column, strict=True)) == list(zip(*np.nonzero(field.valid), strict=True))
    full = field.valid[:-1, :-1] & field.valid[1:, 1:] & field.valid[1:, :-1] & field.valid[:-1, 1:]
    assert len(quads) == full.sum()
    for quad in quads:
        assert sorted(row[quad] - row[quad].min()) == [0, 0, 1, 1]
        assert sorted(column[quad] - column[quad].min()) == [0, 0, 1, 1]
        steps = np.abs(np.diff(row[quad])) + np.abs(np.diff(column[quad]))
        assert (steps == 1).all()


@pytest.mark.parametrize("strained", [False, True])
def test_vtp_holds_the_surface(tmp_path, strained):
    field = pressed().with_strain() if strained else pressed()
    field.save(tmp_path / "press.vtp")
    arrays = read_vtp(tmp_path / "press.vtp")
    assert ("strain" in arrays) == strained
    np.testing.assert_array_equal(arrays["Points"], field.position[field.valid])
    np.testing.assert_array_equal(arrays["displacement"], field.displacement[field.valid])
    quads = arrays["connectivity"].reshape(-1, 4)
    np.testing.assert_array_equal(arrays["offsets"].ravel(), 4 * np.arange(1, len(quads) + 1))
    check_mesh(field, arrays["row"].ravel(), arrays["column"].ravel(), quads)


@pytest.mark.parametrize("strained", [False, True])
def test_ply_holds_the_surface(tmp_path, strained):
    field = pressed().with_strain() if strained else pressed()
    field.save(tmp_path / "press.PLY")
    nodes, quads = read_ply(tmp_path / "press.PLY")
    np.testing.assert_array_equal(
        np.stack([nodes["ux"], nodes["uy"], nodes["uz"]], axis=1), field.displacement[field.valid]
    )
    assert ("e12" in nodes.dtype.names) == strained
    check_mesh(field, nodes["row"], nodes["column"], quads)


@pytest.mark.parametrize("suffix", ["vtp", "ply"])
def test_vtk_reads_the_surface(tmp_path, suffix):
    pyvista = pytest.importorskip("pyvista", reason="pyvista is not installed")
    field = pressed().with_strain()
    field.save(tmp_path / f"press.{suffix}")
    mesh = pyvista.read(tmp_path / f"press.{suffix}")
    np.testing.assert_allclose(mesh.points, field.position[field.valid], rtol=1e-6)
    assert mesh.n_cells == 11 * 9 - 8
    if suffix == "vtp":
        np.testing.assert_array_equal(mesh["displacement"], field.displacement[field.valid])


@pytest.mark.parametrize("suffix", ["npz", "csv", "ply", "vtp"])
def test_a_field_without_a_valid_node_is_a_file_too(tmp_path, suffix):
    nothing = np.full((3, 4, 3), np.nan)
    path = tmp_path / f"none.{suffix}"
    displacement(points(nothing), points(nothing)).with_strain().save(path)
    if suffix == "vtp":
        assert len(read_vtp(path)["Points"]) == 0
    elif suffix == "ply":
        assert len(read_ply(path)[0]) == 0
    elif suffix == "csv":
        with open(path, newline="") as file:
            rows = list(csv.DictReader(file))
        assert [(int(row["row"]), int(row["column"])) for row in rows] == list(np.ndindex(3, 4))
        assert {(row["status"], row["x_mm"], row["uz_mm"]) for row in rows} == {
            ("MISSING", "nan", "nan")
        }
    else:
        with np.load(path) as data:
            assert (data["status"] == PointStatus.MISSING).all()
            for name in ("position", "displacement", "strain"):
                np.testing.assert_array_equal(data[name], nothing)


def test_an_unknown_suffix_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"\.npz, \.csv, \.ply, \.vtp"):
        pressed().save(tmp_path / "press.stl")
    with pytest.raises(OSError, match="no folder"):
        pressed().save(tmp_path / "none" / "press.vtp")
    assert list(tmp_path.iterdir()) == []
