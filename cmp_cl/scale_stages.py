"""The stage from the image to its working scale: pixel by pixel, or for CPUs in bands of rows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.device import DeviceKind
from cmp_cl.launch import Launch, multiple
from cmp_cl.resampling import resampling_weights

if TYPE_CHECKING:
    from cmp_cl.plan import Plan

VECTOR = 8  # columns that kernels/scale_bands.cl takes at a time
FOUR = 4  # taps that it reads at once
BANDS = 8  # for each of a device's units: they share the work out evenly

Weights = tuple[NDArray[np.int32], NDArray[np.int32]]  # of an axis, see `resampling_weights`


def files(plan: Plan) -> list[str]:
    """The kernel files."""
    if plan.scale is None:
        return []
    return ["scale_bands" if _by_bands(plan) else "scale"]


def layout(plan: Plan) -> dict[str, int]:
    """Bytes of the arrays that are needed only in passing, see `Plan.layouts`."""
    if plan.scale is None or not _by_bands(plan):
        return {}
    row = 4 * plan.frames * _bands(plan) * multiple(plan.working[1], VECTOR)
    return {"row_sums": 2 * row, "both_sums": row * plan.dtype.itemsize}


def launches(plan: Plan) -> list[Launch]:
    """From the image to that at its working scale."""
    if plan.scale is None:
        return []
    rows, columns = (
        resampling_weights(size, working, plan.scale)
        for size, working in zip(plan.shape, plan.working, strict=True)
    )
    if _by_bands(plan):
        return [_bands_of_rows(plan, rows, columns)]
    tables = (*_tables(plan, *rows), *_tables(plan, *columns))
    sizes = (*plan.shape, plan.full_step, plan.working[0], plan.step)
    arguments = (*tables, *(np.uint32(n) for n in sizes), plan.image)
    items = (plan.working[1], plan.working[0], plan.frames)
    return [plan.stage("resample", items, None, plan.buffers["image"], *arguments)]


def _by_bands(plan: Plan) -> bool:
    return plan.device.kind is DeviceKind.CPU


def _bands(plan: Plan) -> int:
    return -(-plan.working[0] // _band_rows(plan))


def _band_rows(plan: Plan) -> int:
    return -(-plan.working[0] // (BANDS * plan.device.handle.max_compute_units))


def _tables(plan: Plan, first: NDArray[np.int32], weights: NDArray[np.int32]) -> tuple[Any, ...]:
    return plan.constant(first), plan.constant(weights), np.uint32(weights.shape[1])


def _bands_of_rows(plan: Plan, rows: Weights, columns: Weights) -> Launch:
    first, weights = columns
    count, taps = multiple(len(first), VECTOR), multiple(weights.shape[1], FOUR)
    by_tap = np.zeros((taps, count), np.int32)
    by_tap[: weights.shape[1], : len(first)] = weights.T
    places = plan.constant(np.pad(first, (0, count - len(first))))
    tables = (*_tables(plan, *rows), places, plan.constant(by_tap), np.uint32(taps))
    sizes = (count, plan.shape[0], plan.full_step, *plan.working, plan.step, _band_rows(plan))
    sums = (plan.arrays["row_sums"], plan.arrays["both_sums"])
    arguments = (*tables, *(np.uint32(n) for n in sizes), *sums, plan.image)
    items = (_bands(plan), plan.frames)
    return plan.stage("resample_bands", items, (1, 1), plan.buffers["image"], *arguments)
