"""A progress bar, and lines printed above it."""

import contextlib
import sys
from typing import Any, TextIO

from cmp_cl.closing import Closing


class Progress(Closing):
    """A progress bar if tqdm is installed and stderr is a terminal, else nothing.

    total: number of steps, None if unknown. unit: what is counted.
    """

    def __init__(self, total: int | None, unit: str) -> None:
        self._bar: Any = None
        with contextlib.suppress(ImportError):
            from tqdm import tqdm

            self._bar = tqdm(total=total, unit=f" {unit}", disable=None, leave=False)

    def step(self, note: str = "") -> None:
        """Count a step; note: what is told behind the rate."""
        if self._bar is not None:
            self._bar.set_postfix_str(note, refresh=False)
            self._bar.update()

    def say(self, line: str, stream: TextIO | None = None) -> None:
        """Print a line above the bar, on stdout unless another stream is named."""
        if self._bar is not None:
            self._bar.clear()
        print(line, file=stream or sys.stdout, flush=True)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()
