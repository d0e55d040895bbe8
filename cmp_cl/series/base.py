"""What the formats of a series share."""

import dataclasses
import datetime
from collections.abc import Mapping
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

    def about(self) -> dict[str, Any]:
        """Return the units, cmp_cl's version, the time of writing (UTC, ISO 8601) and the settings,
        by name."""
        from cmp_cl import __version__

        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        return {"units": dict(self.units), "cmp_cl": __version__, "written": now, **self.settings}


def moved_by(constants: Arrays, frame: Arrays) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the positions at rest and the displacement of a frame, (R, C, 2 or 3) each.

    Raises FieldError if there are none.
    """
    rest = constants.get("rest", np.empty(0))
    if rest.ndim != 3:
        raise FieldError("this format needs the positions at rest, (R, C, 2) or (R, C, 3)")
    shift = frame.get("displacement")
    if shift is None and "xy" in frame:
        shift = frame["xy"] - rest
    if shift is None or shift.shape != rest.shape:
        raise FieldError("this format needs the displacement or the positions xy of the nodes")
    return rest, shift


def plain(value: NDArray[Any]) -> Any:
    """Return an array as nested lists for JSON, with None for NaN and infinity."""
    if value.dtype.kind == "S":
        value = np.char.decode(value, "utf-8")
    if value.dtype.kind != "f" or np.isfinite(value).all():
        return value.tolist()
    numbers = value.astype(object)
    numbers[~np.isfinite(value)] = None
    return numbers.tolist()
