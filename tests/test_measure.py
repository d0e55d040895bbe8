"""Measuring from Python: fields from a video of two views, a pattern in one view, aligned views."""

import contextlib
import dataclasses
import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
from comparison import assert_same_bytes
from corner_images import grain
from gels import NODES, RIG, SPLIT, VIEW, numbered_otherwise, pressed, rendered_gel
from lattices import drawn
from videos import write_video

import cmp_cl
from cmp_cl import GridError, NodeStatus, StereoRig, measure
from cmp_cl.measure import OneView
from cmp_cl.measure.views import View
from cmp_cl.media import read_frames
from cmp_cl.motion.plan import FieldPlan
from cmp_cl.opencl import memory
from cmp_cl.synthetic import boards

FILM = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.6, 0.6)  # a press that ends, and one at once


@pytest.fixture(scope="session")
def film():
    """Return frames of both views."""
    return [pressed(severity).frame for severity in FILM]


@pytest.fixture
def two_views(film):
    """Yield what measures both views against the first frame of the film."""
    with measure.TwoViews(film[0], RIG, SPLIT, shape=NODES) as following:
        yield following


def test_the_ten_lines_of_the_readme_turn_a_video_into_fields(tmp_path, monkeypatch):
    readme = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    example = readme.split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(tmp_path)
    RIG.save("rig.yaml")
    write_video("press.mp4", [pressed(0.0).frame, pressed(0.4).frame], "mp4v")
    exec(example.replace("(40, 40)", "(12, 12)"), {})  # the video is small
    assert [path.name for path in tmp_path.glob("*.vtp")] == ["press-0001.vtp"]
    frames = [frame.image for frame in read_frames("press.mp4")]
    with measure.TwoViews(frames[0], RIG, SPLIT, shape=NODES) as against_rest:
        field = against_rest(frames[1]).field
    truth = pressed(0.4).xyz - pressed(0.0).xyz
    assert np.count_nonzero(field.valid) > 0.95 * field.status.size
    off = np.linalg.norm(field.displacement - truth, axis=2)[field.valid]
    assert np.sqrt(np.mean(off**2)) < 0.1 * np.linalg.norm(truth, axis=2).max()


def test_two_views_have_the_field_that_displacement_returns(film):
    with measure.TwoViews(film[0], RIG, SPLIT, shape=NODES, strain=True) as against_rest:
        measured = against_rest(film[4])
        other = cmp_cl.displacement(
            against_rest.rest, RIG.triangulate(*measured.grids)
        ).with_strain()
    found = measured.field
    np.testing.assert_array_equal(found.status, other.status)
    np.testing.assert_allclose(found.displacement, other.displacement, rtol=0, atol=1e-5)
    np.testing.assert_allclose(found.sigma, other.sigma, rtol=2e-3)
    np.testing.assert_allclose(found.strain, other.strain, rtol=0, atol=1e-5)
    np.testing.assert_allclose(found.strain_sigma, other.strain_sigma, rtol=2e-3)


def test_the_bias_sigma_is_what_the_error_of_a_calibrated_rig_does(film):
    error = np.zeros(22)
    error[17], error[19] = 1e-3, 0.02  # the right camera turns and stands farther off
    turn = cv2.Rodrigues(np.array([0, error[17], 0]))[0]
    wrong = dataclasses.replace(RIG, R=turn @ RIG.R, T=RIG.T + error[19:])
    known = dataclasses.replace(RIG, covariance=np.outer(error, error))
    with measure.TwoViews(film[0], known, SPLIT, shape=NODES) as against_rest:
        measured = against_rest(film[4])
    with measure.TwoViews(film[0], wrong, SPLIT, shape=NODES) as against_rest:
        off = against_rest(film[4]).field.displacement - measured.field.displacement
    share = measured.arrays["bias_sigma"] / np.linalg.norm(off, axis=2)
    assert np.median(share) == pytest.approx(1, rel=0.1)


def test_a_frame_is_tracked_or_numbered_anew_and_the_result_is_the_same(film):
    with measure.TwoViews(film[0], RIG, SPLIT, shape=NODES) as following:
        tracked = list(following.stream(film))
        again = [following(frame) for frame in film]
    anew = []
    for frame in film:  # nothing is known of the frame before
        with measure.TwoViews(film[0], RIG, SPLIT, shape=NODES) as alone:
            anew.append(alone(frame))
    assert sum(each.tracked for each in [*tracked, *again]) > len(film)
    assert not any(each.tracked for each in anew)
    assert repr(tracked[0]).startswith("<Measured: <DisplacementField of ")
    for one, other in zip([*tracked, *again], [*anew, *anew], strict=True):
        for grid, expected in zip(one.grids, other.grids, strict=True):
            np.testing.assert_array_equal(grid.index, expected.index)
        for name, values in one.arrays.items():
            np.testing.assert_array_equal(values, other.arrays[name], name)


def enlarged(image):
    """No corner looks like its model, by which the least percentile of residuals shows."""
    return image.repeat(3, axis=0).repeat(3, axis=1)


def grainy(image, deviation=6):
    """Return the image with noise that neighbours share."""
    grey = image + deviation * grain(image.shape, 2, 1)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def torn(node, half, by):
    """Return what moves the square of so many px around a node of the second frame of FILM."""

    def change(image):
        x, y = np.rint(pressed(FILM[1]).left.truth[node]).astype(int)
        top, left, side = y - half, x - half, 2 * half + 1
        image = image.copy()
        moved = image[top - by : top - by + side, left - by : left - by + side].copy()
        image[top : top + side, left : left + side] = moved
        return image

    return change


@pytest.mark.parametrize(
    ("at_rest", "now", "seen"),
    [
        (enlarged, enlarged, lambda grid: np.nanmedian(grid.image_sigma) > 0.2),
        (grainy, grainy, lambda grid: np.nanmedian(grid.image_sigma) > 0.05),
        (np.copy, torn((5, 6), 4, 2), lambda grid: grid.status[5, 6] == NodeStatus.ATTACHED),
        (np.copy, torn((5, 6), 2, 4), lambda grid: grid.status[5, 6] == NodeStatus.SECOND_LOOK),
    ],
    ids=["enlarged", "grainy", "torn, attached", "torn, looked at again"],
)
def test_a_changed_frame_is_the_same_tracked_or_numbered(at_rest, now, seen):
    rest, frame = at_rest(pressed(FILM[0]).left.image), now(pressed(FILM[1]).left.image)
    with OneView(rest, shape=NODES) as following:
        following(rest)
        tracked = following(frame)
    with OneView(rest, shape=NODES) as alone:
        anew = alone(frame)
    assert (tracked.tracked, anew.tracked) == (True, False)
    grid, corners = tracked.grids[0], tracked.corners[0]
    assert seen(grid)
    known = grid.index[:, 0] >= 0
    own = grid.image_sigma[tuple(grid.index[known].T)]
    np.testing.assert_array_equal(own, corners.sigma[known])  # the kernel's, and the host's
    for name in ("xy", "status", "image_sigma"):
        one, other = (getattr(each.grids[0], name) for each in (tracked, anew))
        np.testing.assert_array_equal(one, other, name)
    for name, values in tracked.arrays.items():
        np.testing.assert_array_equal(values, anew.arrays[name], name)


@pytest.mark.parametrize("refinement", [cmp_cl.EdgeLines(), cmp_cl.Midlines()])
def test_tracked_corners_of_any_refinement_have_their_sigma_and_a_field(refinement):
    config = cmp_cl.DetectorConfig.for_cell(15).replace(refinement=refinement)
    rest, frame = (pressed(each).left.image for each in FILM[:2])
    with OneView(rest, shape=NODES, config=config) as following:
        following(rest)
        tracked = following(frame)
    assert tracked.tracked
    grid, corners = tracked.grids[0], tracked.corners[0]
    known = (grid.index[:, 0] >= 0) & (corners.refusal == 0)
    own = grid.image_sigma[tuple(grid.index[known].T)]
    np.testing.assert_array_equal(own, corners.sigma[known])
    assert tracked.field.valid.mean() > 0.9


@pytest.fixture(params=["as it is", "of its own"])
def any_memory(request, monkeypatch):
    """Let the device have the memory that it has, then one that the host does not share."""
    if request.param == "of its own":
        monkeypatch.setattr(memory, "shares_memory", lambda _: False)


@pytest.mark.usefixtures("any_memory")
def test_a_stream_is_measured_as_calls_are_and_refuses_them_until_it_ends(two_views, film):
    calls = [two_views(frame) for frame in film]
    alone = [each.field.displacement for each in calls]
    for each, called in zip(two_views.stream(film), calls, strict=True):
        np.testing.assert_array_equal(each.field.displacement, called.field.displacement)
        for corners, expected in zip(each.corners, called.corners, strict=True):
            assert_same_bytes(corners, expected)
    left = two_views.stream(film)
    next(left)
    within = [lambda: two_views(film[5]), two_views.skip, lambda: next(two_views.stream(film))]
    for call in within:
        with pytest.raises(cmp_cl.FieldError, match="has not ended: take its frames, or"):
            call()
    left.close()  # the second frame runs, and nobody checks its nodes
    after = two_views(film[4])
    assert not after.tracked
    np.testing.assert_array_equal(after.field.displacement, alone[4])


def test_audits_take_the_views_in_turn(two_views, film, monkeypatch):
    number, audited = View.number, []

    def noted(view, corners, image):
        audited.append(view)
        return number(view, corners, image)

    monkeypatch.setattr("cmp_cl.measure.measurement.AUDITED", 2)
    two_views(film[0])
    monkeypatch.setattr(View, "number", noted)
    for frame in (film[1], film[0], film[1], film[0]):
        assert two_views(frame).tracked
    first, second = audited
    assert first is not second


def test_an_audit_tells_the_nodes_that_tracking_numbered_otherwise(two_views, film, monkeypatch):
    monkeypatch.setattr("cmp_cl.measure.measurement.AUDITED", 2)
    found = [two_views(frame) for frame in film[:4]]
    assert [each.tracked for each in found] == [False, True, True, True]
    assert [each.differing for each in found] == [0, 0, 0, 0]
    monkeypatch.setattr(View, "number", numbered_otherwise)
    audited = two_views(film[3])
    assert (audited.tracked, audited.differing) == (False, 4)  # two in each view
    after = two_views(film[3])
    assert (after.tracked, after.differing) == (True, 0)


def test_an_audit_finds_nodes_that_tracking_has_lost(monkeypatch):
    """A hand hides them while they move by more than a third of a cell, and the others do not."""
    monkeypatch.setattr("cmp_cl.measure.measurement.AUDITED", 4)
    rest, nodes = drawn(30, 30)
    y, x = np.indices(rest.shape, np.float32)
    middle = nodes[14:16, 14:16].mean(axis=(0, 1))
    far = (x - middle[0]) ** 2 + (y - middle[1]) ** 2
    hidden = np.where(far < 44**2, np.uint8(120), rest)
    bump = 13 * np.exp(-far / (2 * 16**2)).astype(np.float32)
    moved = cv2.remap(rest, x - bump, y - bump, cv2.INTER_LINEAR)
    with OneView(rest, shape=(30, 30)) as following:
        found = [following(each) for each in (rest, hidden, moved, moved, moved, moved)]
    assert [each.tracked for each in found[1:]] == [True, True, True, False, True]
    assert [each.nodes for each in found[3:]] == [899, 900, 900]
    assert found[4].differing == 0


def beyond(degrees, steps):
    """Return frames of a turned pattern that goes on beyond the view; steps: px to the right."""
    sheet, nodes = drawn(40, 40)
    middle = nodes.mean(axis=(0, 1))
    turn = cv2.getRotationMatrix2D(middle.tolist(), degrees, 1)
    turn[:, 2] += np.array([340, 300]) / 2 - middle
    for step in steps:
        moved = turn + np.array([[0, 0, step], [0, 0, 0]])
        yield cv2.warpAffine(sheet, moved, (340, 300), flags=cv2.INTER_AREA)


@pytest.mark.parametrize("degrees", [0, 4, 25])
def test_a_pattern_beyond_the_view_is_tracked_though_it_is_turned(degrees):
    """Lines come into view and leave it; where it is turned, they lie in the view in part."""
    steps = (0, 4, 9, 14, 19, 24, 26) if degrees == 0 else range(4)
    frames = list(beyond(degrees, steps))
    with OneView(frames[0], track=True) as following:
        found = list(map(following, frames))
    assert [each.tracked for each in found] == [False] + (len(frames) - 1) * [True]
    for step, each in zip(steps, found, strict=True):
        off = each.field.displacement - (step, 0)
        assert each.field.valid.mean() > (0.9 if degrees == 0 else 0.6)
        assert np.nanmax(np.linalg.norm(off, axis=2)) < 0.3


def test_a_slip_shows_at_a_side_where_the_pattern_ends():
    sheet, _ = drawn(40, 40)
    rest, slipped = (np.ascontiguousarray(sheet[y : 360 + y, 200:620]) for y in (0, 40))
    with OneView(rest, track=True) as following:
        assert following.rest_grids[0].border == (True, False, False, False)
        found = list(map(following, (rest, rest, slipped)))
    assert [each.tracked for each in found] == [False, True, False]


def test_a_tracked_frame_says_what_its_kernels_took(film):
    with measure.TwoViews(film[0], RIG, SPLIT, shape=NODES, profile=True) as following:
        following(film[0])
        assert following(film[1]).tracked
        assert 10 < following.launches < 60
        assert {"match", "enter", "space", "blend"} < set(following.times)
        assert len(following.times) <= following.launches
        assert all(ms >= 0 for ms in following.times.values())
        for _ in following.stream(film):  # while the next one runs
            assert all(ms >= 0 for ms in following.times.values())


def test_a_frame_that_is_missing_in_a_stream_has_no_result(two_views, film):
    found = list(two_views.stream([film[0], None, film[1], film[2], None]))
    assert [each is None for each in found] == [False, True, False, False, True]


def test_a_frame_that_does_not_fit_is_refused_and_the_next_one_is_measured(two_views, film):
    wider = np.pad(film[1], ((0, 40), (0, 60)))
    expected = two_views(film[2]).field.displacement
    for other in (wider, film[1][:-5], film[1].astype(np.uint16), film[1].astype(float)):
        with pytest.raises(cmp_cl.ImageError, match=r"of uint8, this one \(|of float64"):
            list(two_views.stream([film[1], other, film[1]]))
    np.testing.assert_array_equal(two_views(film[2]).field.displacement, expected)


@pytest.mark.usefixtures("any_memory")
@pytest.mark.parametrize("most", [1, 65536], ids=["lists that grow", "long lists"])
def test_a_frame_with_more_corners_than_there_is_room_for_is_measured_and_so_is_the_next(most):
    images = [np.pad(pressed(severity).left.image, ((0, 0), (0, 260))) for severity in FILM[:4]]
    y, x = np.indices((len(images[2]), 240)) // 12 % 2
    images[2][:, -240:] = np.where(x == y, 200, 40)  # a board beside the pattern
    config = cmp_cl.DetectorConfig.for_cell(12).replace(max_corners=most)
    with OneView(images[0], shape=NODES, config=config) as following:
        _, few, crowded, after = map(following, images)
    assert len(crowded.corners[0]) > 2 * len(few.corners[0])
    assert few.tracked
    assert crowded.nodes == after.nodes == 144
    assert after.tracked
    with OneView(images[0], shape=NODES, config=config) as alone:
        np.testing.assert_array_equal(after.field.displacement, alone(images[3]).field.displacement)


@pytest.mark.parametrize(
    ("part", "step", "error"),
    [
        (cmp_cl.Detector, "finish", cmp_cl.DeviceError("the device is lost")),
        (FieldPlan, "start", KeyboardInterrupt()),
        (FieldPlan, "read", KeyboardInterrupt()),
    ],
)
def test_a_frame_that_fails_or_is_interrupted_costs_no_memory_and_the_next_is_numbered_anew(
    two_views, film, monkeypatch, part, step, error
):
    def fails(*_):
        raise error

    begin, used = cmp_cl.Detector.begin, []

    def noted(detector, *frames, **how):
        used.append(detector.memory)
        return begin(detector, *frames, **how)

    monkeypatch.setattr(cmp_cl.Detector, "begin", noted)
    two_views(film[0])
    for frame in film[1:5]:
        assert two_views(frame).tracked
        with monkeypatch.context() as patch:
            patch.setattr(part, step, fails)
            with pytest.raises(type(error)):
                two_views(film[6])
        assert not two_views(frame).tracked
    assert used[-1] == used[2]  # before that, other stages make their plans


class Interrupted:
    """A lock that Ctrl-C interrupts as it is left, after so many times."""

    def __init__(self, lock, times):
        self.lock, self.times = lock, times

    def __enter__(self):
        self.lock.acquire()

    def __exit__(self, *_):
        self.lock.release()
        self.times -= 1
        if self.times == 0:
            raise KeyboardInterrupt


@pytest.mark.parametrize("times", range(1, 7))
def test_an_interrupt_between_the_parts_of_a_call_keeps_no_call_from_what_follows(film, times):
    with OneView(film[0][:, :240], shape=NODES) as following:
        lock, following._lock = following._lock, Interrupted(following._lock, times)
        with pytest.raises(KeyboardInterrupt):
            following(film[1][:, :240])
        following._lock = lock
        assert following(film[1][:, :240]).nodes


def test_a_measured_frame_can_be_pickled_for_another_process(two_views, film):
    anew, tracked = map(two_views, film[:2])
    for sent in (anew, tracked):
        came = pickle.loads(pickle.dumps(sent))
        assert repr(came) == repr(sent)
        assert (came.tracked, came.misfit) == (sent.tracked, sent.misfit)
        for name, values in sent.arrays.items():
            np.testing.assert_array_equal(came.arrays[name], values, name)
        for one, other in zip(came.grids + came.views, sent.grids + sent.views, strict=True):
            np.testing.assert_array_equal(getattr(one, "xy", one), getattr(other, "xy", other))
        for one, other in zip(came.corners, sent.corners, strict=True):
            assert_same_bytes(one, other)


def test_a_view_is_measured_against_the_view_at_rest():
    rest, now = pressed(0.0).left.image, pressed(0.4).left.image
    with OneView(rest, shape=NODES) as against_rest:
        still, moved = against_rest(rest), against_rest(now)
        empty = against_rest(np.zeros_like(rest))
    assert against_rest.unit == "px"
    assert still.largest < 1e-6  # px, of single precision
    assert still.nodes == against_rest.nodes == 144
    np.testing.assert_array_equal(still.grids[0].xy, against_rest.rest_grids[0].xy)
    assert moved.largest > 1
    assert (empty.nodes, empty.largest) == (0, 0)
    assert np.isnan(empty.field.displacement).all()
    moved.field.position[0, 0] = 0  # each field has its own
    assert still.field.position[0, 0].all()
    with pytest.raises(cmp_cl.DeviceError, match="closed"):
        against_rest(rest)


def test_a_torn_view_at_rest_has_not_moved():
    torn = pressed(1.8).left.image
    with OneView(torn, shape=NODES) as against_rest:
        assert (against_rest.rest_grids[0].status == NodeStatus.ATTACHED).any()
        anew, tracked = against_rest(torn), against_rest(torn)
    assert (anew.tracked, tracked.tracked) == (False, True)
    assert max(anew.largest, tracked.largest) < 1e-6  # px, of single precision


def test_values_before_the_filter_are_there_too_and_less_certain():
    rest, now = (pressed(severity).left.image for severity in (0.0, 0.4))
    with OneView(rest, shape=NODES) as view:
        arrays, constants = view(now).arrays, view.constants
    moved = arrays["xy"] - constants["xy_rest"]
    np.testing.assert_allclose(arrays["raw_displacement"], moved, rtol=0, atol=1e-4)
    np.testing.assert_array_equal(constants["raw_rest"], constants["xy_rest"])
    for name, values in (("displacement", arrays), ("rest", constants)):
        assert (values[name] != values[f"raw_{name}"])[np.isfinite(values[name])].any()
    assert np.nanmedian(arrays["sigma"]) < np.nanmedian(arrays["raw_sigma"])


@pytest.mark.parametrize("degrees", [90, 180, -90])
def test_a_camera_of_the_rig_may_be_rolled(degrees):
    """Rows and columns of the pattern are as many, and its colours stay after each turn."""
    roll = cv2.Rodrigues(np.array([0.0, 0.0, np.radians(degrees)]))[0]
    rolled = dataclasses.replace(RIG, R=roll @ RIG.R, T=roll @ RIG.T)
    rest, now = rendered_gel(rolled, severity=0.0), rendered_gel(rolled)
    with measure.TwoViews(rest.frame, rolled, SPLIT, shape=NODES) as against_rest:
        field = against_rest(now.frame).field
        _, tracked = map(against_rest, (rest.frame, rest.frame))
    assert tracked.tracked
    for grid, at_rest in zip(tracked.grids, against_rest.rest_grids, strict=True):
        assert grid.reach == at_rest.reach
    off = np.linalg.norm(field.displacement - (now.xyz - rest.xyz), axis=2)[field.valid]
    assert field.valid.mean() > 0.95
    assert np.sqrt(np.mean(off**2)) < 0.05


AHEAD = [[600, 0, 120], [0, 600, 150], [0, 0, 1]]
BESIDE = StereoRig(AHEAD, [], AHEAD, [], np.eye(3), np.array([-4.0, 0, 0]))  # parallel cameras


def test_views_that_may_show_different_parts_of_a_pattern_are_refused():
    split = cmp_cl.BinocularSplit.halves(580, 240)
    sheet, _ = drawn(14, 30)  # cells of 20 px; the first column of nodes is at 60 px
    bordered, inside = (
        np.hstack([sheet[90:330, x : x + 290], sheet[90:330, x + 4 : x + 294]]) for x in (0, 107)
    )
    with measure.TwoViews(bordered, BESIDE, split) as against_rest:
        np.testing.assert_allclose(against_rest.rest.xyz[..., 2], 600, atol=60)
    _, seen = measure.find_pattern(np.ascontiguousarray(inside[:, :290]))
    for shape in (None, seen.shape):
        with pytest.raises(GridError, match=r"different parts .* by 0 rows and -?2 columns"):
            measure.TwoViews(inside, BESIDE, split, shape=shape)


def knocked(shot, *, across=0.0, degrees=0.0, zoom=1.0):
    """Return the frame of a shot whose right view has moved by px, turned, and been enlarged."""
    rows, columns = VIEW
    change = cv2.getRotationMatrix2D((columns / 2, rows / 2), degrees, zoom)
    change[1, 2] += across
    moved = cv2.warpAffine(
        shot.right.image, change, (columns, rows), flags=cv2.INTER_CUBIC, borderValue=115
    )
    return np.hstack([shot.left.image, moved])


@pytest.mark.parametrize("severity", [0.0, 0.9])
def test_a_view_that_is_knocked_after_rest_is_told(two_views, severity):
    shot = pressed(severity)
    knocks = *({"across": px} for px in (0.5, -2.0, 5.0)), {"degrees": 0.2}, {"zoom": 1.005}
    for knock in knocks:
        measured = two_views(knocked(shot, **knock))
        assert measured.misfit, knock
        assert measured.arrays["misfit"]
        assert measured.nodes > 130
    gone = two_views(knocked(shot, across=20.0))
    assert (gone.nodes, gone.misfit) == (0, True)
    still = two_views(knocked(shot)), two_views(shot.frame)
    assert [(each.misfit, each.nodes) for each in still] == 2 * [(False, 144)]
    assert not still[0].arrays["misfit"]


def still(**changes):
    """Return a frame of an unworn gel at rest."""
    return rendered_gel(**{"severity": 0.0, "corrosion": 0.0, "noise": 0.0, **changes}).frame


def test_noise_in_few_nodes_or_after_a_perfect_rest_is_no_knock():
    for shape, noise in ((NODES, 20.0), ((5, 5), 4.0)):
        rest = still(markers=shape[0])
        with measure.TwoViews(rest, RIG, SPLIT, shape=shape) as against_rest:
            for seed in range(6):
                measured = against_rest(still(markers=shape[0], noise=noise, seed=seed))
                assert measured.nodes == shape[0] * shape[1]
                assert not measured.misfit


def test_a_rig_that_was_out_of_date_at_rest_tells_only_what_moves_after_it():
    old = dataclasses.replace(RIG, K1=RIG.K1 * [[1], [1.005], [1]])
    with measure.TwoViews(still(), old, SPLIT, shape=NODES) as against_rest:
        for change in ({"position": (5.0, -7.0)}, {"position": (-6.0, 9.0)}, {"severity": 1.0}):
            assert not against_rest(still(**change)).misfit, change
        for across in (1.0, -1.0):
            assert against_rest(knocked(pressed(0.0), across=across)).misfit, across


def test_neither_a_press_nor_wear_nor_dim_light_nor_a_gel_that_moves_is_a_knock(two_views):
    changes = (
        *({"severity": severity} for severity in (0.1, 0.5, 1.0, 1.5, 2.0)),
        {"corrosion": 3.0},
        {"exposure": 0.2},
        {"noise": 12.0},
        {"blur": 2.0},
        {"position": (5.0, -7.0), "rotation": 0.05},
    )
    for change in changes:
        measured = two_views(rendered_gel(**{"severity": 0.0, **change}).frame)
        assert measured.nodes > 70
        assert not measured.misfit, change
    with OneView(pressed(0.0).left.image, shape=NODES) as one:
        measured = one(pressed(0.4).left.image)
    assert not measured.misfit
    assert "misfit" not in measured.arrays


def test_a_known_size_pairs_views_that_see_opposite_borders():
    sheet, _ = drawn(14, 12)  # from 40 to 300 px; the outer columns of nodes lie 20 px inside
    frame = np.hstack([sheet[:, 10:290], sheet[:, 50:330]])
    split = cmp_cl.BinocularSplit.halves(560, len(sheet))
    with pytest.raises(GridError, match="different parts"):
        measure.TwoViews(frame, BESIDE, split)
    with measure.TwoViews(frame, BESIDE, split, shape=(14, 12)) as against_rest:
        np.testing.assert_allclose(against_rest.rest.xyz[..., 2], 60, atol=1)


def test_a_size_that_was_not_asked_for_is_said_to_be_the_left_view_s():
    shot = pressed(0.0)
    _, grid = measure.find_pattern(shot.left.image)
    left = shot.left.image.copy()
    left[:, round(float(np.nanmax(grid.xy[:, -3, 0]))) + 4 :] = 115
    with pytest.raises(GridError, match=r"right view: .* 12 x 12 corners, in the left view like 1"):
        measure.TwoViews(np.hstack([left, shot.right.image]), RIG, SPLIT)


def test_a_frame_of_one_view_is_refused_as_one_of_two():
    view = pressed(0.0).left.image
    with pytest.raises(GridError, match="no node in common; check the split"):
        measure.TwoViews(view, RIG, cmp_cl.BinocularSplit.halves(*view.shape[::-1]), shape=NODES)


def test_a_pattern_is_found_without_its_cell():
    view = pressed(0.0).left.image
    cell, grid = measure.find_pattern(view, shape=(12, 12))
    assert grid.shape == (12, 12)
    steps = [np.linalg.norm(np.diff(grid.xy, axis=axis), axis=2) for axis in (0, 1)]
    assert cell == pytest.approx(np.median(np.concatenate(steps, axis=None)))
    with pytest.raises(GridError, match="of 12 x 12 corners"):
        measure.find_pattern(np.zeros_like(view), shape=(12, 12))


def test_a_board_has_the_nodes_that_a_calibration_may_use_at_their_filtered_positions():
    image, _ = drawn(9, 6)
    image[:, :90] = grainy(image, 30)[:, :90]
    _, seen = measure.find_pattern(image, shape=(9, 6))
    board = measure.find_board(image, (9, 6))
    assert seen.valid.all()
    np.testing.assert_array_equal(board.valid, seen.image_sigma <= 0.2)
    assert board.valid[:, 2:].all()
    assert not board.valid[:, :2].all()
    assert np.nanmedian(board.sigma) < np.nanmedian(seen.sigma[board.valid])


def test_a_board_without_a_sure_corner_is_refused():
    image, _ = drawn(9, 6)
    assert measure.find_board(grainy(image, 10), (9, 6)).valid.sum() > 40
    with pytest.raises(GridError, match=r"no corner has a sigma of at most 0.2 px"):
        measure.find_board(grainy(image, 40), (9, 6))


# a moving pattern without a border in view


def moved_by(cells: float, down: float = 0.5) -> np.ndarray:
    """Return a checkerboard of cells of 12 px that goes on beyond all edges, (146, 148) uint8.

    It has moved by so many cells along x, and down by a share of them."""
    camera = boards.plane(cell=12, middle=(4 + 12 * cells, 3 + 12 * down * cells))
    return boards.drawn(camera, (146, 148), count=3).image


def skipped(view, images):
    return [view.skip() if image is None else view(image) for image in images]


def blank(view, images):
    covered = np.full((146, 148), 90, np.uint8)
    return [view(covered if image is None else image) for image in images]


def failed(view, images):
    def fails(*_):
        raise cmp_cl.DeviceError("the device is lost")

    found = []
    for image in images:
        with contextlib.suppress(cmp_cl.DeviceError), pytest.MonkeyPatch.context() as patch:
            if image is None:
                patch.setattr(cmp_cl.Detector, "finish", fails)
            found.append(view(moved_by(0) if image is None else image))
    return found


def measured_at(places: list[float | None], measured=skipped, *, track: bool = True, down=0.5):
    """Return the mean displacement of each frame that shows the pattern, in cells along x, and
    which are ambiguous.

    places: how far the pattern has moved in each frame, in cells; None for a missing one.
    measured: how frames are measured of which some are None.
    """
    images = [None if cells is None else moved_by(cells, down) for cells in places]
    config = cmp_cl.DetectorConfig.for_cell(12)
    with OneView(moved_by(0), config=config, track=track) as view:
        found = [each for each in measured(view, images) if each is not None and each.nodes]
    shifts = [np.nanmean(each.field.displacement[..., 0]) / 12 for each in found]
    return shifts, [each.ambiguous for each in found]


missing = pytest.mark.parametrize("measured", [skipped, blank, failed, OneView.stream])


@missing
def test_tracking_follows_a_pattern_without_a_border_over_a_missing_frame(measured):
    shifts, ambiguous = measured_at([0.4, 0.8, 1.2, None, 1.6, 2.0, 2.4], measured)
    np.testing.assert_allclose(shifts, [0.4, 0.8, 1.2, 1.6, 2.0, 2.4], atol=0.02)
    assert not any(ambiguous)


def test_without_tracking_a_pattern_without_a_border_is_ambiguous():
    shifts, ambiguous = measured_at([0.0, 0.4, 2.0], track=False)
    assert ambiguous == [True, True, True]
    assert shifts[2] == pytest.approx(0, abs=1.1)


@missing
@pytest.mark.parametrize("places", [[0.4, None, None, 0.4, 0.8], [0.4, 1.3, 1.6]])
def test_tracking_that_lost_the_pattern_is_ambiguous_from_then_on(places, measured):
    assert measured_at(places, measured)[1] == [False, True, True]


@missing
@pytest.mark.parametrize("step", [0.31, 0.33, 0.345])
def test_a_slip_by_whole_cells_over_a_missing_frame_is_ambiguous(measured, step):
    """By less than half a cell a frame along the diagonal, to a position that looks the same."""
    places = [step, 2 * step, None, 4 * step, 5 * step]
    assert measured_at(places, measured, down=1)[1] == [False, False, True, True]
