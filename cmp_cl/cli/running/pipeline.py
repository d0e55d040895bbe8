"""Stages that work at the same time, and what limits them."""

import collections
import contextlib
import os
import sys
import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

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

    def each(self, items: Generator[T, None, None]) -> Generator[T, None, None]:
        """Yield the items, and count the time in which they are made."""
        with contextlib.closing(items):
            while (item := self.work(next, items, _END)) is not _END:
                yield item


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


def ahead(items: Generator[T, None, None]) -> Generator[T, None, None]:
    """Yield items that a thread makes ahead, and close them at the end.

    What making one raises is raised in its place.
    """
    with contextlib.closing(items), ThreadPoolExecutor(1) as thread:
        made = collections.deque(thread.submit(next, items, _END) for _ in range(_WAITING))
        try:
            while (item := made.popleft().result()) is not _END:
                made.append(thread.submit(next, items, _END))
                yield item
        finally:
            for each in made:
                each.cancel()
