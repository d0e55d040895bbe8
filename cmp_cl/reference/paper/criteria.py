"""The four rapid criteria (section 3.4, Eqs. 18 to 24) on ring bits."""

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.config import RapidCriteria
from cmp_cl.reference.paper import ring


def rapid(
    inner: NDArray[np.uint16], outer: NDArray[np.uint16], criteria: RapidCriteria
) -> dict[str, Any]:
    """Evaluate the rapid criteria but that of corrosion at every pixel, given its ring bits.

    Returns fields of `cmp_cl.corners.Maps`; the response is that of a candidate.
    """
    d2 = sector_differences()[inner]
    inner_count = inner_transitions(inner)
    outer_count = outer_transitions(outer)
    difference = np.bitwise_count(inner ^ outer)
    candidate = (
        (inner_count == 4)
        & (outer_count == 4)
        & (d2 < criteria.sector_threshold)
        & (difference < criteria.ring_threshold)
    )
    return dict(
        inner_transitions=inner_count,
        outer_transitions=outer_count,
        sector_difference=d2,
        ring_difference=difference,
        candidate=candidate,
        response=criteria.sector_threshold - d2.astype(np.int32),
    )


def inner_transitions(mask: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Count the transitions of the ring (Eq. 19)."""
    count: NDArray[np.uint8] = np.bitwise_count(mask ^ ring.rotate(mask, 1))
    return count


def outer_transitions(mask: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Count the transitions to a run of two samples or more (Eq. 20)."""
    starts = (mask ^ ring.rotate(mask, 1)) & (mask ^ ring.rotate(mask, 2))
    return np.bitwise_count(starts)


def corrosion(binary: NDArray[np.bool_], outer: NDArray[np.uint16]) -> NDArray[np.int8]:
    """Return Cd of Eq. 23, which compares black and white on the outer ring with the corrosion
        region.

    It is max(n1 - nR, (16 - n1) - (21 - nR)), if n1 of 16 samples and nR of 21 pixels are black.
    """
    n1 = np.bitwise_count(outer).astype(np.int64)
    region = ring.black_in_region(binary)
    cd: NDArray[np.int8] = np.maximum(n1 - region, region - n1 - 5).astype(np.int8)
    return cd


@functools.cache
def sector_differences() -> NDArray[np.uint8]:
    """Return d2 = max(|L0 - L2|, |L1 - L3|) of four runs (Eq. 21), else 255: (65536,)."""
    black = ring.bits(ring.all_rings())
    starts = black != np.roll(black, 1, axis=1)
    four = starts.sum(axis=1) == 4
    position = np.nonzero(starts[four])[1].reshape(-1, 4)
    length = (np.roll(position, -1, axis=1) - position) % 16
    d2 = np.abs(length[:, :2] - length[:, 2:]).max(axis=1)
    table = np.full(1 << 16, 255, np.uint8)
    table[four] = d2
    return table
