"""Corners of deformed checkerboards on any OpenCL device, and the deformation they show.

A name is imported from its module when it is first used, and so is a module: `import cmp_cl` is
enough for `cmp_cl.media`, `cmp_cl.space` or `cmp_cl.reference`.
"""

import importlib
import importlib.util
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cmp_cl.config import AdaptiveMean as AdaptiveMean
    from cmp_cl.config import BinaryRings as BinaryRings
    from cmp_cl.config import DetectorConfig as DetectorConfig
    from cmp_cl.config import EdgeLines as EdgeLines
    from cmp_cl.config import EdgeStep as EdgeStep
    from cmp_cl.config import Fit as Fit
    from cmp_cl.config import Midlines as Midlines
    from cmp_cl.config import RapidCriteria as RapidCriteria
    from cmp_cl.config import RingHarmonic as RingHarmonic
    from cmp_cl.config import SectorContrast as SectorContrast
    from cmp_cl.config import SpectralCriteria as SpectralCriteria
    from cmp_cl.corners import Corners as Corners
    from cmp_cl.corners import Method as Method
    from cmp_cl.detector import Detector as Detector
    from cmp_cl.detector import detect as detect
    from cmp_cl.errors import CalibrationError as CalibrationError
    from cmp_cl.errors import CapacityError as CapacityError
    from cmp_cl.errors import CmpClError as CmpClError
    from cmp_cl.errors import ConfigError as ConfigError
    from cmp_cl.errors import DeviceError as DeviceError
    from cmp_cl.errors import FieldError as FieldError
    from cmp_cl.errors import GridError as GridError
    from cmp_cl.errors import ImageError as ImageError
    from cmp_cl.errors import KernelBuildError as KernelBuildError
    from cmp_cl.field import DisplacementField as DisplacementField
    from cmp_cl.grid import Grid as Grid
    from cmp_cl.grid import NodeStatus as NodeStatus
    from cmp_cl.grid import build_grid as build_grid
    from cmp_cl.grid import number as number
    from cmp_cl.motion import displacement as displacement
    from cmp_cl.opencl.device import Device as Device
    from cmp_cl.opencl.device import list_devices as list_devices
    from cmp_cl.opencl.device import select_device as select_device
    from cmp_cl.series import SeriesWriter as SeriesWriter
    from cmp_cl.space import BinocularSplit as BinocularSplit
    from cmp_cl.space import Points3D as Points3D
    from cmp_cl.space import StereoRig as StereoRig
    from cmp_cl.space import Window as Window
    from cmp_cl.space import calibrate as calibrate

    __version__: str

# OpenCV reads it when it is imported; its own limit, 2**30, is gigabytes for a hostile file.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 27))

_HOMES = {
    "config": "AdaptiveMean BinaryRings DetectorConfig EdgeLines EdgeStep Fit Midlines "
    "RapidCriteria RingHarmonic SectorContrast SpectralCriteria",
    "corners": "Corners Method",
    "detector": "Detector detect",
    "errors": "CalibrationError CapacityError CmpClError ConfigError DeviceError FieldError "
    "GridError ImageError KernelBuildError",
    "field": "DisplacementField",
    "grid": "Grid NodeStatus build_grid number",
    "motion": "displacement",
    "opencl.device": "Device list_devices select_device",
    "series": "SeriesWriter",
    "space": "BinocularSplit Points3D StereoRig Window calibrate",
}
_HOME = {name: module for module, names in _HOMES.items() for name in names.split()}

__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    found: Any
    if name == "__version__":
        found = importlib.import_module("cmp_cl.files").version()
    elif name in _HOME:
        found = getattr(importlib.import_module(f"cmp_cl.{_HOME[name]}"), name)
    elif not name.startswith("_") and importlib.util.find_spec(f"cmp_cl.{name}") is not None:
        found = importlib.import_module(f"cmp_cl.{name}")
    else:
        raise AttributeError(f"module 'cmp_cl' has no attribute {name!r}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
