"""Displacement and strain in the plane and in space against closed forms, contact, and files as
NumPy, a spreadsheet and ParaView read them."""

import base64
import copy
import csv
import dataclasses
import functools
import math
import pickle
import struct
import xml.etree.ElementTree

import cv2
import numpy as np
import pytest
from cases import some
from stereo_data import gel, grid_of, points, rms

from cmp_cl.errors import FieldError
from cmp_cl.field import DisplacementField, green_lagrange, surface_normals
from cmp_cl.field.strain import principal_of
from cmp_cl.grid import NodeStatus
from cmp_cl.motion import PlaneScale, contact_of, displacement
from cmp_cl.space import PointStatus

SPACES = pytest.mark.parametrize("space", [False, True], ids=["plane", "space"])


def lattice(rows=40, columns=40, side=12.0):
    """Return the nodes of a slightly rotated board, px."""
    row, column = np.mgrid[:rows, :columns]
    x, y = 30 + side * (column + 0.03 * row), 25 + side * (row - 0.03 * column)
    return np.stack([x, y], axis=-1)


def noisy(xy, seed, sigma=0.02):
    return grid_of(xy + np.random.default_rng(seed).normal(0, sigma, xy.shape), sigma)


def pressed(*, space=True):
    """Return a field with two missing nodes: in space a press of 2 mm and a twist, else a bend."""
    if not space:
        rest, now = lattice(18, 19), 1.01 * lattice(18, 19) + np.sin(lattice(18, 19) / 40)
        rest[2, 3] = now[7, 8] = np.nan
        return displacement(noisy(rest, 1), noisy(now, 2))
    return displacement(*map(points, pressed_gel()))


def pressed_gel():
    rest, now = gel(18, 19, depth=0), gel(18, 19)
    now[..., :2] += 0.05 * np.stack([-now[..., 1], now[..., 0]], axis=-1)
    rest[2, 3] = now[7, 8] = np.nan
    return rest, now


def gradient_of(strain):
    return np.array([[1 + strain, 0.3 * strain], [0.1 * strain, 1 - 0.5 * strain]])


def green(gradient):
    tensor = (gradient.T @ gradient - np.eye(2)) / 2
    return tensor[[0, 1, 0], [0, 1, 1]]


def strain_of(by_x, by_y):
    """Return the Green-Lagrange strain (R, C, 3) of a surface with these derivatives."""
    products = [(one * two).sum(axis=2) for one, two in ((by_x, by_x), (by_y, by_y), (by_x, by_y))]
    return (np.stack(products, axis=-1) - [1, 1, 0]) / 2


def rotated(xyz):
    rotation = cv2.Rodrigues(np.array([0.5, -0.3, 0.8]))[0]
    return xyz @ rotation.T + [3, -2, 70]


@SPACES
def test_a_field_has_the_displacement_and_the_holes_of_its_raw_field(space):
    field = pressed(space=space)
    for each in (field, field.raw):
        assert (~each.valid).sum() == 2
        for node in ((2, 3), (7, 8)):
            assert each.status[node] == PointStatus.MISSING
            assert each.source[node] == NodeStatus.MISSING
            for values in (each.position, each.displacement, each.sigma, each.position_sigma):
                assert np.isnan(values[node]).all()
        assert np.isfinite(each.displacement[each.valid]).all()
    assert 0 < np.nanmax(np.abs(field.displacement - field.raw.displacement)) < 0.1
    with pytest.raises(FieldError, match="filtered field"):
        field.raw.with_strain()
    if space:
        moved = pressed_gel()[1] - pressed_gel()[0]
        np.testing.assert_array_equal(field.raw.displacement, moved)


def test_a_field_is_printed_in_one_line_and_goes_to_another_process():
    field = pressed()
    assert repr(field) == "<DisplacementField of 18 x 19 nodes in mm: 340 valid>"
    strained = copy.deepcopy(field).with_strain()
    for sent in (field, strained):
        came = pickle.loads(pickle.dumps(sent))
        np.testing.assert_array_equal(came.displacement, field.displacement)
    np.testing.assert_array_equal(came.with_strain().strain, strained.strain)
    with pytest.raises(FieldError, match="pickle"):
        pickle.loads(pickle.dumps(field)).with_strain()


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


@SPACES
@pytest.mark.parametrize("wear", [0.0, 0.2])
@pytest.mark.parametrize("strain", some([1e-4, 1e-2, 0.3], (1e-4, 1e-2)))
def test_strain_is_right_within_its_sigma(strain, wear, space):
    """Wear moves with the nodes, and is in the sigma of no corner."""
    gradient, rest = gradient_of(strain), lattice() if not space else gel(40, 40, depth=0)
    by = gradient if not space else np.pad(gradient, ((0, 1), (0, 1))) + np.diag([0, 0, 1])
    size = 1.0 if not space else 0.05  # mm a px
    worn = np.random.default_rng(7).normal(0, size * wear, rest.shape)
    rng = np.random.default_rng(8)
    moments = [xy + worn + rng.normal(0, size * 0.02, rest.shape) for xy in (rest, rest @ by.T)]
    as_seen = points if space else grid_of
    field = displacement(*map(as_seen, moments)).with_strain()
    off, before = (strain - green(gradient) for strain in (field.strain, green_lagrange(*moments)))
    assert 0.9 <= np.mean(np.abs(off / field.strain_sigma) < 1.96) <= 0.985
    assert rms(off) < 0.8 * rms(before)
    if strain < 1e-3 and wear:  # noise decides
        unknown = math.pi / math.sqrt(12)
        assert np.median(field.direction_sigma) == pytest.approx(unknown)
    if strain > 1e-3:
        value, axes = np.linalg.eigh((gradient.T @ gradient - np.eye(2)) / 2)
        off = (field.principal - value[::-1]) / field.principal_sigma
        assert np.mean(np.abs(off) < 1.96) >= 0.9
        off = field.direction - math.atan2(axes[1, 1], axes[0, 1])
        off = (off + math.pi / 2) % math.pi - math.pi / 2
        assert np.mean(np.abs(off / field.direction_sigma) < 1.96) >= 0.9


def test_the_sigma_of_principal_strains_and_of_their_direction_follows_from_the_derivatives():
    """By differences, for drawn strains and covariances."""
    rng, step = np.random.default_rng(5), 1e-6
    strain, factor = rng.normal(0, 0.1, (8, 9, 3)), rng.normal(0, 1e-4, (8, 9, 3, 3))
    covariance = factor @ factor.swapaxes(2, 3)

    def principal(strain):
        values, deviations, direction, turn = principal_of(strain, covariance)
        return np.dstack([values, direction]), np.dstack([deviations, turn])

    ends = [[principal(strain + way * step * axis)[0] for way in (1, -1)] for axis in np.eye(3)]
    slopes = np.stack([(one - other) / (2 * step) for one, other in ends], axis=3)
    variance = np.einsum("rcni,rcij,rcnj->rcn", slopes, covariance, slopes)
    np.testing.assert_allclose(principal(strain)[1], np.sqrt(variance), rtol=1e-4)


def test_the_sigma_of_a_strain_counts_the_errors_that_neighbours_share():
    """Two nodes share a third of the variance across the edge between them."""
    relative = []
    for seed in range(2):
        rng = np.random.default_rng(900000 + seed)
        moments = []
        for gradient in (np.eye(2), gradient_of(1e-2)):
            error = rng.normal(size=(40, 40, 2)) * math.sqrt(1 / 3)
            of_columns, of_rows = rng.normal(size=(2, 41, 41)) * math.sqrt(1 / 3)
            error[..., 0] += of_columns[1:, 1:] + of_columns[:-1, 1:]
            error[..., 1] += of_rows[1:, 1:] + of_rows[1:, :-1]
            row, column = 12.0 * np.mgrid[:40, :40]
            moments.append(np.stack([column, row], axis=-1) @ gradient.T + 0.05 * error)
        field = displacement(*map(grid_of, moments)).with_strain()
        off = (field.strain - green(gradient_of(1e-2))) / field.strain_sigma
        relative.append(np.mean(np.square(off[4:-4, 4:-4])))
    assert math.sqrt(np.mean(relative)) == pytest.approx(1, abs=0.1)


@SPACES
def test_a_strain_is_that_at_its_node_also_at_a_border_and_beside_a_hole(space):
    """Its gradient is constant: over nodes that lie to one side, their mean would be another."""
    rest = gel(18, 19, depth=0)
    rest[..., 0] += 0.2 * rest[..., 1]  # cells are no squares
    x, y, flat = rest[..., 0], rest[..., 1], np.zeros((18, 19))
    now = rest + np.stack([0.01 * x * x + 0.02 * x * y, 0.01 * y * y, 0.01 * x * x], axis=-1)
    by_x = np.stack([1 + 0.02 * x + 0.02 * y, flat, 0.02 * x], axis=-1)
    by_y = np.stack([0.02 * x, 1 + 0.02 * y, flat], axis=-1)
    if not space:
        rest, now, by_x, by_y = (each[..., :2] for each in (rest, now, by_x, by_y))
    truth = strain_of(by_x, by_y)
    now[6:11, 8:10] = now[3, 4] = np.nan
    if space:  # as a whole the gel turns, which strains nothing
        rest, now = rotated(rest), rotated(rotated(now))
    missing, beside = np.isnan(now[..., 0]), np.zeros((18, 19), bool)
    beside[[0, -1]] = beside[:, [0, -1]] = beside[5:12, 7:11] = beside[2:5, 3:6] = True
    exact = green_lagrange(rest, now)
    np.testing.assert_allclose(exact[~missing], truth[~missing], rtol=0, atol=1e-9)
    seen = points if space else functools.partial(grid_of, sigma=0.002)
    rng = np.random.default_rng(11)
    field = displacement(*(seen(xy + rng.normal(0, 0.002, xy.shape)) for xy in (rest, now)))
    off = np.abs((field.with_strain().strain - truth) / field.with_strain().strain_sigma)
    assert np.mean(off[beside & ~missing] < 1.96) > 0.9
    assert off[~missing].max() < 6


def test_a_strain_follows_a_cubic_displacement_where_all_nodes_around_stand():
    rest = gel(9, 11, depth=0)[..., :2]
    x, y = np.moveaxis(rest, 2, 0)
    now = rest + np.stack([1e-3 * x**3 + 2e-3 * x * y * y, 1e-3 * y**3], axis=-1)
    by_x = np.stack([1 + 3e-3 * x * x + 2e-3 * y * y, np.zeros_like(x)], axis=-1)
    by_y = np.stack([4e-3 * x * y, 1 + 3e-3 * y * y], axis=-1)
    now[0, 0] = np.nan
    off = np.abs(green_lagrange(rest, now) - strain_of(by_x, by_y)).max(axis=2)
    whole = np.zeros((9, 11), bool)
    whole[2:-2, 2:-2] = True
    whole[2, 2] = False
    assert off[whole].max() < 1e-9
    assert np.nanmax(off[~whole]) > 1e-4


def test_the_sigma_of_a_strain_beside_missing_nodes_counts_what_no_surface_follows():
    """A wave of 21 cells, with a block and single nodes missing."""
    rest = lattice(30, 30)
    wave = 3 * np.sin(rest[..., 0] / 40)
    now, missing = rest + wave[..., None] * [1, 0], np.random.default_rng(5).random((30, 30)) < 0.06
    missing[12:17, 8:20] = True
    truth = ((1 + 3 / 40 * np.cos(rest[..., 0] / 40)) ** 2 - 1) / 2
    now[missing] = np.nan
    field = displacement(noisy(rest, 1), noisy(now, 2)).with_strain()
    off = np.abs(field.strain[..., 0] - truth) / field.strain_sigma[..., 0]
    beside = cv2.dilate(missing.astype(np.uint8), np.ones((3, 3))).astype(bool) & ~missing
    for nodes in (beside, ~beside & ~missing):
        known = off[nodes & np.isfinite(off)]
        assert np.mean(known < 1.96) > 0.9


@pytest.mark.parametrize("turned", [False, True])
def test_the_sigma_of_a_strain_across_a_tear_is_as_large_as_its_error(turned):
    """Both sides of the tear are not strained, and part by .7 of a cell."""
    rest = lattice(24, 24)
    now = rest + (np.arange(24) >= 11)[:, None, None] * np.array([0.0, 7.0])
    rest, now = ((each.swapaxes(0, 1)[..., ::-1] if turned else each) for each in (rest, now))
    field = displacement(noisy(rest, 1), noisy(now, 2)).with_strain()
    across = field.strain[..., 0 if turned else 1]
    assert across.max() > 0.3
    assert (np.abs(field.strain) < 3.5 * field.strain_sigma).mean() > 0.99
    assert (across < 3 * field.strain_sigma[..., 0 if turned else 1])[np.abs(across) > 0.05].all()


def test_cells_of_known_side_give_millimetres_through_a_homography():
    row, column = np.mgrid[:18, :19]
    flat = np.stack([column, row], axis=-1) * 2.5  # mm
    tilted = np.array([[8.0, 0.3, 40], [-0.2, 7.5, 30], [2e-3, 1e-3, 1]])

    def seen(plane):
        there = plane @ tilted[:, :2].T + tilted[:, 2]
        return there[..., :2] / there[..., 2:]

    scale = PlaneScale.of_cells(grid_of(seen(flat)), 2.5)
    grids = noisy(seen(flat), 1), noisy(seen(flat + np.array([0.3, -0.1])), 2)
    field = displacement(*grids, scale=scale)
    assert field.unit == "mm"
    for each in (field.raw, field):
        off = (each.displacement - [0.3, -0.1]) / each.sigma[..., None]
        assert np.mean(np.abs(off) < 2) > 0.9
    np.testing.assert_allclose(field.position, flat, atol=0.05)


def test_cells_that_a_lens_bends_are_off_from_squares_and_noisy_ones_are_not():
    row, column = np.mgrid[-10:11, -10:11]
    flat = np.stack([column, row], axis=-1) * 14.0  # px
    bent = flat * (1 - 0.02 * np.square(flat / 140).sum(axis=2, keepdims=True))
    plane = PlaneScale.of_cells(grid_of(bent), 2.5)
    steps = [np.diff(plane(bent)[0], axis=axis) / 2.5 for axis in (0, 1)]
    off = [steps[0] - [0, 1], steps[1] - [1, 0]]
    true = np.sqrt(np.mean([np.square(each).sum(axis=2).mean() for each in off]))
    assert plane.uneven(noisy(bent, 1), 2.5) == pytest.approx(true, rel=0.1)
    assert PlaneScale.of_cells(grid_of(flat), 2.5).uneven(noisy(flat, 1), 2.5) < 0.05 * true
    assert np.isnan(plane.uneven(grid_of(bent[:7]), 2.5))


def test_the_status_says_which_moment_failed_and_the_source_which_is_less_direct():
    rest, now = points(gel(18, 19)), points(gel(18, 19))
    rest.status[0, :2] = PointStatus.PARALLEL, PointStatus.BEHIND
    now.status[0, :2] = PointStatus.VALID, PointStatus.INCONSISTENT
    now.source[1, 1] = NodeStatus.INTERPOLATED
    field = displacement(rest, now)
    assert field.status[0, :2].tolist() == [PointStatus.PARALLEL, PointStatus.INCONSISTENT]
    assert (np.delete(field.status.ravel(), (0, 1)) == PointStatus.VALID).all()
    assert field.source[1, :2].tolist() == [NodeStatus.DETECTED, NodeStatus.INTERPOLATED]
    assert np.isnan(field.displacement[0, :2]).all()


def test_nodes_are_compared_by_number_if_more_are_in_view_than_at_rest():
    row, column = np.indices((18, 19))
    rest = grid_of(np.stack([10.0 * column, 10.0 * row], axis=2))
    row, column = np.indices((21, 20)) - np.array([2, 1])[:, None, None]
    now = grid_of(np.stack([10.0 * column + 3, 10.0 * row - 1], axis=2))
    field = displacement(rest, dataclasses.replace(now, origin=(-2, -1)))
    expected = np.broadcast_to([3.0, -1.0], (18, 19, 2))
    np.testing.assert_allclose(field.displacement, expected, rtol=1e-6)  # single precision
    with pytest.raises(FieldError, match=r"rest has rows 0 to 17 .* now has rows 1 to 21"):
        displacement(rest, dataclasses.replace(now, origin=(1, 0)))


@pytest.mark.parametrize("tilt", [0.0, 0.4])
def test_depth_area_and_normals_are_those_of_a_bell_pressed_into_a_tilted_gel(tilt):
    top, radius = 0.8, 4.0  # mm, height and sigma of the bell
    row, column = np.indices((81, 81))
    flat = np.stack([(column - 40) * 0.25, (row - 40) * 0.25, np.zeros((81, 81))], axis=2)
    turn = cv2.Rodrigues(np.array([0, tilt, 0]))[0]
    bell = top * np.exp(-np.square(flat).sum(axis=2) / (2 * radius**2))
    covariance = np.broadcast_to(np.eye(3) * 0.01**2, (81, 81, 3, 3))
    field = DisplacementField(
        position=flat @ turn.T + [0, 0, 30],
        displacement=-bell[..., None] * turn[:, 2],
        covariance=covariance,
        position_covariance=covariance,
        status=np.ones((81, 81), np.uint8),
        source=np.ones((81, 81), np.uint8),
        unit="mm",
    )
    contact = contact_of(field, deeper_than=top / 2)
    np.testing.assert_allclose(contact.depth, bell, atol=1e-9)
    np.testing.assert_allclose(contact.sigma, 0.01)
    assert contact.deepest == pytest.approx(top)
    np.testing.assert_array_equal(contact.inside, bell > top / 2)
    disc = np.pi * 2 * np.log(2) * radius**2  # the area on which the bell is above half its height
    assert contact.area == pytest.approx(disc, rel=0.01)
    slope = (contact.normal @ turn[:, 0])[40, 40 - 16]  # one radius from the top
    assert slope == pytest.approx(-np.sin(np.arctan(top * np.exp(-0.5) / radius)), rel=0.01)
    for positions in (field.position, field.position[::-1], field.position.transpose(1, 0, 2)):
        np.testing.assert_allclose(surface_normals(positions)[3, 3], -turn[:, 2], atol=1e-9)
    field.displacement[38:43, 38:43] = np.nan
    holed = contact_of(field, deeper_than=top / 2)
    assert np.isnan(holed.depth[40, 40])
    assert not holed.inside[38:43, 38:43].any()
    assert 0 < holed.area < contact.area
    field.displacement[:] = np.nan
    nothing = contact_of(field, deeper_than=0.7)
    assert nothing.area == 0
    assert np.isnan(nothing.deepest)


def test_a_frame_for_pytac3d_has_its_keys_in_mm_row_by_row_and_no_forces():
    rest, now = gel(18, 19, depth=0), gel(18, 19)
    now[2, 3] = np.nan
    frames = [
        displacement(points(rest * size, unit=unit), points(now * size, unit=unit)).raw
        for unit, size in (("mm", 1.0), ("um", 1e3))
    ]
    for field in frames:
        frame = field.as_pytac3d(serial="gel-1", index=7, time_s=0.25)
        assert sorted(frame) == [
            *("3D_Displacements", "3D_Normals", "3D_Positions"),
            *("SN", "index", "recvTimestamp", "sendTimestamp"),
        ]
        assert (frame["SN"], frame["index"], frame["recvTimestamp"]) == ("gel-1", 7, 0.25)
        np.testing.assert_allclose(frame["3D_Positions"], now.reshape(-1, 3))
        np.testing.assert_allclose(
            frame["3D_Displacements"], (now - rest).reshape(-1, 3), atol=1e-12
        )
        assert np.isnan(frame["3D_Normals"]).any(axis=1).nonzero()[0].tolist() == [2 * 19 + 3]
        assert (np.delete(frame["3D_Normals"], 2 * 19 + 3, axis=0)[:, 2] < 0).all()
    with pytest.raises(FieldError, match="2 coordinates in px"):
        pressed(space=False).as_pytac3d()
    with pytest.raises(FieldError, match="in inch"):
        displacement(points(rest, unit="inch"), points(now, unit="inch")).as_pytac3d()


# files


@SPACES
def test_npz_holds_the_field(tmp_path, space):
    saved = pressed(space=space).with_strain()
    saved.save(tmp_path / "press.npz")
    with np.load(tmp_path / "press.npz", allow_pickle=False) as data:
        for name in ("position", "displacement", "sigma", "status", "source", *saved.strains()):
            np.testing.assert_array_equal(data[name], getattr(saved, name))
        assert data["unit"] == saved.unit
        if saved.raw is not None:
            np.testing.assert_array_equal(data["raw_displacement"], saved.raw.displacement)


@SPACES
def test_csv_names_its_units_and_loses_no_digit(tmp_path, space):
    saved = pressed(space=space).with_strain()
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
    saved = pressed(space=space).with_strain()
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
    assert len(quads) == 17 * 18 - 2 * 4  # those at the missing nodes
    for quad in quads:  # around one cell
        assert sorted(row[quad] - row[quad].min()) == [0, 0, 1, 1]
        assert sorted(column[quad] - column[quad].min()) == [0, 0, 1, 1]
        assert (np.abs(np.diff(row[quad])) + np.abs(np.diff(column[quad])) == 1).all()
