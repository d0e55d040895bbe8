"""The reflectance of the gel: its print, the wear, and the light on it."""

import functools
import math

import cv2
import numpy as np

from cmp_cl.synthetic.raster import Array, Image, samples
from cmp_cl.synthetic.scene import Scene, Surround
from cmp_cl.synthetic.surface import derivatives, surface

SAMPLES = 2  # samples a pixel, along each axis

_TEXTURE = 1024  # texels a side of the fields over the material
_BLACK, _WHITE = 0.17, 0.76  # grey levels of the print, of full scale
_SURROUND = {Surround.WHITE: 0.80, Surround.BLACK: 0.12, Surround.GREY: 0.45}


def reflectance(scene: Scene, points: Image, pixel: float) -> Image:
    """Return the reflectance of the material at points (H, W, 2), 0 to 1; points, pixel in mm."""
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
    """Return the signed distance to the nearest cell edge along one axis, mm."""
    side = scene.side / (scene.markers + 1)
    turns = x / np.float32(side) + np.float32((scene.markers + 1) / 2 + 0.5)
    turns -= 2 * np.floor(turns / 2)
    return np.float32(side) * (np.float32(0.5) - np.abs(turns - 1))


def _covered(distance: Image) -> Image:
    """Return the share of a sample that lies inside an edge at that signed distance, px."""
    covered: Image = distance * SAMPLES + np.float32(0.5)
    return covered.clip(0, 1)


def _wear(scene: Scene, points: Image) -> tuple[Image, Image, Image]:
    """Return the wear of the print at points: warp (H, W, 2), growth (H, W), smear (H, W), px.

    warp displaces the edges. growth widens the white cells, or the black ones if negative.
    smear is the width of an edge. All three grow with the local strain.
    """
    if scene.corrosion == 0:
        none = np.zeros((1, 1, 2), dtype=np.float32)
        return none, none[..., 0], none[..., 0] + 1
    texels = points / np.float32(scene.side / _TEXTURE) + np.float32(_TEXTURE / 2 - 0.5)
    x, y = cv2.split(texels)
    fields = _fields(scene)
    sampled = cv2.remap(fields, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return sampled[..., :2], sampled[..., 2], sampled[..., 3]


@functools.lru_cache(maxsize=1)  # both views of a scene have one wear
def _fields(scene: Scene) -> Image:
    """Return the wear over the material's texels (T, T, 4): warp in x and y, growth, smear, px."""
    strain, area = _strain(scene)
    # Chosen so that the detector of the paper finds every corner in nearly all frames at severity
    # 0.5, in half of them at 1 and in hardly any at 1.5.
    worn = scene.corrosion * (0.1 + 2.5 * strain**2 / ((0.15 + strain) * (1 + strain)))
    ragged, torn, wide, fine, soft = _grains(scene.seed, scene.markers)
    warp = worn[..., None] * 0.5 * ragged + (0.2 * scene.corrosion + 0.4 * worn)[..., None] * torn
    growth = scene.corrosion * area + worn * (1.0 * wide + 0.5 * fine)
    growth = 2.2 * np.tanh(growth / 2.2)
    smear = 1 + worn * np.abs(soft)
    return np.dstack([warp, growth, smear]).astype(np.float32)


@functools.lru_cache(maxsize=1)  # both views of a scene, and all its frames, have one print
def _grains(seed: int, markers: int) -> tuple[Image, Image, Image, Image, Image]:
    """Return the random fields of the wear: two of two components, and three of one."""
    draw = np.random.default_rng([seed, 3])
    cell = _TEXTURE / (markers + 1)
    ragged = np.stack([_grain(draw, 3.0) for _ in range(2)], axis=-1)
    torn = np.stack([_grain(draw, 0.5 * cell) for _ in range(2)], axis=-1)
    wide, fine, soft = (_grain(draw, size) for size in (0.45 * cell, 3.0, 0.5 * cell))
    return ragged, torn, wide, fine, soft


def _grain(draw: np.random.Generator, size: float) -> Image:
    """Return smooth noise over the material: unit deviation, correlation length `size`, texels."""
    noise: Image = draw.standard_normal((_TEXTURE, _TEXTURE), dtype=np.float32)
    smooth: Image = cv2.GaussianBlur(noise, (0, 0), size / 2, borderType=cv2.BORDER_REFLECT_101)
    unit: Image = smooth / smooth.std()
    return unit


def _strain(scene: Scene) -> tuple[Image, Image]:
    """Return the magnitude of the strain and the change of area, over the material's texels."""
    coarse = _TEXTURE // 8
    texel = 8 * scene.side / _TEXTURE
    points = (np.dstack(samples((coarse, coarse))) - (coarse - 1) / 2) * texel
    by_u, by_v = derivatives(lambda at: surface(scene, at), points, 1e-4 * scene.side)
    stretches = np.linalg.svd(np.stack([by_u, by_v], axis=-1), compute_uv=False)
    size = np.hypot(stretches[..., 0] - 1, stretches[..., 1] - 1)
    area = stretches[..., 0] * stretches[..., 1] - 1
    fields = np.stack([size, area], axis=-1).astype(np.float32)
    fine: Image = cv2.resize(fields, (_TEXTURE, _TEXTURE))
    return fine[..., 0], fine[..., 1]


def illumination(scene: Scene, points: Array, pixel: float) -> Image:
    """Return the light's factor on the grey level at points (H, W, 2); points, pixel in mm."""
    rows, columns = scene.shape
    draw = np.random.default_rng([scene.seed, 4])
    angle = draw.uniform(-math.pi, math.pi)
    x, y = math.cos(angle), math.sin(angle)
    few = points[::4, ::4]
    height: Image = -surface(scene, few)[..., 2]
    by_y, by_x = np.gradient(height, 4 * pixel)
    across, down = (
        np.linspace(-1, 1, few.shape[1])[None, :] * columns / max(rows, columns),
        np.linspace(-1, 1, few.shape[0])[:, None] * rows / max(rows, columns),
    )
    uneven = 1 + scene.light * 0.3 * (x * across + y * down)
    shading = 1 - scene.light * 0.45 * np.tanh(x * by_x + y * by_y)
    reach = (across**2 + down**2) / (rows**2 + columns**2) * max(rows, columns) ** 2
    fall = 1 / (1 + (scene.vignetting - 1) * reach)
    coarse = (scene.exposure * uneven * shading * fall).astype(np.float32)
    light: Image = cv2.resize(coarse, (columns, rows))
    return light
