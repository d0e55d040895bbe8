"""EDGE_STEP: one least-squares step of a corner model from the edge lines, in float64."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import EdgeStep
from cmp_cl.corners import Refusal
from cmp_cl.image import GreyImage
from cmp_cl.reference.edges import EdgePoints, both_lines, norm, normal_of

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

STEP_SHIFT = 2.0  # px, from the start
LARGEST_STEP = 0.7  # px
BLUR = 1.2  # px, of the model's edges
# Symmetric corners lie between two pixels exactly; the second is the middle one
HALF = 0.5 + 2**-12
LEAST_CONTRAST = 1e-3  # grey levels
LEAST_SPREAD = 1e-3  # of the model, relative to its weighted mean square
GRADIENT = 1e-3  # 1/px, expected gradient of the light, unless the image shows a larger one
SIGNIFICANT = 9.0  # squared standard deviations: above it, the gradient in the image is used
DOUBT = 0.010  # excess over the median of the autocorrelations
VARIANCE_OF_ODD = 1000  # px^2, per squared autocorrelation of the residual's odd part
STEP_ERROR = 0.003  # px: error of a position by grey levels in steps and by sampling
OFF_X, OFF_Y = 3.0, 1.5  # 1/px^2: share of an even misfit that is not even about the middle pixel
ODD_Y = 1.2  # 1/px^2: what neighbours share of it
MOST_OFF = 0.75
LEAST_NOISE = 0.02  # of what neighbours do not share
FEW = 8
VARIANCE_OF_GRAIN = 2.2  # by how much the noise of a position exceeds that of pixels, per grain


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Step:
    """N steps: position (N, 2) from the start; the rest (N,), as in `Refined`.

    variance: of an accepted position; otherwise what is to be added to that of the lines. px^2.
    """

    position: Floats
    accepted: Bools
    refusal: NDArray[np.uint8]
    variance: Floats
    doubtful: Bools
    margin: Floats


def edge_step(
    image: GreyImage,
    start: NDArray[np.int64],
    shift: Floats,
    points: EdgePoints,
    refinement: EdgeStep,
) -> Step:
    """Apply EDGE_STEP: one weighted linear least-squares step of a blurred corner from EDGE_LINES.

    The model of the grey around x is (m + c f(n1.u) g(n2.u)) (1 + e.u). f and g are smooth steps of
    1.2 px, and e is the relative gradient of the light. The radius of the model is
    clamp(0.75 cell, 4.5, 9). The terms of the normal equations that depend only on the model are
    integrated over the disc. In the frame of the edges the equations separate into two systems of
    two unknowns.
    """
    radius = disc_radius(refinement)
    n1, n2 = (normal_of(line) for line in both_lines(points))
    at_once = max(1, 2_000_000 // math.ceil(2 * radius + 1) ** 2)
    blocks = [slice(k, k + at_once) for k in range(0, len(start), at_once)]
    parts = [
        _step_terms(image, start[rows], shift[rows], n1[rows], n2[rows], radius) for rows in blocks
    ]
    step, solvable, variance, correlation, grain, near = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    position = shift + step
    length, moved = norm(step), norm(position)
    accepted = solvable & (length <= LARGEST_STEP) & (moved <= STEP_SHIFT)

    typical, coarse = 0.0, 1.0
    if accepted.any():
        typical = median(correlation[accepted])
        few = np.zeros(FEW)  # corners more, without grain: so few would not tell what the noise is
        coarse = max(1, VARIANCE_OF_GRAIN * median(np.concatenate([grain[accepted], few])))
    odd = np.maximum(np.where(accepted, correlation, typical), typical)
    of_step = STEP_ERROR**2 + 0.5 * variance * coarse
    of_shape = VARIANCE_OF_ODD * np.maximum(0, odd) ** 2
    of_refused = np.where(solvable, LARGEST_STEP**2, 0)  # the lines and the step differ by more
    margin = np.min(
        [
            near,
            np.where(solvable, np.abs(length - LARGEST_STEP) / LARGEST_STEP, np.inf),
            np.where(solvable, np.abs(moved - STEP_SHIFT) / STEP_SHIFT, np.inf),
            np.where(accepted, np.abs(odd - typical - DOUBT) / DOUBT, np.inf),
        ],
        axis=0,
    )
    return Step(
        position=position,
        accepted=accepted,
        refusal=np.select([accepted, solvable], [Refusal.NONE, Refusal.SHIFT], Refusal.FLAT).astype(
            np.uint8
        ),
        variance=np.where(accepted, of_step, of_refused) + of_shape,
        doubtful=odd - typical > DOUBT,
        margin=margin,
    )


def disc_radius(refinement: EdgeStep) -> float:
    """Return the radius of the model, px."""
    return min(max(0.75 * refinement.cell, 4.5), 9.0)


def median(values: Floats) -> float:
    """Return the median, of two values the lower one."""
    return float(np.sort(values)[(len(values) - 1) // 2])


def _step_terms(
    image: GreyImage,
    start: NDArray[np.int64],
    shift: Floats,
    n1: Floats,
    n2: Floats,
    radius: float,
) -> tuple[Floats, Bools, Floats, Floats, Floats, Floats]:
    """Return for each corner the step (N, 2), whether the system is regular, tr rho^2, ac, the
        grain, and a margin.

    ac is the autocorrelation of the residual's odd part, since an even residual moves no corner:
    half the difference of the means of r(q) r(q + 1) and of r(q) (r(-q - 1) + r(1 - q)) / 2,
    weighted by w(q), minus the part that comes from the light's gradient. q is counted from the
    middle pixel, q + 1 is the right neighbour, and r is 0 outside the radius or the image. rho^2 is
    the noise, which neighbours do not share: mean r^2 minus the mean of r(q) r(q + 1), minus the
    same of r(q) and r(-q), a misfit that is even. The middle pixel is not the corner, so a part of
    such a misfit is odd; how much it is depends on their distance, see `_noise`. The grain is
    the noise over the disc relative to rho^2. It is seen where the model has nothing but noise:
    along k P, k the coordinate along s or t, in the part that neither an offset nor the light's
    gradient explains.
    """
    height, width = image.shape
    reach = np.arange(-math.ceil(radius), math.ceil(radius) + 1)
    middle = np.floor(shift + HALF).astype(np.int64)
    x = (middle[:, 0, None] + reach)[:, None, :]
    y = (middle[:, 1, None] + reach)[:, :, None]
    columns = np.clip(start[:, 0, None, None] + x, 0, width - 1)
    rows = np.clip(start[:, 1, None, None] + y, 0, height - 1)
    grey = image[rows, columns].astype(np.float64)
    centre = image[start[:, 1], start[:, 0]].astype(np.float64)
    grey -= centre[:, None, None]

    ux, uy = x - shift[:, 0, None, None], y - shift[:, 1, None, None]
    r2 = ux * ux + uy * uy
    is_seen = (columns == start[:, 0, None, None] + x) & (rows == start[:, 1, None, None] + y)
    inside = is_seen & (r2 < radius * radius)
    whole = weight_of(r2, radius)
    w = np.where(is_seen, whole, 0)
    share = np.where(is_seen.all(axis=(1, 2)), 1, w.sum(axis=(1, 2)) / whole.sum(axis=(1, 2)))
    p, da, db = model_of(*(n[:, 0, None, None] * ux + n[:, 1, None, None] * uy for n in (n1, n2)))

    def total(values: Floats) -> Floats:
        result: Floats = (w * values).sum(axis=(1, 2))
        return result

    s1, sp, si = total(np.ones_like(p)), total(p), total(grey)
    spp, spi = total(p * p), total(p * grey)
    with np.errstate(all="ignore"):
        spread = s1 * spp - sp * sp
        c = (s1 * spi - sp * si) / spread
        m = (si - c * sp) / s1
        r = grey - m[:, None, None] - c[:, None, None] * p
        level = np.maximum(m + centre, np.abs(c))
        ratio = c / level
        squares = total(r * r)

        axes, half = edge_frame(n1, n2)
        known = moments(half, radius) * share[:, None, None]
        d_d, d_k, d_kp, k_k, k_kp, k_kpp = np.moveaxis(known, -1, 0)
        d_light = d_k + ratio[:, None] * d_kp
        light_2 = k_k + 2 * ratio[:, None] * k_kp + ratio[:, None] ** 2 * k_kpp
        r_d = half * np.stack([total(r * (da + db)), total(r * (da - db))], axis=1)
        r_k, r_kp = (
            np.einsum("nki,ni->nk", axes, np.stack([total(part * ux), total(part * uy)], axis=1))
            for part in (r, r * p)
        )
        r_light = r_k + ratio[:, None] * r_kp

        by_offset = d_light / d_d
        left = light_2 - by_offset * d_light
        noise = (squares - (r_d**2 / d_d).sum(axis=1)) / s1
        gradient, variance_of_gradient = _gradient(
            left,
            r_light - by_offset * r_d,
            np.stack([level, noise, s1, np.abs(c)], axis=1),
        )
        along = (by_offset * gradient - r_d / d_d) / c[:, None]
        step = np.einsum("nk,nki->ni", along, axes)
        trace = (1 / d_d + by_offset**2 * variance_of_gradient).sum(axis=1)
        explained = (2 * gradient * r_light - gradient**2 * light_2).sum(axis=1)

        within = np.where(inside, r, 0)
        weighted, mirrored = w * within, within[:, ::-1, ::-1]
        opposite, neighbours, before, behind = (
            (one * other).sum(axis=(1, 2)) / s1
            for one, other in (
                (weighted, mirrored),
                (weighted[:, :, :-1], within[:, :, 1:]),
                (weighted[:, :, :-1], mirrored[:, :, 1:]),
                (weighted[:, :, 1:], mirrored[:, :, :-1]),
            )
        )
        across = (before + behind) / 2
        off = shift - middle
        white, misfit = _noise(squares / s1 - neighbours, opposite - across, off)
        variance = np.maximum(0, white) / (c * c) * trace
        of_light = (k_kp + ratio[:, None] * k_kpp - by_offset * d_kp) / left
        broad = r_kp - d_kp / d_d * r_d - of_light * (r_light - by_offset * r_d)
        expected = k_kpp - d_kp**2 / d_d - of_light**2 * left
        grain = (broad**2).sum(axis=1) / expected.sum(axis=1)
        grain /= np.maximum(white, (LEAST_CONTRAST * c) ** 2)
        odd = (neighbours - across) / 2 - ODD_Y * off[:, 1] ** 2 * misfit
        correlation = (odd - explained / s1) / (c * c)

        ratios = np.stack([np.abs(c) / LEAST_CONTRAST, spread / (s1 * spp) / LEAST_SPREAD])
        sound = (ratios > 1).all(axis=0) & np.isfinite(step).all(axis=1)
        sound &= np.isfinite(variance) & np.isfinite(correlation)
        near = np.abs(np.where(np.isfinite(ratios), ratios, 0) - 1).min(axis=0)
    return (
        np.where(sound[:, None], step, 0),
        sound,
        np.where(sound, variance, 0),
        np.where(sound, correlation, 0),
        np.where(sound, grain, 0),
        near,
    )


def _noise(white: Floats, even: Floats, off: Floats) -> tuple[Floats, Floats]:
    """Return the noise and the misfit of the model, both (N,).

    white: mean r(q)^2 minus mean r(q) r(q + 1). even: the same of r(q) and r(-q). off: (N, 2), the
        corner from the middle pixel.
    """
    share = np.minimum(OFF_X * off[:, 0] ** 2 + OFF_Y * off[:, 1] ** 2, MOST_OFF)
    noise = np.maximum((white - even - share * white) / (1 - share), LEAST_NOISE * white)
    return noise, np.maximum(white - noise, 0)


def weight_of(r2: Floats, radius: float) -> Floats:
    """Return the weights of the disc for squared distances from the corner."""
    return np.clip(4 * (1 - r2 / radius**2), 0, 1)


def model_of(a: Floats, b: Floats) -> tuple[Floats, Floats, Floats]:
    """Return P and its slopes for distances from the two edges, px."""
    a, b = a / BLUR, b / BLUR
    qa, qb = 1 / np.sqrt(1 + a * a), 1 / np.sqrt(1 + b * b)
    f, g = a * qa, b * qb
    return f * g, qa**3 * g / BLUR, f * qb**3 / BLUR


def edge_frame(n1: Floats, n2: Floats) -> tuple[Floats, Floats]:
    """Return the axes s, t (N, 2, 2), and the cosine and sine of half the angle (N, 2)."""
    along = np.stack([n1 + n2, n1 - n2], axis=1)
    length = norm(along)
    return along / length[..., None], length / 2


def moments(half: Floats, radius: float) -> Floats:
    """Return the integrals over the disc that depend on the model alone, (N, 2, 6).

    half: (N, 2) from `edge_frame`. For the axes s and t, with D the slope of P along the axis and k
    the coordinate: the integrals of w D D, w D k, w D k P, w k k, w k k P, w k k P P.

    The integration is in polar coordinates: Gauss-Legendre along the radius, separately before and
    after the radius at which the weight begins to fall, and trapezoids of equal angles. P is even
    in s and in t, so a quadrant is enough.
    """
    count = math.ceil(3 * radius) + 8
    node, weight = np.polynomial.legendre.leggauss(count)
    falls = radius * math.sqrt(0.75)
    spans = ((0, falls), (falls, radius))
    r = np.concatenate([(low + high) / 2 + (high - low) / 2 * node for low, high in spans])
    by_r = np.concatenate([(high - low) / 2 * weight for low, high in spans])
    angle = np.linspace(0, math.pi / 2, count)
    by_angle = np.full(count, 4 * (angle[1] - angle[0]))
    by_angle[[0, -1]] /= 2
    s, t = r[:, None] * np.cos(angle), r[:, None] * np.sin(angle)
    w = weight_of(r * r, radius)[:, None] * (r * by_r)[:, None] * by_angle
    result = np.empty((len(half), 2, 6))
    for row, (cosine, sine) in zip(result, half, strict=True):
        p, da, db = model_of(cosine * s + sine * t, cosine * s - sine * t)
        for each, slope, k in ((row[0], cosine * (da + db), s), (row[1], sine * (da - db), t)):
            light = k * p
            products = (slope * slope, slope * k, slope * light, k * k, k * light, light * light)
            each[:] = [(w * product).sum() for product in products]
    return result


def _gradient(left: Floats, right: Floats, scales: Floats) -> tuple[Floats, Floats]:
    """Return the light's gradient along s and t, (N, 2), grey levels per px, and its variance over
    that of the noise, (N, 2).

    left, right: (N, 2), of the equation left e = right that remains without the offsets.
    scales: (N, 4), level, mean square of the residual of the edges alone, sum of weights, |c|.

    It is a ridge estimate. It expects a gradient of GRADIENT, or a larger one if the gradient that
    fits best exceeds the noise by SIGNIFICANT.
    """
    level, noise, weights, contrast = scales.T
    best = right / left
    gained = (best * right).sum(axis=1)
    noise = np.maximum(noise - gained / weights, (LEAST_CONTRAST * contrast) ** 2)
    surely = np.maximum(0, 1 - SIGNIFICANT * noise / np.maximum(gained, 1e-30))
    expected = (GRADIENT * level) ** 2 + surely * (best**2).sum(axis=1) / 2
    ridged = left + (noise / expected)[:, None]
    return right / ridged, 1 / ridged
