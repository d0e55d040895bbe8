"""The detector in NumPy, one module per kernel file: slow, plain, and what kernels are held to.

It is an oracle, to be called on purpose; the library never falls back to it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import BinaryRings, DetectorConfig, Pyramid, RapidCriteria
from cmp_cl.corners import Corners
from cmp_cl.errors import ImageError
from cmp_cl.image import GreyImage, check_image
from cmp_cl.maps import Maps
from cmp_cl.reference import binarize, criteria, gate, nms, refine, ring, scale, spectral

__all__ = ["detect", "detect_with_margin", "maps"]

_CRITERIA_MAPS = (
    "inner_transitions",
    "outer_transitions",
    "sector_difference",
    "ring_difference",
    "corrosion",
    "spectrum_12",
    "spectrum_23",
    "correlation",
    "phase",
)

Mask = NDArray[np.bool_] | None


def detect(image: GreyImage, config: DetectorConfig | None = None, mask: Mask = None) -> Corners:
    """The corners of an image, (H, W) uint8 or uint16.

    config: None stands for DetectorConfig.for_image(image).
    mask: (H, W) bool, where candidates may be centred; pixels outside are still sampled.

    Raises ImageError where image or mask is anything else.
    """
    return detect_with_margin(image, config, mask)[0]


def detect_with_margin(
    image: GreyImage, config: DetectorConfig | None = None, mask: Mask = None
) -> tuple[Corners, NDArray[np.float64]]:
    """The corners, and (N,) float64 how near refinement was to deciding otherwise.

    The margin is the smallest relative distance of a guard's quantity from its bound; where
    it is tiny, float32 may take the other branch. It is infinite without refinement.
    """
    image = check_image(image)
    config = config or DetectorConfig.for_image(image)
    factor, found = _at_best_scale(image, config, mask)
    y, x = np.nonzero(found.maximum)
    centroid, rounded = nms.centroids(found.response, x, y)
    pixel = np.stack([x, y], axis=1)
    if factor != 1:
        pixel = scale.nearest(scale.to_full(pixel.astype(np.float64), factor), image.shape)
        centroid = scale.to_full(centroid, factor)
        rounded = scale.nearest(centroid, image.shape)
    refined = refine.refine(image, rounded, centroid, config.refinement, factor)
    corners = Corners(
        xy=refined.xy.astype(np.float32),
        pixel=pixel.astype(np.int32),
        response=found.response[y, x].astype(np.float32),
        method=refined.method,
        sigma=refined.sigma.astype(np.float32),
        edges=refined.edges.astype(np.float32),
        doubtful=refined.doubtful,
        device="NumPy",
    )
    return corners, refined.margin


def maps(image: GreyImage, config: DetectorConfig | None = None, mask: Mask = None) -> Maps:
    """Every intermediate image of `detect`, with a value at every pixel."""
    image = check_image(image)
    return _at_best_scale(image, config or DetectorConfig.for_image(image), mask)[1]


def _at_best_scale(image: GreyImage, config: DetectorConfig, mask: Mask) -> tuple[float, Maps]:
    """The working scale and the maps at that scale."""
    mask = _checked(mask, image)
    if not isinstance(config.scale, Pyramid):
        factor = 1.0 if config.scale is None else float(config.scale)
        return factor, _at_scale(image, config, mask, factor)
    found = {
        factor: _at_scale(image, config, mask, factor)
        for factor in map(float, config.scale.factors)
    }
    counts = {factor: int(each.maximum.sum()) for factor, each in found.items()}
    best = scale.best_factor(counts, config.scale.expected)
    return best, found[best]


def _checked(mask: Mask, image: GreyImage) -> NDArray[np.bool_]:
    if mask is None:
        return np.ones(image.shape, np.bool_)
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != image.shape:
        came = f"{mask.dtype} {mask.shape}" if isinstance(mask, np.ndarray) else type(mask).__name__
        raise ImageError(f"expected a mask of bool {image.shape}, got {came}")
    return mask


def _at_scale(
    image: GreyImage, config: DetectorConfig, mask: NDArray[np.bool_], factor: float
) -> Maps:
    if not image.size:
        one = _at_scale(np.zeros((1, 1), image.dtype), config, np.ones((1, 1), np.bool_), 1.0)
        return _emptied(one, image.shape)
    full_scale = config.grey_levels(image.dtype)
    image = scale.to_working(image, factor)
    mask = scale.mask_at_working(mask, factor)
    rings = config.detection
    if not isinstance(rings, BinaryRings):
        raise NotImplementedError
    layers = [
        _layer(image, binary, mask, rings, full_scale)
        for binary in binarize.binarize(image, rings.threshold)
    ]
    if len(layers) == 1:
        layer = layers[0]
        response = layer.pop("response")
    else:
        middle, below, above = (layer.pop("response") for layer in layers)
        response = 2 * middle + below + above
        layer = {
            name: None if values is None else np.stack([each[name] for each in layers])
            for name, values in layers[0].items()
        }
    score = nms.score(response)
    return Maps(
        **layer,
        response=response,
        score=score,
        maximum=nms.maxima(response, score, config.nms_radius),
    )


def _layer(
    image: GreyImage,
    binary: NDArray[np.bool_],
    mask: NDArray[np.bool_],
    rings: BinaryRings,
    full_scale: int,
) -> dict[str, Any]:
    """The maps of one binary image by their names, `response` after the gate."""
    inner = ring.ring_mask(binary, ring.INNER)
    outer = ring.ring_mask(binary, ring.OUTER[rings.outer_radius])
    layer: dict[str, Any] = dict.fromkeys(_CRITERIA_MAPS)
    if isinstance(rings.criteria, RapidCriteria):
        layer |= vars(criteria.rapid(binary, inner, outer, rings.criteria))
    else:
        layer |= vars(spectral.spectral(binary, inner, outer, rings.criteria))
    kept = layer["candidate"] = layer["candidate"] & mask
    contrast = None
    if rings.contrast is not None:
        contrast, kept = gate.gate(
            image,
            inner,
            kept,
            rings.outer_radius,
            rings.contrast,
            full_scale,
            rings.threshold.masks,
        )
    response = np.where(kept, layer["response"], 0)
    return layer | dict(
        binary=binary, inner=inner, outer=outer, contrast=contrast, response=response
    )


def _emptied(found: Maps, shape: tuple[int, ...]) -> Maps:
    """The same maps of an image without pixels."""
    empty: dict[str, Any] = {
        name: None if values is None else np.empty(values.shape[:-2] + shape, values.dtype)
        for name, values in vars(found).items()
    }
    return Maps(**empty)
