"""Displacements in the image of one camera, or in the plane of a flat pattern."""

from collections.abc import Sequence

from cmp_cl.config import DetectorConfig
from cmp_cl.field import DisplacementField
from cmp_cl.grid import Grid
from cmp_cl.image import GreyImage
from cmp_cl.measure.measurement import Measurement, constants_of
from cmp_cl.measure.patterns import Region
from cmp_cl.measure.views import Search, Views
from cmp_cl.motion import PlaneScale, displacement
from cmp_cl.motion.geometry import InPlane
from cmp_cl.motion.moments import Moment
from cmp_cl.opencl.device import Device, select_device


class OneView(Measurement):
    """Measures the displacement of the nodes in the image, px, or in the plane of a flat pattern.

    rest: the frame at rest, (H, W) uint8 or uint16.
    shape: (rows, columns) of the pattern's corners; None takes the shape that is seen at rest.
    region: (x0, y0, x1, y1), px, holds the pattern in every frame; None is the whole frame.
    cell: side of the cells of a flat pattern, in `unit`, to measure in its plane, see
        `cmp_cl.motion.PlaneScale.of_cells`; None measures in px.
    unit: name of the unit of length; only with a cell.
    config: configuration of the detector; None finds the pattern at rest with `DetectorConfig()`,
        as every caller does, and then takes `DetectorConfig.for_cell` for its cells.
    track: continue the numbers of the previous frame if the frame at rest leaves them ambiguous.
        Frames then come in order, and the pattern as a whole moves by less than half a cell from
        the frame at rest to the first and from each to the next. After two frames without a grid,
        or one that is ambiguous, those that follow are ambiguous too, until a border or the
        printing errors decide.
    full_scale: the camera's largest grey level; None is that of the configuration or of the type.
    device: a Device, a text for `select_device`, or None for the default device.
    strain: give every field its strain, see `DisplacementField.with_strain`.
    profile: record the times of the kernels of the last frame, see `times`.

    With a cell, constants has the homography too, (3, 3), from px to the plane.

    Raises GridError if the frame at rest shows no such pattern, FieldError if its nodes do not fix
    the plane, and the errors of `Detector`.
    """

    def __init__(
        self,
        rest: GreyImage,
        *,
        shape: tuple[int, int] | None = None,
        region: Region | None = None,
        cell: float | None = None,
        unit: str = "mm",
        config: DetectorConfig | None = None,
        full_scale: int | None = None,
        device: Device | str | None = None,
        track: bool = False,
        strain: bool = False,
        profile: bool = False,
    ) -> None:
        super().__init__(device=select_device(device), strain=strain, profile=profile)
        search = Search(
            device=self._device,
            shape=shape,
            config=config,
            full_scale=full_scale,
            track=track,
            profile=profile,
        )
        with self._closed_on_error():
            self._views = self._stack.enter_context(Views([rest], search, [region]))
            at_rest = self.rest_grid
            self._scale = (
                PlaneScale.pixels() if cell is None else PlaneScale.of_cells(at_rest, cell, unit)
            )
            moment = Moment.in_plane(at_rest, self._scale)
            geometry = InPlane(self._scale, at_rest.edge_radius)
            self._plan_for(search.device, rest, moment, geometry)
        self.unit = self._scale.unit
        self.nodes = at_rest.status.size
        still = displacement(at_rest, at_rest, scale=self._scale, device=self._device)
        self.constants = constants_of(still) | {"xy_rest": at_rest.xy}
        if cell is not None:
            self.constants["homography"] = self._scale.matrix

    @property
    def rest_grid(self) -> Grid:
        """Return the grid of the frame at rest."""
        return self._views.views[0].rest

    def _views_of(self, frame: GreyImage) -> tuple[GreyImage, ...]:
        return (frame,)

    def _between(self, grids: Sequence[Grid]) -> DisplacementField:
        return displacement(self.rest_grid, grids[0], scale=self._scale, device=self._device)
