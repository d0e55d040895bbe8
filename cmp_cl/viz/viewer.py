"""A live view of the frames, in Rerun's viewer."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.closing import Closing
from cmp_cl.errors import ConfigError, extra
from cmp_cl.field import DisplacementField
from cmp_cl.field.nodes import quadrilaterals
from cmp_cl.grid.grid import Grid
from cmp_cl.image import GreyImage
from cmp_cl.viz.overlays import coloured, strips


class Viewer(Closing):
    """Shows frames as they are measured: the image with its nodes, and the surface in space.

    Raises ConfigError without rerun-sdk, or if its viewer is not found on the PATH.
    """

    def __init__(self) -> None:
        with extra("view", "The live view"):
            import rerun
        self._rerun = rerun
        self._stream = rerun.RecordingStream("cmp_cl")
        self._top = 1e-12
        try:
            self._stream.spawn()
        except RuntimeError as error:
            raise ConfigError(str(error).strip().splitlines()[0]) from error

    def frame(
        self,
        *,
        index: int,
        time_ms: float,
        image: GreyImage,
        grid: Grid,
        field: DisplacementField,
        rate: float = math.nan,
    ) -> None:
        """Show a frame: its image, and its nodes coloured by their displacement.

        index: its number. time_ms: NaN leaves it out of the clock's timeline. image: (H, W). grid:
        on the image. field: of the same nodes; the surface is shown if it is in space. The colours
        end at the largest displacement so far. rate: frames per second, NaN if unknown.
        """
        rerun, stream = self._rerun, self._stream
        stream.set_time("frame", sequence=index)
        if not math.isnan(time_ms):
            stream.set_time("time", duration=time_ms / 1000)
        picture = rerun.Image(image)
        stream.log("view", picture.compress() if image.dtype == np.uint8 else picture)
        stream.log("frames_per_second", rerun.Scalars(rate))
        stream.log("nodes", rerun.Scalars(np.count_nonzero(grid.valid)))
        colours = self._colours(np.linalg.norm(field.displacement, axis=2)[grid.valid])
        stream.log("view/nodes", rerun.Points2D(grid.xy[grid.valid], colors=colours, radii=1.5))
        stream.log("view/lines", rerun.LineStrips2D(strips(grid.xy, grid.valid), radii=0.4))
        if field.position.shape[2] == 3:
            self._surface(field)
        scale = f"displacement from 0 (dark blue) to {self._top:.3g} {field.unit} (yellow)"
        stream.log("scale", rerun.TextDocument(scale))

    def _surface(self, field: DisplacementField) -> None:
        """Show the surface now and arrows from rest."""
        quads = quadrilaterals(field.valid)
        rest, shift = field.position[field.valid], field.displacement[field.valid]
        colours = self._colours(np.linalg.norm(shift, axis=1))
        extent = float(np.ptp(rest, axis=0).max()) if len(rest) else 1.0
        surface = self._rerun.Mesh3D(
            vertex_positions=rest + shift,
            triangle_indices=np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]),
            vertex_colors=colours,
        )
        arrows = self._rerun.Arrows3D(
            origins=rest, vectors=shift, colors=colours, radii=extent / 800
        )
        self._stream.log("gel/surface", surface)
        self._stream.log("gel/displacement", arrows)

    def _colours(self, length: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
        """Return the colours of lengths (N,), up to the largest so far."""
        self._top = max(self._top, float(np.nan_to_num(length).max(initial=0)))
        return coloured(length, self._top)

    def close(self) -> None:
        """End the stream; the viewer stays open."""
        self._stream.disconnect()
