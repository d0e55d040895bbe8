"""Configurations that tests share: a table of them in which every kernel has a part, and all
settings that there are."""

import dataclasses
import typing
from typing import Any

from cmp_cl import (
    AdaptiveMean,
    BinaryRings,
    DetectorConfig,
    EdgeStep,
    Fit,
    Midlines,
    RapidCriteria,
    RingHarmonic,
    SpectralCriteria,
)

# Every pixel whose rings have four transitions is a candidate.
ANY_RINGS = RapidCriteria(sector_threshold=16, ring_threshold=17, corrosion_threshold=17)
_OF_RINGS = [field.name for field in dataclasses.fields(BinaryRings)]


def rings(base: DetectorConfig | None = None, **changes: Any) -> DetectorConfig:
    """Return a configuration with BinaryRings and some changes, each to the part that has this
    field."""
    base = base or DetectorConfig(detection=BinaryRings())
    inner = {name: changes.pop(name) for name in _OF_RINGS if name in changes}
    return base.replace(detection=dataclasses.replace(base.detection, **inner), **changes)


CONFIGS = {
    "default": DetectorConfig(),
    "wide cells, no checks": DetectorConfig(detection=RingHarmonic(fine=False), nms_radius=15),
    "any response": DetectorConfig(detection=RingHarmonic(noise=0, relative=0), nms_radius=1),
    "rings": rings(),
    "least": rings(
        criteria=RapidCriteria(corrosion_threshold=None),
        outer_radius=4,
        contrast=None,
        nms_radius=1,
        refinement=None,
    ),
    "wide windows": rings(threshold=AdaptiveMean(window=255), nms_radius=15),
    "rings, step": rings(refinement=EdgeStep(cell=11)),
    "spectral, midlines": rings(
        criteria=SpectralCriteria(correlation=0, corrosion_threshold=None), refinement=Midlines()
    ),
    "quadratic midlines": DetectorConfig(refinement=Midlines(fit=Fit.QUADRATIC)),
}


class Setting(typing.NamedTuple):
    """A field of a part of a configuration: the types of its values, and the range of a number,
    (low, high, odd)."""

    part: type
    name: str
    kinds: tuple[type, ...]
    limits: tuple[float, float, bool] | None


def settings_of(part: type) -> list[Setting]:
    """Return the settings of a part of a configuration."""
    found = []
    for field in dataclasses.fields(part):
        kind, limits = field.type, None
        if typing.get_origin(kind) is typing.Annotated:
            kind, limits = typing.get_args(kind)
        found.append(Setting(part, field.name, typing.get_args(kind) or (kind,), limits))
    return found


def all_settings(part: type = DetectorConfig) -> list[Setting]:
    """Return the settings of a part, and of all parts of it."""
    own = settings_of(part)
    parts = [kind for each in own for kind in each.kinds if dataclasses.is_dataclass(kind)]
    return own + [inner for each in parts for inner in all_settings(each)]
