"""The kernels from the nodes of two views to the displacement and the strain, and their oracles."""

import dataclasses

import numpy as np
import pyopencl as cl
import pytest

from cmp_cl import StereoRig, Window
from cmp_cl.grid.grid import MEASURED, Grid, NodeStatus
from cmp_cl.motion import PlaneScale
from cmp_cl.motion import plan as plans
from cmp_cl.motion.geometry import InPlane, InSpace, camera_numbers
from cmp_cl.motion.moments import AtRest, Moment
from cmp_cl.motion.plan import FieldPlan
from cmp_cl.opencl.program import programs_of
from cmp_cl.reference.field import filter as lattice_filter
from cmp_cl.reference.field import space
from cmp_cl.reference.field import strain as strains
from cmp_cl.space import PointStatus
from cmp_cl.synthetic import default_rig

SHAPE = 480, 400
LENSES = {
    "pinhole": (np.array([-0.2, 0.05, 1e-3, -5e-4, 0.01]),) * 2,
    "rational": (np.array([0.3, -0.1, 1e-3, 2e-3, 0.01, 0.4, -0.05, 0.02]), np.zeros(0)),
    "thin prism": (np.array([-0.1, 0, 0, 0, 0, 0, 0, 0, 1e-3, 0, -2e-3, 0]), np.zeros(4)),
}
FEW = 1e-3  # largest part of the noise by which a displacement may differ from the oracle's
RADIUS = 8.0  # px, of the corners' discs


WINDOWS = {
    "no window": None,
    "acrylic and gel": Window((0.05, -0.02, 1.0), 15.0, ((5.0, 1.49),), 1.41),
    "one medium": Window((0.0, 0.0, 1.0), 30.0, (), 1.33),
    "an air gap": Window((-0.1, 0.0, 1.0), 20.0, ((3.0, 1.5), (1.0, 1.0), (2.0, 1.6)), 1.41),
}


def rig_with(lens="pinhole", window="no window"):
    k1, _, k2, _, r, t = default_rig(SHAPE)[:6]
    one, two = LENSES[lens]
    return StereoRig(k1, one, k2, two, r, t, window=WINDOWS[window])


def window_of(rig):
    """Return the window of a rig as the oracle takes it."""
    window = rig.window
    if window is None:
        return None
    thickness, index = np.array([*window.layers, (0.0, window.index)]).T
    return space.Window(
        normal=window.normal, distance=window.distance, thickness=thickness[:-1], index=index
    )


def views_of(rig, xyz, rng, noise=0.03, shared=0.0):
    """Return grids of both views of points (R, C, 3), with noise, px, that sigma knows.

    shared: the share of the noise of a node that is that of the nodes beside it.
    """
    found = []
    for name in ("1", "2"):
        turn, move = (np.eye(3), np.zeros(3)) if name == "1" else (rig.R, rig.T)
        camera = camera_of(rig, name)
        straight, window = xyz, window_of(rig)
        if window is not None:
            straight = np.array([window.straight(-move @ turn, x) for x in xyz.reshape(-1, 3)])
        local = straight.reshape(xyz.shape) @ turn.T + move
        plane = (local[..., :2] / local[..., 2:]).reshape(-1, 2)
        pixels = np.array([space.seen(camera, point) for point in plane]).reshape(*xyz.shape[:2], 2)
        error = rng.standard_normal(pixels.shape)
        around = [np.roll(error, step, axis) for axis in (0, 1) for step in (-1, 1)]
        found.append(
            Grid(
                xy=(pixels + noise * (error + shared * sum(around))).astype(np.float32),
                status=np.full(xyz.shape[:2], NodeStatus.DETECTED, np.uint8),
                image_sigma=rng.uniform(0.5 * noise, 1.5 * noise, xyz.shape[:2]).astype(np.float32),
                index=np.zeros((0, 2), np.int32),
                edge_radius=RADIUS,
            )
        )
    return tuple(found)


def camera_of(rig, name):
    numbers = camera_numbers(
        getattr(rig, f"K{name}"),
        getattr(rig, f"D{name}"),
        np.eye(3) if name == "1" else rig.R,
        np.zeros(3) if name == "1" else rig.T,
    )
    return space.Camera(
        focal=numbers[:2],
        centre=numbers[2:4],
        distortion=numbers[4:16],
        rotation=numbers[16:25].reshape(3, 3),
        move=numbers[25:28],
    )


def surface(rows, columns, press=0.0):
    """Return points of a gel with cells of 0.8 mm, pressed by a ball, mm."""
    y, x = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    x, y = (x - (columns - 1) / 2) * 0.8, (y - (rows - 1) / 2) * 0.8
    near = np.exp(-(x**2 + y**2) / 8)
    return np.stack([x * (1 + 0.1 * press * near), y, 46 - press * near], axis=-1)


def with_holes(grid, *nodes, status=NodeStatus.MISSING):
    changed = grid.status.copy()
    xy = grid.xy.copy()
    for node in nodes:
        changed[node] = status
        if status is NodeStatus.MISSING:
            xy[node] = np.nan
    return dataclasses.replace(grid, status=changed, xy=xy)


@pytest.fixture
def run(device):
    """Return run(rig, rest, now): the plan, its results and its field for two pairs of grids, or of
    one view where the rig is a scale."""
    made = []

    def of(rig, rest, now, *, complete=None, strain=False):
        if isinstance(rig, StereoRig):
            moment = Moment.in_space(rig.triangulate(*rest))
            geometry = InSpace(rig, (RADIUS, RADIUS))
        else:
            moment, geometry = Moment.in_plane(rest[0], rig), InPlane(rig, RADIUS)
        programs = programs_of(device.handle)
        plan = FieldPlan(
            cl.CommandQueue(programs.context),
            programs,
            device,
            rest=moment,
            geometry=geometry,
            strain=strain,
        )
        made.append(plan)
        for view, (grid, whole) in enumerate(zip(now, complete or now, strict=True)):
            plan.frame.arrays["nodes"][view] = whole.xy
            plan.frame.arrays["seen_status"][view] = grid.status
            plan.frame.arrays["seen_sigma"][view] = grid.image_sigma
        plan.frame.upload()
        plan.start()
        results = plan.read()
        return plan, results, plan.field(results)

    yield of
    for plan in made:
        plan.release()


def expected(rig, rest, now, complete):
    """Return what the oracles make of the same grids: the field and the strain."""
    cameras = camera_of(rig, "1"), camera_of(rig, "2")
    at_rest = rig.triangulate(*rest)
    points = space.points(
        tuple(grid.xy.astype(float) for grid in complete),
        tuple(grid.status > 0 for grid in now),
        tuple(grid.image_sigma for grid in now),
        cameras,
        (RADIUS, RADIUS),
        window_of(rig),
    )
    status = np.where(points.status == space.VALID, at_rest.status, points.status)
    valid = status == space.VALID
    measured = valid & np.isin(np.maximum(now[0].status, now[1].status), MEASURED)
    quiet = lattice_filter.filter_positions(at_rest.xyz, at_rest.valid)
    before = np.trace(at_rest.covariance, axis1=2, axis2=3) / 3
    after = np.trace(points.covariance, axis1=2, axis2=3) / 3
    most = np.sqrt(before + after + 9 * np.maximum(quiet.noise**2 - before, 0))
    moved = np.where(valid[..., None], points.xyz - at_rest.xyz, np.nan)
    found = lattice_filter.filter_displacements(moved, measured, most)
    change = points.bent - np.where(np.isfinite(at_rest.bend_shift), at_rest.bend_shift, 0)
    return status, moved, found, np.where(valid[..., None], found.values - change, np.nan)


CASES = {
    "whole": ((20, 22), [], []),
    "holes and a tear": ((18, 16), [(5, 5), (0, 3), (9, 9), (9, 10), (10, 10)], []),
    "a border line is missing": ((16, 17), [(0, c) for c in range(17)], []),
    "two parts": ((12, 24), [(r, c) for r in range(12) for c in range(10, 14)], []),
    "outliers": ((20, 20), [(3, 3)], [(8, 8), (15, 4)]),
    "narrow": ((3, 9), [], []),
    "wide": ((7, 40), [(3, 20)], []),
}


def pressed(case, rig, seed, shared=0.0):
    """Return the grids of a case at rest and now, and those now with the nodes of the holes."""
    shape, holes, wrong = CASES[case]
    rng = np.random.default_rng(seed)
    rest = views_of(rig, surface(*shape), rng)
    complete = views_of(rig, surface(*shape, press=1.0), rng, shared=shared)
    for node in wrong:
        complete[0].xy[node] += 2.0
    return rest, tuple(with_holes(grid, *holes) for grid in complete), complete


@pytest.mark.parametrize(
    ("case", "lens", "window"),
    [
        *((case, "pinhole", "no window") for case in CASES),
        ("whole", "rational", "no window"),
        ("whole", "thin prism", "no window"),
        ("holes and a tear", "pinhole", "acrylic and gel"),
        ("whole", "pinhole", "one medium"),
        ("whole", "rational", "an air gap"),
    ],
)
def test_the_field_is_the_oracles(run, case, lens, window):
    rig = rig_with(lens, window)
    rest, now, complete = pressed(case, rig, 3)
    _, results, field = run(rig, rest, now, complete=complete)
    status, moved, found, displaced = expected(rig, rest, now, complete)
    np.testing.assert_array_equal(field.status, status)
    assert found.margin > 1e-3, "the case tests a bound"
    np.testing.assert_array_equal(np.isnan(field.displacement), np.isnan(displaced))
    np.testing.assert_allclose(field.raw.displacement, moved, rtol=0, atol=2e-6)
    noise = np.nanmedian(found.noise) if np.isfinite(found.noise).any() else 1e-3
    np.testing.assert_allclose(field.displacement, displaced, rtol=0, atol=FEW * noise)
    known = np.isfinite(found.sigma)
    covariance = found.common * found.sigma[..., None, None] ** 2
    covariance = np.where(known[..., None, None], covariance, np.nan)
    np.testing.assert_allclose(
        field.covariance[known],
        covariance[known],
        rtol=0,
        atol=3e-3 * np.nanmax(covariance) if known.any() else 0,
    )
    assert results["counts"][1:].sum() == found.refused.sum()
    assert bool(CASES[case][2]) == found.refused.any()


SCALE = PlaneScale(np.array([[0.05, 0.002, 3], [-0.001, 0.06, 1], [1e-4, -5e-5, 1]]), "mm")


def expected_in_plane(rest, now, complete):
    """Return what the oracles make of grids of one view: the displacement before the filter, and
    after it, see `expected`."""
    before, after = (
        space.in_plane(
            whole.xy.astype(float), seen.status > 0, seen.image_sigma, SCALE.matrix, RADIUS
        )
        for whole, seen in ((rest, rest), (complete, now))
    )
    quiet = lattice_filter.filter_positions(before[0], rest.valid)
    most = np.sqrt(before[1] + after[1] + 9 * np.maximum(quiet.noise**2 - before[1], 0))
    moved = after[0] - before[0]
    found = lattice_filter.filter_displacements(moved, now.valid, most)
    displaced = np.where(now.valid[..., None], found.values - (after[2] - before[2]), np.nan)
    return moved, found, displaced


@pytest.mark.parametrize("case", CASES)
def test_the_field_in_the_plane_is_the_oracles(run, case):
    rest, now, complete = pressed(case, rig_with(), 9)
    rest, now, complete = rest[:1], now[:1], complete[:1]
    _, results, field = run(SCALE, rest, now, complete=complete)
    moved, found, displaced = expected_in_plane(rest[0], now[0], complete[0])
    assert found.margin > 1e-3, "the case tests a bound"
    noise = np.nanmedian(found.noise) if np.isfinite(found.noise).any() else 1e-3
    np.testing.assert_array_equal(field.valid, now[0].valid)
    np.testing.assert_allclose(field.raw.displacement, moved, rtol=0, atol=2e-6)
    np.testing.assert_allclose(field.displacement, displaced, rtol=0, atol=FEW * noise)
    known = np.isfinite(found.sigma) & now[0].valid
    np.testing.assert_allclose(field.sigma[known], found.sigma[known], rtol=3e-3)
    assert results["counts"][1:].sum() == found.refused.sum()


@pytest.mark.parametrize("at_once", [True, False], ids=["in the plan", "later"])
@pytest.mark.parametrize("views", [1, 2])
@pytest.mark.parametrize("case", ["whole", "holes and a tear", "outliers", "narrow", "wide"])
def test_the_strain_is_the_oracles(run, device, case, views, at_once):
    rig = rig_with()
    rest, now, complete = pressed(case, rig, 4, shared=0.2)
    if views == 1:
        rest, now, complete = rest[:1], now[:1], complete[:1]
        moved, found, _ = expected_in_plane(rest[0], now[0], complete[0])
        moment = Moment.in_plane(rest[0], SCALE)
    else:
        _, moved, found, _ = expected(rig, rest, now, complete)
        moment = Moment.in_space(rig.triangulate(*rest))
    seen_by = SCALE if views == 1 else rig
    field = run(seen_by, rest, now, complete=complete, strain=at_once)[2].with_strain()
    shape = field.status.shape
    filters = tuple(
        np.stack([lattice_filter.axis_filter(n, *f) for f in lattice_filter.PAIRED if n > 2 * f[0]])
        for n in shape
    )
    votes = field.valid & ~found.refused
    correlations = strains.shared(moved, votes, found.noise**2)
    assert max(shape) < 10 or max(correlations) > 0.1
    slopes = strains.slope_variances(
        found.weights, found.sigma / np.sqrt(found.gain), votes, filters, correlations
    )
    quiet = AtRest(moment, device, slopes=True)
    still = tuple(np.moveaxis(quiet.filtered.slopes, 2, 0))
    strain, covariance = strains.strain(
        quiet.position,
        np.where(field.valid[..., None], field.displacement, np.nan),
        (quiet.filtered.covariance, field.covariance),
        (still, slopes),
    )
    np.testing.assert_allclose(field.strain, strain, rtol=0, atol=2e-5)
    np.testing.assert_array_equal(np.isnan(field.strain_covariance), np.isnan(covariance))
    size = np.sqrt(np.diagonal(covariance, axis1=2, axis2=3))
    off = np.abs(field.strain_covariance - covariance) / (size[..., None] * size[..., None, :])
    assert np.nanmax(off) < 2e-2


@pytest.mark.parametrize("window", ["no window", "acrylic and gel"])
def test_points_that_no_rig_can_see_say_why(run, window):
    rng, rig = np.random.default_rng(6), rig_with(window=window)
    rest = views_of(rig, surface(9, 9), rng)
    now = views_of(rig, surface(9, 9), rng)
    now[1].xy[2, 2] += (0, 12)  # off its epipolar line
    now[1].xy[4, 4] = now[0].xy[4, 4] + 300  # behind the cameras
    now[1].xy[4, 6] += (-250, 0)  # far in front of the pattern, and of a window
    now = tuple(with_holes(grid, (6, 6)) for grid in now)
    _, _, field = run(rig, rest, now, complete=tuple(map(_filled, now)))
    other = rig.triangulate(*now)
    np.testing.assert_array_equal(field.status, other.status)
    assert set(np.unique(field.status)) >= {PointStatus.MISSING, PointStatus.INCONSISTENT}
    assert field.status[4, 6] == (PointStatus.VALID if rig.window is None else PointStatus.BEHIND)


def _filled(grid):
    return dataclasses.replace(grid, xy=np.nan_to_num(grid.xy))


def test_the_same_nodes_give_the_same_bytes(run):
    rng, rig = np.random.default_rng(7), rig_with()
    rest, now = (views_of(rig, surface(11, 13, press), rng) for press in (0.0, 1.0))
    first, again = (run(rig, rest, now)[1] for _ in range(2))
    for name, values in first.items():
        assert values.tobytes() == again[name].tobytes(), name


@pytest.mark.parametrize("window", ["no window", "acrylic and gel"])
def test_a_device_without_double_precision_errs_by_hundredths_of_a_micrometre(
    run, monkeypatch, window
):
    rng, rig = np.random.default_rng(8), rig_with(window=window)
    rest, now = (views_of(rig, surface(16, 16, press), rng) for press in (0.0, 1.0))
    _, _, exact = run(rig, rest, now)
    monkeypatch.setattr(plans, "has_double", lambda device: False)
    _, _, single = run(rig, rest, now)
    off = np.abs(single.displacement - exact.displacement).max()
    assert 0 < off < 1e-4
