"""Refinement on the grey image (section 3.5, Fig. 9), in float64."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import EdgeLines, EdgeStep, Midlines
from cmp_cl.corners import Method, Refusal
from cmp_cl.image import GreyImage
from cmp_cl.reference.edge_lines import edge_lines, lines_sigma
from cmp_cl.reference.edge_step import STEP_SHIFT, disc_radius, edge_step
from cmp_cl.reference.edges import EdgePoints, edge_points, enough_points
from cmp_cl.reference.midlines import midlines

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Refined:
    """Refined corners: fields of `cmp_cl.corners.Corners` in float64, and a margin.

    margin: (N,), the smallest relative distance of a check's quantity from its bound. A
        float32 implementation may decide otherwise if it is below about 1e-4.
    """

    xy: Floats
    method: NDArray[np.uint8]
    refusal: NDArray[np.uint8]
    sigma: Floats
    edges: Floats
    doubtful: Bools
    margin: Floats


def refine(
    image: GreyImage,
    start: NDArray[np.int64],
    centroid: Floats,
    refinement: EdgeLines | EdgeStep | Midlines | None,
) -> Refined:
    """Refine the positions of N corners.

    start: (N, 2) (x, y), the rounded centroids; centroid: (N, 2), the positions that are kept if a
        check rejects the refinement.
    """
    count = len(start)
    unknown = np.full(count, np.nan)
    if refinement is None or count == 0:
        return Refined(
            xy=centroid,
            method=np.full(count, Method.CENTROID, np.uint8),
            refusal=np.zeros(count, np.uint8),
            sigma=unknown,
            edges=np.full((count, 4), np.nan),
            doubtful=np.zeros(count, np.bool_),
            margin=np.full(count, np.inf),
        )
    points = edge_points(image, start)
    two_rings = points.valid.sum(axis=1) >= 2
    enough, sigma = two_rings, unknown
    doubtful = np.zeros(count, np.bool_)
    if isinstance(refinement, Midlines):
        shift, method, refusal, margin = midlines(points, refinement.fit, refinement.max_shift)
    else:
        enough = enough_points(points)
        max_shift = STEP_SHIFT if isinstance(refinement, EdgeStep) else refinement.max_shift
        shift, method, refusal, margin = edge_lines(points, max_shift)
        sigma = np.where(method == Method.EDGE_LINES, lines_sigma(points), np.nan)
    method = np.where(enough, method, Method.KEPT).astype(np.uint8)
    refusal = np.where(enough, refusal, Refusal.RINGS).astype(np.uint8)
    lines = np.nonzero(method == Method.EDGE_LINES)[0]
    if isinstance(refinement, EdgeStep) and len(lines):
        chosen = EdgePoints(**{name: values[lines] for name, values in vars(points).items()})
        step = edge_step(image, start[lines], shift[lines], chosen, refinement)
        accepted = lines[step.accepted]
        shift[accepted] = step.position[step.accepted]
        method[accepted] = Method.EDGE_STEP
        refusal[lines] = step.refusal
        of_lines = np.where(step.accepted, 0, sigma[lines] ** 2)
        sigma[lines] = np.sqrt(of_lines + step.variance)
        doubtful[lines] = step.doubtful
        margin[lines] = np.minimum(margin[lines], step.margin)
    edges = np.arctan2(points.direction[..., 1], points.direction[..., 0])
    kept = (method == Method.KEPT)[:, None]
    return Refined(
        xy=np.where(kept, centroid, start + shift),
        method=method,
        refusal=refusal,
        sigma=np.where(method == Method.KEPT, np.nan, sigma),
        edges=np.where(two_rings[:, None], edges, np.nan),
        doubtful=doubtful,
        margin=np.where(enough, np.minimum(margin, points.margin), points.margin),
    )


def edge_radius(refinement: EdgeLines | EdgeStep | Midlines | None) -> float:
    """Return the radius within which the refinement assumes straight edges, px of the image; NaN
    without EDGE_STEP."""
    return disc_radius(refinement) if isinstance(refinement, EdgeStep) else math.nan
