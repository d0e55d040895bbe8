"""From the nodes of two views to points in space, node by node, in float64, and of one view to a
plane.

1. A pixel becomes the point (x, y) of the plane at distance 1 that the lens maps to it. With
   r = x^2 + y^2 and g = (1 + k1 r + k2 r^2 + k3 r^3) / (1 + k4 r + k5 r^2 + k6 r^3), the lens maps
   (x, y) to u = f (x g + 2 p1 x y + p2 (r + 2 x^2) + s1 r + s2 r^2) + c, and to v alike with p1 and
   p2 exchanged and s3, s4.
2. Sampson's step moves the points p and q of both views onto each other's epipolar lines: with
   E = [t]x R, p -= e (q' E) / n and q -= e (E p) / n in x and y, e = q' E p, n the sum of the
   squares of the four components.
3. The point is the middle of the shortest segment between the rays.
4. Behind a window of flat layers the rays bend at each face, by Snell's law: with the normal w, a
   unit direction v, i = w . v and r the ratio of the indices before and after, v becomes
   r v + (sqrt(1 - r^2 (1 - i^2)) - r i) w. Then no Sampson's step is made, and the point is the
   middle between these rays. A pixel shows a point at the lateral distance L from the axis w of the
   camera where the sum of d_k s / sqrt(n_k^2 - s^2) is L, over the depths d_k and the indices n_k
   of all media; s is the sine of the ray in air: the renderer finds it, by bisection.
5. One Gauss-Newton step of the reprojection error, weighted by 1 / sigma^2. Its normal matrix is
   the inverse of the covariance. Shifts by bent edges move the point like errors of the pixels.
6. A node is PARALLEL if the rays in air enclose less than 1 px of the mean focal length, BEHIND if
   it is behind a camera or in front of the last face of the window, INCONSISTENT if the lens has no
   inverse there or the reprojection error is above 3 px.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from cmp_cl.reference.field.filter import bend_shift
from cmp_cl.space.window import Window
from cmp_cl.synthetic.camera import straightened

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]

MISSING, VALID, PARALLEL, BEHIND, INCONSISTENT = range(5)
LEAST_PARALLAX = 1.0  # px
LARGEST_ERROR = 3.0  # px


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Camera:
    """focal, centre: (2,), px. distortion: (12,): k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4. rotation,
    move: from the left camera."""

    focal: Floats
    centre: Floats
    distortion: Floats
    rotation: Floats
    move: Floats


def behind(window: Window, centre: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Return where a ray from a camera leaves the last face, and its direction there."""
    w = window.normal
    v = direction / np.linalg.norm(direction)
    if not w @ v > 0:
        return np.full(3, np.nan), np.full(3, np.nan)
    at = centre + v * (window.distance - w @ centre) / (w @ v)
    before = 1.0
    for thickness, after in [*window.layers, (0.0, window.index)]:
        i, r = w @ v, before / after
        v = r * v + (np.sqrt(1 - r**2 * (1 - i**2)) - r * i) * w
        at = at + v * thickness / (w @ v)
        before = after
    return at, v


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Points:
    """xyz, bent: (R, C, 3), the position and its shift by bent edges; covariance: (R, C, 3, 3), NaN
    without the sigma of both corners; status: (R, C)."""

    xyz: Floats
    bent: Floats
    covariance: Floats
    status: Bytes


def seen(camera: Camera, point: Floats) -> Floats:
    """Return the pixel of a point (x, y) of the plane at distance 1."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = camera.distortion
    x, y = point
    r = x * x + y * y
    g = (1 + k1 * r + k2 * r**2 + k3 * r**3) / (1 + k4 * r + k5 * r**2 + k6 * r**3)
    moved = np.array(
        [
            x * g + 2 * p1 * x * y + p2 * (r + 2 * x * x) + s1 * r + s2 * r**2,
            y * g + 2 * p2 * x * y + p1 * (r + 2 * y * y) + s3 * r + s4 * r**2,
        ]
    )
    pixel: Floats = camera.focal * moved + camera.centre
    return pixel


def unseen(camera: Camera, pixel: Floats) -> tuple[Floats, bool]:
    """Return the point of the plane at distance 1 that a pixel shows, and whether there is one."""
    point = start = (pixel - camera.centre) / camera.focal
    for _ in range(200):  # of a damped fixed point
        off = (pixel - seen(camera, point)) / camera.focal
        point = point + 0.9 * off
        if np.abs(off).max() < 1e-15:
            break
    found = bool(np.isfinite(point).all())
    near = found and float(np.abs(seen(camera, point) - pixel).max()) < 1e-2
    return (point, True) if near else (start, False)


def points(
    nodes: tuple[Floats, Floats],
    shown: tuple[Bools, Bools],
    sigma: tuple[Floats, Floats],
    cameras: tuple[Camera, Camera],
    radii: tuple[float, float],
    window: Window | None = None,
) -> Points:
    """Triangulate. nodes: of each view, (R, C, 2), complete. shown: (R, C), whether the view shows
    the node. sigma: (R, C), px, not positive if unknown. radii: of the corners' discs, px. window:
    None is air; the oracle takes its numbers alone."""
    there = shown[0] & shown[1]
    shape = there.shape
    left, right = cameras
    essential = np.cross(np.eye(3), right.move) @ right.rotation
    centre = -right.move @ right.rotation
    least_sine = LEAST_PARALLAX / np.mean([left.focal, right.focal])
    bends = [
        np.where(_supported(seen_nodes)[..., None], bend_shift(xy, radius), 0)
        for xy, seen_nodes, radius in zip(nodes, shown, radii, strict=True)
    ]
    xyz, bent = np.full((*shape, 3), np.nan), np.full((*shape, 3), np.nan)
    covariance = np.full((*shape, 3, 3), np.nan)
    status = np.full(shape, MISSING, np.uint8)
    for node in zip(*np.nonzero(there), strict=True):
        pixels = np.concatenate([nodes[0][node], nodes[1][node]])
        (one, sound_one), (two, sound_two) = unseen(left, pixels[:2]), unseen(right, pixels[2:])
        p, q = np.append(one, 1), np.append(two, 1)
        turned = q @ right.rotation
        sine = np.linalg.norm(np.cross(p, turned))
        sine /= np.linalg.norm(p) * np.linalg.norm(turned)
        if window is None:
            line_p, line_q = q @ essential, essential @ p
            size = np.square([*line_p[:2], *line_q[:2]]).sum()
            step = (line_p @ p) / max(size, 1e-300)
            p[:2], q[:2] = p[:2] - step * line_p[:2], q[:2] - step * line_q[:2]
            point = _meeting((np.zeros(3), p), (centre, q @ right.rotation))
            depth = min(point[2], (right.rotation @ point + right.move)[2])
        else:
            rays = behind(window, np.zeros(3), p), behind(window, centre, turned)
            point = _meeting(*rays) if np.isfinite(rays).all() else np.full(3, np.nan)
            last = window.distance + sum(thickness for thickness, _ in window.layers)
            depth = float(window.normal @ point) - last
        status[node] = VALID
        if not depth > 0:
            status[node] = BEHIND
        if not sine >= least_sine:
            status[node] = PARALLEL
        if not (sound_one and sound_two):
            status[node] = INCONSISTENT
        if status[node] != VALID:
            continue
        known = bool(sigma[0][node] > 0 and sigma[1][node] > 0)
        own = [sigma[0][node], sigma[1][node]] if known else [1.0, 1.0]
        weight = np.diag(np.repeat(1 / np.square(own), 2))
        jacobian = _slopes(cameras, window, point)
        inverse = np.linalg.inv(jacobian.T @ weight @ jacobian)
        residual = pixels - _both(cameras, window, point)
        better = inverse @ jacobian.T @ weight @ residual
        if not np.square(residual - jacobian @ better).sum() / 2 <= LARGEST_ERROR**2:
            status[node] = INCONSISTENT
            continue
        xyz[node] = point + better
        by_bends = np.concatenate([bends[0][node], bends[1][node]])
        bent[node] = inverse @ jacobian.T @ weight @ by_bends
        if known:
            covariance[node] = inverse
    return Points(xyz=xyz, bent=bent, covariance=covariance, status=status)


def in_plane(
    nodes: Floats, shown: Bools, sigma: Floats, homography: Floats, radius: float
) -> tuple[Floats, Floats, Floats]:
    """Map the nodes (R, C, 2) of one view to the plane. shown, sigma, radius: as in `points`.

    Returns the positions, (R, C, 2), their variance per axis, (R, C), NaN where unknown, and their
    shift by bent edges, (R, C, 2). The variance is the mean of those along both axes.
    """

    def mapped(xy: Floats) -> Floats:
        place = np.append(xy, 1.0) @ homography.T
        flat: Floats = place[:2] / place[2]
        return flat

    at, bent = np.full(nodes.shape, np.nan), np.full(nodes.shape, np.nan)
    variance = np.full(shown.shape, np.nan)
    bends = np.where(_supported(shown)[..., None], bend_shift(nodes, radius), 0)
    for node in zip(*np.nonzero(shown), strict=True):
        step = 1e-3 * np.eye(2)
        slope = np.stack(
            [(mapped(nodes[node] + d) - mapped(nodes[node] - d)) / 2e-3 for d in step], axis=1
        )
        at[node], bent[node] = mapped(nodes[node]), slope @ bends[node]
        if sigma[node] > 0:
            variance[node] = np.trace(slope @ slope.T) / 2 * sigma[node] ** 2
    return at, variance, bent


def _supported(shown: Bools) -> Bools:
    """Return the nodes around which three quarters of the nodes that show a bend are there."""
    sizes = [5 if n >= 5 else 3 for n in shown.shape]
    found = np.zeros_like(shown)
    for node in np.ndindex(*shown.shape):
        box = []
        for i, n, size in zip(node, shown.shape, sizes, strict=True):
            first = min(max(i - size // 2, 0), n - size)
            box.append(slice(first, first + size))
        found[node] = shown[tuple(box)].mean() >= 0.75
    return found


def _meeting(one: tuple[Floats, Floats], two: tuple[Floats, Floats]) -> Floats:
    """Return the middle of the shortest segment between two rays, each a point and a direction."""
    rays = np.column_stack([one[1], -two[1]])
    near, far = np.linalg.lstsq(rays, two[0] - one[0], rcond=None)[0]
    middle: Floats = (one[0] + near * one[1] + two[0] + far * two[1]) / 2
    return middle


def _both(cameras: tuple[Camera, Camera], window: Window | None, point: Floats) -> Floats:
    """Return the pixels of a point in both views, (4,)."""
    pixels = []
    for camera in cameras:
        at = point
        if window is not None:
            at = straightened(window, -camera.move @ camera.rotation, point)
        x, y, z = camera.rotation @ at + camera.move
        pixels.append(seen(camera, np.array([x / z, y / z])))
    return np.concatenate(pixels)


def _slopes(cameras: tuple[Camera, Camera], window: Window | None, point: Floats) -> Floats:
    """Return the derivatives of the pixels by the point, (4, 3), as differences."""
    step = 1e-5 * float(np.linalg.norm(point))
    columns = [
        (_both(cameras, window, point + step * axis) - _both(cameras, window, point - step * axis))
        / (2 * step)
        for axis in np.eye(3)
    ]
    return np.stack(columns, axis=1)
