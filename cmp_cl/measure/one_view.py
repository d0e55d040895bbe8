"""Displacements in the image of one camera, or in the plane of a flat pattern."""

from typing import Unpack

from cmp_cl.image import AnyImage
from cmp_cl.measure.measurement import Measurement, Settings
from cmp_cl.motion import PlaneScale
from cmp_cl.motion.geometry import InPlane
from cmp_cl.motion.moments import Moment


class OneView(Measurement):
    """Measures the displacement of the nodes in the image, px, or in the plane of a flat pattern.

    rest: the frame at rest, (H, W) uint8 or uint16.
    cell: side of the cells of a flat pattern, mm, to measure in its plane, see
        `cmp_cl.motion.PlaneScale.of_cells`; None measures in px.
    settings: see `cmp_cl.measure.Settings`.

    uneven: with a cell, by which share the cells at rest are not squares of that side in the plane,
        see `PlaneScale.uneven`. Displacements and strains in the plane are wrong by as much.

    With a cell, constants has the homography too, (3, 3), from px to the plane; and a device
    without double precision computes in float32: displacements on a pattern of 44 cells then differ
    by at most 1.1e-5 cells (measured), in px by nothing.

    Raises GridError if the frame at rest shows no such pattern, FieldError if its nodes do not fix
    the plane, and the errors of `Detector`.
    """

    def __init__(
        self, rest: AnyImage, *, cell: float | None = None, **settings: Unpack[Settings]
    ) -> None:
        self._cell = cell
        super().__init__(rest, lambda frame: (frame,), **settings)
        self.constants["xy_rest"] = self.rest_grids[0].xy
        self.uneven = 0.0
        if cell is not None:
            self.constants["homography"] = self._scale.matrix
            self.uneven = self._scale.uneven(self.rest_grids[0], cell)

    def _at_rest(self) -> tuple[Moment, InPlane]:
        (grid,), cell = self.rest_grids, self._cell
        self._scale = PlaneScale.pixels() if cell is None else PlaneScale.of_cells(grid, cell)
        return Moment.in_plane(grid, self._scale), InPlane(self._scale, grid.edge_radius)
