"""OpenCV on one thread, where its answer depends on the order in which threads end."""

import contextlib
import threading
from collections.abc import Iterator

import cv2

_alone = threading.Lock()  # the number of threads is the process's


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Run OpenCV on one thread inside this block.

    Its calibrations add up the views in the order in which its threads finish with them, so that
    the last bits differ from run to run.
    """
    with _alone:
        before = cv2.getNumThreads()
        cv2.setNumThreads(1)
        try:
            yield
        finally:
            cv2.setNumThreads(before)
