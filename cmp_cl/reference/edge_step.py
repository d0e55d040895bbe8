"""EDGE_STEP: one least-squares step of a corner model from the edge lines, in float64."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import EdgeStep
from cmp_cl.corners import Refusal
from cmp_cl.image import GreyImage
from cmp_cl.reference.edges import EdgePoints, both_lines, cross, dot, norm, normal_of

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

STEP_SHIFT = 2.0  # px, from the start
LARGEST_STEP = 0.3  # px
BLUR = 1.2  # px, of the model's edges
LEAST_CONTRAST = 1e-3  # grey levels
LEAST_DETERMINANT = 1e-3  # relative to the product of the diagonal
GRADIENT = 1e-3  # 1/px, of the light: what is expected where the image does not say more
SIGNIFICANT = 9.0  # squared standard deviations from which on the image's own gradient counts
DOUBT = 0.010  # excess autocorrelation of the residual
# px: what bent edges, shading and sampling add to the noise of a position on perfect prints
STEP_ERROR = 0.01


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Step:
    """N steps: position (N, 2) from the start; the rest (N,), as in `Refined`."""

    position: Floats
    accepted: Bools
    refusal: NDArray[np.uint8]
    sigma: Floats
    doubtful: Bools
    margin: Floats


def edge_step(
    image: GreyImage,
    start: NDArray[np.int64],
    shift: Floats,
    points: EdgePoints,
    refinement: EdgeStep,
    scale: float,
) -> Step:
    """Apply EDGE_STEP: one weighted linear least-squares step of a blurred corner from EDGE_LINES.

    The model of the grey around x is (m + c f(n1.u) g(n2.u)) (1 + e.u), f and g smooth steps of
    1.2 px, e the relative gradient of the light. Its radius is clamp(0.75 cell s, 4.5, 9) / s with
    the working scale s.
    """
    radius = min(max(0.75 * refinement.cell * scale, 4.5), 9.0) / scale
    n1, n2 = (normal_of(line) for line in both_lines(points))
    at_once = max(1, 2_000_000 // math.ceil(2 * radius + 1) ** 2)
    blocks = [slice(k, k + at_once) for k in range(0, len(start), at_once)]
    parts = [
        _step_terms(image, start[rows], shift[rows], n1[rows], n2[rows], radius) for rows in blocks
    ]
    step, solvable, variance, correlation, near = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    position = shift + step
    length, moved = norm(step), norm(position)
    longest, furthest = LARGEST_STEP / scale, STEP_SHIFT / scale
    accepted = solvable & (length <= longest) & (moved <= furthest)

    excess = np.zeros(len(start))
    if accepted.any():
        excess = np.maximum(0, correlation - lower_median(correlation[accepted]))
    sigma = np.sqrt(STEP_ERROR**2 + 0.5 * variance + 1000 * excess**2)
    margin = np.min(
        [
            near,
            np.where(solvable, np.abs(length - longest) / longest, np.inf),
            np.where(solvable, np.abs(moved - furthest) / furthest, np.inf),
            np.where(accepted, np.abs(excess - DOUBT) / DOUBT, np.inf),
        ],
        axis=0,
    )
    return Step(
        position=position,
        accepted=accepted,
        refusal=np.select([accepted, solvable], [Refusal.NONE, Refusal.SHIFT], Refusal.FLAT).astype(
            np.uint8
        ),
        sigma=np.where(accepted, sigma, np.nan),
        doubtful=accepted & (excess > DOUBT),
        margin=margin,
    )


def lower_median(values: Floats) -> float:
    """Return the value of rank (n - 1) // 2, from 0: one that occurs."""
    return float(np.sort(values)[(len(values) - 1) // 2])


def _step_terms(
    image: GreyImage,
    start: NDArray[np.int64],
    shift: Floats,
    n1: Floats,
    n2: Floats,
    radius: float,
) -> tuple[Floats, Bools, Floats, Floats, Floats]:
    """Return per corner: step (N, 2), whether the system is sound, tr rho^2, ac, and a margin.

    ac is the mean of r(q) r(q + (1, 0)), weighted by w(q), over the pixels q that are, like
    their right neighbours, within the radius, less what the light's gradient adds to it. rho^2 is
    what mean r^2 has beyond that product: noise, which is not alike in neighbours.
    """
    height, width = image.shape
    reach = np.arange(-math.ceil(radius), math.ceil(radius) + 1)
    middle = np.floor(shift + 0.5).astype(np.int64)
    x = (middle[:, 0, None] + reach)[:, None, :]
    y = (middle[:, 1, None] + reach)[:, :, None]
    columns = np.clip(start[:, 0, None, None] + x, 0, width - 1)
    rows = np.clip(start[:, 1, None, None] + y, 0, height - 1)
    grey = image[rows, columns].astype(np.float64)
    centre = image[start[:, 1], start[:, 0]].astype(np.float64)
    grey -= centre[:, None, None]

    ux, uy = x - shift[:, 0, None, None], y - shift[:, 1, None, None]
    r2 = ux * ux + uy * uy
    inside = r2 < radius * radius
    w = np.clip(4 * (1 - r2 / radius**2), 0, 1)
    a, b = ((n[:, 0, None, None] * ux + n[:, 1, None, None] * uy) / BLUR for n in (n1, n2))
    qa, qb = 1 / np.sqrt(1 + a * a), 1 / np.sqrt(1 + b * b)
    f, g = a * qa, b * qb
    p, da, db = f * g, qa**3 * g / BLUR, f * qb**3 / BLUR

    def total(values: Floats) -> Floats:
        result: Floats = (w * values).sum(axis=(1, 2))
        return result

    def products(first: tuple[Floats, ...], second: tuple[Floats, ...]) -> Floats:
        """Return (N, len(first), len(second)) sums."""
        sums = [np.stack([total(one * other) for other in second], axis=1) for one in first]
        return np.stack(sums, axis=1)

    s1, sp, si = total(np.ones_like(p)), total(p), total(grey)
    spp, spi = total(p * p), total(p * grey)
    with np.errstate(all="ignore"):
        spread = s1 * spp - sp * sp
        c = (s1 * spi - sp * si) / spread
        m = (si - c * sp) / s1
        r = grey - m[:, None, None] - c[:, None, None] * p
        level = np.maximum(m + centre, np.abs(c))
        light = 1 + (c / level)[:, None, None] * p
        edges, gradient = (da, db), (ux * light, uy * light)
        aa, am = products(edges, edges), products(edges, gradient)
        mm = products(gradient, gradient)
        ra, rm = products(edges, (r,))[..., 0], products(gradient, (r,))[..., 0]
        squares = total(r * r)
        d = aa[:, 0, 0] * aa[:, 1, 1] - aa[:, 0, 1] ** 2
        ratios = np.stack(
            [
                np.abs(c) / LEAST_CONTRAST,
                d / (aa[:, 0, 0] * aa[:, 1, 1]) / LEAST_DETERMINANT,
                spread / (s1 * spp) / LEAST_DETERMINANT,
            ]
        )
        sound = np.logical_and((ratios > 1).all(axis=0), np.isfinite(ra).all(axis=1))
        near = np.abs(np.where(np.isfinite(ratios), ratios, 0) - 1).min(axis=0)
        aa = np.where(sound[:, None, None], aa, np.eye(2))
        alone, by_gradient = np.linalg.solve(aa, ra[..., None])[..., 0], np.linalg.solve(aa, am)
        noise = (squares - (ra * alone).sum(axis=1)) / s1
        own, variance_of_own = _gradient(
            mm - np.swapaxes(am, 1, 2) @ by_gradient,
            rm - np.einsum("nij,ni->nj", am, alone),
            np.stack([level, noise, s1, np.abs(c)], axis=1),
        )
        alone -= np.einsum("nij,nj->ni", by_gradient, own)
        covariance = np.linalg.inv(aa)
        covariance += by_gradient @ variance_of_own @ np.swapaxes(by_gradient, 1, 2)

        ha, hb = -alone.T / c
        sine = cross(n1, n2)
        step = np.stack(
            [
                (ha * n2[:, 1] - hb * n1[:, 1]) / sine,
                (hb * n1[:, 0] - ha * n2[:, 0]) / sine,
            ],
            axis=1,
        )
        explained = 2 * (own * rm).sum(axis=1) - np.einsum("ni,nij,nj->n", own, mm, own)
        trace = covariance[:, 0, 0] + covariance[:, 1, 1]
        trace -= 2 * covariance[:, 0, 1] * dot(n1, n2)
        pair = np.where(inside[:, :, :-1] & inside[:, :, 1:], w[:, :, :-1], 0)
        neighbours = np.where(pair > 0, r[:, :, :-1] * r[:, :, 1:], 0)
        correlation = (pair * neighbours).sum(axis=(1, 2)) / s1
        rho2 = np.maximum(0, squares / s1 - correlation) / (c * c)
        variance = rho2 * trace / (sine * sine)
        correlation = (correlation - explained / s1) / (c * c)
        sound &= np.isfinite(step).all(axis=1)
        sound &= np.isfinite(variance) & np.isfinite(correlation)
    clean = sound[:, None]
    return (
        np.where(clean, step, 0),
        sound,
        np.where(sound, variance, 0),
        np.where(sound, correlation, 0),
        near,
    )


def _gradient(normal: Floats, right: Floats, scales: Floats) -> tuple[Floats, Floats]:
    """Return the light's gradient in grey levels a px (N, 2), and its variance by that of the noise
    (N, 2, 2).

    normal: (N, 2, 2), right: (N, 2), the equations for it once the edges are eliminated.
    scales: (N, 4), level, mean square of what edges alone leave, sum of weights, |c|.

    It is a ridge estimate: GRADIENT is expected of the light, or more where the gradient that fits
    best is more than SIGNIFICANT says that noise alone would give.
    """
    level, noise, weights, contrast = scales.T
    det = normal[:, 0, 0] * normal[:, 1, 1] - normal[:, 0, 1] ** 2
    solvable = det > LEAST_DETERMINANT * normal[:, 0, 0] * normal[:, 1, 1]
    best = np.linalg.solve(np.where(solvable[:, None, None], normal, np.eye(2)), right[..., None])
    best = np.where(solvable[:, None], best[..., 0], 0)
    gained = (best * right).sum(axis=1)
    noise = np.maximum(noise - gained / weights, (LEAST_CONTRAST * contrast) ** 2)
    surely = np.maximum(0, 1 - SIGNIFICANT * noise / np.maximum(gained, 1e-30))
    expected = (GRADIENT * level) ** 2 + surely * (best**2).sum(axis=1) / 2
    inverse = np.linalg.inv(normal + (noise / expected)[:, None, None] * np.eye(2))
    return np.einsum("nij,nj->ni", inverse, right), inverse
