"""Signals that stop a command: Ctrl-C, SIGTERM, and SIGHUP of a terminal that is closed."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

_STOPPING = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]


@contextlib.contextmanager
def handled(handler: Any) -> Iterator[None]:
    """Handle the stopping signals by a function, except those that are ignored, as under nohup.

    Only the main thread of a process can handle signals; in any other, nothing changes.
    """
    before: dict[signal.Signals, Any] = {}
    try:
        if threading.current_thread() is threading.main_thread():
            before = {number: signal.getsignal(number) for number in _STOPPING}
        for number, old in before.items():
            if old != signal.SIG_IGN:
                signal.signal(number, handler)
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def ignore() -> None:
    """Ignore the stopping signals until the end of a `handled` block."""
    if threading.current_thread() is threading.main_thread():
        for number in _STOPPING:
            signal.signal(number, signal.SIG_IGN)


def interrupt(_: int, __: FrameType | None) -> None:
    """End a command as Ctrl-C does, so that what it has begun to write is removed."""
    raise KeyboardInterrupt


class Stop:
    """Notes the first signal, so that the frame is finished; a second signal interrupts.

    name: the signal that came, such as Ctrl-C; "" before.
    """

    def __init__(self) -> None:
        self.name = ""

    def __call__(self, number: int, _: FrameType | None) -> None:
        if self.name:
            raise KeyboardInterrupt
        self.name = "Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name
