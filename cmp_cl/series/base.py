"""What the formats of a series share."""

import dataclasses
import datetime
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError, check_kind

Arrays = Mapping[str, NDArray[Any]]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Description:
    """The description that is stored with a series.

    units: units of the arrays, by name; arrays without an entry have no unit. settings:
    configuration, device and source, as texts by name. Raises FieldError if either is no Mapping.
    """

    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    settings: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        check_kind("units", self.units, Mapping, FieldError)
        check_kind("settings", self.settings, Mapping, FieldError)

    def entries(self) -> dict[str, str]:
        """Return cmp_cl's version, the time of writing (UTC, ISO 8601) and the settings, by
        name."""
        from cmp_cl import __version__

        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        return {"cmp_cl": __version__, "written": now, **self.settings}

    def with_units(self) -> dict[str, Any]:
        """Return the units of the arrays, then the entries."""
        return {"units": dict(self.units), **self.entries()}


class Format:
    """Writes the frames of a series to the file `part`, in one format.

    A frame is complete on the disk when `write` returns, and readable from then on. A frame that a
    full disk refuses leaves no trace.
    """

    def __init__(self, part: Path, description: Description, constants: Arrays) -> None:
        self.part, self.description, self.constants = part, description, constants

    def write(self, number: int, index: int, time_ms: float, frame: Arrays) -> None:
        """Write a frame, the one of that number in the series; raises OSError."""
        raise NotImplementedError

    def finish(self, target: Path, frames: int) -> None:
        """Complete the part, which has that many frames, and rename it to the target."""
        os.replace(self.part, target)

    def close(self) -> None:
        """Close what is open, without completing it."""

    def discard(self) -> None:
        """Remove the part."""
        self.part.unlink(missing_ok=True)


def moved_by(constants: Arrays, frame: Arrays, what: str) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the positions at rest and the displacement of a frame, (R, C, 2 or 3) each.

    what: the format that needs them. Raises FieldError if there are none.
    """
    rest = at_rest(constants, what)
    shift = frame.get("displacement")
    if shift is None and "xy" in frame:
        shift = frame["xy"] - rest
    if shift is None or shift.shape != rest.shape:
        raise FieldError(f"{what} needs the displacement or the positions xy of the nodes")
    return rest, shift


def at_rest(constants: Arrays, what: str) -> NDArray[Any]:
    """Return the constant `rest`; raises FieldError without it."""
    rest = constants.get("rest", np.empty(0))
    if rest.ndim != 3:
        raise FieldError(f"{what} needs the positions at rest, (R, C, 2) or (R, C, 3)")
    return rest
