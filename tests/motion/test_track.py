"""The kernels that follow nodes from frame to frame, their oracle, and what they must never do."""

import dataclasses

import numpy as np
import pyopencl as cl
import pytest
from lattices import corners_at, keep
from stereo_data import grid_of

from cmp_cl.grid.grid import NodeStatus, Sides
from cmp_cl.motion.nodes import put
from cmp_cl.motion.track import Tracker, colour_of
from cmp_cl.opencl.launches import enqueue
from cmp_cl.opencl.memory import Memory
from cmp_cl.opencl.program import programs_of
from cmp_cl.reference.field import track as oracle
from cmp_cl.stages.refine import EDGES, METHOD, POSITION, RESULT_FIELDS, RESULT_HEAD, VARIANCE

SIZE = 420, 460
SHAPE = 18, 22  # nodes; each other shape is compiled anew
CELL = 17.0
ROOM = 1024  # corners of a view


def lattice(rows, columns, *, turn=0.05, bend=2.0, at=(40.0, 50.0)):
    y, x = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    flat = np.stack([x, y], axis=2) * CELL
    wave = bend * np.stack([np.sin(y / 3), np.cos(x / 4)], axis=2)
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return flat @ rotation + wave + np.array(at)


def whole(xy):
    """Return the grid of a whole board with nodes there."""
    return dataclasses.replace(grid_of(xy, 0.03), border=Sides(True, True, True, True))


def board_at(xy, *, turn=0.05):
    """Return the corners of a checkerboard whose nodes (R, C, 2) are there."""
    r, c = np.indices(xy.shape[:2])
    angle = np.where((r + c) % 2, np.pi / 2, 0.0).ravel() + turn
    return corners_at(
        xy, sigma=np.full(angle.size, 0.04), edges=angle[:, None] + (0, 1.6, 3.1, -1.5)
    )


def joined(one, other):
    names = [name for name, values in vars(one).items() if isinstance(values, np.ndarray)]
    both = {name: np.concatenate([getattr(one, name), getattr(other, name)]) for name in names}
    return dataclasses.replace(one, **both)


def records(corners):
    """Return what the kernels take of corners, (N, 4): x, y, first boundary, sigma."""
    return np.column_stack([corners.xy, corners.edges[:, 0], corners.sigma]).astype(np.float64)


def result_of(found, room):
    """Return corners of some views as kernels/result.clh lays them out."""
    result = np.zeros((len(found), RESULT_HEAD + RESULT_FIELDS * room), np.float32)
    for row, corners in zip(result, found, strict=True):
        count, padded = len(corners), -(-len(corners) // 8) * 8
        row[:1].view(np.uint32)[0] = count
        fields = row[RESULT_HEAD:][: RESULT_FIELDS * padded].reshape(RESULT_FIELDS, padded)
        fields[POSITION].reshape(-1)[: 2 * count] = corners.xy.ravel()
        fields[EDGES].reshape(-1)[: 4 * count] = corners.edges.ravel()
        fields[METHOD].view(np.uint8)[:count] = corners.method
        fields[METHOD].view(np.uint8)[padded : padded + count] = corners.refusal
        fields[VARIANCE, :count] = corners.sigma**2
    return result


@pytest.fixture
def tracker_of(device):
    """Return tracker_of(rests): follow(corners) of views at rest, which returns what was found and
    the arrays of the frame, and reset()."""
    made = []

    def of(*rests):
        programs = programs_of(device.handle)
        queue = cl.CommandQueue(programs.context)
        frame = Memory(queue, Tracker.layout(len(rests), rests[0].shape[:2]))
        views = [(whole(xy), board_at(xy)) for xy in rests]
        tracker = Tracker(
            queue,
            programs,
            views=views,
            size=SIZE,
            frame=frame,
        )
        made.append(tracker)

        def reset():
            for view, each in enumerate(views):
                put(frame.arrays, view, *each)
            frame.upload()
            assert tracker.begin([grid for grid, _ in views])

        def follow(*found):
            given = result_of(found, ROOM)
            flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
            result = cl.Buffer(queue.context, flags, hostbuf=given)
            enqueue(queue, tracker.bind(result, ROOM, looks=[]))
            frame.download()
            queue.finish()
            arrays = {name: values.copy() for name, values in frame.arrays.items()}
            return tracker.found(arrays), arrays

        reset()
        return follow, reset

    yield of
    for tracker in made:
        tracker.release()


def test_nodes_are_those_of_the_oracle(tracker_of):
    rng = np.random.default_rng(2)
    rest = lattice(*SHAPE)
    follow, _ = tracker_of(rest, rest)
    colour = colour_of(whole(rest), board_at(rest))
    known = [(rest, np.zeros_like(rest), np.ones(SHAPE, np.bool_))] * 2
    for frame in range(6):
        found = []
        for view in range(2):
            shift = np.array([1.5 + view, 0.7]) * (frame + 1)
            xy = rest + shift + rng.normal(0, 0.2, rest.shape)
            xy[4, 4] += 2.6
            xy[12, 12, 1] += min(2.8 * frame, 5.6)  # astray
            xy[7, 7] += 4.0  # not alike
            xy[10, 3, 0] += 2.2  # whole, and near enough
            xy[9, 9] += 30.0
            corners = board_at(xy)
            edges = corners.edges.copy()
            edges[[30, 31], 0] += np.pi / 2  # the other colour
            edges[40] = np.nan
            sigma = corners.sigma.copy()
            sigma[50] = np.nan  # rough
            corners = dataclasses.replace(corners, edges=edges, sigma=sigma)
            found.append(keep(corners, rng.random(len(corners)) > 0.02))
        numbers, arrays = follow(*found)
        for view in range(2):
            expected = oracle.track(rest, *known[view], records(found[view]), colour)
            assert expected.margin > 1e-4
            np.testing.assert_array_equal(arrays["owner"][view], expected.owner)
            np.testing.assert_array_equal(arrays["seen_status"][view], expected.status)
            np.testing.assert_allclose(arrays["nodes"][view], expected.nodes, rtol=0, atol=1e-3)
            for name in ("lost", "adrift"):
                assert getattr(numbers[view], name) == getattr(expected, name), name
            assert numbers[view].beyond == tuple(expected.beyond)
            assert numbers[view].gone == tuple(expected.gone)
            known[view] = expected.nodes, expected.motion, np.isin(expected.status, (1, 2))
            if frame == 2:
                assert expected.status[12, 12] == NodeStatus.INTERPOLATED


@pytest.mark.parametrize(
    "slip", [(r, c) for r in range(4) for c in range(-3, 4) if (r, c) > (0, 0)]
)
def test_a_slip_by_whole_cells_is_refused(tracker_of, slip):
    rest = lattice(*SHAPE, bend=0.5)
    follow, reset = tracker_of(rest)
    step = slip[0] * (rest[1, 0] - rest[0, 0]) + slip[1] * (rest[0, 1] - rest[0, 0])
    (found,), _ = follow(board_at(rest + step))
    assert not found.holds(SHAPE)
    reset()
    (found,), _ = follow(board_at(rest + 0.25 * step / np.linalg.norm(step) * CELL))
    assert found.holds(SHAPE)


@pytest.mark.parametrize(("hidden", "holds"), [(8, True), (12, False)])
def test_numbers_do_not_hold_where_most_of_a_side_is_hidden(tracker_of, hidden, holds):
    rest, seen = lattice(*SHAPE, bend=0.5), np.ones(SHAPE, np.bool_)
    seen[0, 4 : 4 + hidden] = False
    follow, _ = tracker_of(rest)
    (found,), _ = follow(keep(board_at(rest), seen.ravel()))
    assert found.gone == (hidden, 0, 0, 0)
    assert found.holds(SHAPE) is holds


HIDDEN = {
    "a corner of the lattice": np.s_[:1, :1],
    "three by three at a corner": np.s_[:3, -3:],
    "six by six inside": np.s_[6:12, 8:14],
    "part of a side": np.s_[:2, 6:14],
    "five by five at a corner": np.s_[:5, :5],
}


@pytest.mark.parametrize("part", HIDDEN)
def test_hidden_nodes_stay_where_the_others_are(tracker_of, part):
    """While the pattern moves and turns to and fro, and nodes beside them come and go."""
    rest, rng = lattice(*SHAPE), np.random.default_rng(4)
    follow, _ = tracker_of(rest)
    middle = rest.mean(axis=(0, 1))
    hidden = np.zeros(SHAPE, np.bool_)
    hidden[HIDDEN[part]] = True
    for frame in range(80):
        turn = 0.1 * np.sin(frame / 12)
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        xy = (rest - middle) @ rotation + middle + 8 * np.sin(frame / 9)
        noisy = xy + rng.normal(0, 0.05, xy.shape)
        gone = (hidden if frame else False) | (rng.random(SHAPE) < 0.03)
        _, arrays = follow(keep(board_at(noisy, turn=0.05 - turn), ~gone.ravel()))
        off = np.linalg.norm(arrays["nodes"][0] - xy, axis=2)
        assert off[hidden].max() < 0.1 * CELL, frame


def test_a_node_beside_its_place_is_seen_again_after_a_frame_without_it(tracker_of):
    """It lies .14 cell from where the others say that it is, and all move by a quarter a frame."""
    rest = lattice(*SHAPE)
    follow, _ = tracker_of(rest)
    for frame in range(12):
        xy = rest + 0.17 * CELL * min(frame, 6)
        xy[8, 9, 0] += 0.14 * CELL
        seen = np.ones(SHAPE, np.bool_)
        seen[8, 9] = frame not in (2, 4, 5, 9)
        _, arrays = follow(keep(board_at(xy), seen.ravel()))
        assert (arrays["owner"][0][8, 9] >= 0) == seen[8, 9], frame


def pushed(xy, at, push, width):
    """Return nodes that a push (2,), px, at the place `at` moves, less so farther away."""
    far = np.linalg.norm(xy - at, axis=2, keepdims=True)
    return xy + np.asarray(push) * np.exp(-((far / width) ** 2) / 2)


def test_random_jumps_are_refused_or_numbered_right(tracker_of):
    rng = np.random.default_rng(11)
    rest = lattice(*SHAPE)
    follow, reset = tracker_of(rest)
    refused = accepted = 0
    middle = rest.mean(axis=(0, 1))
    for trial in range(400):
        reset()
        size = (0.2, 0.7, 1.5, 3.0)[rng.integers(4)]
        turn, zoom = rng.normal() * 0.02 * size, 1 + rng.normal() * 0.01 * size
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        xy = rest
        if rng.integers(2):  # the pattern as a whole
            xy = (rest - middle) @ rotation * zoom + middle + rng.uniform(-1, 1, 2) * size * CELL
        else:  # a part of it, by whole cells in its middle
            angle, width = rng.uniform(0, 2 * np.pi), rng.uniform(1.5, 5) * CELL
            push = min(size * CELL, width * 1.5) * np.array([np.cos(angle), np.sin(angle)])
            xy = pushed(rest, rest[tuple(rng.integers(SHAPE))], push, width)
        truth = np.arange(rest[..., 0].size)
        kept = rng.random(truth.size) > (0, 0.02, 0.05)[trial % 3]
        corners = keep(board_at(xy, turn=0.05 - turn), kept)
        false = lattice(3, 3, at=rng.uniform(0, 300, 2))  # corners of something else
        other = keep(board_at(false, turn=rng.uniform(0, 3)), np.arange(9) < 9 * (trial % 2))
        (found,), arrays = follow(joined(corners, other))
        if not found.holds(SHAPE):
            refused += 1
            continue
        accepted += 1
        owner = arrays["owner"][0].ravel()
        own = owner[owner >= 0]
        numbers = np.append(truth[kept], np.full(len(other), -2))[own]
        away = np.linalg.norm(arrays["nodes"][0].reshape(-1, 2) - xy.reshape(-1, 2), axis=1)
        # A corner of something else may stand for a missing one where that would be.
        assert ((numbers == truth[owner >= 0]) | (numbers == -2)).all(), trial
        assert (away[owner >= 0] < 0.2 * CELL).all(), trial
    assert accepted > 40
    assert refused > 150
