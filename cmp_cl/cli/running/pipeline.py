"""Stages that work at the same time: one makes ahead what another takes, one uses it behind."""

import collections
import contextlib
import os
import sys
import time
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from cmp_cl.closing import Closing

_BUSY = 0.85  # share of the time of all cores from which on they limit
_WAITING = 4  # the most results that wait between two stages
_END: Any = object()

T = TypeVar("T")


class Stage:
    """A stage. name: what it does, for a reader. busy_s: the time that it has worked, s."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.busy_s = 0.0

    def work(self, function: Callable[..., T], *arguments: Any) -> T:
        """Call a function, and count its time."""
        start = time.perf_counter()
        try:
            return function(*arguments)
        finally:
            self.busy_s += time.perf_counter() - start


class Pace:
    """The stages of a run, by their names in the order of the data, and how fast it goes."""

    def __init__(self, *names: str) -> None:
        self.stages = [Stage(name) for name in names]
        self._start, self._used = time.perf_counter(), time.process_time()
        self._cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count()

    @property
    def limit(self) -> str:
        """Return what limits the run, as text: all cores, if this process keeps them busy, else
        the stage that has worked most."""
        most = max(self.stages, key=lambda stage: stage.busy_s).name
        took, used = time.perf_counter() - self._start, time.process_time() - self._used
        if self._cores and used > _BUSY * self._cores * took:
            return f"limited by the {self._cores} cores of this machine, which are busy"
        return f"limited by {most}"

    def line(self, frames: int) -> str:
        """Return how many frames a second there were, as text, and what limited them."""
        rate = frames / (time.perf_counter() - self._start)
        return f"{rate:.3g} frames a second, {self.limit}"


def ahead(stage: Stage, items: Generator[T, None, None]) -> Generator[T, None, None]:
    """Yield items that a thread makes ahead, and close them at the end.

    What making one raises is raised in its place.
    """
    with contextlib.closing(items), ThreadPoolExecutor(1) as thread:
        made = collections.deque(
            thread.submit(stage.work, next, items, _END) for _ in range(_WAITING)
        )
        try:
            while (item := made.popleft().result()) is not _END:
                made.append(thread.submit(stage.work, next, items, _END))
                yield item
        finally:
            for each in made:
                each.cancel()


class Behind(Closing):
    """Calls functions one after the other in a thread, while the caller goes on.

    Closing waits for all of them. After a call that raises, there are no more: calling again or
    closing raises the same.
    """

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._thread = ThreadPoolExecutor(1)
        self._waiting: collections.deque[Future[None]] = collections.deque()
        self._failed = False

    def __call__(self, function: Callable[..., None], *arguments: Any) -> None:
        """Call a function soon; wait while too many others wait."""
        while len(self._waiting) >= _WAITING:
            self._waiting.popleft().result()
        self._waiting.append(self._thread.submit(self._call, function, *arguments))

    def _call(self, function: Callable[..., None], *arguments: Any) -> None:
        if self._failed:
            return
        self._failed = True
        self._stage.work(function, *arguments)
        self._failed = False

    def close(self) -> None:
        """Wait for the calls; raises what one has raised."""
        self._thread.shutdown()
        while self._waiting:
            self._waiting.popleft().result()
