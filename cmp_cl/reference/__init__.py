"""The detector in NumPy, with one module per stage, slow and simple. Tests compare the kernels with
it.

It is an oracle. The library never falls back to it. It shares no constant with the kernels, so that
a wrong constant shows.
"""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import BinaryRings, DetectorConfig, RapidCriteria
from cmp_cl.corners import Corners, HarmonicMaps, Maps
from cmp_cl.errors import ConfigError, check_kind
from cmp_cl.image import GreyImage, check_image, check_mask
from cmp_cl.reference import harmonic, refine
from cmp_cl.reference.paper import binarize, criteria, gate, nms, ring, spectral

__all__ = ["detect", "detect_with_margin", "maps"]

Mask = NDArray[np.bool_] | None


def detect(image: GreyImage, config: DetectorConfig | None = None, mask: Mask = None) -> Corners:
    """Find the corners of an image, (H, W) uint8 or uint16.

    config: None means DetectorConfig().
    mask: (H, W) bool, where candidates may be centred; pixels outside are still sampled.

    Raises ImageError if image or mask is anything else, ConfigError if config is.
    """
    return detect_with_margin(image, config, mask)[0]


def detect_with_margin(
    image: GreyImage, config: DetectorConfig | None = None, mask: Mask = None
) -> tuple[Corners, NDArray[np.float64]]:
    """Find the corners; also return the margins of the decisions of refinement, (N,) float64.

    image, config, mask: as in `detect`. A margin is the smallest relative distance of a check's
        quantity from its bound. If it is tiny, float32 may decide otherwise. It is infinite without
        refinement.
    """
    image = check_image(image)
    config = DetectorConfig() if config is None else config
    check_kind("config", config, DetectorConfig, ConfigError)
    found = _found(image, config, mask)
    pixel = np.stack([harmonic.in_frame(at, found.halvings) for at in (found.x, found.y)], axis=1)
    values: dict[str, NDArray[Any]] = {}
    for halvings, octave in enumerate(found.images):
        here, size = found.halvings == halvings, 2**halvings
        refined = refine.refine(
            octave, found.rounded[here], found.centroid[here], config.refinement
        )
        placed = dataclasses.replace(
            refined, xy=refined.xy * size + (size - 1) / 2, sigma=refined.sigma * size
        )
        for name, part in vars(placed).items():
            whole = values.setdefault(name, np.zeros((len(here), *part.shape[1:]), part.dtype))
            whole[here] = part
    margin = values.pop("margin")
    for name in ("xy", "sigma", "edges"):
        values[name] = values[name].astype(np.float32)
    corners = Corners(
        pixel=pixel.astype(np.int32),
        octave=found.halvings.astype(np.uint8),
        response=found.response.astype(np.float32),
        edge_radius=refine.edge_radius(config.refinement),
        device="NumPy",
        **values,
    )
    return corners, margin


def maps(
    image: GreyImage, config: DetectorConfig | None = None, mask: Mask = None
) -> Maps | HarmonicMaps:
    """Return every intermediate image of `detect`, with a value at every pixel."""
    image = check_image(image)
    config = config or DetectorConfig()
    return _found(image, config, mask).maps


def _found(image: GreyImage, config: DetectorConfig, mask: Mask) -> nms.Found:
    full_scale = config.grey_levels(image.dtype)
    allowed = np.ones(image.shape, np.bool_) if mask is None else check_mask(mask, image.shape)
    if isinstance(config.detection, BinaryRings):
        return _of_rings(image, config.detection, config.nms_radius, full_scale, allowed)
    return harmonic.corners(image, config.detection, config.nms_radius, full_scale, allowed)


def _of_rings(
    image: GreyImage,
    rings: BinaryRings,
    nms_radius: int,
    full_scale: int,
    mask: NDArray[np.bool_],
) -> nms.Found:
    """Find corners by the paper's criteria; the gate examines the maxima of the response."""
    binary = binarize.binarize(image, rings.threshold)
    inner = ring.ring_bits(binary, ring.INNER)
    outer = ring.ring_bits(binary, ring.OUTER[rings.outer_radius])
    maps: dict[str, Any] = dict.fromkeys(field.name for field in dataclasses.fields(Maps))
    if isinstance(rings.criteria, RapidCriteria):
        maps |= criteria.rapid(inner, outer, rings.criteria)
    else:
        maps |= spectral.spectral(inner, outer, rings.criteria)
    candidate = maps["candidate"] & mask
    if rings.criteria.corrosion_threshold is not None:
        maps["corrosion"] = criteria.corrosion(binary, outer)
        candidate &= maps["corrosion"] < rings.criteria.corrosion_threshold
    response = np.where(candidate, maps["response"], 0)
    score = nms.score(response)
    maximum = nms.maxima(response, score, nms_radius)
    maps |= dict(binary=binary, inner=inner, outer=outer, candidate=candidate, response=response)
    if rings.contrast is not None:
        maps["contrast"], maximum = gate.gate(
            image, inner, maximum, rings.outer_radius, rings.contrast, full_scale
        )
    y, x = np.nonzero(maximum)
    centroid, rounded = nms.centroids(response, x, y)
    return nms.Found(
        x=x,
        y=y,
        response=response[y, x],
        centroid=centroid,
        rounded=rounded,
        halvings=np.zeros(len(x), np.int64),
        images=[image],
        maps=Maps(**maps | dict(score=score, maximum=maximum)),
    )
