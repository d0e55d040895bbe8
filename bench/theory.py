"""The theory of the criteria: closed forms on a continuous ring against rings of 16 samples.

    python bench/theory.py              writes results/theory.json, a few seconds

An ideal corner has four sectors; the black ones begin at angles a0 and a2 and end at a1 and
a3. Around its ring the binary image f is 1 where black, and its Fourier coefficients are
F_k = sum over the black sectors of (exp(-i k begin) - exp(-i k end)) / (2 pi i k): for sectors of
width w that lie opposite each other |F2| = |sin w| / pi, F1 = F3 = 0 (the paper's Eq. 5). The
circular cross-correlation of two such rings (Eq. 15), each rotated by some angle, is piecewise
linear in the rotation: the overlap of the sectors over pi. A ring of radius r around a point beside
the corner crosses a boundary that passes the point at distance e at an angle that is shifted by
asin(e / r). From this follows how the coefficients change with the shift.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from environment import environment, parser_of, write_result

from cmp_cl.reference import ring

RADIUS = {"inner": 3.0, "outer": 5.0}


def samples(name: str, width: float, azimuth: float, shift: tuple[float, float]) -> np.ndarray:
    """Return the 16 samples, 1 where black, around a point `shift` (px) away from an ideal corner.

    The lines of the corner run at azimuth and azimuth + width; black is between them.
    """
    offsets = ring.INNER if name == "inner" else ring.OUTER[5]
    x, y = (np.array(offsets, float) + shift).T
    return _black(x, y, width, azimuth).astype(float)


def _black(x: np.ndarray, y: np.ndarray, width: float, azimuth: float) -> np.ndarray:
    angle = (np.arctan2(y, x) - azimuth) % math.pi
    return angle < width


def continuous(
    name: str, width: float, azimuth: float, shift: tuple[float, float], orders: Sequence[int]
) -> list[float]:
    """Return 16 |F_k| in closed form on a circle of the ring's radius."""
    radius = RADIUS[name]
    ends = []
    for line in (azimuth, azimuth + width):
        # The line passes the ring's centre at this signed distance.
        apart = math.cos(line) * shift[1] - math.sin(line) * shift[0]
        bend = math.asin(max(-1.0, min(1.0, apart / radius)))
        ends.append((line - bend, line + math.pi + bend))
    (a0, a2), (a1, a3) = ends
    sizes = []
    for k in orders:
        total = sum(
            np.exp(-1j * k * begin) - np.exp(-1j * k * end) for begin, end in ((a0, a1), (a2, a3))
        )
        sizes.append(16 * abs(total / (2j * math.pi * k)))
    return sizes


def spectrum(name: str, width: float, azimuth: float, shift: tuple[float, float]) -> list[float]:
    """Return |F1|, |F2|, |F3| of the 16 samples."""
    return [float(size) for size in np.abs(np.fft.fft(samples(name, width, azimuth, shift)))[1:4]]


def correlation(width: float, other: float, azimuth: float) -> tuple[np.ndarray, np.ndarray]:
    """Return R(k) sampled, and its closed form at the same rotations, normalised by sqrt(n1 n2).

    The outer ring sees sectors of `width`, the inner one of `other`, rotated by `azimuth`.
    """
    outer = samples("outer", width, 0.3, (0, 0))
    inner = samples("inner", other, 0.3 + azimuth, (0, 0))
    turns = np.arange(16)
    sampled = np.array([float(outer @ np.roll(inner, -k)) for k in turns])
    sampled /= math.sqrt(max(outer.sum() * inner.sum(), 1))
    formula = [
        _overlap(width, other, azimuth - k * math.pi / 8) / math.sqrt(width * other) for k in turns
    ]
    return sampled, np.array(formula)


def _overlap(width: float, other: float, turn: float) -> float:
    """Return the length that [0, width] and [turn, turn + other] share on a circle of length pi."""
    shared = 0.0
    for lap in (-2, -1, 0, 1, 2):
        begin = turn % math.pi + lap * math.pi
        shared += max(0.0, min(width, begin + other) - max(0.0, begin))
    return shared


def curves() -> dict[str, Any]:
    """Return both, sampled and closed, along sector width, azimuth and shift."""
    whole: dict[str, Any] = {}
    sweeps = {
        "width": [(w, 0.3, (0.0, 0.0)) for w in np.linspace(0.05, math.pi - 0.05, 121)],
        "azimuth": [(math.pi / 2, a, (0.0, 0.0)) for a in np.linspace(0, math.pi, 121)],
        "shift": [(math.pi / 2, 0.3, (float(d), 0.0)) for d in np.linspace(0, 2.9, 121)],
    }
    place = {"width": 0, "azimuth": 1}
    for along, points in sweeps.items():
        rows = {"at": [p[place[along]] if along in place else p[2][0] for p in points]}
        for name in RADIUS:
            rows[f"{name}_sampled"] = [spectrum(name, *point) for point in points]
            rows[f"{name}_formula"] = [continuous(name, *point, (1, 2, 3)) for point in points]
        whole[along] = rows
    whole["correlation"] = {}
    for width, other in ((math.pi / 2, math.pi / 2), (math.pi / 3, math.pi / 2), (0.9, 0.6)):
        sampled, formula = correlation(width, other, 0.0)
        whole["correlation"][f"{width:.2f}, {other:.2f}"] = {
            "sampled": sampled.tolist(),
            "formula": formula.tolist(),
        }
    return whole


def agreement(whole: dict[str, Any]) -> dict[str, float]:
    """Return the errors of 16 samples against the closed form: root mean square of |F2|, of 16, and
    R."""
    figures = {}
    for along in ("width", "azimuth", "shift"):
        for name in RADIUS:
            sampled = np.array(whole[along][f"{name}_sampled"])[:, 1]
            formula = np.array(whole[along][f"{name}_formula"])[:, 1]
            figures[f"F2, {name}, {along}"] = float(np.sqrt(np.mean((sampled - formula) ** 2)))
    apart = [np.subtract(c["sampled"], c["formula"]) for c in whole["correlation"].values()]
    figures["correlation"] = float(np.sqrt(np.mean(np.concatenate(apart) ** 2)))
    return figures


def _rounded(value: Any) -> Any:
    """Round floats to 4 digits: curves for a plot."""
    if isinstance(value, float):
        return round(value, 4)
    if isinstance(value, dict):
        return {name: _rounded(each) for name, each in value.items()}
    return [_rounded(each) for each in value] if isinstance(value, list) else value


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parser_of(__doc__).parse_args(argv)
    whole = curves()
    figures = agreement(whole)
    for what, rms in figures.items():
        print(f"{what:24} differs by {rms:.3f} rms")
    result = {"kind": "theory", "environment": environment(), "agreement": figures, **whole}
    write_result(_rounded(result), arguments.out, indent=None)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
