"""What becomes of a frame that is measured."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners
from cmp_cl.field import DisplacementField
from cmp_cl.grid import Grid
from cmp_cl.image import GreyImage
from cmp_cl.measure.fit import Fit
from cmp_cl.motion.nodes import positions_of
from cmp_cl.motion.plan import FieldPlan
from cmp_cl.space import Bias
from cmp_cl.stages.refine import Found


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Measured:
    """A frame, measured against the frame at rest.

    views: the one view, or the left and the right one.
    tracked: whether its nodes have their numbers from the frame before.
    ambiguous: whether the numbering of a grid is ambiguous, see `Grid.ambiguous`.
    differing: the nodes for which tracking had another corner than the numbers that were found
        anew, which hold; 0 where none were looked for.
    bias: of the rig of two views, where it has a covariance.
    """

    views: tuple[GreyImage, ...]
    tracked: bool = False
    ambiguous: bool = False
    differing: int = 0
    bias: Bias | None = None
    _fit: Fit | None
    _plan: FieldPlan
    _found: Found
    _arrays: dict[str, NDArray[Any]]  # what the kernels have found
    _numbered: Callable[[], tuple[Grid, ...]]  # returns the grids

    def __repr__(self) -> str:
        doubts = [name for name in ("ambiguous", "misfit") if getattr(self, name)]
        return f"<Measured: {', '.join([repr(self.field), *doubts])}>"

    def __getstate__(self) -> dict[str, Any]:
        """Return what a pickle holds: all that is known of the frame, and nothing of the device."""
        _ = self.field, self.corners, self.grids
        return {**vars(self), "_plan": None, "_found": None, "_numbered": None}

    @functools.cached_property
    def field(self) -> DisplacementField:
        """Return the displacement of the nodes, in the image, in the plane of a flat pattern, or
        in space."""
        return self._plan.field(self._arrays)

    @functools.cached_property
    def corners(self) -> tuple[Corners, ...]:
        """Return the corners of the one view, or of the left and of the right one."""
        return tuple(self._found.corners)

    @functools.cached_property
    def grids(self) -> tuple[Grid, ...]:
        """Return the grid of the one view, or those of the left and of the right one."""
        return self._numbered()

    @functools.cached_property
    def misfit(self) -> bool:
        """Return whether the rig of two views no longer fits as it did at rest: all displacements
        may then be wrong. A camera that moves along the epipolar lines alone does not show."""
        return self._fit is not None and self._fit.is_lost(self._arrays["misfit"])

    @functools.cached_property
    def bias_sigma(self) -> NDArray[np.float64] | None:
        """Return the standard deviation of the displacement by the error of the rig, (R, C), see
        `cmp_cl.space.Bias`; None without a bias."""
        return None if self.bias is None else self.bias.sigma(self.field.displacement)

    @property
    def nodes(self) -> int:
        """Return the number of nodes that are measured both at rest and now."""
        return int(np.count_nonzero(self.field.valid))

    @property
    def largest(self) -> float:
        """Return the largest displacement in the unit of the field, 0 without nodes."""
        moved = self.field.displacement[self.field.valid]
        return float(np.linalg.norm(moved, axis=1).max(initial=0))

    @property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays for `SeriesWriter.append`, by name.

        displacement, sigma, status and source of the field; raw_displacement and raw_sigma before
        the lattice filter; its strain, if it has one, see
        `DisplacementField.strains`; bias_sigma, if there is one; misfit of two views; and the
        detected positions, (R, C, 2) float32, px: xy of one view, left and right of two.
        """
        field = self.field
        arrays: dict[str, NDArray[Any]] = {
            "displacement": field.displacement,
            "sigma": field.sigma,
            "status": field.status,
            "source": field.source,
            **field.strains(),
        }
        if field.raw is not None:
            arrays |= {"raw_displacement": field.raw.displacement, "raw_sigma": field.raw.sigma}
        if self.bias_sigma is not None:
            arrays["bias_sigma"] = self.bias_sigma
        if self._fit is not None:
            arrays["misfit"] = np.array(self.misfit)
        names = ("xy",) if len(self.views) == 1 else ("left", "right")
        seen = {name: positions_of(self._arrays, view) for view, name in enumerate(names)}
        return arrays | seen
