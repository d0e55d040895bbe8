"""Displacements in the image of one camera, or in the plane of a flat pattern."""

from cmp_cl.config import DetectorConfig
from cmp_cl.image import GreyImage
from cmp_cl.measure.measurement import Measurement
from cmp_cl.motion import PlaneScale
from cmp_cl.motion.geometry import InPlane
from cmp_cl.motion.moments import Moment
from cmp_cl.opencl.device import Device


class OneView(Measurement):
    """Measures the displacement of the nodes in the image, px, or in the plane of a flat pattern.

    rest: the frame at rest, (H, W) uint8 or uint16.
    shape: (rows, columns) of the pattern's corners; None takes the shape that is seen at rest.
    cell: side of the cells of a flat pattern, mm, to measure in its plane, see
        `cmp_cl.motion.PlaneScale.of_cells`; None measures in px.
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
        cell: float | None = None,
        config: DetectorConfig | None = None,
        full_scale: int | None = None,
        device: Device | str | None = None,
        track: bool = False,
        strain: bool = False,
        profile: bool = False,
    ) -> None:
        self._cell = cell
        super().__init__(
            [rest],
            shape=shape,
            config=config,
            full_scale=full_scale,
            device=device,
            track=track,
            strain=strain,
            profile=profile,
        )
        self.constants["xy_rest"] = self.rest_grids[0].xy
        if cell is not None:
            self.constants["homography"] = self._scale.matrix

    def _at_rest(self) -> tuple[Moment, InPlane]:
        (grid,), cell = self.rest_grids, self._cell
        self._scale = PlaneScale.pixels() if cell is None else PlaneScale.of_cells(grid, cell)
        return Moment.in_plane(grid, self._scale), InPlane(self._scale, grid.edge_radius)

    def _views_of(self, frame: GreyImage) -> tuple[GreyImage, ...]:
        return (frame,)
