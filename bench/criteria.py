"""Two choices of the paper, measured: the window mean against a threshold for each ring
(its Fig. 3), and the rapid against the spectral criteria, in decisions and in time.

    python bench/criteria.py            writes results/criteria.json, about two minutes

The thresholds are compared in NumPy, with the same gate, suppression and refinement after
them; the times are the device's.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from environment import environment, parser_of, write_result
from scenes import TEST_SEED, Frame, rendered
from speed import stages

from cmp_cl import BinaryRings, DetectorConfig, EdgeLines, SpectralCriteria, reference
from cmp_cl.config import RapidCriteria
from cmp_cl.image import GreyImage
from cmp_cl.reference import criteria, gate, nms, refine, ring
from cmp_cl.synthetic import random_scene
from cmp_cl.synthetic.scoring import total

RAPID = DetectorConfig(detection=BinaryRings())
SPECTRAL = DetectorConfig(detection=BinaryRings(criteria=SpectralCriteria()))
SEED = TEST_SEED + 800_000
SEVERITIES = (0.25, 0.75, 1.25)
CRITERIA_STAGE = "criteria"  # in the name of every kernel that decides
Threshold = Callable[[np.ndarray], np.ndarray]  # (samples, H, W) -> (H, W)
PER_RING: dict[str, Threshold] = {
    "mean of the ring": lambda greys: greys.mean(0),
    "middle of the ring's range": lambda greys: (greys.min(0) + greys.max(0)) / 2,
}


def corners_per_ring(image: GreyImage, threshold: Threshold) -> np.ndarray:
    """Return (N, 2) positions where each ring is compared with its own threshold."""
    inner_grey, outer_grey = _greys(image, ring.INNER), _greys(image, ring.OUTER[5])
    inner_threshold = threshold(inner_grey)
    inner = _mask(inner_grey < inner_threshold)
    outer = _mask(outer_grey < threshold(outer_grey))
    in_region = (_greys(image, ring.REGION) < inner_threshold).sum(0)
    usual = RapidCriteria()
    found = criteria.rapid(
        image < inner_threshold, inner, outer, RapidCriteria(corrosion_threshold=None)
    )
    black = ring.popcount(outer).astype(int)
    corrosion = np.maximum(black - in_region, in_region - black - 5)
    candidate = found.candidate & (corrosion < (usual.corrosion_threshold or 0))
    response = np.where(candidate, found.response, 0)
    maximum = nms.maxima(response, nms.score(response), 3)
    contrast = BinaryRings().contrast
    if contrast is not None:
        _, maximum = gate.gate(image, inner, maximum, 5, contrast, 255, 1)
    y, x = np.nonzero(maximum)
    centroid, rounded = nms.centroids(response, x, y)
    return refine.refine(image, rounded, centroid, EdgeLines(), 1.0).xy


def _greys(image: GreyImage, offsets: Sequence[tuple[int, int]]) -> np.ndarray:
    """Return (samples, H, W) float32: the grey level of every sample around every pixel."""
    reach = ring.PADDING
    rows, columns = image.shape
    wide = np.pad(image, reach, mode="edge").astype(np.float32)
    return np.stack(
        [wide[reach + y : reach + y + rows, reach + x : reach + x + columns] for x, y in offsets]
    )


def _mask(black: np.ndarray) -> np.ndarray:
    weights = (1 << np.arange(16)).astype(np.uint16)[:, None, None]
    return np.asarray((black * weights).sum(0), np.uint16)


def thresholds(frames: Sequence[Frame]) -> list[dict[str, Any]]:
    """Measure the errors with the window mean and with a threshold for each ring."""
    ways: dict[str, Callable[[GreyImage], np.ndarray]] = {
        "mean of the window": lambda image: reference.detect(image, RAPID).xy
    }
    for name, threshold in PER_RING.items():
        ways[name] = lambda image, t=threshold: corners_per_ring(image, t)
    return [
        {"threshold": name, **total(f.score(find(f.image)) for f in frames).summary()}
        for name, find in ways.items()
    ]


def decisions(frames: Sequence[Frame]) -> dict[str, Any]:
    """Count how often rapid and spectral criteria disagree near a corner, and elsewhere."""
    near_pixels = near_differ = far_pixels = far_differ = 0
    for frame in frames:
        one = reference.maps(frame.image, RAPID).candidate
        other = reference.maps(frame.image, SPECTRAL).candidate
        rows, columns = np.indices(frame.image.shape)
        near = np.zeros(frame.image.shape, np.bool_)
        for x, y in frame.truth:
            part = np.s_[max(int(y) - 2, 0) : int(y) + 4, max(int(x) - 2, 0) : int(x) + 4]
            near[part] |= np.hypot(columns[part] - x, rows[part] - y) <= 1.5
        near_pixels += int(near.sum())
        near_differ += int(((one != other) & near).sum())
        far_pixels += int((~near).sum())
        far_differ += int(((one != other) & ~near).sum())
    return {
        "near_pixels": near_pixels,
        "near_disagree": near_differ / near_pixels,
        "far_disagree": far_differ / far_pixels,
    }


def times(frame: Frame) -> dict[str, Any]:
    """Return the ms of the kernels from the binary image to the candidates, for both."""
    spent = {}
    for name, config in (
        ("rapid", RAPID),
        ("spectral", SPECTRAL),
    ):
        kernels = stages(config, frame)["stages"]
        picked = {k: ms for k, ms in kernels.items() if CRITERIA_STAGE in k}
        spent[name] = {"ms": sum(picked.values()), "stages": picked}
    return spent | {"ratio": spent["spectral"]["ms"] / spent["rapid"]["ms"]}


def main(argv: Sequence[str] | None = None) -> int:
    arguments = parser_of(__doc__, quick="fewer scenes").parse_args(argv)
    frames = [
        rendered(random_scene(SEED + k, markers=markers, severity=severity))
        for k in range(1 if arguments.quick else 2)
        for markers in (20, 30, 40)
        for severity in SEVERITIES
    ]
    result = {
        "kind": "criteria",
        "environment": environment(),
        "first_seed": SEED,
        "thresholds": thresholds(frames),
        "decisions": decisions(frames),
        "times": times(frames[0]),
    }
    for row in result["thresholds"]:
        print(
            f"{row['threshold']:28} succeeds in {row['success']} of {row['frames']}, missed "
            f"{row['missed']}, false {row['false']}, RMSE {row['rmse']:.3f} px"
        )
    far = result["decisions"]
    print(
        f"rapid and spectral disagree on {100 * far['near_disagree']:.2f} % of pixels near a "
        f"corner, {100 * far['far_disagree']:.4f} % of the others; "
        f"spectral takes {result['times']['ratio']:.1f} times as long"
    )
    write_result(result, arguments.out, quick=arguments.quick)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
