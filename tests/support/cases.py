"""Parameters of which the default command takes a few, and the exhaustive run all."""

from collections.abc import Container, Iterable
from typing import Any

import pytest


def some(cases: Iterable[Any], few: Container[Any], *, several: bool = False) -> list[Any]:
    """Return every case; those that are not among the few are marked exhaustive.

    several: a case is a tuple of several arguments.
    """
    return [
        pytest.param(
            *(case if several else (case,)), marks=() if case in few else pytest.mark.exhaustive
        )
        for case in cases
    ]
