"""The rows of the tables: our configurations, each optional stage, the peers, and both followed by
the grid step."""

import contextlib
import dataclasses
import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from peers import PEERS, Detect, Pattern

from cmp_cl import (
    BinaryRings,
    Corners,
    Detector,
    DetectorConfig,
    EdgeLines,
    Midlines,
    RapidCriteria,
    RingHarmonic,
    SpectralCriteria,
)
from cmp_cl.errors import GridError
from cmp_cl.grid import build_grid, filter_grid
from cmp_cl.grid.grid import MEASURED
from cmp_cl.image import GreyImage
from cmp_cl.reference import refine

DEFAULT = "cmp_cl, default"
LINES = "cmp_cl, EDGE_LINES"
FOR_CELL = "cmp_cl, for_cell"
PAPER = "cmp_cl, paper's preset"
RINGS = "cmp_cl, binary rings"
FULL = "cmp_cl, full with grid"
GRIDDED = f"{DEFAULT} + grid"
FILTERED = f"{DEFAULT} + grid + filter"


class Method(NamedTuple):
    """A row of a table: its name, its settings in words, and what runs."""

    name: str
    settings: str
    detect: Detect
    slow: bool = False
    grid: bool = False


def configs(markers: int, cell: float) -> dict[str, DetectorConfig]:
    """Return our configurations by the name of their row: presets, then each option alone.

    cell: side of a cell at rest, px.
    """
    default = DetectorConfig()
    rings = BinaryRings()
    table_2 = 40 if markers > 40 else markers
    paper = DetectorConfig.paper(table_2)
    gated = dataclasses.replace(paper.detection, contrast=rings.contrast)
    found = {
        DEFAULT: default,
        LINES: default.replace(refinement=EdgeLines()),
        FOR_CELL: DetectorConfig.for_cell(cell),
        "cmp_cl, centroids": default.replace(refinement=None),
        "cmp_cl, midlines": default.replace(refinement=Midlines()),
        PAPER: paper,
        "cmp_cl, paper's preset + gate": paper.replace(detection=gated),
    }
    alone: dict[str, RingHarmonic | BinaryRings] = {
        "cmp_cl, no squeezed cells": RingHarmonic(fine=False),
        RINGS: rings,
        f"{RINGS}, window of Table 2": BinaryRings(threshold=gated.threshold),
        f"{RINGS}, for the cell": BinaryRings.for_cell(cell),
        f"{RINGS}, no gate": BinaryRings(contrast=None),
        f"{RINGS}, corrosion below 4": BinaryRings(criteria=RapidCriteria(corrosion_threshold=4)),
        f"{RINGS}, no corrosion criterion": BinaryRings(
            criteria=RapidCriteria(corrosion_threshold=None)
        ),
        f"{RINGS}, outer radius 4": BinaryRings(outer_radius=4),
        f"{RINGS}, spectral": BinaryRings(criteria=SpectralCriteria()),
    }
    return found | {name: DetectorConfig(detection=each) for name, each in alone.items()}


def own(name: str, config: DetectorConfig, shape: tuple[int, int]) -> Method:
    """Return one of our configurations as a row."""
    detector = Detector(shape=shape, config=config)
    return Method(name, repr(config), lambda image: detector(image).xy)


def own_with_grid(
    name: str, config: DetectorConfig, frame: Any, *, filtered: bool = False
) -> Method:
    """Return one of our configurations with the grid step as a row; only measured nodes count.

    filtered: with the lattice filter too.
    """
    detector = Detector(shape=frame.image.shape, config=config)
    size = (frame.markers, frame.markers)

    def detect(image: GreyImage) -> np.ndarray:
        return _measured(detector(image), image, size, filtered=filtered)

    settings = f"{config!r}, build_grid(shape={size}){', filter_grid' * filtered}"
    return Method(name, settings, detect, grid=True)


def peer(name: str, pattern: Pattern) -> Method:
    """Return a peer as a row, at the settings that the search found for that density."""
    entry = PEERS[name]
    settings = entry.settings(pattern.markers)
    detect = entry.make(settings, pattern)
    return Method(entry.label, json.dumps(settings), detect, entry.slow, entry.labels)


def peer_with_grid(name: str, pattern: Pattern) -> Method:
    """Return a peer with our grid step as a row. The edge angles that the step needs at the peer's
    positions come from NumPy, so the result is right but the time is no fair one."""
    plain = peer(name, pattern)
    size = (pattern.markers, pattern.markers)

    def detect(image: GreyImage) -> np.ndarray:
        return _measured(_with_edges(plain.detect(image), image), image, size)

    return Method(f"{plain.name} + our grid", plain.settings, detect, plain.slow, grid=True)


def _with_edges(xy: np.ndarray, image: GreyImage) -> Corners:
    rows, columns = image.shape
    pixel = np.clip(np.rint(xy).astype(np.int64), 0, (columns - 1, rows - 1))
    order = np.lexsort((pixel[:, 0], pixel[:, 1]))
    xy, pixel = xy[order], pixel[order]
    seen = refine.refine(image, pixel, xy.astype(np.float64), EdgeLines(), 1.0)
    return Corners(
        xy=xy.astype(np.float32),
        pixel=pixel.astype(np.int32),
        octave=np.zeros(len(xy), np.uint8),
        response=np.ones(len(xy), np.float32),
        method=seen.method,
        refusal=seen.refusal,
        sigma=seen.sigma.astype(np.float32),
        edges=seen.edges.astype(np.float32),
        doubtful=seen.doubtful,
        device="NumPy",
    )


def _measured(
    corners: Corners, image: GreyImage, size: tuple[int, int], *, filtered: bool = False
) -> np.ndarray:
    with contextlib.suppress(GridError):
        grid = build_grid(corners, image, shape=size)
        measured = np.isin(grid.status, MEASURED)
        xy = filter_grid(grid.xy, measured=measured).values if filtered else grid.xy
        return xy[measured]
    return np.empty((0, 2), np.float32)


def warm(methods: Sequence[Method], image: GreyImage) -> None:
    """Run each method once: some compile or allocate only then."""
    for method in methods:
        method.detect(image)
