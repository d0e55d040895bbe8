"""How fast a run goes, and what limits it."""

import contextlib
import time
from collections.abc import Iterator

_WAITED = 0.1  # share of the time, waiting for the source, from which on it is what limits
_ALL = 0.9  # the same of writing


class Pace:
    """How fast a run goes, from now on. source: what its frames come from, such as decoding."""

    def __init__(self, source: str) -> None:
        self.source = source
        self._spent_s = {source: 0.0, "writing": 0.0}
        self._start = time.perf_counter()

    @contextlib.contextmanager
    def spent(self, what: str) -> Iterator[None]:
        """Count the time of a block as spent in waiting for the source, or in writing."""
        start = time.perf_counter()
        yield
        self._spent_s[what] += time.perf_counter() - start

    @property
    def limit(self) -> str:
        """Return what limits the run, as text: the source if frames are waited for, writing if it
        takes nearly all the time, else measuring."""
        waited, writing = (
            self._spent_s[each] / (time.perf_counter() - self._start) for each in self._spent_s
        )
        most = self.source if waited > _WAITED else "writing" if writing > _ALL else "measuring"
        return f"limited by {most}"

    def line(self, frames: int) -> str:
        """Return how many frames a second there were, as text, and what limited them."""
        return f"{frames / (time.perf_counter() - self._start):.3g} frames a second, {self.limit}"
