"""Memory that the host and a device share."""

import gc
from collections import Counter

import images
import numpy as np
import pyopencl as cl
import pytest
from comparison import assert_same_bytes
from gels import NODES, RIG, SPLIT, pressed

from cmp_cl import Detector
from cmp_cl.measure import OneView, TwoViews
from cmp_cl.opencl import memory

BOARD = images.eight_bits()["board"]
TEXTURE = images.texture(BOARD.shape)


@pytest.fixture
def handle(device):
    if not memory.shares_memory(device.handle):
        pytest.skip(f"{device} does not share memory")
    return device.handle


def test_a_detector_gives_the_same_corners_with_and_without_shared_memory(
    handle, device, monkeypatch
):
    results = []
    for shares in (True, False):
        monkeypatch.setattr(memory, "shares_memory", lambda _, shares=shares: shares)
        with Detector(shape=BOARD.shape, device=device) as detector:
            assert detector.layout.memory["image"].shared is shares
            results.append([detector(BOARD), *detector.batch([TEXTURE, BOARD])])
    for here, copied in zip(*results, strict=True):
        assert_same_bytes(here, copied)


@pytest.fixture
def copies(monkeypatch):
    """Count the copies to ("write") and from ("read") the memory of a device of its own."""
    counts = Counter()

    copy = cl.enqueue_copy

    def counted(queue, to, source, **place):
        counts["read"] += isinstance(to, np.ndarray)
        counts["write"] += isinstance(source, np.ndarray)
        return copy(queue, to, source, **place)

    monkeypatch.setattr(cl, "enqueue_copy", counted)
    return counts


@pytest.mark.parametrize("views", [1, 2])
def test_fields_are_the_same_without_shared_memory_and_a_tracked_frame_is_one_read(
    handle, device, monkeypatch, copies, views
):
    shots = [pressed(level) for level in (0.0, 0.1, 0.15)]
    rest, now, last = (shot.left.image if views == 1 else shot.frame for shot in shots)
    results = []
    for shares in (True, False):
        monkeypatch.setattr(memory, "shares_memory", lambda _, shares=shares: shares)
        with (
            OneView(rest, shape=NODES, strain=True, device=device)
            if views == 1
            else TwoViews(rest, RIG, SPLIT, shape=NODES, strain=True, device=device)
        ) as measure:
            measure.skip()
            first = measure(now)  # is numbered anew
            copies.clear()
            found = [first, measure(now), measure(last)]
            expected = {} if shares else {"read": 2, "write": 2 * views}
            assert {name: count for name, count in copies.items() if count} == expected
        assert [each.tracked for each in found] == [False, True, True]
        results.append(found)
    for here, copied in zip(*results, strict=True):
        for name, values in here.arrays.items():
            np.testing.assert_array_equal(values, copied.arrays[name], err_msg=name)
        for corners, others in zip(here.corners, copied.corners, strict=True):
            assert_same_bytes(corners, others)


@pytest.fixture
def large(handle, device):
    """Yield a detector of large frames, which take milliseconds each, and two such frames."""
    board = np.tile(BOARD, (16, 16))
    with Detector(shape=board.shape, device=device) as detector:
        yield detector, board, np.roll(board, 7, axis=1)


def test_a_frame_is_not_written_while_kernels_read_the_one_before(large):
    detector, *frames = large
    expected = [detector(frame) for frame in frames]
    for number, corners in enumerate(detector.stream(frames * 5)):
        assert_same_bytes(corners, expected[number % 2])


def test_memory_is_kept_until_the_kernels_of_a_deleted_detector_are_done(large, device):
    _, board, _ = large
    for _ in range(5):
        detector = Detector(shape=board.shape, device=device)
        detector(board)  # its lists are long enough now
        plan = detector._plans.lend()
        plan.launch(plan.launches)
        event = plan._last
        del detector, plan
        gc.collect()
        assert event.command_execution_status == cl.command_execution_status.COMPLETE
