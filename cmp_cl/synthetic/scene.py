"""A scene: a gel that is pressed, its print, the light and the noise."""

import dataclasses
import enum
import math

import numpy as np

from cmp_cl.errors import ConfigError, check_pair, check_range


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
class Scene:
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
    bits: 8 for uint8, 12 for 0 to 4095 in uint16.
    position: (x, y) of the pattern's centre from the image's, px, within +-8192.
    rotation: rotation of the pattern in the image, rad, -7 to 7.
    tilt: rotations of the gel about the image's x and y axes, rad, -0.5 to 0.5.
    seed: seed of the tears, the light's direction and the noise, from 0.

    Raises ConfigError if a field is outside its range.
    """

    markers: int = 40
    shape: tuple[int, int] = (480, 640)
    side: float = 32.0
    indenter: Indenter = Indenter.BALL
    mode: Mode = Mode.PRESS
    severity: float = 1.0
    contact: tuple[float, float] = (0.0, 0.0)
    direction: float = 0.0
    corrosion: float = 1.0
    blur: float = 0.9
    noise: float = 3.0
    light: float = 0.5
    vignetting: float = 1.2
    exposure: float = 1.0
    surround: Surround = Surround.GREY
    bits: int = 8
    position: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    tilt: tuple[float, float] = (0.0, 0.0)
    seed: int = 0

    def __post_init__(self) -> None:
        check_range("Scene.markers", self.markers, 3, 100, kind=int)
        check_pair("Scene.shape", self.shape, 64, 8192, kind=int)
        check_range("Scene.side", self.side, 16, 64)
        _check_member("indenter", self.indenter, Indenter)
        _check_member("mode", self.mode, Mode)
        check_range("Scene.severity", self.severity, 0, 2)
        check_pair("Scene.contact", self.contact, -32, 32)
        check_range("Scene.direction", self.direction, -7, 7)
        check_range("Scene.corrosion", self.corrosion, 0, 3)
        check_range("Scene.blur", self.blur, 0, 10)
        check_range("Scene.noise", self.noise, 0, 100)
        check_range("Scene.light", self.light, 0, 1)
        check_range("Scene.vignetting", self.vignetting, 1, 10)
        check_range("Scene.exposure", self.exposure, 0.05, 10)
        _check_member("surround", self.surround, Surround)
        if isinstance(self.bits, bool) or self.bits not in (8, 12):
            raise ConfigError(f"Scene.bits must be 8 or 12, not {self.bits!r}")
        check_pair("Scene.position", self.position, -8192, 8192)
        check_range("Scene.rotation", self.rotation, -7, 7)
        check_pair("Scene.tilt", self.tilt, -0.5, 0.5)
        check_range("Scene.seed", self.seed, 0, 2**63 - 1, kind=int)

    def at_rest(self) -> "Scene":
        """Return the same scene with nothing pressing on the gel."""
        return dataclasses.replace(self, severity=0.0)


def _check_member(field: str, value: object, kind: type[enum.Enum]) -> None:
    if not isinstance(value, kind):
        names = ", ".join(f"{kind.__name__}.{member.name}" for member in kind)
        raise ConfigError(f"Scene.{field} must be one of {names}, not {value!r}")


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
    check_range("seed", seed, 0, 2**63 - 1, kind=int)
    check_pair("shape", shape, 64, 8192, kind=int)
    draw = np.random.default_rng([seed, 1])
    indenters = [kind for kind in Indenter if kind is not Indenter.NONE]
    chosen = indenters[draw.integers(len(indenters))]
    moved = list(Mode)[draw.integers(len(Mode))]
    reach = 6.0 * min(shape) / 480
    return Scene(
        markers=markers,
        shape=shape,
        indenter=chosen if indenter is None else indenter,
        mode=moved if mode is None else mode,
        severity=severity,
        contact=_uniform_pair(draw, 5.0),
        direction=float(draw.uniform(-math.pi, math.pi)),
        corrosion=corrosion,
        blur=float(draw.uniform(0.7, 1.1)),
        noise=float(draw.uniform(2.0, 4.5)),
        light=float(draw.uniform(0.2, 1.0)),
        vignetting=float(draw.uniform(1.0, 1.5)),
        surround=list(Surround)[draw.integers(len(Surround))],
        position=_uniform_pair(draw, reach),
        rotation=float(draw.uniform(-0.05, 0.05)),
        tilt=_uniform_pair(draw, 0.035),
        seed=seed,
    )


def _uniform_pair(draw: np.random.Generator, reach: float) -> tuple[float, float]:
    x, y = draw.uniform(-reach, reach, 2)
    return float(x), float(y)
