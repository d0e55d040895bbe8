"""The kernels from the nodes of two views to the displacement and the strain, and their oracles:
the positions are those of `StereoRig.triangulate` and of a `PlaneScale`, in NumPy."""

import dataclasses

import numpy as np
import pyopencl as cl
import pytest
from cases import some
from stereo_data import grid_of

from cmp_cl import StereoRig, Window
from cmp_cl.fits import completed
from cmp_cl.grid.grid import MEASURED, NodeStatus
from cmp_cl.motion import PlaneScale
from cmp_cl.motion import plan as plans
from cmp_cl.motion.geometry import InPlane, InSpace
from cmp_cl.motion.moments import AtRest, Moment
from cmp_cl.motion.plan import FieldPlan
from cmp_cl.opencl.program import programs_of
from cmp_cl.reference.field import filter as lattice_filter
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
    one, two = LENSES[lens]
    return dataclasses.replace(default_rig(SHAPE), D1=one, D2=two, window=WINDOWS[window])


def views_of(rig, xyz, rng, noise=0.03):
    """Return grids of both views of points (R, C, 3), with noise, px, that sigma knows."""
    found, shape = [], xyz.shape[:2]
    for pixels in rig.project(xyz.reshape(-1, 3)):
        error = rng.standard_normal((*shape, 2))
        grid = grid_of(pixels.reshape(*shape, 2) + noise * error)
        sigma = rng.uniform(0.5 * noise, 1.5 * noise, shape).astype(np.float32)
        found.append(dataclasses.replace(grid, image_sigma=sigma, edge_radius=RADIUS))
    return tuple(found)


def surface(rows, columns, press=0.0):
    """Return points of a gel with cells of 0.8 mm, pressed by a ball, mm."""
    y, x = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    x, y = (x - (columns - 1) / 2) * 0.8, (y - (rows - 1) / 2) * 0.8
    near = np.exp(-(x**2 + y**2) / 8)
    return np.stack([x * (1 + 0.1 * press * near), y, 46 - press * near], axis=-1)


def with_holes(grid, *nodes):
    status, xy = grid.status.copy(), grid.xy.copy()
    for node in nodes:
        status[node], xy[node] = NodeStatus.MISSING, np.nan
    return dataclasses.replace(grid, status=status, xy=xy)


@pytest.fixture
def run(device):
    """Return run(rig, rest, now): the plan, its results and its field for two pairs of grids, or of
    one view where the rig is a scale."""
    made = []

    def of(rig, rest, now, *, strain=False):
        two = isinstance(rig, StereoRig)
        geometry = InSpace(rig, (RADIUS, RADIUS)) if two else InPlane(rig, RADIUS)
        programs = programs_of(device.handle)
        plan = FieldPlan(
            cl.CommandQueue(programs.context),
            programs,
            device,
            rest=moment_of(rig, rest),
            geometry=geometry,
            strain=strain,
        )
        made.append(plan)
        for view, grid in enumerate(now):
            plan.frame.arrays["nodes"][view] = np.nan_to_num(completed(grid.xy.astype(float)))
            plan.frame.arrays["seen_status"][view] = grid.status
            plan.frame.arrays["seen_sigma"][view] = grid.image_sigma
        plan.frame.upload()
        plan.start()
        results = plan.read()
        return plan, results, plan.field(results)

    yield of
    for plan in made:
        plan.release()


SCALE = PlaneScale(np.array([[0.05, 0.002, 3], [-0.001, 0.06, 1], [1e-4, -5e-5, 1]]), "mm")


@dataclasses.dataclass
class Expected:
    """What the oracles make of the same grids: the status of the nodes and their source, the
    displacement before the filter, its covariance from the images, the filter's result, and the
    displacement that is free of the shift by bent edges."""

    status: np.ndarray
    source: np.ndarray
    moved: np.ndarray
    by_images: np.ndarray
    found: lattice_filter.Filtered
    displaced: np.ndarray


def moment_of(rig, grids):
    """Return the nodes of grids of two views in space, or of one view in the plane."""
    if isinstance(rig, PlaneScale):
        return Moment.in_plane(grids[0], rig)
    return Moment.in_space(rig.triangulate(*grids))


def expected(rig, rest, now):
    """Return what NumPy's positions and the filter's oracle make of grids of two views, or of one
    where the rig is a scale."""
    before, after = (moment_of(rig, grids) for grids in (rest, now))
    status = np.where(after.valid, before.status, after.status)
    sources = before.source, after.source
    source = np.where(np.min(sources, axis=0) == NodeStatus.MISSING, 0, np.max(sources, axis=0))
    measured = np.where(np.isin(source, MEASURED) & (status == PointStatus.VALID), source, 0)
    valid = (status == PointStatus.VALID)[..., None]
    at_rest = np.where(np.isin(before.source, MEASURED), before.source, 0)
    quiet = lattice_filter.filter_positions(before.at, at_rest, before.own)
    worn = 9 * np.maximum(quiet.noise**2 - before.own, 0)
    moved = np.where(valid, after.at - before.at, np.nan)
    found = lattice_filter.filter_displacements(
        moved, measured, after.own, np.sqrt(before.own + after.own + worn)
    )
    displaced = np.where(valid, found.values - (after.bend - before.bend), np.nan)
    by_images = before.covariance + after.covariance
    return Expected(status, source, moved, by_images, found, displaced)


USUAL = 18, 19  # nodes; each other shape is compiled anew
CASES = {  # shape, holes, wrong nodes
    "whole": (USUAL, [], []),
    "holes and a tear": (USUAL, [(5, 5), (0, 3), (9, 9), (9, 10), (10, 10)], []),
    "a border line is missing": (USUAL, [(0, c) for c in range(19)], []),
    "two parts": (USUAL, [(r, c) for r in range(18) for c in range(6, 10)], []),
    "outliers": (USUAL, [(3, 3)], [(8, 8), (15, 4)]),
    "rough outliers": (USUAL, [], [(8, 8), (15, 4)]),
    "narrow": ((15, 3), [], []),
    "too small to filter": ((4, 4), [], []),
    "wide": ((7, 40), [(3, 20)], []),
}
ROUGH_PX = 0.45  # between three and six standard deviations
STRAINED = "whole", "holes and a tear", "outliers", "narrow", "wide"
AT_REST = {"holes and a tear": [(7, 2), (12, 12)]}  # nodes that are missing at rest alone


def pressed(case, rig, seed):
    """Return the grids of a case at rest and now."""
    shape, holes, wrong = CASES[case]
    rng = np.random.default_rng(seed)
    rest = views_of(rig, surface(*shape), rng)
    rest = tuple(with_holes(grid, *AT_REST.get(case, [])) for grid in rest)
    now = views_of(rig, surface(*shape, press=1.0), rng)
    for node in wrong:  # along its epipolar line, where no first point matters
        now[0].xy[node] += (ROUGH_PX if case == "rough outliers" else 2.0, 0.0)
        if case == "rough outliers":
            now[0].status[node] = NodeStatus.ATTACHED
    now = tuple(with_holes(grid, *holes) for grid in now)
    if case in AT_REST:
        rest[0].status[1, 1] = NodeStatus.INTERPOLATED
        now[-1].status[2, 3] = now[0].status[1, 1] = NodeStatus.ATTACHED
    return rest, now


def seen_by(views, rig, *grids):
    """Return what a field of so many views is measured with, and the grids of these views."""
    return (SCALE if views == 1 else rig, *(pair[:views] for pair in grids))


@pytest.mark.parametrize(
    ("case", "views", "lens", "window"),
    [
        *((case, views, "pinhole", "no window") for case in CASES for views in (1, 2)),
        ("holes and a tear", 2, "rational", "no window"),
        ("holes and a tear", 2, "thin prism", "no window"),
        ("holes and a tear", 2, "pinhole", "acrylic and gel"),
        ("holes and a tear", 2, "pinhole", "one medium"),
        ("holes and a tear", 2, "rational", "an air gap"),
    ],
)
def test_the_field_is_the_oracles(run, case, views, lens, window):
    rig = rig_with(lens, window)
    seen = seen_by(views, rig, *pressed(case, rig, 3))
    _, results, field = run(*seen)
    assert not results["rejected"].any()  # the next frame counts from 0
    wanted = expected(*seen)
    found = wanted.found
    assert found.margin > 1e-3, "the case tests a bound"
    np.testing.assert_array_equal(field.status, wanted.status)
    np.testing.assert_array_equal(field.source, wanted.source)
    np.testing.assert_array_equal(np.isnan(field.displacement), np.isnan(wanted.displaced))
    np.testing.assert_allclose(field.raw.displacement, wanted.moved, rtol=0, atol=2e-6)
    of_images = np.sqrt(np.diagonal(wanted.by_images, axis1=2, axis2=3).mean(axis=2))
    noise = np.nanmedian(found.noise if np.isfinite(found.noise).any() else of_images)
    np.testing.assert_allclose(field.displacement, wanted.displaced, rtol=0, atol=FEW * noise)
    known = np.isfinite(found.covariance[..., 0, 0]) & field.valid
    covariance = found.covariance[known]
    largest = np.max(covariance, initial=0)
    np.testing.assert_allclose(field.covariance[known], covariance, rtol=0, atol=3e-3 * largest)
    alone = ~known & field.valid  # in a lattice too small for the filter
    np.testing.assert_allclose(field.covariance[alone], wanted.by_images[alone], rtol=1e-3)
    assert bool(CASES[case][2]) == found.refused.any()


@pytest.mark.parametrize(
    ("case", "views", "at_once"),
    some(
        [
            *((case, views, True) for case in STRAINED for views in (1, 2)),
            ("holes and a tear", 1, False),
            ("holes and a tear", 2, False),
        ],
        [
            *(("holes and a tear", views, True) for views in (1, 2)),
            *((case, 2, True) for case in ("outliers", "narrow")),
            ("wide", 1, True),
            ("holes and a tear", 2, False),
        ],
        several=True,
    ),
)
def test_the_strain_is_the_oracles(run, device, case, views, at_once):
    rig = rig_with()
    seen = seen_by(views, rig, *pressed(case, rig, 7))
    field = run(*seen, strain=at_once)[2].with_strain()
    quiet = AtRest(moment_of(*seen[:2]), device)
    strain, covariance = strains.strain(
        quiet.position,
        np.where(field.valid[..., None], field.displacement, np.nan),
        (quiet.filtered.covariance, field.covariance),
    )
    np.testing.assert_allclose(field.strain, strain, rtol=0, atol=2e-5)
    np.testing.assert_array_equal(np.isnan(field.strain_covariance), np.isnan(covariance))
    size = np.sqrt(np.diagonal(covariance, axis1=2, axis2=3))
    off = np.abs(field.strain_covariance - covariance) / (size[..., None] * size[..., None, :])
    assert np.nanmax(off) < 1e-4


@pytest.mark.parametrize("window", ["no window", "acrylic and gel"])
def test_the_misfit_is_the_reprojection_error_of_points_from_views_that_weigh_alike(run, window):
    rig = rig_with(window=window)
    rest, now = pressed("holes and a tear", rig, 5)
    now[1].xy[2, 2] += (0, 12)  # off its epipolar line
    misfit = run(rig, rest, now)[1]["misfit"]
    alike = (dataclasses.replace(grid, image_sigma=np.full_like(grid.sigma, 0.1)) for grid in now)
    points = rig.triangulate(*alike)
    left_over = now[0].xy[points.valid] - rig.project(points.xyz[points.valid])[0]
    np.testing.assert_allclose(misfit[:, points.valid].T, left_over, rtol=0.1, atol=1e-3)
    seen = now[0].valid & now[1].valid
    np.testing.assert_array_equal(np.isnan(misfit), [~seen, ~seen])
    assert points.status[2, 2] == PointStatus.INCONSISTENT
    assert np.hypot(*misfit[:, 2, 2]) == pytest.approx(6, abs=0.3)


@pytest.mark.parametrize("window", ["no window", "acrylic and gel"])
def test_points_that_no_rig_can_see_say_why(run, window):
    rng, rig = np.random.default_rng(6), rig_with(window=window)
    rest = views_of(rig, surface(*USUAL), rng)
    now = views_of(rig, surface(*USUAL), rng)
    now[1].xy[2, 2] += (0, 12)  # off its epipolar line
    now[1].xy[4, 4] = now[0].xy[4, 4] + 300  # behind the cameras
    now[1].xy[8, 9] += (-250, 0)  # far in front of the pattern, and of a window
    now = tuple(with_holes(grid, (6, 6)) for grid in now)
    _, _, field = run(rig, rest, now)
    other = rig.triangulate(*now)
    np.testing.assert_array_equal(field.status, other.status)
    assert set(np.unique(field.status)) >= {PointStatus.MISSING, PointStatus.INCONSISTENT}
    assert field.status[8, 9] == (PointStatus.VALID if rig.window is None else PointStatus.BEHIND)


def wide_views(lens, least, most):
    """Return a rig of two such lenses of 500 px, points in directions with these tangents, and
    their grids."""
    matrix = np.array([[500.0, 0, 640], [0, 500, 480], [0, 0, 1]])
    rig = StereoRig(matrix, lens, matrix, lens, np.eye(3), [-4.0, 0, 0])
    rng = np.random.default_rng(4)
    angle, tangent = rng.uniform(0, 2 * np.pi, USUAL), rng.uniform(least, most, USUAL)
    wide = 100 * np.dstack([tangent * np.cos(angle), tangent * np.sin(angle), np.ones(USUAL)])
    grids = views_of(rig, wide, rng, noise=0.0)
    return rig, wide, [dataclasses.replace(g, image_sigma=0.05 + 0 * g.image_sigma) for g in grids]


def test_points_near_the_fold_of_a_lens_are_right_and_none_lies_beyond_it(run):
    """The radius of a pixel is 500 (r + r^3 / 2 - 0.3 r^5) px, at most 659 px where r is 1.207."""
    rig, wide, now = wide_views([0.5, -0.3, 0, 0], 0.9, 1.1)
    for grid in now:
        ahead = wide[0, :, :2] / np.linalg.norm(wide[0, :, :2], axis=1, keepdims=True)
        grid.xy[0] = (640, 480) + 700 * ahead
    rest = views_of(rig, surface(*USUAL), np.random.default_rng(5))
    field = run(rig, rest, now)[2]
    assert (field.status[0] == PointStatus.INCONSISTENT).all()
    found = field.raw.position + field.raw.displacement
    np.testing.assert_allclose(found[1:], wide[1:], atol=0.01)


def test_points_beyond_a_narrow_pole_of_a_fitted_lens_are_right(run):
    """Above and below nearly share a root, where r is 0.707: 1 - 2.002 r^2 and 1 - 2 r^2."""
    rig, wide, now = wide_views([-1.902, -0.2002, 0, 0, 0, -1.8, -0.4, 0], 0.8, 1.0)
    rest = views_of(rig, surface(*USUAL), np.random.default_rng(5))
    field = run(rig, rest, now)[2]
    for found in (field.raw.position + field.raw.displacement, rig.triangulate(*now).xyz):
        np.testing.assert_allclose(found, wide, atol=0.01)


@pytest.mark.parametrize(
    ("views", "window"), [(1, "no window"), (2, "no window"), (2, "acrylic and gel")]
)
def test_a_device_without_double_precision_errs_by_hundredths_of_a_micrometre(
    run, monkeypatch, views, window
):
    rng, rig = np.random.default_rng(8), rig_with(window=window)
    grids = (views_of(rig, surface(*USUAL, press), rng) for press in (0.0, 1.0))
    seen = seen_by(views, rig, *grids)
    _, _, exact = run(*seen)
    monkeypatch.setattr(plans, "has_double", lambda device: False)
    _, _, single = run(*seen)
    off = np.abs(single.displacement - exact.displacement).max()
    assert 0 < off < 1e-4


@pytest.mark.parametrize("window", ["no window", "acrylic and gel"])
def test_nodes_give_the_same_one_by_one_and_four_at_a_time(run, monkeypatch, window):
    rng, rig = np.random.default_rng(9), rig_with(window=window)
    rest, now = (views_of(rig, surface(*USUAL, press), rng) for press in (0.0, 1.0))
    now = with_holes(now[0], (0, 0), (4, 3)), with_holes(now[1], (2, 5))
    _, _, many = run(rig, rest, now)
    monkeypatch.setattr(InSpace, "width", 1)
    _, _, one = run(rig, rest, now)
    np.testing.assert_array_equal(one.status, many.status)
    np.testing.assert_allclose(one.displacement, many.displacement, rtol=0, atol=1e-6)
    np.testing.assert_allclose(one.covariance, many.covariance, rtol=1e-4)
