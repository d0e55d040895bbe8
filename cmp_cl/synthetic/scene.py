"""A scene: a gel that is pressed, its print, the light and the noise."""

import dataclasses
import enum
import math
from typing import Annotated

import numpy as np

from cmp_cl.config import Range, Settings


class Indenter(enum.Enum):
    """The object that presses on the gel; NONE leaves it flat."""

    NONE = "none"
    BALL = "ball"
    TORUS = "torus"
    CUBE = "cube"
    RIB = "rib"
    WEDGE = "wedge"


class Mode(enum.Enum):
    """The motion of the indenter; at severity 1 it is 2 mm, 1.2 mm or 20 degrees.

    A shear and a twist include a press of half the depth.
    """

    PRESS = "press"  #: along the normal of the gel
    SHEAR = "shear"  #: along the gel
    TWIST = "twist"  #: about the normal of the gel


class Surround(enum.Enum):
    """The grey level beside the pattern."""

    WHITE = "white"
    BLACK = "black"
    GREY = "grey"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scene(Settings):
    """One frame to render.

    markers: N inner corners a side, 3 to 100: N x N corners between (N+1) x (N+1) cells.
    shape: (rows, columns) of the image, or of each view of a stereo pair, px, 64 to 8192.
    side: side of the whole pattern, mm, 16 to 64; the indenters keep their size.
    indenter, mode: the object that touches the gel, and its motion.
    severity: 0 to 2; 1 is a press of 2 mm, a shear of 1.2 mm or a twist of 20 degrees.
    contact: (x, y) of the indenter's centre from the pattern's, mm, -32 to 32.
    direction: rotation of the indenter and direction of the shear, rad, -7 to 7.
    corrosion: 0 to 3; 0 is a perfect print. At 1 strain makes cell edges retract and overlap by
        up to about 2 px.
    blur: standard deviation of the point spread function, px, 0 to 10.
    noise: standard deviation of the noise, 1/255 of full scale, 0 to 100.
    light: strength of uneven light and of the shading by slope, 0 to 1; 1 is a ratio of
        about 2 across the image.
    vignetting: brightness at the centre over that in the image's corners, 1 to 10.
    exposure: factor on all grey levels, 0.05 to 10; above about 1.3 white saturates.
    surround: grey level beside the pattern.
    bits: of the camera: 8 for uint8, 9 to 16 for uint16.
    position: (x, y) of the pattern's centre from the image's, px, within +-8192.
    rotation: rotation of the pattern in the image, rad, -7 to 7.
    tilt: rotations of the gel about the image's x and y axes, rad, -0.5 to 0.5.
    seed: seed of the tears, the light's direction and the noise, from 0.

    Raises ConfigError if a field is outside its range.
    """

    markers: Annotated[int, Range(3, 100)] = 40
    shape: Annotated[tuple[int, int], Range(64, 8192)] = (480, 640)
    side: Annotated[float, Range(16, 64)] = 32.0
    indenter: Indenter = Indenter.BALL
    mode: Mode = Mode.PRESS
    severity: Annotated[float, Range(0, 2)] = 1.0
    contact: Annotated[tuple[float, float], Range(-32, 32)] = (0.0, 0.0)
    direction: Annotated[float, Range(-7, 7)] = 0.0
    corrosion: Annotated[float, Range(0, 3)] = 1.0
    blur: Annotated[float, Range(0, 10)] = 0.9
    noise: Annotated[float, Range(0, 100)] = 3.0
    light: Annotated[float, Range(0, 1)] = 0.5
    vignetting: Annotated[float, Range(1, 10)] = 1.2
    exposure: Annotated[float, Range(0.05, 10)] = 1.0
    surround: Surround = Surround.GREY
    bits: Annotated[int, Range(8, 16)] = 8
    position: Annotated[tuple[float, float], Range(-8192, 8192)] = (0.0, 0.0)
    rotation: Annotated[float, Range(-7, 7)] = 0.0
    tilt: Annotated[tuple[float, float], Range(-0.5, 0.5)] = (0.0, 0.0)
    seed: Annotated[int, Range(0, 2**63 - 1)] = 0

    def at_rest(self) -> "Scene":
        """Return the same scene with nothing pressing on the gel."""
        return dataclasses.replace(self, severity=0.0)


def random_scene(
    seed: int,
    *,
    markers: int = 40,
    severity: float = 1.0,
    indenter: Indenter | None = None,
    mode: Mode | None = None,
    shape: tuple[int, int] = (480, 640),
    corrosion: float = 1.0,
) -> Scene:
    """Draw a random scene from the seed.

    markers, severity, indenter, mode, shape, corrosion: as in `Scene`; an indenter or a mode of
        None is drawn at random.

    The contact is within 5 mm of the centre, in any direction. Blur is 0.7 to 1.1 px, noise 2 to
    4.5, light 0.2 to 1, vignetting 1 to 1.5. The surround is random. The position is within
    6 px (at VGA), the rotation within 3 degrees, the tilt within 2. Raises ConfigError for a value
    that `Scene` does not take.
    """
    given = Scene(markers=markers, shape=shape, severity=severity, corrosion=corrosion, seed=seed)
    draw = np.random.default_rng([seed, 1])
    indenters = [kind for kind in Indenter if kind is not Indenter.NONE]
    chosen = indenters[draw.integers(len(indenters))]
    moved = list(Mode)[draw.integers(len(Mode))]
    reach = 6.0 * min(shape) / 480
    return dataclasses.replace(
        given,
        indenter=chosen if indenter is None else indenter,
        mode=moved if mode is None else mode,
        contact=_uniform_pair(draw, 5.0),
        direction=float(draw.uniform(-math.pi, math.pi)),
        blur=float(draw.uniform(0.7, 1.1)),
        noise=float(draw.uniform(2.0, 4.5)),
        light=float(draw.uniform(0.2, 1.0)),
        vignetting=float(draw.uniform(1.0, 1.5)),
        surround=list(Surround)[draw.integers(len(Surround))],
        position=_uniform_pair(draw, reach),
        rotation=float(draw.uniform(-0.05, 0.05)),
        tilt=_uniform_pair(draw, 0.035),
    )


def _uniform_pair(draw: np.random.Generator, reach: float) -> tuple[float, float]:
    x, y = draw.uniform(-reach, reach, 2)
    return float(x), float(y)
