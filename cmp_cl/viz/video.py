"""One annotated video: the nodes on the image, coloured by their displacement."""

import os
from os import PathLike
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.closing import Closing
from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.files import check_target, suffix_of, temporary_beside
from cmp_cl.grid.grid import Grid
from cmp_cl.image import GreyImage
from cmp_cl.viz.overlays import PLASMA, coloured, eight_bits, strips

_STRIP = 40  # px below the image for the text and the colour bar
_WIDEST = 1920  # px, the widest video; wider images are reduced by a whole factor
_NARROWEST = 480  # px, the narrowest video, so that its text fits
_DISC = [(y, x) for y in range(-2, 3) for x in range(-2, 3) if y * y + x * x <= 5]
_LINE = (150, 110, 50)  # BGR


class OverlayVideo(Closing):
    """Writes an annotated video, frame by frame; use it in a with statement.

    path: .mp4. fps: frames per second. unit: of the displacement. The colour scale ends at the
    largest displacement so far, which the bar shows. The file replaces an older one when the block
    ends. Raises ConfigError on another suffix, OSError if the folder is missing, not writable or
    full, or OpenCV cannot write such a video.
    """

    def __init__(self, path: str | PathLike[str], *, fps: float = 25.0, unit: str = "px") -> None:
        if suffix_of(path, ConfigError) != ".mp4":
            raise ConfigError(f"{str(path)!r}: a video must end in .mp4")
        if not 0 < fps < 1e4:
            raise ConfigError(f"fps must be from 0 to 10000, not {fps!r}")
        self._target, self._fps, self._unit = check_target(path), fps, unit
        self._temporary = self._target
        self._writer: Any = None
        self._frames = 0
        self._shape: tuple[int, ...] = ()
        self._factor = 1.0
        self._top = 0.0

    def frame(
        self, image: GreyImage, grid: Grid, moved: NDArray[np.floating[Any]], *, text: str = ""
    ) -> None:
        """Add a frame: the image (H, W), its nodes, and how far each has moved, (R, C).

        A node without a displacement is grey. Raises FieldError if the image differs in size
        from the first one, or `moved` in shape from the grid. Raises OSError.
        """
        if moved.shape != grid.shape:
            raise FieldError(f"moved is {moved.shape}, the grid has {grid.shape} nodes")
        if not self._shape:
            self._begin(image.shape)
        elif image.shape != self._shape:
            raise FieldError(f"the image is {image.shape}, the first one was {self._shape}")
        self._top = max(self._top, float(np.nan_to_num(moved).max(initial=0)))
        factor = self._factor
        grey = eight_bits(image)
        wide, high = int(image.shape[1] * factor), int(image.shape[0] * factor)
        canvas = np.zeros((high + _STRIP, wide, 3), np.uint8)
        if factor != 1:
            how = cv2.INTER_AREA if factor < 1 else cv2.INTER_LINEAR
            grey = np.asarray(cv2.resize(grey, (wide, high), interpolation=how), np.uint8)
        canvas[:high, :wide] = grey[..., None]
        self._nodes(canvas[:high, :wide], (grid.xy + 0.5) * np.float32(factor) - 0.5, moved)
        self._legend(canvas[high:], text)
        self._write(canvas)

    def _begin(self, shape: tuple[int, ...]) -> None:
        self._shape = shape
        width = shape[1]
        if width > _WIDEST:
            self._factor = 1 / -(-width // _WIDEST)
        elif width < _NARROWEST:
            self._factor = float(-(-_NARROWEST // width))

    def _nodes(
        self,
        canvas: NDArray[np.uint8],
        xy: NDArray[np.float32],
        moved: NDArray[np.floating[Any]],
    ) -> None:
        """Draw lines between neighbours, then a disc on every node."""
        valid = ~np.isnan(xy[..., 0])
        whole = np.rint(np.where(valid[..., None], xy, 0)).astype(np.int32)
        lines = [np.ascontiguousarray(line) for line in strips(whole, valid)]
        cv2.polylines(canvas, lines, False, _LINE, 1)
        colours = coloured(moved[valid], self._top)[:, ::-1]
        x, y = whole[valid].T
        for down, right in _DISC:
            row, column = y + down, x + right
            inside = (row >= 0) & (row < canvas.shape[0]) & (column >= 0)
            inside &= column < canvas.shape[1]
            canvas[row[inside], column[inside]] = colours[inside]

    def _legend(self, strip: NDArray[np.uint8], text: str) -> None:
        """Draw the text at the left, the colour bar with its two ends at the right."""
        font, size, white = cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255)
        cv2.putText(strip, text, (8, 25), font, size, white, 1, cv2.LINE_AA)
        top = f"{self._top:.3g} {self._unit}"
        width = cv2.getTextSize(top, font, size, 1)[0][0]
        right = strip.shape[1] - width - 14
        left = right - 110
        bar = PLASMA[np.linspace(0, 255, right - left).astype(int), ::-1]
        strip[14:28, left:right] = bar
        cv2.putText(strip, "0", (left - 14, 25), font, size, white, 1, cv2.LINE_AA)
        cv2.putText(strip, top, (right + 6, 25), font, size, white, 1, cv2.LINE_AA)

    def _write(self, picture: NDArray[np.uint8]) -> None:
        """Add a picture (H, W, 3), BGR; an odd last row or column is left out."""
        high, wide = (side - side % 2 for side in picture.shape[:2])
        if self._writer is None:
            self._temporary = temporary_beside(self._target, ".mp4")
            self._writer = cv2.VideoWriter(
                str(self._temporary), cv2.VideoWriter.fourcc(*"mp4v"), self._fps, (wide, high)
            )
            if not self._writer.isOpened():
                self._temporary.unlink(missing_ok=True)
                raise OSError(f"OpenCV cannot write a video to {str(self._target)!r}")
        self._writer.write(np.ascontiguousarray(picture[:high, :wide]))
        self._frames += 1

    def close(self) -> None:
        """Finish the video; closing again does nothing. Without a frame no file appears.

        Raises OSError if it is not whole: OpenCV does not report a full disk.
        """
        if self._writer is None:
            return
        self._writer.release()
        self._writer = None
        written = cv2.VideoCapture(str(self._temporary))
        counted = round(written.get(cv2.CAP_PROP_FRAME_COUNT))
        written.release()
        if counted != self._frames:
            self._temporary.unlink(missing_ok=True)
            raise OSError(f"{str(self._target)!r}: the video was not written; is the disk full?")
        os.replace(self._temporary, self._target)
