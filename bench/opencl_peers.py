"""ChESS and the circular spectrum as OpenCL kernels, for a fair time on the same device."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyopencl as cl

import cmp_cl

PAD = 16
ROOM = 65536
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
        queue = self._queue
        _rows, columns = image.shape
        around = (PAD, PAD, PAD, self._padded.shape[1] - columns - PAD)
        cv2.copyMakeBorder(image, *around, cv2.BORDER_REPLICATE, dst=self._padded)
        cl.enqueue_copy(queue, self._grey, self._padded, is_blocking=False)
        for kernel, size, local in self._dense:
            cl.enqueue_nd_range_kernel(queue, kernel, size, local)
        cl.enqueue_copy(queue, self._rows, self._largest)
        threshold = max(float(self._rows.max()), 0.0) * self._settings["threshold"]
        self._list.set_arg(5, np.float32(threshold))
        cl.enqueue_fill_buffer(queue, self._count, np.uint32(0), 0, 4)
        cl.enqueue_nd_range_kernel(queue, self._list, self._size, self._local)
        count = np.empty(1, np.uint32)
        cl.enqueue_copy(queue, count, self._count)
        found = np.empty((min(int(count[0]), ROOM), 2), np.float32)
        if len(found):
            cl.enqueue_copy(queue, found, self._found)
        return found[np.lexsort((found[:, 0], np.rint(found[:, 1])))]

    def _prepare(self, shape: tuple[int, ...]) -> None:
        settings = self._settings
        rows, columns = (np.uint32(n) for n in shape)
        context = cl.Context([cmp_cl.select_device().handle])
        self._queue = cl.CommandQueue(context)
        options = ["-cl-std=CL1.2", f"-DPAD={PAD}", f"-DRADIUS={settings['radius']}"]
        program = cl.Program(context, _SOURCE.read_text()).build(options)
        step = np.uint64(-(-(shape[1] + 2 * PAD) // 16) * 16)
        padded = 4 * int(step) * (shape[0] + 2 * PAD)

        def room(size: int) -> cl.Buffer:
            buffer = cl.Buffer(context, cl.mem_flags.READ_WRITE, size)
            cl.enqueue_fill_buffer(self._queue, buffer, np.float32(0), 0, size // 4 * 4)
            return buffer

        self._padded = np.zeros((shape[0] + 2 * PAD, int(step)), np.uint8)
        self._grey = room(self._padded.nbytes)
        self._kept = [room(padded) for _ in range(5)]  # a kernel does not keep its buffers
        wide, half, soft, response, peak = self._kept
        lowest = np.float32(-1e30)
        cl.enqueue_fill_buffer(self._queue, response, lowest, 0, padded)
        cl.enqueue_fill_buffer(self._queue, peak, lowest, 0, padded)
        self._largest, self._count = room(4 * shape[0]), room(4)
        self._found = room(8 * ROOM)
        self._rows = np.empty(shape[0], np.float32)
        self._local = (64, 4)
        self._size = _padded(shape[::-1], self._local)
        whole = _padded((shape[1] + 2 * PAD, shape[0] + 2 * PAD), self._local)

        def bound(name: str, *arguments: Any) -> cl.Kernel:
            kernel = cl.Kernel(program, name)
            kernel.set_args(*arguments)
            return kernel

        area = (rows, columns, step)
        dense = [(bound("widen", self._grey, *area, wide), whole)]
        image = wide
        if settings["sigma"]:
            taps = _taps(settings["sigma"])
            dense.append((bound("smooth", wide, *area, np.uint64(1), *taps, half), whole))
            dense.append((bound("smooth", half, *area, step, *taps, soft), whole))
            image = soft
        if "weight" in settings:
            weight = np.float32(settings["weight"])
            dense.append((bound("spectrum", image, *area, weight, response), self._size))
        else:
            dense.append((bound("chess", image, wide, *area, response), self._size))
        dense.append((bound("row_peak", response, *area, peak), self._size))
        self._dense = [(kernel, size, self._local) for kernel, size in dense]
        per_row = (-(-shape[0] // 16) * 16,)
        self._dense.append((bound("row_largest", peak, *area, self._largest), per_row, (16,)))
        self._list = bound(
            "list_peaks",
            response,
            peak,
            *area,
            np.float32(0),
            np.uint32(ROOM),
            self._count,
            self._found,
        )
        self._shape = shape


def _padded(size: tuple[int, ...], local: tuple[int, int]) -> tuple[int, ...]:
    return tuple(-(-n // m) * m for n, m in zip(size, local, strict=True))


def _taps(sigma: float) -> list[np.float32]:
    """Return the weights of the centre and of the three neighbours on each side."""
    weights = np.exp(-0.5 * (np.arange(4) / sigma) ** 2)
    return [np.float32(weight) for weight in weights / (weights[0] + 2 * weights[1:].sum())]
