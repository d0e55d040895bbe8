"""A small gel seen by two cameras, for the tests that measure: frames, and the truth in space."""

import dataclasses
import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl import BinocularSplit, StereoRig
from cmp_cl.measure.views import View
from cmp_cl.synthetic import (
    Indenter,
    Mode,
    Rendered,
    Scene,
    binocular_frame,
    default_rig,
    render_stereo,
)

VIEW = (240, 216)
RIG = default_rig(VIEW)
SPLIT = BinocularSplit.halves(2 * VIEW[1], VIEW[0])
NODES = (12, 12)
GEL = Scene(markers=12, shape=VIEW, indenter=Indenter.TORUS, mode=Mode.TWIST, seed=5)


class Shot(NamedTuple):
    """A rendered frame: its views, both in one image, and its nodes in space (12, 12, 3), mm."""

    left: Rendered
    right: Rendered
    xyz: NDArray[np.float64]

    @property
    def frame(self) -> NDArray[np.uint8]:
        return binocular_frame(self.left, self.right)


def rendered_gel(rig: StereoRig = RIG, **changes: Any) -> Shot:
    """Return the gel, with some fields changed, as the cameras of a rig see it."""
    return Shot(*render_stereo(dataclasses.replace(GEL, **changes), rig))


@functools.cache
def pressed(severity: float) -> Shot:
    """Return the gel pressed so strongly; 0 is at rest."""
    return rendered_gel(severity=severity)


def board_frame(
    number: int, tilt: tuple[float, float], rig: StereoRig, view: tuple[int, int] = VIEW
) -> NDArray[np.uint8]:
    """Return a frame that shows a tilted board of 12 x 12 corners, 2 mm apart, to both cameras."""
    scene = Scene(
        markers=12,
        side=26.0,
        shape=view,
        severity=0.0,
        corrosion=0.0,
        noise=1.0,
        tilt=tilt,
        rotation=0.1 * number,
        seed=number,
    )
    return binocular_frame(*render_stereo(scene, rig)[:2])


def numbered_otherwise(view, corners, image, *, number=View.number):
    """Number a view as it does, with two of its corners exchanged."""
    grid = number(view, corners, image)
    index = grid.index.copy()
    index[[5, 7]] = index[[7, 5]]
    return dataclasses.replace(grid, index=index)
