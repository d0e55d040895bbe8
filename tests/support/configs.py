"""Configurations that tests share."""

import dataclasses
from typing import Any

from cmp_cl import BinaryRings, DetectorConfig

_OF_RINGS = [field.name for field in dataclasses.fields(BinaryRings)]


def rings(base: DetectorConfig | None = None, **changes: Any) -> DetectorConfig:
    """Return a configuration with BinaryRings and some changes, each to the part that has this
    field."""
    base = base or DetectorConfig(detection=BinaryRings())
    inner = {name: changes.pop(name) for name in _OF_RINGS if name in changes}
    return base.replace(detection=dataclasses.replace(base.detection, **inner), **changes)
