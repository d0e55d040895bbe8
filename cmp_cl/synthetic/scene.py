"""Rendered frames of a pressed gel that carries a dense checkerboard, with exact truth.

A scene is a surface X(u, v), mm, over the material points (u, v) of the gel at rest, seen by
a known camera. The truth goes through that forward map; the picture asks, for every sample
of every pixel, which material point it shows, so the two agree to a thousandth of a pixel.

The frame of the gel: origin at the centre of the pattern, x right and y down as the camera
sees it at rest, z away from the camera. An indenter behind the gel bulges it towards the camera.
"""

import dataclasses
import enum
import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError
from cmp_cl.image import GreyImage

Array = NDArray[np.float64]
Image = NDArray[Any]  # float32 unless said otherwise
Forward = Callable[[Array], Array]

_DISTANCE = 45.0  # mm from the camera to the gel of a single view
_FILL = 0.92  # share of the shorter image side that the pattern takes
_SAMPLES = 2  # samples a pixel, along each axis
_STEP = 4  # px between the points where the inverse map starts
_PAD = 8  # px by which the inverse map goes beyond the image
_RESIDUAL = 2e-3  # px, the largest error of the inverse map
_TEXTURE = 1024  # texels a side of the fields that live on the material
_BLACK, _WHITE = 0.17, 0.76  # grey levels of the print, of full scale


class Indenter(enum.Enum):
    """What presses on the gel; NONE leaves it flat."""

    NONE = "none"
    BALL = "ball"
    TORUS = "torus"
    CUBE = "cube"
    RIB = "rib"
    WEDGE = "wedge"


class Mode(enum.Enum):
    """How the indenter moves: severity 1 is 2 mm, 1.2 mm and 20 degrees.

    A shear and a twist go with a press of half the depth.
    """

    PRESS = "press"
    SHEAR = "shear"
    TWIST = "twist"


class Surround(enum.Enum):
    """What is seen beside the pattern."""

    WHITE = "white"
    BLACK = "black"
    GREY = "grey"


_SURROUND = {Surround.WHITE: 0.80, Surround.BLACK: 0.12, Surround.GREY: 0.45}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scene:
    """One frame to render; raises ConfigError for a field outside its range.

    markers: N inner corners a side, 3 to 100: N x N corners between (N+1) x (N+1) cells.
    shape: (rows, columns) of the image, or of each view of a stereo pair, px, 64 to 8192.
    side: side of the whole pattern, mm, 16 to 64; the indenters keep their size.
    indenter, mode: what touches the gel, and how it moves.
    severity: 0 to 2; 1 is a press of 2 mm, a shear of 1.2 mm or a twist of 20 degrees.
    contact: (x, y) of the indenter's centre from the pattern's, mm, -32 to 32.
    direction: turn of the indenter and direction of the shear, rad, -7 to 7.
    corrosion: 0 to 3; 0 is a perfect print, 1 a gel whose cell edges retract and overlap
        with the strain, by up to about 2 px.
    blur: standard deviation of the point spread function, px, 0 to 10.
    noise: standard deviation of the noise, 1/255 of full scale, 0 to 100.
    light: strength of uneven light and of the shading by slope, 0 to 1; 1 is a ratio of
        about 2 across the image.
    vignetting: brightness at the centre over that in the image's corners, 1 to 10.
    exposure: factor on all grey levels, 0.05 to 10; above about 1.3 white saturates.
    surround: what is beside the pattern.
    bits: 8 for uint8, 12 for 0 to 4095 in uint16.
    position: (x, y) of the pattern's centre from the image's, px, within +-8192.
    rotation: turn of the pattern in the image, rad, -7 to 7.
    tilt: turns of the gel about the image's x and y axes, rad, -0.5 to 0.5.
    seed: of the tears, the light's direction and the noise, from 0.
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
        _check("markers", self.markers, 3, 100, kind=int)
        _check_pair("shape", self.shape, 64, 8192, kind=int)
        _check("side", self.side, 16, 64)
        _check_member("indenter", self.indenter, Indenter)
        _check_member("mode", self.mode, Mode)
        _check("severity", self.severity, 0, 2)
        _check_pair("contact", self.contact, -32, 32)
        _check("direction", self.direction, -7, 7)
        _check("corrosion", self.corrosion, 0, 3)
        _check("blur", self.blur, 0, 10)
        _check("noise", self.noise, 0, 100)
        _check("light", self.light, 0, 1)
        _check("vignetting", self.vignetting, 1, 10)
        _check("exposure", self.exposure, 0.05, 10)
        _check_member("surround", self.surround, Surround)
        if isinstance(self.bits, bool) or self.bits not in (8, 12):
            raise ConfigError(f"Scene.bits must be 8 or 12, not {self.bits!r}")
        _check_pair("position", self.position, -8192, 8192)
        _check("rotation", self.rotation, -7, 7)
        _check_pair("tilt", self.tilt, -0.5, 0.5)
        _check("seed", self.seed, 0, 2**63 - 1, kind=int)

    def at_rest(self) -> "Scene":
        """The same gel, camera and light with nothing pressing on it."""
        return dataclasses.replace(self, severity=0.0)


def _check(field: str, value: object, low: float, high: float, *, kind: type = float) -> None:
    noun = "an integer" if kind is int else "a number"
    numeric = int if kind is int else (int, float)
    if isinstance(value, bool) or not isinstance(value, numeric) or not low <= value <= high:
        raise ConfigError(f"Scene.{field} must be {noun} in [{low:g}, {high:g}], not {value!r}")


def _check_pair(field: str, value: object, low: float, high: float, *, kind: type = float) -> None:
    if not isinstance(value, tuple) or len(value) != 2:
        raise ConfigError(
            f"Scene.{field} must be a tuple of two numbers in [{low:g}, {high:g}], not {value!r}"
        )
    for entry in value:
        _check(field, entry, low, high, kind=kind)


def _check_member(field: str, value: object, kind: type[enum.Enum]) -> None:
    if not isinstance(value, kind):
        names = ", ".join(f"{kind.__name__}.{member.name}" for member in kind)
        raise ConfigError(f"Scene.{field} must be one of {names}, not {value!r}")


@dataclasses.dataclass(frozen=True)
class Rendered:
    """A rendered view and its truth.

    image: (H, W) uint8, or uint16 with 12 bits.
    truth: (N, N, 2) float64, px: where each inner corner is, [row, column] = (x, y).
    cell: median side of a cell in the image, px.
    junctions: (4 (N+1), 2) float64, px: where cell edges and the pattern's corners meet the
        surroundings. A detection there is neither true nor false.
    """

    image: GreyImage
    truth: Array
    cell: float
    junctions: Array


class Rig(Protocol):
    """Two cameras in OpenCV's convention: X_right = R X_left + T, lengths in mm."""

    @property
    def K1(self) -> Array: ...
    @property
    def D1(self) -> Array: ...
    @property
    def K2(self) -> Array: ...
    @property
    def D2(self) -> Array: ...
    @property
    def R(self) -> Array: ...
    @property
    def T(self) -> Array: ...


class Cameras(NamedTuple):
    """A rig in plain arrays: K (3, 3) px, D (5,) as k1 k2 p1 p2 k3, R (3, 3), T (3,) mm."""

    K1: Array
    D1: Array
    K2: Array
    D2: Array
    R: Array
    T: Array


def default_rig(shape: tuple[int, int] = (1200, 800)) -> Cameras:
    """Two cameras 16 mm apart whose axes meet 45 mm away, for views of shape (rows, columns).

    The pattern of a default scene fills 92 % of the shorter side of each view.
    """
    rows, columns = shape
    focal = _FILL * min(shape) / 32.0 * _DISTANCE
    half = math.atan2(8.0, _DISTANCE)
    matrix = np.array([[focal, 0, (columns - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1.0]])
    turn = _turn(0.0, 2 * half, 0.0)
    centre = np.array([0.0, 0.0, math.hypot(8.0, _DISTANCE)])
    return Cameras(
        K1=matrix,
        D1=np.array([-0.06, 0.02, 0.0004, -0.0003, 0.0]),
        K2=matrix + np.array([[3.0, 0, 2.0], [0, 3.0, -1.5], [0, 0, 0]]),
        D2=np.array([-0.05, 0.015, -0.0003, 0.0005, 0.0]),
        R=turn,
        T=centre - turn @ centre,
    )


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
    """A scene with everything that is not given drawn from the seed.

    Contact within 5 mm of the centre, any direction, blur 0.7 to 1.1 px, noise 2 to 4.5,
    light 0.2 to 1, vignetting 1 to 1.5, any surroundings, position within 6 px (at VGA),
    rotation within 3 degrees, tilt within 2.
    """
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


def render(scene: Scene) -> Rendered:
    """The scene through a distortion-free camera 45 mm in front of the gel.

    Raises ConfigError where the surface would fold over in the image.
    """
    rows, columns = scene.shape
    focal = _FILL * min(scene.shape) / scene.side * _DISTANCE
    matrix = np.array([[focal, 0, (columns - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1.0]])
    centre = np.array([0.0, 0.0, _DISTANCE])
    camera = _Camera(matrix, np.zeros(5), np.eye(3), np.zeros(3))
    pose = _Pose.of(scene, np.eye(3), centre, focal)
    return _render_view(scene, pose, camera, view=0)


def render_stereo(scene: Scene, rig: Rig) -> tuple[Rendered, Rendered, Array]:
    """Both views of the scene, and the nodes in the left camera's frame.

    The gel stands where the optical axes meet (or, for others, 45 mm in front of
    the middle between the cameras), facing both cameras alike.

    Returns (left, right, xyz) with xyz (N, N, 3) float64, mm, in the left camera's frame:
    projecting it through the rig gives both truths. Raises ConfigError where the surface
    would fold over in one of the images.
    """
    turn, shift = np.asarray(rig.R, float), np.asarray(rig.T, float).reshape(3)
    left = _Camera(rig.K1, rig.D1, np.eye(3), np.zeros(3))
    right = _Camera(rig.K2, rig.D2, turn, shift)
    axes, centre = _between(turn, shift)
    pose = _Pose.of(scene, axes, centre, float(left.matrix[0, 0]))
    xyz = pose.place(_surface(scene, _nodes(scene)))
    return (
        _render_view(scene, pose, left, view=0),
        _render_view(scene, pose, right, view=1),
        xyz,
    )


def binocular_frame(left: Rendered, right: Rendered) -> GreyImage:
    """Both views beside each other, (H, 2 W): what a camera behind the mirrors delivers."""
    frame: Image = np.concatenate([left.image, right.image], axis=1)
    return frame


def _turn(x: float, y: float, z: float) -> Array:
    """The rotation matrix of a rotation vector, rad."""
    return np.asarray(cv2.Rodrigues(np.array([x, y, z]))[0], dtype=np.float64)


def _between(turn: Array, shift: Array) -> tuple[Array, Array]:
    """Axes (columns) and origin, in the left frame, of a gel that faces both cameras."""
    eye = -turn.T @ shift
    ahead, other = np.array([0.0, 0.0, 1.0]), turn[2]
    normal = ahead + other
    normal /= np.linalg.norm(normal)
    cosine = float(ahead @ other)
    spread = 1 - cosine**2
    first = float((eye @ ahead) - cosine * (eye @ other)) / max(spread, 1e-9)
    second = float(cosine * (eye @ ahead) - (eye @ other)) / max(spread, 1e-9)
    centre = (first * ahead + eye + second * other) / 2
    if spread < 1e-6 or min(first, second) <= 0:
        centre = eye / 2 + _DISTANCE * normal
    across = np.array([1.0, 0.0, 0.0])
    across -= (across @ normal) * normal
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(normal, across), normal], axis=1), centre


class _Pose(NamedTuple):
    """From the frame of the gel to that of the left camera."""

    axes: Array
    origin: Array

    @classmethod
    def of(cls, scene: Scene, axes: Array, centre: Array, focal: float) -> "_Pose":
        """The scene's own turn and shift within a frame that faces the camera."""
        tilt = _turn(scene.tilt[0], scene.tilt[1], 0.0)
        turn = _turn(0.0, 0.0, scene.rotation)
        shift = np.array([scene.position[0], scene.position[1], 0.0]) * centre[2] / focal
        return cls(axes @ tilt @ turn, centre + axes @ shift)

    def place(self, points: Array) -> Array:
        """Points (..., 3) of the gel's frame in the left camera's, mm."""
        return points @ self.axes.T + self.origin


class _Camera:
    """A pinhole camera with OpenCV's distortion k1 k2 p1 p2 k3."""

    def __init__(self, matrix: Array, distortion: Array, turn: Array, shift: Array) -> None:
        self.matrix = np.asarray(matrix, dtype=np.float64)
        coefficients = np.asarray(distortion, dtype=np.float64).ravel()
        if coefficients.size > 5 and np.any(coefficients[5:]):
            raise ConfigError(
                f"a rig to render has the distortion k1 k2 p1 p2 k3, not {coefficients.tolist()}"
            )
        self.distortion = np.concatenate([coefficients, np.zeros(5)])[:5]
        self.turn = np.asarray(turn, dtype=np.float64)
        self.shift = np.asarray(shift, dtype=np.float64)

    def project(self, points: Array) -> Array:
        """Points (..., 3), mm, to pixels (..., 2)."""
        seen = points @ self.turn.T + self.shift
        x, y = seen[..., 0] / seen[..., 2], seen[..., 1] / seen[..., 2]
        if np.any(self.distortion):
            k1, k2, p1, p2, k3 = self.distortion
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            x, y = (
                x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
            )
        matrix = self.matrix
        return np.stack(
            [
                matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2],
                matrix[1, 1] * y + matrix[1, 2],
            ],
            axis=-1,
        )


def _lines(scene: Scene) -> Array:
    """The N + 2 positions of cell edges along one axis, mm."""
    return np.linspace(-scene.side / 2, scene.side / 2, scene.markers + 2)


def _nodes(scene: Scene) -> Array:
    """The inner corners at rest, (N, N, 2) mm, [row, column] = (x, y)."""
    inner = _lines(scene)[1:-1]
    return np.stack(np.meshgrid(inner, inner), axis=-1)


def _rim(scene: Scene) -> Array:
    """The ends of all cell edges and the pattern's corners at rest, (4 (N+1), 2) mm."""
    lines = _lines(scene)
    x, y = np.meshgrid(lines, lines)
    outer = np.ones(x.shape, dtype=bool)
    outer[1:-1, 1:-1] = False
    return np.stack([x[outer], y[outer]], axis=-1)


def _height(indenter: Indenter, x: Array, y: Array) -> Array:
    """The surface under an indenter of unit depth, over the contact's own axes, mm.

    About 1 at the deepest, smooth, and fading outside the contact.
    """
    x2, y2 = x * x, y * y
    if indenter is Indenter.BALL:
        return (1 + (x2 + y2) / 3.6**2) ** -1.5
    if indenter is Indenter.TORUS:
        ring = (x2 + y2 - 6.0**2) / (2 * 6.0)
        return (1 + (ring / 2.6) ** 2) ** -1.5
    if indenter is Indenter.CUBE:
        return (1 + (x2**3 + y2**3) / 4.5**6) ** -0.5
    along = (1 + x2**3 / 9.0**6) ** -0.5
    if indenter is Indenter.RIB:
        return along * (1 + y2 * y2 / 2.2**4) ** -0.75
    if indenter is Indenter.WEDGE:
        ramp = 0.8 + 0.2 * np.tanh(x / 5.0)
        return along * ramp * np.exp((0.7 - np.sqrt(y2 + 0.7**2)) / 2.6)
    return np.zeros_like(x)


def _surface(scene: Scene, points: Array) -> Array:
    """X(u, v): material points (..., 2), mm, to the surface (..., 3) in the gel's frame, mm.

    Pressed gel gives way sideways, away from the contact, in proportion to the slope; the
    contact region follows a shear or a twist of the indenter, the more the nearer it is.
    """
    if scene.severity == 0 or scene.indenter is Indenter.NONE:
        return np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)
    cosine, sine = math.cos(scene.direction), math.sin(scene.direction)
    x = points[..., 0] - scene.contact[0]
    y = points[..., 1] - scene.contact[1]
    along, across = cosine * x + sine * y, cosine * y - sine * x

    depth = scene.severity * (2.0 if scene.mode is Mode.PRESS else 1.0)
    kind, reach = scene.indenter, 0.8
    height = depth * _height(kind, along, across)
    slope_along = _height(kind, along + reach, across) - _height(kind, along - reach, across)
    slope_across = _height(kind, along, across + reach) - _height(kind, along, across - reach)
    yielding = 0.5 * depth / (2 * reach)
    along, across = along - yielding * slope_along, across - yielding * slope_across

    if scene.mode is not Mode.PRESS:
        grip = (1 + (x * x + y * y) ** 2 / 6.0**4) ** -0.75
        if scene.mode is Mode.SHEAR:
            along = along + 1.2 * scene.severity * grip
        else:
            angle = math.radians(20) * scene.severity * grip
            c, s = np.cos(angle), np.sin(angle)
            along, across = c * along - s * across, s * along + c * across
    x, y = cosine * along - sine * across, sine * along + cosine * across
    return np.stack([x + scene.contact[0], y + scene.contact[1], -height], axis=-1)


def _render_view(scene: Scene, pose: _Pose, camera: _Camera, *, view: int) -> Rendered:
    def forward(points: Array) -> Array:
        return camera.project(pose.place(_surface(scene, points)))

    truth = forward(_nodes(scene))
    sides = [np.linalg.norm(np.diff(truth, axis=axis), axis=-1).ravel() for axis in (0, 1)]
    cell = float(np.median(np.concatenate(sides)))
    return Rendered(
        image=_picture(scene, _inverse(scene, forward), cell, view),
        truth=truth,
        cell=cell,
        junctions=forward(_rim(scene)),
    )


def _inverse(scene: Scene, forward: Forward) -> Array:
    """The material point at each pixel, (H + 2 PAD, W + 2 PAD, 2) mm, PAD beyond the image.

    Newton's method on every fourth pixel from the flat gel on; between them two or three
    steps more with the inverse map's own slope as the inverse Jacobian.
    """
    rows, columns = (-(-size // _STEP) * _STEP + 2 * _PAD for size in scene.shape)
    coarse = _pixels(rows // _STEP, columns // _STEP) * _STEP + (_STEP - 1) / 2 - _PAD
    points = _newton(forward, coarse, _flat_start(scene, forward, coarse))
    points = _resized(points, rows, columns)
    pixels = _pixels(rows, columns) - _PAD
    for _ in range(6):
        residual = forward(points) - pixels
        inside = residual[_STEP:-_STEP, _STEP:-_STEP]
        if np.abs(inside).max() < _RESIDUAL:
            return points
        by_y, by_x = np.gradient(points, axis=(0, 1))
        points = points - by_x * residual[..., :1] - by_y * residual[..., 1:]
    raise ConfigError(
        f"Scene.severity {scene.severity!r} folds the surface over in the image; "
        "lower it, the tilt or the markers' distance from the camera's axis"
    )


def _resized(image: Image, rows: int, columns: int) -> Image:
    resized: Image = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_LINEAR)
    return resized


def _pixels(rows: int, columns: int) -> Array:
    x, y = np.meshgrid(np.arange(columns, dtype=np.float64), np.arange(rows, dtype=np.float64))
    return np.stack([x, y], axis=-1)


def _flat_start(scene: Scene, forward: Forward, pixels: Array) -> Array:
    """Material points near those of the pixels: the plane through the pattern's corners."""
    half = scene.side / 2
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    plane = cv2.getPerspectiveTransform(
        forward(corners).astype(np.float32), corners.astype(np.float32)
    )
    start: Image = cv2.perspectiveTransform(pixels.reshape(-1, 1, 2), plane)
    return start.reshape(pixels.shape)


def _newton(forward: Forward, pixels: Array, points: Array) -> Array:
    """Material points that are seen at the pixels, from near ones, by steps up to 1 mm."""
    for _ in range(20):
        residual = forward(points) - pixels
        if np.abs(residual).max() < 1e-6:
            break
        by_u, by_v = _slopes(forward, points, 1e-5)
        det = by_u[..., 0] * by_v[..., 1] - by_u[..., 1] * by_v[..., 0]
        move_u = residual[..., 0] * by_v[..., 1] - residual[..., 1] * by_v[..., 0]
        move_v = residual[..., 1] * by_u[..., 0] - residual[..., 0] * by_u[..., 1]
        move = np.stack([move_u, move_v], axis=-1) / det[..., None]
        points = points - move.clip(-1, 1)
    return points


def _slopes(map_: Forward, points: Array, step: float) -> tuple[Array, Array]:
    """The derivatives of a map by u and by v at material points, over that step, mm."""
    by_u, by_v = (
        (map_(points + move) - map_(points - move)) / (2 * step)
        for move in (np.array([step, 0.0]), np.array([0.0, step]))
    )
    return by_u, by_v


def _picture(scene: Scene, points: Array, cell: float, view: int) -> GreyImage:
    """The grey image of a view from the material point at each (padded) pixel."""
    rows, columns = scene.shape
    pixel = scene.side / (scene.markers + 1) / cell  # mm
    reflectance = _reflectance(scene, _supersample(points, scene.shape), pixel)
    grey: Image = cv2.resize(reflectance, (columns, rows), interpolation=cv2.INTER_AREA)
    grey *= _light(scene, points[_PAD : _PAD + rows, _PAD : _PAD + columns], pixel)
    if scene.blur > 0:
        grey = cv2.GaussianBlur(grey, (0, 0), scene.blur, borderType=cv2.BORDER_REPLICATE)
    draw = np.random.default_rng([scene.seed, 2, view, round(scene.severity * 1e6)])
    grey += np.float32(scene.noise / 255) * draw.standard_normal(grey.shape, dtype=np.float32)
    full = 2**scene.bits - 1
    levels: Image = np.rint(grey * full).clip(0, full)
    return levels.astype(np.uint8) if scene.bits == 8 else levels.astype(np.uint16)


def _supersample(points: Array, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Material points of all samples of all pixels, (H S, W S, 2), by cubic convolution."""
    rows, columns = shape
    fine = np.empty((rows * _SAMPLES, columns * _SAMPLES, 2), dtype=np.float32)
    kernels = [_cubic((k + 0.5) / _SAMPLES - 0.5) for k in range(_SAMPLES)]
    for j, down in enumerate(kernels):
        for i, across in enumerate(kernels):
            moved = cv2.sepFilter2D(points, cv2.CV_64F, across, down)
            fine[j::_SAMPLES, i::_SAMPLES] = moved[_PAD : _PAD + rows, _PAD : _PAD + columns]
    return fine


def _cubic(shift: float) -> Array:
    """Five weights that move a signal by |shift| <= 1/2 sample, exact for quadratics."""
    t = np.abs(np.arange(-2.0, 3.0) - shift)
    near = 1.5 * t**3 - 2.5 * t**2 + 1
    far = -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2
    weights: Array = np.select([t <= 1, t < 2], [near, far])
    return weights


def _reflectance(scene: Scene, points: Image, pixel: float) -> Image:
    """What the material at points (H, W, 2) reflects, 0 to 1; points and pixel in mm."""
    warp, growth, smear = _wear(scene, points)
    x, y = (points[..., k] + warp[..., k] * np.float32(pixel) for k in (0, 1))
    inside = np.float32(scene.side / 2) - np.maximum(np.abs(x), np.abs(y))
    x, y = _to_edge(scene, x), _to_edge(scene, y)
    edge = x * y / np.sqrt(x * x + y * y + np.float32(1e-12))  # mm, > 0 in a white cell
    white = _covered((edge / np.float32(pixel) + growth) / smear)
    pattern = _BLACK + (_WHITE - _BLACK) * white
    surround = np.float32(_SURROUND[scene.surround])
    return surround + (pattern - surround) * _covered(inside / np.float32(pixel))


def _to_edge(scene: Scene, x: Image) -> Image:
    """The signed distance to the nearest cell edge along one axis, mm."""
    side = scene.side / (scene.markers + 1)
    turns = x / np.float32(side) + np.float32((scene.markers + 1) / 2 + 0.5)
    turns -= 2 * np.floor(turns / 2)
    return np.float32(side) * (np.float32(0.5) - np.abs(turns - 1))


def _covered(distance: Image) -> Image:
    """The share of a sample inside an edge at that signed distance, px."""
    covered: Image = distance * _SAMPLES + np.float32(0.5)
    return covered.clip(0, 1)


def _wear(scene: Scene, points: Image) -> tuple[Image, Image, Image]:
    """How worn the print is at points: (warp (H, W, 2), growth, smear), px.

    warp moves the edges, growth is by how much white has eaten into black (black into white
    where negative), smear is the width of an edge. All grow with the local strain.
    """
    if scene.corrosion == 0:
        none = np.zeros((1, 1, 2), dtype=np.float32)
        return none, none[..., 0], none[..., 0] + 1
    draw = np.random.default_rng([scene.seed, 3])
    cell = _TEXTURE / (scene.markers + 1)
    texel = scene.side / _TEXTURE
    strain, area = _strain(scene)
    # Set so that the plain detector finds every corner of nearly all frames at severity 0.5,
    # of half of them at 1 and of hardly any at 1.5.
    worn = scene.corrosion * (0.1 + 2.5 * strain**2 / ((0.15 + strain) * (1 + strain)))
    ragged = np.stack([_grain(draw, 3.0) for _ in range(2)], axis=-1)
    torn = np.stack([_grain(draw, 0.5 * cell) for _ in range(2)], axis=-1)
    warp = worn[..., None] * 0.5 * ragged + (0.2 * scene.corrosion + 0.4 * worn)[..., None] * torn
    growth = scene.corrosion * area + worn * (
        1.0 * _grain(draw, 0.45 * cell) + 0.5 * _grain(draw, 3.0)
    )
    growth = 2.2 * np.tanh(growth / 2.2)
    smear = 1 + worn * np.abs(_grain(draw, 0.5 * cell))
    place = points / np.float32(texel) + np.float32(_TEXTURE / 2 - 0.5)
    fields = np.dstack([warp, growth, smear]).astype(np.float32)
    x, y = cv2.split(place)
    seen = cv2.remap(fields, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return seen[..., :2], seen[..., 2], seen[..., 3]


def _grain(draw: np.random.Generator, size: float) -> Image:
    """Smooth noise over the material, of unit deviation and that correlation, texels."""
    noise: Image = draw.standard_normal((_TEXTURE, _TEXTURE), dtype=np.float32)
    smooth: Image = cv2.GaussianBlur(noise, (0, 0), size / 2, borderType=cv2.BORDER_REFLECT_101)
    unit: Image = smooth / smooth.std()
    return unit


def _strain(scene: Scene) -> tuple[Image, Image]:
    """The size of the strain and the change of area, over the texels of the material."""
    coarse = _TEXTURE // 8
    texel = 8 * scene.side / _TEXTURE
    points = (_pixels(coarse, coarse) - (coarse - 1) / 2) * texel
    by_u, by_v = _slopes(lambda at: _surface(scene, at), points, 1e-4 * scene.side)
    stretches = np.linalg.svd(np.stack([by_u, by_v], axis=-1), compute_uv=False)
    size = np.hypot(stretches[..., 0] - 1, stretches[..., 1] - 1)
    area = stretches[..., 0] * stretches[..., 1] - 1
    fields = np.stack([size, area], axis=-1).astype(np.float32)
    fields = _resized(fields, _TEXTURE, _TEXTURE)
    return fields[..., 0], fields[..., 1]


def _light(scene: Scene, points: Array, pixel: float) -> Image:
    """The factor of the light at material points (H, W, 2); points and pixel in mm."""
    rows, columns = scene.shape
    draw = np.random.default_rng([scene.seed, 4])
    angle = draw.uniform(-math.pi, math.pi)
    x, y = math.cos(angle), math.sin(angle)
    few = points[::4, ::4]
    height: Image = -_surface(scene, few)[..., 2]
    by_y, by_x = np.gradient(height, 4 * pixel)
    across, down = (
        np.linspace(-1, 1, few.shape[1])[None, :] * columns / max(rows, columns),
        np.linspace(-1, 1, few.shape[0])[:, None] * rows / max(rows, columns),
    )
    uneven = 1 + scene.light * 0.3 * (x * across + y * down)
    shading = 1 - scene.light * 0.45 * np.tanh(x * by_x + y * by_y)
    reach = (across**2 + down**2) / (rows**2 + columns**2) * max(rows, columns) ** 2
    fall = 1 / (1 + (scene.vignetting - 1) * reach)
    light = (scene.exposure * uneven * shading * fall).astype(np.float32)
    return _resized(light, rows, columns)
