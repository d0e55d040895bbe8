"""ChESS and the circular spectrum as OpenCL kernels, for a fair time on the same device."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyopencl as cl

import cmp_cl

PAD = 16
ROOM = 65536
LOCAL = 64, 4
LOWEST = np.float32(-1e30)
_SOURCE = Path(__file__).with_name("ring_peers.cl")


class RingPeer:
    """Corners from one of the two ring responses; buffers and kernels are made at first use.

    settings: threshold (share of the largest response), sigma (smoothing, px; 0 for none),
    radius (of suppression, px), and weight (|F1| + |F3| against |F2|) for the spectrum.
    """

    def __init__(self, settings: dict[str, Any]) -> None:
        self._settings = settings
        self._shape: tuple[int, ...] = ()

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Return (N, 2) float32, px, in the order of (y, x)."""
        if image.shape != self._shape:
            self._prepare(image.shape)
        queue, beside = self._queue, self._padded.shape[1] - image.shape[1] - PAD
        cv2.copyMakeBorder(image, PAD, PAD, PAD, beside, cv2.BORDER_REPLICATE, dst=self._padded)
        cl.enqueue_copy(queue, self._grey, self._padded, is_blocking=False)
        for kernel, size, local in self._dense:
            cl.enqueue_nd_range_kernel(queue, kernel, size, local)
        cl.enqueue_copy(queue, self._rows, self._largest)
        threshold = max(float(self._rows.max()), 0.0) * self._settings["threshold"]
        self._list.set_arg(5, np.float32(threshold))
        cl.enqueue_fill_buffer(queue, self._count, np.uint32(0), 0, 4)
        cl.enqueue_nd_range_kernel(queue, self._list, _whole(image.shape), LOCAL)
        count = np.empty(1, np.uint32)
        cl.enqueue_copy(queue, count, self._count)
        found = np.empty((min(int(count[0]), ROOM), 2), np.float32)
        if len(found):
            cl.enqueue_copy(queue, found, self._found)
        return found[np.lexsort((found[:, 0], np.rint(found[:, 1])))]

    def _prepare(self, shape: tuple[int, ...]) -> None:
        settings = self._settings
        context = cl.Context([cmp_cl.select_device().handle])
        self._queue = cl.CommandQueue(context)
        options = ["-cl-std=CL1.2", f"-DPAD={PAD}", f"-DRADIUS={settings['radius']}"]
        program = cl.Program(context, _SOURCE.read_text()).build(options)
        step = -(-(shape[1] + 2 * PAD) // 16) * 16
        self._padded = np.zeros((shape[0] + 2 * PAD, step), np.uint8)
        self._rows = np.empty(shape[0], np.float32)

        def room(numbers: int, value: float = 0) -> cl.Buffer:
            buffer = cl.Buffer(context, cl.mem_flags.READ_WRITE, 4 * numbers)
            cl.enqueue_fill_buffer(self._queue, buffer, np.float32(value), 0, 4 * numbers)
            return buffer

        def bound(name: str, *arguments: Any) -> cl.Kernel:
            kernel = cl.Kernel(program, name)
            kernel.set_args(*arguments)
            return kernel

        pixels, area = self._padded.size, (*map(np.uint32, shape), np.uint64(step))
        wide, half, soft = (room(pixels) for _ in range(3))
        response, peak = room(pixels, LOWEST), room(pixels, LOWEST)
        self._kept = [wide, half, soft, response, peak]  # a kernel does not keep its buffers
        self._grey, self._largest = room(-(-pixels // 4)), room(shape[0])
        self._count, self._found = room(1), room(2 * ROOM)
        inside, everywhere = _whole(shape), _whole(self._padded.shape)
        dense, image = [(bound("widen", self._grey, *area, wide), everywhere)], wide
        if settings["sigma"]:
            taps, image = _taps(settings["sigma"]), soft
            dense.append((bound("smooth", wide, *area, np.uint64(1), *taps, half), everywhere))
            dense.append((bound("smooth", half, *area, area[2], *taps, soft), everywhere))
        if "weight" in settings:
            weight = np.float32(settings["weight"])
            dense.append((bound("spectrum", image, *area, weight, response), inside))
        else:
            dense.append((bound("chess", image, wide, *area, response), inside))
        dense.append((bound("row_peak", response, *area, peak), inside))
        self._dense = [(*each, LOCAL) for each in dense]
        per_row = (-(-shape[0] // 16) * 16,)
        self._dense.append((bound("row_largest", peak, *area, self._largest), per_row, (16,)))
        most = np.float32(0), np.uint32(ROOM)
        self._list = bound("list_peaks", response, peak, *area, *most, self._count, self._found)
        self._shape = shape


def _whole(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the work-items for an image (H, W), in whole groups."""
    return tuple(-(-n // m) * m for n, m in zip(shape[::-1], LOCAL, strict=True))


def _taps(sigma: float) -> list[np.float32]:
    """Return the weights of the centre and of the three neighbours on each side."""
    weights = np.exp(-0.5 * (np.arange(4) / sigma) ** 2)
    return [np.float32(weight) for weight in weights / (weights[0] + 2 * weights[1:].sum())]
