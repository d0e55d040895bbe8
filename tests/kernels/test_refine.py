"""Every refinement: positions in float32, within the tolerances of the oracle in float64."""

import images
import numpy as np
import pytest
import tolerances
from cases import some
from comparison import assert_corners_equal
from configs import rings
from corner_images import board, corner

from cmp_cl import (
    BinaryRings,
    DetectorConfig,
    EdgeLines,
    EdgeStep,
    Fit,
    Method,
    Midlines,
    RapidCriteria,
    SpectralCriteria,
    reference,
)
from cmp_cl.corners import Refusal

EIGHT = images.eight_bits()
DEEP = images.sixteen_bits()
REFINEMENTS = {
    "centroid": None,
    "edge lines": EdgeLines(),
    "edge step": EdgeStep(),
    "midlines": Midlines(),
    "quadratic midlines": Midlines(fit=Fit.QUADRATIC),
}
METHODS = {
    "centroid": {Method.CENTROID},
    "edge lines": {Method.EDGE_LINES, Method.KEPT},
    "edge step": {Method.EDGE_STEP, Method.EDGE_LINES, Method.KEPT},
    "midlines": {Method.MIDLINE, Method.CUSP, Method.KEPT},
    "quadratic midlines": {Method.MIDLINE, Method.CUSP, Method.KEPT},
}
refinements = pytest.mark.parametrize("refinement", REFINEMENTS)


def check(detector_for, image, refinement, **changes):
    config = rings(refinement=REFINEMENTS[refinement], **changes)
    return assert_corners_equal(detector_for(image, config), image)


@refinements
@pytest.mark.parametrize(
    "name",
    some(EIGHT, ("worn scene",)),
)
def test_positions_of_eight_bits_are_the_oracles(detector_for, name, refinement):
    corners = check(detector_for, EIGHT[name], refinement)
    assert set(corners.method) <= METHODS[refinement]
    assert np.isfinite(corners.xy).all()


@refinements
@pytest.mark.parametrize(
    "name",
    some(DEEP, ("12-bit scene",)),
)
def test_positions_of_sixteen_bits_are_the_oracles(detector_for, name, refinement):
    corners = check(detector_for, DEEP[name], refinement, full_scale=4095)
    assert np.isfinite(corners.xy).all()


@refinements
def test_any_maximum_with_four_sectors_is_refined_as_in_the_oracle(detector_for, refinement):
    """Without the gate, most maxima in noise and texture are rejected by refinement."""
    image = np.vstack([images.texture((800, 83)), EIGHT["noise"], EIGHT["worn scene"]])
    wide = RapidCriteria(sector_threshold=16, ring_threshold=17, corrosion_threshold=17)
    corners = check(detector_for, image, refinement, contrast=None, nms_radius=1, criteria=wide)
    assert len(corners) > 1000
    if refinement != "centroid":
        assert (corners.method == Method.KEPT).any()
        assert (corners.method != Method.KEPT).any()
    first = {"edge step": Method.EDGE_STEP, "edge lines": Method.EDGE_LINES}
    first |= {"midlines": Method.MIDLINE, "quadratic midlines": Method.MIDLINE}
    rejected = corners.method != first.get(refinement, Method.CENTROID)
    assert np.array_equal(rejected, corners.refusal != Refusal.NONE)
    reasons = {
        "centroid": {Refusal.NONE},
        "edge lines": set(Refusal) - {Refusal.FLAT},
        "midlines": {Refusal.NONE, Refusal.RINGS, Refusal.ANGLE, Refusal.SHIFT},
    }
    name = "midlines" if "midlines" in refinement else refinement
    assert set(corners.refusal) - {Refusal.FLAT} == reasons.get(name, reasons["edge lines"])


@refinements
@pytest.mark.parametrize("severity", some([0.5, 1.5], (1.5,)))
def test_positions_on_scenes_are_the_oracles(detector_for, refinement, severity):
    image = images.scene(severity, seed=3).image
    corners = check(detector_for, image, refinement)
    assert len(corners) >= 30


@pytest.mark.parametrize("max_shift", [0.0, 0.2, 5.0])
def test_only_a_position_beyond_the_largest_shift_is_rejected_for_it(detector_for, max_shift):
    image = images.scene(1.5, seed=3).image
    config = DetectorConfig(detection=BinaryRings(), refinement=EdgeLines(max_shift=max_shift))
    corners = assert_corners_equal(detector_for(image, config), image)
    usual = check(detector_for, image, "edge lines")
    stricter, other = (corners, usual) if max_shift < 2 else (usual, corners)  # px, the default
    changed = corners.refusal != usual.refusal
    assert (stricter.refusal[changed] == Refusal.SHIFT).all()
    kept, others_kept = (each.method == Method.KEPT for each in (stricter, other))
    assert (kept | ~others_kept).all()
    if max_shift < 2:
        assert np.count_nonzero(kept) > np.count_nonzero(others_kept)
    if max_shift == 0:
        assert kept.all()


def test_the_step_gives_its_sigma(detector_for):
    image = images.scene(1.5, seed=3).image
    corners = check(detector_for, image, "edge step")
    stepped = corners.method == Method.EDGE_STEP
    assert (corners.sigma[stepped] >= np.float32(0.01)).all()
    assert np.array_equal(np.isnan(corners.sigma), corners.method == Method.KEPT)
    assert 0 < corners.doubtful.sum() < len(corners)


def test_the_lines_give_their_sigma(detector_for):
    corners = check(detector_for, images.scene(1.5, seed=3).image, "edge lines")
    assert np.array_equal(np.isnan(corners.sigma), corners.method == Method.KEPT)
    assert np.nanmax(corners.sigma) > 3 * np.nanmin(corners.sigma)


@pytest.mark.parametrize(
    "changes",
    [{"criteria": SpectralCriteria()}, {"outer_radius": 4}],
    ids=["spectral", "radius 4"],
)
def test_positions_after_every_kind_of_response_equal_the_oracles(detector_for, changes):
    corners = check(detector_for, EIGHT["scene"], "edge lines", **changes)
    assert (corners.method == Method.EDGE_LINES).sum() > 5


@refinements
@pytest.mark.parametrize("inside", some([0, 1, 3, 5], (1,)))
def test_positions_at_the_edge_of_the_image_are_the_oracles(detector_for, refinement, inside):
    image = np.ascontiguousarray(np.tile(corner(20, 20, 0.35), 2)[20 - inside :])
    check(detector_for, image, refinement)
    check(detector_for, np.ascontiguousarray(image.T), refinement)


@pytest.mark.parametrize("steep", some([1, 20], (20,)))
@pytest.mark.parametrize("refinement", [name for name in REFINEMENTS if name != "edge step"])
def test_positions_on_clipped_profiles_are_the_oracles(detector_for, refinement, steep):
    """Grey levels are clipped at 0 and 255, so that most neighbours are equal. For EdgeStep, see
    test_edge_step, where both of its forms refine them."""
    grey = (EIGHT["board"].astype(np.float64) - 120) * steep + 120
    image = np.where(grey < 0, 0, np.where(grey > 255, 255, grey)).astype(np.uint8)
    check(detector_for, image, refinement)


@pytest.mark.parametrize(
    ("refinement", "columns"),
    [
        ("edge step", 4000),
        *(
            pytest.param(*case, marks=pytest.mark.exhaustive)
            for case in (
                ("edge lines", 4000),
                ("midlines", 4000),
                ("edge lines", 16000),
                ("edge step", 16000),
            )
        ),
    ],
)
def test_far_columns_are_equally_exact(detector_for, refinement, columns):
    """If columns are added on the left, corners move by their number, up to float32's spacing."""
    image = board(*images.SHAPE, 12)[0]
    added = columns - images.SHAPE[1]
    wide = np.pad(image, ((0, 0), (added, 0)), mode="edge")
    config = DetectorConfig(detection=BinaryRings(), refinement=REFINEMENTS[refinement])
    near = reference.detect(image, config)
    far = detector_for(wide, config)(wide)
    clear = near.pixel[:, 0] > 20
    same = far.pixel[:, 0] > added + 20
    np.testing.assert_array_equal(far.pixel[same], near.pixel[clear] + [added, 0])
    rounding = np.spacing(np.float32(columns)) / 2
    moved = far.xy[same].astype(np.float64) - [added, 0]
    np.testing.assert_allclose(
        moved, near.xy[clear], rtol=0, atol=rounding + tolerances.POSITION / 10
    )


def test_positions_are_near_the_truth(detector_for):
    image, truth = board(121, 83, 12)
    for refinement, error in [("edge lines", 0.03), ("edge step", 0.03), ("centroid", 0.7)]:
        corners = check(detector_for, image, refinement)
        distance = np.linalg.norm(corners.xy[:, None] - truth, axis=2).min(axis=0)
        assert distance.mean() < error


def test_corners_in_noise_are_refined_as_in_the_oracle(detector_for):
    rng = np.random.default_rng(0)
    board_image = board(121, 83, 12)[0].astype(np.float64)
    for sigma in (5, 15, 25):
        grey = board_image + rng.normal(0, sigma, board_image.shape)
        image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
        for refinement in REFINEMENTS:
            check(detector_for, image, refinement)
