"""Results that `cmp-cl run` adds on request: lengths in the plane, strain, contact."""

import argparse
import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.cli.arguments import positive_number, unit_name
from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.field import (
    PlaneField,
    PlaneScale,
    motion_of,
    plane_displacement,
    plane_strain,
    with_measured_noise,
)
from cmp_cl.field.contact import contact_of
from cmp_cl.image import GreyImage
from cmp_cl.measure import Measured, MeasuredInSpace, Measurement, OneView, TwoViews

# The arrays of the strain of one view, with their shapes: after the axes of the nodes, or whole.
_OF_NODES: dict[str, tuple[int, ...]] = {
    "strain": (3,),
    "strain_sigma": (3,),
    "principal": (2,),
    "principal_sigma": (2,),
    "direction": (),
    "direction_sigma": (),
}
_OF_THE_WHOLE: dict[str, tuple[int, ...]] = {
    **{"translation": (2,), "translation_sigma": ()},
    **dict.fromkeys(("rotation", "rotation_sigma", "zoom", "zoom_sigma"), ()),
}


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


@dataclasses.dataclass(frozen=True, kw_only=True)
class Added:
    """The results to add to the frames of a series.

    side: side of the cells, None for px. unit: its unit. strain: whether strain is requested.
    depth: the least depth of a contact, None if contact is not requested.
    """

    side: float | None
    unit: str
    strain: bool
    depth: float | None

    @classmethod
    def of(cls, arguments: argparse.Namespace) -> "Added":
        """Take the results that the arguments request.

        Raises ConfigError if an option is for the other number of views.
        """
        if arguments.cell is not None and arguments.stereo is not None:
            raise ConfigError(
                "--cell is for one view; with --stereo, the calibration gives the unit of length"
            )
        if arguments.unit is not None and arguments.cell is None:
            raise ConfigError(
                "--unit needs --cell: without it, lengths are in px or in the unit of the "
                "calibration"
            )
        if arguments.contact is not None and arguments.stereo is None:
            raise ConfigError("--contact needs --stereo: one view shows no depth")
        return cls(
            side=arguments.cell,
            unit=arguments.unit or "mm",
            strain=arguments.strain,
            depth=arguments.contact,
        )

    def to(self, measure: OneView | TwoViews) -> Measurement:
        """Return the measurement with these results added.

        Raises FieldError if the cells of the frame at rest give no scale.
        """
        if isinstance(measure, TwoViews):
            if self.strain or self.depth is not None:
                return _InSpace(measure, self)
        elif self.strain or self.side is not None:
            return _InThePlane(measure, self)
        return measure


class _InThePlane(Measurement):
    """Measures frames of one view, and adds the requested results.

    Strain comes from the raw positions. Its sigma comes from the noise that the field itself shows,
    and from the part of it that neighbours share.
    """

    def __init__(self, measure: OneView, added: Added) -> None:
        super().__init__()
        self._detectors.enter_context(measure)
        self._measure, self._added = measure, added
        rest = measure.rest_grid
        self._scale = (
            PlaneScale.pixels()
            if added.side is None
            else PlaneScale.of_cells(rest, added.side, added.unit)
        )
        self.unit, self.nodes = self._scale.unit, measure.nodes
        self.constants = dict(measure.constants)
        if added.side is not None:
            self.constants["rest_px"] = self.constants["rest"]
            self.constants["rest"] = self._scale(self.constants["rest"])[0]
            self.constants["unit"] = np.array(self.unit)
            self.constants["homography"] = self._scale.matrix

    def __call__(self, frame: GreyImage) -> Measured:
        measured = self._measure(frame)
        arrays = dict(measured.arrays)
        rest, largest = self._measure.rest_grid, measured.largest
        if self._added.side is not None:
            raw = not self.constants["filtered"]
            field = plane_displacement(rest, measured.grids[0], self._scale, raw=raw)
            arrays["displacement"] = field.displacement
            arrays["sigma"] = field.sigma.astype(np.float32)
            moved = np.linalg.norm(field.displacement[field.valid], axis=1)
            largest = float(moved.max(initial=0))
        if self._added.strain:
            field = plane_displacement(rest, measured.grids[0], self._scale, raw=True)
            arrays |= _strain_arrays(field)
        return dataclasses.replace(measured, arrays=arrays, largest=largest)


def _strain_arrays(field: PlaneField) -> dict[str, NDArray[Any]]:
    """Return strain, principal strains and the motion of the whole, each with its sigma."""
    arrays: dict[str, NDArray[Any]] = {
        **{name: np.full(field.valid.shape + after, np.nan) for name, after in _OF_NODES.items()},
        **{name: np.full(shape, np.nan) for name, shape in _OF_THE_WHOLE.items()},
    }
    try:
        noisy = with_measured_noise(field)
    except FieldError:  # too few nodes for an estimate
        noisy = field
    try:
        motion = motion_of(noisy)
    except FieldError:
        return arrays
    strain = plane_strain(noisy)
    principal = strain.principal()
    return arrays | {
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


class _InSpace(Measurement):
    """Measures frames of two views, and adds the requested results."""

    def __init__(self, measure: TwoViews, added: Added) -> None:
        super().__init__()
        self._detectors.enter_context(measure)
        self._measure, self._added = measure, added
        self.unit, self.nodes = measure.unit, measure.nodes
        self.constants = dict(measure.constants)
        if added.depth is not None:
            self.constants["deeper_than"] = np.array(added.depth)

    def __call__(self, frame: GreyImage) -> MeasuredInSpace:
        measured = self._measure(frame)
        field, arrays = measured.field, dict(measured.arrays)
        if self._added.strain:
            field = field.with_strain()
            arrays |= {"strain": _there(field.strain), "strain_sigma": _there(field.strain_sigma)}
        if self._added.depth is not None:
            contact = contact_of(field, deeper_than=self._added.depth)
            arrays |= {
                "depth": contact.depth,
                "depth_sigma": contact.sigma,
                "normal": contact.normal,
                "contact": contact.inside,
                "contact_area": np.array(contact.area),
                "contact_depth": np.array(contact.deepest),
            }
        return dataclasses.replace(measured, arrays=arrays, field=field)


def _there(array: NDArray[np.float64] | None) -> NDArray[np.float64]:
    if array is None:
        raise FieldError("the field has no strain")
    return array


def units(measure: Measurement) -> dict[str, str]:
    """Return the units of the added results, by name."""
    length = measure.unit
    return {
        **dict.fromkeys(("depth", "depth_sigma", "contact_depth", "deeper_than"), length),
        **dict.fromkeys(("translation", "translation_sigma"), length),
        **dict.fromkeys(("rotation", "rotation_sigma", "direction", "direction_sigma"), "rad"),
        "contact_area": f"{length}2",
    }
