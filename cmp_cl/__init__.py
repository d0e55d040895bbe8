"""Corners of deformed checkerboards on any OpenCL device, and the deformation they show."""

import cmp_cl.cli.starting  # noqa: F401, first: it answers Ctrl-C while the others are imported

# isort: split
from cmp_cl import arrays, cameras, measure, media, reference, series
from cmp_cl.cell import estimate_cell
from cmp_cl.config import (
    AdaptiveMean,
    BinaryRings,
    DetectorConfig,
    EdgeLines,
    EdgeStep,
    Fit,
    Midlines,
    Pyramid,
    RapidCriteria,
    RingHarmonic,
    SectorContrast,
    SpectralCriteria,
)
from cmp_cl.corners import Corners, Method, Refusal
from cmp_cl.detector import Detector, choose_config, detect
from cmp_cl.errors import (
    CalibrationError,
    CapacityError,
    CmpClError,
    ConfigError,
    DeviceError,
    FieldError,
    GridError,
    ImageError,
    KernelBuildError,
)
from cmp_cl.field import DisplacementField, displacement
from cmp_cl.grid import (
    Grid,
    NodeStatus,
    Rival,
    Sides,
    align,
    build_grid,
    build_grids,
    refine_markers,
)
from cmp_cl.maps import HarmonicMaps, Maps
from cmp_cl.marks import drop_marks
from cmp_cl.opencl.device import Device, DeviceKind, list_devices, select_device
from cmp_cl.series import SeriesWriter
from cmp_cl.space import (
    BinocularSplit,
    Points3D,
    PointStatus,
    StereoRig,
    calibrate,
    calibrate_camera,
)
from cmp_cl.version import package_version

__version__ = package_version()

__all__ = [
    "AdaptiveMean",
    "BinaryRings",
    "BinocularSplit",
    "CalibrationError",
    "CapacityError",
    "CmpClError",
    "ConfigError",
    "Corners",
    "Detector",
    "DetectorConfig",
    "Device",
    "DeviceError",
    "DeviceKind",
    "DisplacementField",
    "EdgeLines",
    "EdgeStep",
    "FieldError",
    "Fit",
    "Grid",
    "GridError",
    "HarmonicMaps",
    "ImageError",
    "KernelBuildError",
    "Maps",
    "Method",
    "Midlines",
    "NodeStatus",
    "PointStatus",
    "Points3D",
    "Pyramid",
    "RapidCriteria",
    "Refusal",
    "RingHarmonic",
    "Rival",
    "SectorContrast",
    "SeriesWriter",
    "Sides",
    "SpectralCriteria",
    "StereoRig",
    "__version__",
    "align",
    "arrays",
    "build_grid",
    "build_grids",
    "calibrate",
    "calibrate_camera",
    "cameras",
    "choose_config",
    "detect",
    "displacement",
    "drop_marks",
    "estimate_cell",
    "list_devices",
    "measure",
    "media",
    "reference",
    "refine_markers",
    "select_device",
    "series",
]
