"""Displacements in space, from two views in a frame."""

import dataclasses
import math
from typing import Unpack

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError, GridError, check_kind
from cmp_cl.grid import Grid
from cmp_cl.grid.grid import NO_SIDES
from cmp_cl.image import AnyImage
from cmp_cl.measure.fit import LEAST_FITTING
from cmp_cl.measure.measurement import Measurement, Settings
from cmp_cl.measure.patterns import align_views
from cmp_cl.measure.views import SHIFTS
from cmp_cl.motion.geometry import InSpace
from cmp_cl.motion.moments import Moment
from cmp_cl.space import Bias, BinocularSplit, Points3D, StereoRig

Ends = tuple[bool, bool]  # whether the first and the last line are seen to be the pattern's
_FITS = 1.0  # px, largest reprojection error of a node that fits the rig
_FLIP = np.array([-1, 1], np.float32)
_BETTER = 0.25  # share of the reprojection error that is left if the views were swapped or mirrored


class TwoViews(Measurement):
    """Measures displacements in space from frames that hold two views.

    rest: the frame at rest, (H, W) uint8 or uint16. rig: the cameras, calibrated on views that were
        split in the same way.
    split: the rectangles of the two views in a frame. settings: see `cmp_cl.measure.Settings`.

    A device without double precision computes in float32: displacements 46 mm away then differ by
    at most .015 um, behind a window by .05 um (measured).

    Raises GridError if a view of the frame at rest shows no such pattern, or the rig does not fit
    three quarters of its nodes to 1 px, or it fits other pairs of nodes as well and no border of
    the pattern decides: on the same side of both views, or with a shape on any side of each;
    ImageError if a view extends past the frame; ConfigError if rig or split is of another type; and
    the errors of `Detector`.
    """

    def __init__(
        self,
        rest: AnyImage,
        rig: StereoRig,
        split: BinocularSplit,
        **settings: Unpack[Settings],
    ) -> None:
        check_kind("rig", rig, StereoRig, ConfigError)
        check_kind("split", split, BinocularSplit, ConfigError)
        self._rig, self._split = rig, split
        self._knows_size = settings.get("shape") is not None
        super().__init__(rest, split, **settings)
        if rig.covariance is not None:
            self._bias = Bias(rig, self.rest.xyz)
        left, right = self.rest_grids
        self.constants |= {"left_rest": left.xy, "right_rest": right.xy}

    def _at_rest(self) -> tuple[Moment, InSpace]:
        left, right = self._views
        right.rest = align_views(left.rest, right.rest, self._rig.R)
        self.rest = self._placed(left.rest, right.rest)
        return Moment.in_space(self.rest), InSpace(
            self._rig, [v.rest.edge_radius for v in self._views]
        )

    def _placed(self, left: Grid, right: Grid) -> Points3D:
        """Return the nodes at rest in space; raises GridError if the rig does not fit them."""
        points = self._rig.triangulate(left, right)
        both = np.count_nonzero(left.valid & right.valid)
        fitting = _fit(points)
        if not both:
            raise GridError("the two views show no node in common; check the split")
        if not fitting >= LEAST_FITTING * both:
            glass = "its window, beyond which the pattern must lie"
            if self._rig.window is None:
                glass = "a window or gel that the calibration does not know (calibrate --window)"
            raise GridError(
                f"the rig fits {fitting} of the {both} nodes that both views show to "
                f"{_FITS:g} px; check the calibration, the number of corners, the split, mirrored "
                f"views, {glass}, and which view is the left one"
            )
        self._check_order(left, right, _middle(points.error))
        self._check_pairs(left, right)
        return points

    def _check_pairs(self, left: Grid, right: Grid) -> None:
        """Raise GridError if the rig fits as well with the numbers of one view shifted, and no
        border of the pattern decides: of the same side in both views, or with a known size of
        either side.

        Along the epipolar lines another pair of nodes is a point at another depth.
        """
        sides = left.border or NO_SIDES, right.border or NO_SIDES
        rows_known = self._decided(*(view[:2] for view in sides))
        columns_known = self._decided(*(view[2:] for view in sides))
        for rows, columns in SHIFTS.tolist():
            if (rows and rows_known) or (columns and columns_known):
                continue
            other = dataclasses.replace(right, origin=(rows, columns)).cut_to(left)
            points = self._rig.triangulate(left, other)
            pairs = np.count_nonzero(left.valid & other.valid)
            if pairs and _fit(points) >= LEAST_FITTING * pairs:
                raise GridError(
                    f"the two views may show different parts of the pattern: the rig fits as well "
                    f"with the right view's numbers shifted by {rows} rows and {columns} columns; "
                    "show its border on the same side of both views, or give its rows and columns "
                    "and show a border of each in both"
                )

    def _decided(self, left: Ends, right: Ends) -> bool:
        """Return whether the ends of the lines that each view shows decide their numbers."""
        if self._knows_size:
            return any(left) and any(right)
        return any(here and there for here, there in zip(left, right, strict=True))

    def _check_order(self, left: Grid, right: Grid, error: float) -> None:
        """Raise GridError if the rig fits far better to views that are swapped or mirrored.

        A flat pattern near the point at which the cameras look fits to 1 px even so, with its
        heights reversed. error: the median reprojection error of the views as they are, px.
        """
        last = self._split.left[2] - 1, 0
        flipped = [dataclasses.replace(grid, xy=grid.xy * _FLIP + last) for grid in (left, right)]
        ways = {"left and right swapped": [right, left], "both views mirrored": flipped}
        other, how = min(
            (_middle(self._rig.triangulate(*views).error), how) for how, views in ways.items()
        )
        if other < _BETTER * error:
            raise GridError(
                f"the rig fits the nodes to {error:.2g} px, but with {how} to {other:.2g} px; give "
                "the views as they were in the calibration"
            )


def _fit(points: Points3D) -> int:
    """Return the number of nodes that fit the rig."""
    return int(np.count_nonzero(points.valid & (points.error <= _FITS)))


def _middle(error: NDArray[np.float64]) -> float:
    """Return the median of the known errors; infinity if none is known."""
    known = error[~np.isnan(error)]
    return float(np.median(known)) if len(known) else math.inf
