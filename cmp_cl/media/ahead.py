"""Items that a thread makes ahead of those who take them."""

import atexit
import contextlib
import threading
from collections import deque
from collections.abc import Generator, Iterator
from typing import Generic, TypeVar

from cmp_cl.closing import Closing

T = TypeVar("T")

_LONGEST_END = 10.0  # s, for which closing waits for the thread, which may wait for a camera


class Ahead(Closing, Generic[T]):
    """Makes items in a thread, of which some wait to be taken.

    items: makes them; the thread closes it at the end. most: how many wait at most. lossy: whether
    a new item then takes the place of the oldest, as for a camera, or waits for a place.
    """

    def __init__(self, items: Generator[T, None, None], most: int, *, lossy: bool = False) -> None:
        self._waiting: deque[T] = deque()
        self._changed = threading.Condition()
        self._closed = False
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._make, args=(items, most, lossy), daemon=True)
        atexit.register(self.close)  # Python would end the thread within a call of C++, and abort
        self._thread.start()

    def _make(self, items: Generator[T, None, None], most: int, lossy: bool) -> None:
        try:
            with contextlib.closing(items):
                for item in items:
                    with self._changed:
                        if lossy and len(self._waiting) == most:
                            self._waiting.popleft()
                        self._waiting.append(item)
                        self._changed.notify_all()
                        self._changed.wait_for(
                            lambda: lossy or len(self._waiting) < most or self._closed
                        )
                    if self._closed:
                        return
        except BaseException as error:
            self._error = error
        finally:
            atexit.unregister(self.close)
            with self._changed:
                self._closed = True
                self._changed.notify_all()

    def wait(self, seconds: float = threading.TIMEOUT_MAX) -> bool:
        """Return whether an item waits now, or within that time; False at once at the end.

        Raises what making an item raised, once those before it are taken.
        """
        with self._changed:
            longest = min(seconds, threading.TIMEOUT_MAX)
            self._changed.wait_for(lambda: self._waiting or self._closed, longest)
            if not self._waiting and self._error is not None:
                raise self._error
            return bool(self._waiting)

    def take(self, seconds: float = threading.TIMEOUT_MAX) -> T | None:
        """Return the oldest item that waits now, or within that time, as `wait` does; None if none
        does."""
        with self._changed:
            if not self.wait(seconds):
                return None
            self._changed.notify_all()
            return self._waiting.popleft()

    def __iter__(self) -> Iterator[T]:
        while (item := self.take()) is not None:
            yield item

    @property
    def ended(self) -> bool:
        """Return whether no further item comes."""
        return self._closed

    def close(self) -> None:
        """End the thread; the item that it is making is its last one."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if self._thread is not threading.current_thread():
            self._thread.join(_LONGEST_END)
