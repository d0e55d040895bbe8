"""Corners of deformed checkerboards on any OpenCL device, and the deformation they show."""

from cmp_cl import reference
from cmp_cl.cell import estimate_cell
from cmp_cl.config import (
    AdaptiveMean,
    DetectorConfig,
    EdgeLines,
    EdgeStep,
    Fit,
    Midlines,
    Pyramid,
    RapidCriteria,
    SectorContrast,
    SpectralCriteria,
)
from cmp_cl.detector import Detector, detect
from cmp_cl.device import Device, DeviceKind, list_devices, select_device
from cmp_cl.results import Corners, Grid, Maps, Method, NodeStatus, Points3D

__all__ = [
    "AdaptiveMean",
    "Corners",
    "Detector",
    "DetectorConfig",
    "Device",
    "DeviceKind",
    "EdgeLines",
    "EdgeStep",
    "Fit",
    "Grid",
    "Maps",
    "Method",
    "Midlines",
    "NodeStatus",
    "Points3D",
    "Pyramid",
    "RapidCriteria",
    "SectorContrast",
    "SpectralCriteria",
    "detect",
    "estimate_cell",
    "list_devices",
    "reference",
    "select_device",
]
