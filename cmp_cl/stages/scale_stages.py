"""The stage from the image to its working scale: pixel by pixel, or for CPUs in bands of rows."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmp_cl.opencl.device import DeviceKind
from cmp_cl.stages.plan_base import GROUP, Launch, PlanBase, multiple
from cmp_cl.stages.resampling import resampling_weights

VECTOR = 8  # columns that kernels/scale_bands.cl takes at a time
FOUR = 4  # taps that it reads at once
BANDS = 8  # for each of a device's units: they share the work out evenly

Weights = tuple[NDArray[np.int32], NDArray[np.int32]]  # of an axis, see `resampling_weights`


def files(plan: PlanBase) -> list[str]:
    """The kernel files."""
    if plan.scale is None:
        return []
    return ["scale_bands" if _by_bands(plan) else "scale"]


def layout(plan: PlanBase) -> dict[str, int]:
    """Bytes of the arrays that are needed only in passing, see `Plan._layouts`."""
    if plan.scale is None or not _by_bands(plan):
        return {}
    bands = 4 * plan.frames * _bands(plan)
    return {
        "column_sums": bands * plan.full_step,
        "row_totals": bands * plan.step * plan.dtype.itemsize,
    }


def launches(plan: PlanBase) -> list[Launch]:
    """From the image to that at its working scale."""
    if plan.scale is None:
        return []
    rows, columns = (
        resampling_weights(size, working, plan.scale)
        for size, working in zip(plan.shape, plan.working, strict=True)
    )
    if _by_bands(plan):
        return [_bands_of_rows(plan, rows, columns)]
    return [_pixels(plan, rows, columns)]


def _by_bands(plan: PlanBase) -> bool:
    return plan.device.kind is DeviceKind.CPU


def _bands(plan: PlanBase) -> int:
    return -(-plan.working[0] // _band_rows(plan))


def _band_rows(plan: PlanBase) -> int:
    return -(-plan.working[0] // (BANDS * plan.device.handle.max_compute_units))


def _tables(
    plan: PlanBase, first: NDArray[np.int32], weights: NDArray[np.int32]
) -> tuple[Any, ...]:
    return plan.constant(first), plan.constant(weights), np.uint32(weights.shape[1])


def _pixels(plan: PlanBase, rows: Weights, columns: Weights) -> Launch:
    first_x, weights_x = columns
    by_tap = (plan.constant(first_x), plan.constant(weights_x.T), np.uint32(weights_x.shape[1]))
    sizes = (plan.shape[0], plan.full_step, *plan.working, plan.step)
    arguments = (*_tables(plan, *rows), *by_tap, *(np.uint32(n) for n in sizes), plan.image)
    items = (multiple(plan.working[1], GROUP), plan.working[0], plan.frames)
    return plan.stage("resample", items, (GROUP, 1, 1), plan.buffers["image"], *arguments)


def _bands_of_rows(plan: PlanBase, rows: Weights, columns: Weights) -> Launch:
    first_y, weights_y = rows[0], _padded(rows[1], len(rows[1]), max(rows[1].shape[1], 2))
    count, taps = multiple(plan.working[1], VECTOR), multiple(columns[1].shape[1], FOUR)
    first_x = plan.constant(np.pad(columns[0], (0, count - plan.working[1])))
    # Of eight outputs and four taps those of outputs k and k + 4 lie beside each other.
    weights_x = _padded(columns[1], count, taps).reshape(-1, 2, FOUR, taps // FOUR, FOUR)
    by_taps = plan.constant(weights_x.transpose(3, 0, 2, 1, 4).astype(np.uint16))
    tables = (*_tables(plan, first_y, weights_y), first_x, by_taps, np.uint32(taps))
    sizes = (*plan.shape, plan.full_step, *plan.working, plan.step, _band_rows(plan))
    sums = (plan.arrays["column_sums"], plan.arrays["row_totals"])
    arguments = (*tables, *(np.uint32(n) for n in sizes), *sums, plan.image)
    items = (_bands(plan), plan.frames)
    return plan.stage("resample_bands", items, (1, 1), plan.buffers["image"], *arguments)


def _padded(weights: NDArray[np.int32], rows: int, columns: int) -> NDArray[np.int32]:
    """The weights and zeros."""
    return np.pad(weights, ((0, rows - len(weights)), (0, columns - weights.shape[1])))
