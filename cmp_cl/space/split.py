"""The two views in a frame that shows both."""

import dataclasses
from numbers import Integral
from typing import Self

from cmp_cl.errors import ConfigError, ImageError, check_kind
from cmp_cl.image import AnyImage, GreyImage, check_image


@dataclasses.dataclass(frozen=True)
class BinocularSplit:
    """The rectangles of the two views in a frame that shows both.

    left, right: rectangles (x, y, width, height) of one size, px.
    mirror_left, mirror_right: flip that view left to right. A view is reversed if the camera sees
        it through an odd number of mirrors.

    Calibrate the rig on views that were split in the same way.

    Raises ConfigError if a rectangle is malformed.
    """

    left: tuple[int, int, int, int]
    right: tuple[int, int, int, int]
    mirror_left: bool = False
    mirror_right: bool = False

    def __post_init__(self) -> None:
        for side in ("left", "right"):
            mirror = f"mirror_{side}"
            check_kind(mirror, getattr(self, mirror), bool, ConfigError)
            box = getattr(self, side)
            whole = isinstance(box, tuple) and all(
                isinstance(number, Integral) and not isinstance(number, bool) for number in box
            )
            if not whole or len(box) != 4 or min(box[:2]) < 0 or min(box[2:]) < 1:
                raise ConfigError(
                    f"BinocularSplit.{side} must be whole numbers (x, y, width, height) with "
                    f"x, y >= 0 and width, height >= 1, not {box!r}"
                )

        if self.left[2:] != self.right[2:]:
            sizes = " and ".join(f"{box[2]} x {box[3]}" for box in (self.left, self.right))
            raise ConfigError(f"left and right must have one size, not {sizes} px: cut the larger")

    @classmethod
    def halves(cls, width: int, height: int) -> Self:
        """Split a frame of that size, px, into halves; an odd width loses its middle column.

        Raises ConfigError if the frame is narrower than 2 px or has no row.
        """
        width, height = int(width), int(height)
        half = width // 2
        return cls((0, 0, half, height), (width - half, 0, half, height))

    def __call__(self, frame: AnyImage) -> tuple[GreyImage, GreyImage]:
        """Return the two views of a frame (H, W): slices of it, or copies where mirrored.

        Raises ImageError if the frame is none, or a rectangle extends past it.
        """
        frame = check_image(frame)
        return (
            _cut(frame, self.left, mirror=self.mirror_left),
            _cut(frame, self.right, mirror=self.mirror_right),
        )


def _cut(frame: GreyImage, box: tuple[int, int, int, int], *, mirror: bool) -> GreyImage:
    x, y, width, height = box
    if y + height > frame.shape[0] or x + width > frame.shape[1]:
        raise ImageError(
            f"the view (x, y, width, height) = {box} extends past the frame of "
            f"{frame.shape[1]} x {frame.shape[0]} px"
        )
    view = frame[y : y + height, x : x + width]
    return view[:, ::-1].copy() if mirror else view
