"""Displacement and strain in the plane, against closed forms."""

import dataclasses
import math

import numpy as np
import pytest
from cases import some
from plane_images import moved_board
from stereo_data import grid_of

import cmp_cl
from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.field.plane import (
    PlaneScale,
    motion_of,
    plane_displacement,
    plane_strain,
    with_measured_noise,
    without_motion,
)

SIGMA = 0.02  # px


def lattice(rows=40, columns=40, side=12.0):
    """Return the nodes of a slightly rotated board, px."""
    row, column = np.mgrid[:rows, :columns]
    x, y = 30 + side * (column + 0.03 * row), 25 + side * (row - 0.03 * column)
    return np.stack([x, y], axis=-1)


def noisy(xy, seed, sigma=SIGMA):
    return grid_of(xy + np.random.default_rng(seed).normal(0, sigma, xy.shape), sigma)


def gradient_of(strain):
    return np.array([[1 + strain, 0.3 * strain], [0.1 * strain, 1 - 0.5 * strain]])


def green(gradient):
    tensor = (gradient.T @ gradient - np.eye(2)) / 2
    return np.array([tensor[0, 0], tensor[1, 1], tensor[0, 1]])


@pytest.mark.parametrize("wear", [0.0, 0.2])
@pytest.mark.parametrize("strain", some([1e-4, 1e-2, 0.3], (1e-2,)))
def test_strain_is_right_within_its_sigma(strain, wear):
    """Both filtered and raw. Wear moves with the nodes, and is in the sigma of no corner."""
    gradient, rest = gradient_of(strain), lattice()
    worn = np.random.default_rng(7).normal(0, wear, rest.shape)
    field = plane_displacement(noisy(rest + worn, 1), noisy(rest @ gradient.T + worn, 2))
    found = plane_strain(field)
    errors = []
    for each in (plane_strain(field.raw), found):
        off = each.tensor - green(gradient)
        assert 0.9 <= np.mean(np.abs(off / each.sigma) < 1.96) <= 0.98
        errors.append(np.sqrt(np.mean(np.square(off))))
    assert errors[1] < 0.8 * errors[0]
    principal, direction = np.linalg.eigh((gradient.T @ gradient - np.eye(2)) / 2)
    if strain > 1e-3:
        seen = found.principal()
        assert 0.9 <= np.mean(np.abs((seen.strain - principal[::-1]) / seen.sigma) < 1.96) <= 0.98
        off = seen.direction - math.atan2(direction[1, 1], direction[0, 1])
        off = (off + math.pi / 2) % math.pi - math.pi / 2
        assert 0.9 <= np.mean(np.abs(off / seen.sigma_direction) < 1.96) <= 0.98


def test_wear_that_stretches_with_the_material_makes_sigma_too_large_and_not_too_small():
    gradient, rest = gradient_of(0.3), lattice()
    worn = rest + np.random.default_rng(7).normal(0, 0.2, rest.shape)
    found = plane_strain(plane_displacement(noisy(worn, 1), noisy(worn @ gradient.T, 2)))
    assert np.mean(np.abs((found.tensor - green(gradient)) / found.sigma) < 1.96) >= 0.95


def test_a_direction_that_noise_decides_has_the_sigma_of_an_unknown_one():
    rest = lattice(12, 12)
    found = plane_strain(plane_displacement(noisy(rest, 3), noisy(1.01 * rest, 4))).principal()
    assert np.median(found.sigma_direction) == pytest.approx(math.pi / math.sqrt(12))


def test_rotation_and_translation_give_no_strain():
    rest = lattice(8, 8)
    rotation = np.array([[math.cos(1.0), -math.sin(1.0)], [math.sin(1.0), math.cos(1.0)]])
    field = plane_displacement(grid_of(rest), grid_of(rest @ rotation.T + [500, 0]))
    for each in (field, field.raw):
        assert np.nanmax(np.abs(plane_strain(each).tensor)) < 1e-5


def test_a_node_that_a_frame_does_not_show_has_no_position_and_spoils_none_at_rest():
    row, column = np.indices((9, 9))
    rest = 20.0 * np.stack([column, row], axis=-1) + np.random.default_rng(1).normal(
        0, 0.1, (9, 9, 2)
    )
    now = rest + 1
    whole = plane_displacement(grid_of(rest), grid_of(now))
    now[4, 5] = np.nan
    field = plane_displacement(grid_of(rest), grid_of(now))
    for values in (field.position, field.displacement, field.sigma, field.sigma_position):
        assert np.isnan(values[4, 5]).all()
    there = field.valid
    assert np.count_nonzero(~there) == 1
    np.testing.assert_array_equal(field.position[there], whole.position[there])


def test_without_neighbours_and_without_the_sigma_of_corners_sigma_is_unknown():
    rest = lattice(4, 4)
    field = plane_displacement(grid_of(rest), grid_of(rest * 1.01))
    assert np.isnan(field.sigma).all()
    assert np.isnan(plane_strain(field).covariance).all()


def test_nodes_without_neighbours_have_no_strain():
    rest = lattice(12, 12)
    now = rest.copy()
    now[:, 5:] = np.nan
    now[0, 0] = np.nan
    found = plane_strain(plane_displacement(noisy(rest, 1), noisy(now, 2)), radius=1).tensor
    assert np.isnan(found[0, 0]).all()
    assert np.isnan(found[:, 5:]).all()
    assert not np.isnan(found[2:-1, :5]).any()


def test_a_motion_is_found_and_removed():
    rest = lattice(20, 20)
    factor = 1.002 * np.exp(0.03j)
    moved = (rest[..., 0] + 1j * rest[..., 1] - (200 + 150j)) * factor + 203 + 149j
    field = plane_displacement(
        noisy(rest, 5), noisy(np.stack([moved.real, moved.imag], axis=-1), 6)
    )
    motion = motion_of(field)
    assert abs(motion.zoom - 1.002) < 3 * motion.sigma_zoom < 1e-4
    assert abs(motion.rotation - 0.03) < 3 * motion.sigma_rotation < 1e-4
    still = without_motion(field, motion)
    raw, filtered = (np.sqrt(np.mean(np.square(f.displacement))) for f in (still.raw, still))
    assert raw == pytest.approx(SIGMA * math.sqrt(2), rel=0.1)
    assert filtered < 0.7 * raw
    rigid = without_motion(field, motion_of(field, zoom=False))
    assert np.mean(plane_strain(rigid).tensor[..., 0]) == pytest.approx(0.002, rel=0.05)


def test_cells_of_known_side_give_millimetres_through_a_homography():
    row, column = np.mgrid[:10, :12]
    flat = np.stack([column, row], axis=-1) * 2.5  # mm
    tilted = np.array([[8.0, 0.3, 40], [-0.2, 7.5, 30], [2e-3, 1e-3, 1]])

    def seen(plane):
        points = plane @ tilted[:, :2].T + tilted[:, 2]
        return points[..., :2] / points[..., 2:]

    scale = PlaneScale.of_cells(grid_of(seen(flat)), 2.5)
    field = plane_displacement(
        noisy(seen(flat), 1), noisy(seen(flat + np.array([0.3, -0.1])), 2), scale
    )
    assert field.unit == "mm"
    off = [(f.displacement - [0.3, -0.1]) / f.sigma[..., None] for f in (field.raw, field)]
    assert np.sqrt(np.mean(np.square(off[0]))) == pytest.approx(1, abs=0.15)
    assert np.mean(np.abs(off[1]) < 2) > 0.9
    np.testing.assert_allclose(field.position, flat, atol=0.05)


def detected(*images, cell):
    """Return the grids of images, all numbered as in the first."""
    config = cmp_cl.DetectorConfig.for_cell(cell).replace(refinement=cmp_cl.EdgeStep(cell=cell))
    with cmp_cl.Detector(shape=images[0].shape, dtype=np.uint8, config=config) as detector:
        rest = cmp_cl.build_grid(detector(images[0]), images[0])
        return rest, *(cmp_cl.build_grid(detector(i), i, like=rest) for i in images[1:])


@pytest.mark.exhaustive
@pytest.mark.parametrize("way", [with_measured_noise, lambda field: field])
def test_the_strain_of_images_is_right_within_the_noise_that_they_show(way):
    gradient, centre = gradient_of(1e-2), np.array([130.0, 130.0])
    covered = []
    for seed in range(2):
        angle = 0.1 + 0.2 * seed
        cos, sin = math.cos(angle), math.sin(angle)
        rotation = np.array([[cos, -sin], [sin, cos]])
        images = [
            moved_board(
                (260, 260),
                12,
                lambda q, by=by: (q - centre) @ (by - np.eye(2)).T + 0.3,
                board=(36, 36, 228, 228),
                noise=3,
                seed=900000 + 2 * seed + number,
            )
            for number, by in enumerate((rotation, rotation @ gradient))
        ]
        field = way(plane_displacement(*detected(*images, cell=12)))
        found = plane_strain(field)
        off = (found.tensor - green(rotation @ gradient @ rotation.T)) / found.sigma
        covered.append(np.mean(np.abs(off[~np.isnan(off)]) < 1.96))
    assert 0.9 < np.mean(covered) < 0.98


def edge_noise(seed, part, rotation):
    """Return errors (20, 20, 2) of unit variance, of which neighbours share a part.

    part: of the variance across the edge between them. rotation: (2, 2), from the lattice's axes to
    the plane's.
    """
    rng = np.random.default_rng(seed)
    own = rng.normal(size=(20, 20, 2)) * math.sqrt(1 - 2 * part)
    of_rows, of_columns = rng.normal(size=(2, 21, 21)) * math.sqrt(part)
    own[..., 0] += of_columns[1:, 1:] + of_columns[:-1, 1:]  # across the edges along a column
    own[..., 1] += of_rows[1:, 1:] + of_rows[1:, :-1]
    return own @ rotation.T


@pytest.mark.parametrize("angle", [0.0, 0.3])
@pytest.mark.parametrize("part", [0.0, 0.33])
def test_strain_counts_the_errors_that_neighbours_share(part, angle):
    rotation = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    row, column = np.mgrid[:20, :20]
    rest = np.stack([12.0 * column, 12.0 * row], axis=-1)
    relative, parts = [], []
    for seed in range(900000, 900040, 2):  # the board rotates, and the shared errors with it
        before = rest + 0.05 * edge_noise(seed, part, np.eye(2))
        now = rest @ rotation.T @ gradient_of(1e-2).T + 0.05 * edge_noise(seed + 1, part, rotation)
        field = with_measured_noise(plane_displacement(grid_of(before), grid_of(now), raw=True))
        found = plane_strain(field)
        off = (found.tensor - green(gradient_of(1e-2) @ rotation)) / found.sigma
        relative.append(np.mean(np.square(off[4:-4, 4:-4])))
        variance = np.mean(np.square(field.sigma_position))
        parts.append([np.diag(shared) / variance for shared in field.shared[0]])
    assert math.sqrt(np.mean(relative)) == pytest.approx(1, abs=0.08)
    np.testing.assert_allclose(np.mean(parts, axis=0), [[0, part], [part, 0]], atol=0.05)


@pytest.mark.parametrize("part", [0.0, 0.33])
def test_raw_sigma_is_right_if_neighbours_share_a_part_of_the_errors(part):
    row, column = np.mgrid[:20, :20]
    rest = np.stack([12.0 * column, 12.0 * row], axis=-1)
    relative = []
    for seed in range(900000, 900016, 2):
        before, now = (rest + 0.05 * edge_noise(seed + k, part, np.eye(2)) for k in (0, 1))
        field = plane_displacement(grid_of(before), grid_of(now), raw=True)
        relative += [
            np.mean(np.square(off / sigma[..., None]))
            for off, sigma in (
                (field.displacement, field.sigma),
                (field.position - rest, field.sigma_position),
            )
        ]
    assert math.sqrt(np.mean(relative)) == pytest.approx(1, abs=0.05)


def test_the_strain_of_a_filtered_field_counts_the_errors_that_neighbours_share():
    row, column = np.mgrid[:20, :20]
    rest = np.stack([12.0 * column, 12.0 * row], axis=-1)
    relative = []
    for seed in range(900000, 900024, 2):
        before = rest + 0.05 * edge_noise(seed, 0.33, np.eye(2))
        now = rest @ gradient_of(1e-2).T + 0.05 * edge_noise(seed + 1, 0.33, np.eye(2))
        found = plane_strain(plane_displacement(grid_of(before), grid_of(now)))
        off = (found.tensor - green(gradient_of(1e-2))) / found.sigma
        relative.append(np.mean(np.square(off[4:-4, 4:-4])))
    assert math.sqrt(np.mean(relative)) == pytest.approx(1, abs=0.1)


def test_the_errors_that_neighbours_share_rotate_with_the_nodes():
    rotation = np.array([[0.0, -1.0], [1.0, 0.0]])
    row, column = np.mgrid[:20, :20]
    rest = np.stack([12.0 * column, 12.0 * row], axis=-1)
    now = (rest + 0.05 * edge_noise(900000, 0.33, np.eye(2))) @ rotation.T
    field = with_measured_noise(plane_displacement(grid_of(rest), grid_of(now), raw=True))
    at_rest, rotated = field.shared
    assert at_rest[0, 1, 1] > 2e-4
    np.testing.assert_allclose(rotated, at_rest[:, ::-1, ::-1], atol=1e-6)
    back = without_motion(field, motion_of(field))
    np.testing.assert_allclose(back.shared[1], at_rest, atol=1e-6)


def test_nodes_are_compared_by_number_if_more_are_in_view_than_at_rest():
    row, column = np.indices((4, 5))
    rest = grid_of(np.stack([10.0 * column, 10.0 * row], axis=2))
    row, column = np.indices((7, 6)) - np.array([2, 1])[:, None, None]
    now = grid_of(np.stack([10.0 * column + 3, 10.0 * row - 1], axis=2))
    field = plane_displacement(rest, dataclasses.replace(now, origin=(-2, -1)))
    np.testing.assert_allclose(field.displacement, np.broadcast_to([3.0, -1.0], (4, 5, 2)))
    with pytest.raises(FieldError, match=r"rest has rows 0 to 3 .* now has rows 1 to 7"):
        plane_displacement(rest, dataclasses.replace(now, origin=(1, 0)))


def test_arguments_that_do_not_fit_are_refused():
    rest = grid_of(lattice(5, 5))
    field = plane_displacement(rest, rest)
    with pytest.raises(FieldError, match="now has"):
        plane_displacement(rest, grid_of(lattice(4, 5)))
    with pytest.raises(ConfigError, match="radius"):
        plane_strain(field, radius=0)
    with pytest.raises(FieldError, match="4 x 4"):
        with_measured_noise(plane_displacement(grid_of(lattice(3, 3)), grid_of(lattice(3, 3))))
