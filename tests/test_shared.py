"""Memory that the host and a device share."""

import gc

import images
import numpy as np
import pyopencl as cl
import pytest
from comparison import assert_same_bytes

from cmp_cl import Detector
from cmp_cl.opencl.shared import shares_memory
from cmp_cl.stages import plan as plans

BOARD = images.eight_bits()["board"]
TEXTURE = images.texture(BOARD.shape)


@pytest.fixture
def handle(device):
    if not shares_memory(device.handle):
        pytest.skip(f"{device} does not share memory")
    return device.handle


def test_a_detector_gives_the_same_corners_with_and_without_shared_memory(
    handle, device, monkeypatch
):
    results = []
    for shares in (True, False):
        monkeypatch.setattr(plans, "shares_memory", lambda _, shares=shares: shares)
        with Detector(shape=BOARD.shape, device=device) as detector:
            assert bool(detector._plans.lend()._here) is shares
            results.append([detector(BOARD), *detector.batch([TEXTURE, BOARD])])
    for here, copied in zip(*results, strict=True):
        assert_same_bytes(here, copied)


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
