"""Results that `cmp-cl run` derives from the positions on request: lengths, strain, contact."""

import argparse
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.cli.arguments import positive_number, unit_name
from cmp_cl.errors import ConfigError
from cmp_cl.measure import Measured
from cmp_cl.motion import contact_of


def add_arguments(group: Any) -> None:
    """Add the options --cell, --unit, --strain and --contact to a group of an argparse parser."""
    group.add_argument(
        "--cell",
        metavar="SIDE",
        type=positive_number,
        help="for one view of a flat pattern: side of its cells at rest, in --unit; lengths are "
        "then in that unit, in the plane of the pattern",
    )
    group.add_argument("--unit", metavar="UNIT", type=unit_name, help="unit of --cell; default: mm")
    group.add_argument(
        "--strain",
        action="store_true",
        help="add the Green-Lagrange strain of each node, the principal strains and their "
        "direction, each with its sigma; with one view in the plane, with two in the surface",
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


def constants(arguments: argparse.Namespace) -> dict[str, NDArray[Any]]:
    """Return the arrays that a series holds once because of these options."""
    deeper_than = arguments.contact
    return {} if deeper_than is None else {"deeper_than": np.array(deeper_than)}


def arrays_of(measured: Measured, arguments: argparse.Namespace) -> dict[str, NDArray[Any]]:
    """Return the arrays of a measured frame for a series, with those that the options ask for."""
    arrays = measured.arrays
    if arguments.contact is not None:
        contact = contact_of(measured.field, deeper_than=arguments.contact)
        arrays |= {
            "depth": contact.depth,
            "depth_sigma": contact.sigma,
            "normal": contact.normal,
            "contact": contact.inside,
            "contact_area": np.array(contact.area),
            "contact_depth": np.array(contact.deepest),
        }
    return arrays


def units(length: str) -> dict[str, str]:
    """Return the units of the derived results by name; length: the unit of lengths."""
    return {
        **dict.fromkeys(("depth", "depth_sigma", "contact_depth", "deeper_than"), length),
        **dict.fromkeys(("direction", "direction_sigma"), "rad"),
        "contact_area": f"{length}2",
    }
