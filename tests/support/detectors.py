"""Detectors that tests share, and both forms of the kernels on the device under test."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from cmp_cl import Detector, DetectorConfig, Device
from cmp_cl.opencl.device import DeviceKind

MakeDetector = Callable[..., Detector]
FORMS = DeviceKind.CPU, DeviceKind.GPU  # kinds of devices; cards have the portable form


def in_form(device: Device, form: DeviceKind) -> Device:
    """Return the device as if it were of the kind that has that form."""
    return dataclasses.replace(device, kind=form)


def in_other_form(device: Device) -> Device:
    """Return the device as if it were of the other kind."""
    return in_form(device, FORMS[device.kind is FORMS[0]])


@contextlib.contextmanager
def detectors_on(device: Device) -> Iterator[MakeDetector]:
    """Yield make(image, config, mask), which returns a detector for such images, made only once."""
    made: dict[Any, Detector] = {}

    def make(
        image: np.ndarray, config: DetectorConfig | None = None, mask: np.ndarray | None = None
    ) -> Detector:
        config = config or DetectorConfig()
        key = (image.shape, image.dtype, config, None if mask is None else mask.tobytes())
        if key not in made:
            made[key] = Detector(
                shape=image.shape, dtype=image.dtype, config=config, device=device, mask=mask
            )
        return made[key]

    try:
        yield make
    finally:
        for detector in made.values():
            detector.close()
