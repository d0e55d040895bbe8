"""Runs OpenCV on one thread, because results of its calibration depend on the order of its
threads."""

import contextlib
import threading
from collections.abc import Iterator

import cv2

_alone = threading.Lock()  # the whole process shares the number of threads


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Run OpenCV on one thread inside this block.

    OpenCV's calibrations add up the views in the order in which threads finish them, so that the
    last bits differ from run to run.
    """
    with _alone:
        before = cv2.getNumThreads()
        cv2.setNumThreads(1)
        try:
            yield
        finally:
            cv2.setNumThreads(before)
