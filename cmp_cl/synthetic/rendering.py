"""Rendered views of a scene, with exact truth.

The truth goes through the forward map, from material point to pixel. The image needs the inverse
map: which material point each sample of each pixel shows. Both agree to a thousandth of a pixel.
"""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import ConfigError
from cmp_cl.image import GreyImage
from cmp_cl.points import sides
from cmp_cl.space import StereoRig
from cmp_cl.synthetic.camera import (
    DISTANCE,
    FILL,
    PinholeCamera,
    Pose,
    facing_both,
)
from cmp_cl.synthetic.material import SAMPLES, illumination, reflectance
from cmp_cl.synthetic.raster import Array, Image, samples
from cmp_cl.synthetic.scene import Scene
from cmp_cl.synthetic.surface import (
    Forward,
    derivatives,
    nodes_at_rest,
    rim_at_rest,
    surface,
)

_STEP = 4  # px between the points where the inverse map starts
_PAD = 8  # px by which the inverse map extends past the image
_RESIDUAL = 2e-3  # px, the largest error of the inverse map


@dataclasses.dataclass(frozen=True)
class Rendered:
    """A rendered view and its truth.

    image: (H, W) uint8, or uint16 with more than 8 bits.
    truth: (N, N, 2) float64, px: the true position of each inner corner, [row, column] = (x, y).
    cell: median side of a cell in the image, px.
    junctions: (4 (N+1), 2) float64, px: the points at which cell edges and the pattern's corners
        meet the surround. A detection there is neither true nor false.
    """

    image: GreyImage
    truth: Array
    cell: float
    junctions: Array


def render(scene: Scene) -> Rendered:
    """Render the scene with a camera without distortion, 45 mm in front of the gel.

    Raises ConfigError if the surface would fold over in the image.
    """
    rows, columns = scene.shape
    focal = FILL * min(scene.shape) / scene.side * DISTANCE
    matrix = np.array([[focal, 0, (columns - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1.0]])
    centre = np.array([0.0, 0.0, DISTANCE])
    camera = PinholeCamera(matrix, np.zeros(5), np.eye(3), np.zeros(3))
    pose = Pose.of(scene, np.eye(3), centre, focal)
    return _render_view(scene, pose, camera, view=0)


def render_stereo(scene: Scene, rig: StereoRig) -> tuple[Rendered, Rendered, Array]:
    """Render both views of the scene.

    rig: the two cameras, mm.

    The gel faces both cameras alike, where their optical axes meet. If the axes do not meet, it
    stands 45 mm in front of the midpoint between the cameras. If the rig has a window, the light
    bends in its layers.

    Returns the left view, the right view and the nodes (N, N, 3) float64, mm, in the left camera's
    frame. The rig projects these nodes to both truths.

    Raises ConfigError if the lenses have more coefficients than k1 k2 p1 p2 k3, or if the surface
    would fold over in one of the images.
    """
    left = PinholeCamera(rig.K1, rig.D1, np.eye(3), np.zeros(3), rig.window)
    right = PinholeCamera(rig.K2, rig.D2, rig.R, rig.T, rig.window)
    axes, centre = facing_both(rig.R, rig.T)
    pose = Pose.of(scene, axes, centre, float(left.matrix[0, 0]))
    xyz = pose.place(surface(scene, nodes_at_rest(scene)))
    return (
        _render_view(scene, pose, left, view=0),
        _render_view(scene, pose, right, view=1),
        xyz,
    )


def binocular_frame(left: Rendered, right: Rendered) -> GreyImage:
    """Put the left and the right view side by side, (H, 2 W), as one camera sees them through
    mirrors."""
    return np.concatenate([left.image, right.image], axis=1)


def _render_view(scene: Scene, pose: Pose, camera: PinholeCamera, *, view: int) -> Rendered:
    def forward(points: Array) -> Array:
        return camera.project(pose.place(surface(scene, points)))

    truth = forward(nodes_at_rest(scene))
    cell = float(np.median(sides(truth)))
    return Rendered(
        image=_image(scene, _inverse(scene, forward), cell, view),
        truth=truth,
        cell=cell,
        junctions=forward(rim_at_rest(scene)),
    )


def _inverse(scene: Scene, forward: Forward) -> Array:
    """Return the material point at each pixel, (H + 2 _PAD, W + 2 _PAD, 2), mm.

    Newton's method starts from the flat gel, at every fourth pixel. Two or three more steps follow
    at all pixels, with the gradient of the inverse map as the inverse Jacobian.
    """
    rows, columns = (-(-size // _STEP) * _STEP + 2 * _PAD for size in scene.shape)
    pixels = np.dstack(samples((rows, columns))) - _PAD
    coarse = np.dstack(samples((rows // _STEP, columns // _STEP))) * _STEP + (_STEP - 1) / 2 - _PAD
    points = newton(forward, coarse, _flat_start(scene, forward, coarse))
    points = np.asarray(cv2.resize(points, (columns, rows)), np.float64)
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


def _flat_start(scene: Scene, forward: Forward, pixels: Array) -> Array:
    """Return approximate material points: those of the plane through the pattern's corners."""
    half = scene.side / 2
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    plane = cv2.getPerspectiveTransform(
        forward(corners).astype(np.float32), corners.astype(np.float32)
    )
    start: Image = cv2.perspectiveTransform(pixels.reshape(-1, 1, 2), plane)
    return start.reshape(pixels.shape)


def newton(forward: Forward, pixels: Array, points: Array) -> Array:
    """Solve forward(points) = pixels by Newton's method, in steps of at most 1."""
    for _ in range(20):
        residual = forward(points) - pixels
        if np.abs(residual).max() < 1e-6:
            break
        by_u, by_v = derivatives(forward, points, 1e-5)
        det = by_u[..., 0] * by_v[..., 1] - by_u[..., 1] * by_v[..., 0]
        move_u = residual[..., 0] * by_v[..., 1] - residual[..., 1] * by_v[..., 0]
        move_v = residual[..., 1] * by_u[..., 0] - residual[..., 0] * by_u[..., 1]
        move = np.stack([move_u, move_v], axis=-1) / det[..., None]
        points = points - move.clip(-1, 1)
    return points


def _image(scene: Scene, points: Array, cell: float, view: int) -> GreyImage:
    """Return the grey image of a view from the material point at each (padded) pixel."""
    rows, columns = scene.shape
    pixel = scene.side / (scene.markers + 1) / cell  # mm
    fine = reflectance(scene, _supersample(points, scene.shape), pixel)
    grey: Image = cv2.resize(fine, (columns, rows), interpolation=cv2.INTER_AREA)
    grey *= illumination(scene, points[_PAD : _PAD + rows, _PAD : _PAD + columns], pixel)
    if scene.blur > 0:
        grey = cv2.GaussianBlur(grey, (0, 0), scene.blur, borderType=cv2.BORDER_REPLICATE)
    draw = np.random.default_rng([scene.seed, 2, view, round(scene.severity * 1e6)])
    grey += np.float32(scene.noise / 255) * draw.standard_normal(grey.shape, dtype=np.float32)
    full = 2**scene.bits - 1
    levels: Image = np.rint(grey * full).clip(0, full)
    return levels.astype(np.uint8) if scene.bits == 8 else levels.astype(np.uint16)


def _supersample(points: Array, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Interpolate the material points of all samples, (H S, W S, 2), by cubic convolution."""
    rows, columns = shape
    fine = np.empty((rows * SAMPLES, columns * SAMPLES, 2), dtype=np.float32)
    kernels = [_cubic((k + 0.5) / SAMPLES - 0.5) for k in range(SAMPLES)]
    for j, down in enumerate(kernels):
        for i, across in enumerate(kernels):
            shifted = cv2.sepFilter2D(points, cv2.CV_64F, across, down)
            fine[j::SAMPLES, i::SAMPLES] = shifted[_PAD : _PAD + rows, _PAD : _PAD + columns]
    return fine


def _cubic(shift: float) -> Array:
    """Return five weights that shift a signal by |shift| <= 1/2 sample; exact for quadratics."""
    t = np.abs(np.arange(-2.0, 3.0) - shift)
    near = 1.5 * t**3 - 2.5 * t**2 + 1
    far = -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2
    return np.select([t <= 1, t < 2], [near, far])
