"""Results that `cmp-cl run` derives from the positions on request: lengths, strain, contact."""

import argparse
import contextlib
import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.cli.arguments import positive_number, unit_name
from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.field import (
    Motion,
    PlaneField,
    PlaneScale,
    motion_of,
    plane_displacement,
    plane_strain,
    with_measured_noise,
)
from cmp_cl.field.contact import contact_of
from cmp_cl.image import GreyImage
from cmp_cl.measure import Measured, MeasuredInSpace, OneView, TwoViews

_UNKNOWN = Motion(
    centre=(math.nan, math.nan),
    translation=(math.nan, math.nan),
    rotation=math.nan,
    zoom=math.nan,
    sigma_translation=math.nan,
    sigma_rotation=math.nan,
    sigma_zoom=math.nan,
    unit="",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options --cell, --unit, --strain and --contact to an argparse parser."""
    group = parser.add_argument_group("results computed from the positions")
    group.add_argument(
        "--cell",
        metavar="SIDE",
        type=positive_number,
        help="for one view of a flat pattern: side of its cells at rest, in --unit; the series "
        "then holds displacement, its sigma and rest in that unit",
    )
    group.add_argument("--unit", metavar="UNIT", type=unit_name, help="unit of --cell; default: mm")
    group.add_argument(
        "--strain",
        action="store_true",
        help="add the Green-Lagrange strain of each node with its sigma; with one view, in the "
        "plane, with principal strains, their direction, and the translation, rotation and zoom of "
        "the whole pattern; with two views, in the surface",
    )
    group.add_argument(
        "--contact",
        metavar="DEPTH",
        type=positive_number,
        help="with --stereo: add depth and normals of the nodes, and the area that is pressed in "
        "deeper than this, in the unit of the calibration",
    )


def check(arguments: argparse.Namespace) -> None:
    """Raise ConfigError if one of these options is for the other number of views."""
    if arguments.cell is not None and arguments.stereo is not None:
        raise ConfigError(
            "--cell is for one view; with --stereo, the calibration gives the unit of length"
        )
    if arguments.unit is not None and arguments.cell is None:
        raise ConfigError(
            "--unit needs --cell: without it, lengths are in px or in the unit of the calibration"
        )
    if arguments.contact is not None and arguments.stereo is None:
        raise ConfigError("--contact needs --stereo: one view shows no depth")


class InThePlane:
    """Measures frames of one view, and adds the requested results.

    unit: of the lengths. constants: arrays that a series holds once, see `Measurement`.

    Strain comes from the raw positions. Its sigma comes from the noise that the field itself shows,
    and from the part of it that neighbours share.
    """

    def __init__(self, measure: OneView, arguments: argparse.Namespace) -> None:
        self._measure, self._arguments = measure, arguments
        self._scale = PlaneScale.pixels()
        self.constants = dict(measure.constants)
        if arguments.cell is not None:
            unit = arguments.unit or "mm"
            self._scale = PlaneScale.of_cells(measure.rest_grid, arguments.cell, unit)
            self.constants["rest_px"] = self.constants["rest"]
            self.constants["rest"] = self._scale(self.constants["rest"])[0]
            self.constants["unit"] = np.array(self._scale.unit)
            self.constants["homography"] = self._scale.matrix
        self.unit = self._scale.unit

    def __call__(self, frame: GreyImage) -> Measured:
        """Measure a frame (H, W), see `Measurement`."""
        measured = self._measure(frame)
        arrays, largest = dict(measured.arrays), measured.largest
        moment = self._measure.rest_grid, measured.grids[0], self._scale
        if self._arguments.cell is not None:
            field = plane_displacement(*moment, raw=self._arguments.raw)
            arrays["displacement"] = field.displacement
            arrays["sigma"] = field.sigma.astype(np.float32)
            moved = np.linalg.norm(field.displacement[field.valid], axis=1)
            largest = float(moved.max(initial=0))
        if self._arguments.strain:
            arrays |= _strain_arrays(plane_displacement(*moment, raw=True))
        return dataclasses.replace(measured, arrays=arrays, largest=largest)


def _strain_arrays(field: PlaneField) -> dict[str, NDArray[Any]]:
    """Return strain, principal strains and the motion of the whole, each with its sigma."""
    motion = _UNKNOWN
    with contextlib.suppress(FieldError):  # too few nodes for an estimate
        field = with_measured_noise(field)
    with contextlib.suppress(FieldError):
        motion = motion_of(field)
    strain = plane_strain(field)
    principal = strain.principal()
    return {
        "strain": strain.tensor,
        "strain_sigma": strain.sigma,
        "principal": principal.strain,
        "principal_sigma": principal.sigma,
        "direction": principal.direction,
        "direction_sigma": principal.sigma_direction,
        "translation": np.array(motion.translation),
        "translation_sigma": np.array(motion.sigma_translation),
        "rotation": np.array(motion.rotation),
        "rotation_sigma": np.array(motion.sigma_rotation),
        "zoom": np.array(motion.zoom),
        "zoom_sigma": np.array(motion.sigma_zoom),
    }


class InSpace:
    """Measures frames of two views, and adds the requested results; see `InThePlane`."""

    def __init__(self, measure: TwoViews, arguments: argparse.Namespace) -> None:
        self._measure, self._arguments = measure, arguments
        self.unit, self.constants = measure.unit, dict(measure.constants)
        if arguments.contact is not None:
            self.constants["deeper_than"] = np.array(arguments.contact)

    def __call__(self, frame: GreyImage) -> MeasuredInSpace:
        """Measure a frame (H, W), see `Measurement`."""
        measured = self._measure(frame)
        field, arrays = measured.field, dict(measured.arrays)
        if self._arguments.strain:
            field = field.with_strain()
            arrays |= {name: getattr(field, name) for name in ("strain", "strain_sigma")}
        if self._arguments.contact is not None:
            contact = contact_of(field, deeper_than=self._arguments.contact)
            arrays |= {
                "depth": contact.depth,
                "depth_sigma": contact.sigma,
                "normal": contact.normal,
                "contact": contact.inside,
                "contact_area": np.array(contact.area),
                "contact_depth": np.array(contact.deepest),
            }
        return dataclasses.replace(measured, arrays=arrays, field=field)


def results_of(measure: OneView | TwoViews, arguments: argparse.Namespace) -> InThePlane | InSpace:
    """Return a function that measures frames and adds the results that the arguments request.

    Raises FieldError if the cells of the frame at rest give no scale.
    """
    if isinstance(measure, TwoViews):
        return InSpace(measure, arguments)
    return InThePlane(measure, arguments)


def units(length: str) -> dict[str, str]:
    """Return the units of the derived results by name; length: the unit of lengths."""
    return {
        **dict.fromkeys(("depth", "depth_sigma", "contact_depth", "deeper_than"), length),
        **dict.fromkeys(("translation", "translation_sigma"), length),
        **dict.fromkeys(("rotation", "rotation_sigma", "direction", "direction_sigma"), "rad"),
        "contact_area": f"{length}2",
    }
