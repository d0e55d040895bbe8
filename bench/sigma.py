"""Positions and displacements before and after the lattice filter, and whether sigma is right.

    python bench/sigma.py --quick       20 frames, a minute
    python bench/sigma.py               worn, new and noisy prints, about ten minutes

A node counts if the numbering of both frames is right. A share is of coordinates whose error is
within two stated standard deviations: 95 % if errors are normal and sigma is right. A row of
results/sigma.csv is a kind of figure on the frames of one wear and severity.
"""

import argparse
import dataclasses
import itertools
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from environment import main_of
from scenes import DENSITIES, INDENTERS, SEVERITIES, TEST_SEED, rendered

from cmp_cl import Detector, GridError
from cmp_cl.grid.grid import MEASURED
from cmp_cl.motion import displacement
from cmp_cl.synthetic import Scene, random_scene

CORROSIONS = (0.0, 0.3, 1.0, 2.0)
NOISES = (0.5, 8.0)  # grey levels, beside the 2 to 4.5 of other scenes
FIRST_SEED = TEST_SEED + 700_000
Errors = tuple[np.ndarray, np.ndarray]  # (N, 2) and their sigma (N,), px


def scenes(quick: bool) -> Iterator[Scene]:
    """Yield two prints of each wear, density and severity, then prints of other noise."""
    combined = itertools.product(range(1 if quick else 2), CORROSIONS, DENSITIES, SEVERITIES)
    for seed, (_, corrosion, markers, severity) in enumerate(combined, FIRST_SEED):
        if quick and markers != 40:
            continue
        indenter = INDENTERS[seed % len(INDENTERS)]
        yield random_scene(
            seed, markers=markers, severity=severity, indenter=indenter, corrosion=corrosion
        )
    for noise, severity in itertools.product(() if quick else NOISES, SEVERITIES):
        scene = random_scene(FIRST_SEED + 5000 + int(100 * severity), severity=severity)
        yield dataclasses.replace(scene, noise=noise)


def measured(scene: Scene, detector: Detector) -> dict[str, Errors] | None:
    """Measure a scene against its frame at rest; None if the numbering is wrong or missing."""
    shape = (scene.markers, scene.markers)
    still, pressed = rendered(scene.at_rest()), rendered(scene)
    try:
        rest = detector.grid(still.image, shape=shape)[1]
        now = detector.grid(pressed.image, like=rest)[1]
    except GridError:
        return None
    numbered = [frame.truth[:, :2].reshape(*shape, 2) for frame in (still, pressed)]
    apart = [np.nanmedian(np.abs(rest.xy - np.rot90(numbered[0], k))) for k in range(4)]
    at_rest, truth = (np.rot90(each, int(np.argmin(apart))) for each in numbered)
    wrong = np.linalg.norm(now.xy - truth, axis=2) > 0.6 * pressed.cell
    if np.count_nonzero(wrong) > 0.05 * wrong.size:
        return None
    field = displacement(rest, now)
    moved = truth - at_rest
    good = np.isin(now.status, MEASURED) & np.isin(rest.status, MEASURED) & ~wrong
    good &= np.isfinite(field.displacement[..., 0])
    kinds = {
        "position": (now.xy - truth, now.sigma),
        "displacement, raw": (now.xy - rest.xy - moved, field.raw.sigma),
        "displacement": (field.displacement - moved, field.sigma),
    }
    return {kind: (error[good], sigma[good]) for kind, (error, sigma) in kinds.items()}


def summary(kind: str, parts: Sequence[Errors], **group: Any) -> dict[str, Any]:
    """Return the figures of a kind over some frames."""
    shares = []
    for error, sigma in parts:
        ratio = np.abs(error) / sigma[:, None]
        shares.append(float(np.mean(ratio[np.isfinite(ratio).all(axis=1)] <= 2)))
    squares = [float(np.square(error).sum(axis=1).mean()) for error, _ in parts]
    return {
        "kind": kind,
        **group,
        "frames": len(parts),
        "rms": math.sqrt(np.mean(squares)),
        "within_2": float(np.mean(shares)),
    }


def rows(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    detectors: dict[int, Detector] = {}
    groups: dict[tuple[str, float, float, float], list[Errors]] = defaultdict(list)
    lost = 0
    for scene in scenes(arguments.quick):
        detector = detectors.setdefault(scene.markers, Detector(shape=scene.shape))
        found = measured(scene, detector)
        lost += found is None
        noise = scene.noise if scene.noise in NOISES else math.nan
        for kind, errors in (found or {}).items():
            groups[kind, scene.corrosion, scene.severity, noise].append(errors)
    for (kind, corrosion, severity, noise), parts in groups.items():
        yield summary(kind, parts, corrosion=corrosion, severity=severity, noise=noise)
    print(f"{lost} scenes were not numbered")


main = main_of(__doc__, {"sigma": rows}, quick="20 frames, a minute")

if __name__ == "__main__":
    raise SystemExit(main())
