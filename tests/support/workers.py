"""Functions that tests run in other processes, which can import this module but no test file."""

import time

import images
import numpy as np

from cmp_cl import Detector


def frame(number):
    """Return a frame of a recording: the scene moves by a pixel a frame."""
    return np.ascontiguousarray(np.roll(images.scene().image, number, axis=1))


def slow_frame(number):
    """Return `frame(number)` after a tenth of a second."""
    time.sleep(0.1)
    return frame(number)


def broken_frame(number):
    """Return `frame(number)`, but raise OSError for frame 17."""
    if number == 17:
        raise OSError("frame 17 is broken")
    return frame(number)


def colour_frame(number):
    """Return `frame(number)` with three channels."""
    return np.dstack([frame(number)] * 3)


def corners_of_board(device):
    """Return how many corners a detector in this process finds on a board."""
    board = images.eight_bits()["board"]
    with Detector(shape=board.shape, device=device) as detector:
        return len(detector(board))
