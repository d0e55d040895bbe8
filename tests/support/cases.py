"""Parameters of which the default command takes a few, and the exhaustive run all."""

from collections.abc import Container, Iterable
from typing import Any

import pytest


def some(cases: Iterable[Any], few: Container[Any]) -> list[Any]:
    """Return every case; those that are not among the few are marked exhaustive."""
    return [
        case if case in few else pytest.param(case, marks=pytest.mark.exhaustive) for case in cases
    ]
