"""The surface of the gel, X(u, v), mm, over its material points (u, v), mm.

The frame of the gel: origin at the centre of the pattern, x right and y down as the camera
sees it at rest, z away from the camera. An indenter behind the gel bulges it towards the camera.
"""

import math
from collections.abc import Callable

import numpy as np

from cmp_cl.synthetic.raster import Array
from cmp_cl.synthetic.scene import Indenter, Mode, Scene

Forward = Callable[[Array], Array]


def surface(scene: Scene, points: Array) -> Array:
    """Map material points (..., 2), mm, to the surface (..., 3) in the gel's frame, mm.

    Pressed gel also moves sideways, away from the contact, in proportion to the slope. Gel near
    the contact follows a shear or a twist of the indenter.
    """
    if scene.severity == 0 or scene.indenter is Indenter.NONE:
        return np.concatenate([points, np.zeros((*points.shape[:-1], 1))], axis=-1)
    cosine, sine = math.cos(scene.direction), math.sin(scene.direction)
    x = points[..., 0] - scene.contact[0]
    y = points[..., 1] - scene.contact[1]
    along, across = cosine * x + sine * y, cosine * y - sine * x

    depth = scene.severity * (2.0 if scene.mode is Mode.PRESS else 1.0)
    kind, step = scene.indenter, 0.8  # mm
    height = depth * _indentation(kind, along, across)
    slope_along, slope_across = (
        _indentation(kind, along + u, across + v) - _indentation(kind, along - u, across - v)
        for u, v in ((step, 0.0), (0.0, step))
    )
    sideways = 0.5 * depth / (2 * step)
    along, across = along - sideways * slope_along, across - sideways * slope_across

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


def _indentation(indenter: Indenter, x: Array, y: Array) -> Array:
    """Return the indentation by an indenter at unit depth; x, y along the contact's axes, mm.

    It is smooth, about 1 at the deepest point, and fades outside the contact.
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


def nodes_at_rest(scene: Scene) -> Array:
    """Return the inner corners at rest, (N, N, 2), mm: [row, column] = (x, y)."""
    inner = _cell_edges(scene)[1:-1]
    return np.stack(np.meshgrid(inner, inner), axis=-1)


def rim_at_rest(scene: Scene) -> Array:
    """Return the ends of all cell edges and the pattern's corners at rest, (4 (N+1), 2), mm."""
    lines = _cell_edges(scene)
    x, y = np.meshgrid(lines, lines)
    outer = np.ones(x.shape, dtype=bool)
    outer[1:-1, 1:-1] = False
    return np.stack([x[outer], y[outer]], axis=-1)


def _cell_edges(scene: Scene) -> Array:
    """Return the N + 2 positions of the cell edges along one axis, mm."""
    return np.linspace(-scene.side / 2, scene.side / 2, scene.markers + 2)


def derivatives(function: Forward, points: Array, step: float) -> tuple[Array, Array]:
    """Return the derivatives by u and v at material points, by central differences; step: mm."""
    by_u, by_v = (
        (function(points + move) - function(points - move)) / (2 * step)
        for move in (np.array([step, 0.0]), np.array([0.0, step]))
    )
    return by_u, by_v
