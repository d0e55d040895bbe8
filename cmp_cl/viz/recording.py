"""A log of frames for Rerun."""

import math
from os import PathLike
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.closing import Closing
from cmp_cl.field import DisplacementField, mesh
from cmp_cl.grid.grid import Grid, NodeStatus
from cmp_cl.image import GreyImage
from cmp_cl.viz.overlays import STATUS_COLOURS, strips
from cmp_cl.viz.piped import PipedFile

_JPEG_QUALITY = 80


class RerunLog(Closing):
    """Shows frames in Rerun's viewer, or records them to a .rrd file for it.

    path: the file; None opens the viewer. It needs rerun-sdk 0.23 or newer. The file appears when
    the `with` block ends, even by an exception or Ctrl-C; without a frame an older file is kept.

    Raises ImportError without rerun-sdk, RuntimeError if its viewer is not found on the
    PATH, OSError if the file cannot be written.
    """

    def __init__(self, path: str | PathLike[str] | None = None) -> None:
        import rerun

        self._rerun = rerun
        self._stream = rerun.RecordingStream("cmp_cl")
        self._file: PipedFile | None = None
        self._empty = True
        self._top = 0.0
        if path is None:
            self._stream.spawn()
        else:
            self._file = PipedFile(path, self._stream.save)

    def frame(
        self,
        *,
        index: int,
        time_ms: float,
        image: GreyImage | None = None,
        grid: Grid | None = None,
        field: DisplacementField | None = None,
        moved: NDArray[np.floating[Any]] | None = None,
        unit: str = "px",
        rate: float = math.nan,
    ) -> None:
        """Show a frame: its image, its grid on it, its surface with the displacements.

        index: its number. image: (H, W), stored as JPEG if it has 8 bits, as PNG if it has 16.
        field: the displacement of the nodes, or None. moved: its length at each node, (R, C) in
        `unit`, which colours the nodes up to the largest so far; None colours them by their status.
        rate: frames per second, NaN if unknown. time_ms: NaN leaves it out of the clock's timeline.

        Raises OSError if an earlier frame could not be written.
        """
        if self._file is not None:
            self._file.check()
        self._empty = False
        rerun, stream = self._rerun, self._stream
        stream.set_time("frame", sequence=index)
        if not math.isnan(time_ms):
            stream.set_time("time", duration=time_ms / 1000)
        if image is not None:
            stream.log("view", rerun.EncodedImage(**_encoded(image)))
        if not math.isnan(rate):
            stream.log("frames_per_second", rerun.Scalars(rate))
        if grid is not None:
            stream.log("nodes", rerun.Scalars(np.count_nonzero(grid.valid)))
            colours: Any = [
                STATUS_COLOURS[NodeStatus(status)][::-1] for status in grid.status[grid.valid]
            ]
            if moved is not None:
                colours = self._colours(moved[grid.valid])
                scale = f"displacement from 0 (dark blue) to {self._top:.3g} {unit} (yellow)"
                stream.log("scale", rerun.TextDocument(scale))
            stream.log("view/nodes", rerun.Points2D(grid.xy[grid.valid], colors=colours, radii=1.5))
            stream.log("view/lines", rerun.LineStrips2D(strips(grid.xy, grid.valid), radii=0.4))
        if field is not None:
            self._surface(field)

    def _surface(self, field: DisplacementField) -> None:
        """Log the surface now and arrows from rest, coloured up to the largest so far."""
        columns, quads = mesh(field)
        rest, shift = columns["position"], columns["displacement"]
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
        """Return the colours (N, 3), RGB, of lengths (N,); grey where one is NaN."""
        self._top = max(self._top, float(np.nan_to_num(length).max(initial=0)), 1e-12)
        levels = np.rint(255 * np.nan_to_num(length) / self._top).astype(np.uint8).reshape(-1, 1)
        colours = np.empty((0, 3), np.uint8)
        if len(levels):
            colours = cv2.applyColorMap(levels, cv2.COLORMAP_PLASMA)[:, 0, ::-1].astype(np.uint8)
        colours[np.isnan(length)] = 128
        return colours

    def close(self) -> None:
        """Finish the recording; closing again does nothing.

        Raises OSError if it could not be written whole; an older file is then kept.
        """
        self._stream.disconnect()
        file, self._file = self._file, None
        if file is not None and self._empty:
            file.abandon()
        elif file is not None:
            file.close()


def _encoded(image: GreyImage) -> dict[str, Any]:
    """Encode the image for rerun.EncodedImage: as JPEG, or, with 16 bits, as PNG."""
    if image.dtype == np.uint8:
        contents = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
        return {"contents": contents.tobytes(), "media_type": "image/jpeg"}
    return {"contents": cv2.imencode(".png", image)[1].tobytes(), "media_type": "image/png"}
