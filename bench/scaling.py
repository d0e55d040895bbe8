"""How cost grows with pixels and frames, on any device.

    python bench/scaling.py --quick         small sizes, half a minute
    python bench/scaling.py                 160 x 120 to 8192 x 8192, batches of up to 256 frames
    CMP_CL_DEVICE=gpu python bench/scaling.py   on another device

The corners of every frame of a batch are compared with those of the single frame. A row of
results/scaling.csv is a size, or a way to give many VGA frames.
"""

import statistics
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pyopencl as cl
from environment import run
from scenes import TEST_SEED, rendered, vga

import cmp_cl
from cmp_cl import Corners, Detector
from cmp_cl.synthetic import random_scene

SIZES = ((120, 160), (240, 320), (480, 640), (960, 1280), (2048, 2048), (4096, 4096), (8192, 8192))
PATCH = {"markers": 20, "severity": 0.25, "corrosion": 0.3, "shape": (240, 240)}
BATCHES = (1, 4, 16, 64, 256)
FRAMES = 64  # in a loop and in a stream
Row = dict[str, Any]


def milliseconds(call: Callable[[], object], repeats: int) -> float:
    """Return the median of a call, after two warm-up calls."""
    spent = []
    for _ in range(repeats + 2):
        start = time.perf_counter()
        call()
        spent.append(1e3 * (time.perf_counter() - start))
    return statistics.median(spent[2:])


def tiled(shape: tuple[int, int]) -> np.ndarray:
    """Return an image of that shape, tiled with one rendered pattern of 20 x 20 corners."""
    tile = rendered(random_scene(TEST_SEED, **PATCH)).image
    return np.ascontiguousarray(
        np.tile(tile, [-(-n // 240) for n in shape])[: shape[0], : shape[1]]
    )


def sizes(quick: bool) -> Iterator[Row]:
    """Yield the cost of one frame by its pixels, at a constant density of corners."""
    for shape in SIZES[:4] if quick else SIZES:
        image = tiled(shape)
        with Detector(shape=shape) as detector:
            corners = len(detector(image))
            repeats = max(3, min(60, 30_000_000 // image.size))
            spent = milliseconds(lambda d=detector, i=image: d(i), repeats)
            memory = detector.memory
        yield {
            "what": f"{shape[1]} x {shape[0]}",
            "corners": corners,
            "ms_a_frame": spent,
            "ns_a_pixel": 1e6 * spent / image.size,
            "bytes_a_pixel": memory / image.size,
        }


def many(quick: bool) -> Iterator[Row]:
    """Yield the cost of a VGA frame: in a loop, a stream, and batches from host and device."""
    frames = [vga(TEST_SEED + k).image for k in range(4)]
    context = cl.Context([cmp_cl.select_device().handle])
    with Detector(shape=frames[0].shape, queue=cl.CommandQueue(context)) as detector:
        single = [detector(frame) for frame in frames]

        def timed(what: str, count: int, call: Callable[[], list[Corners]]) -> Row:
            for k, corners in enumerate(call()):
                if not np.array_equal(corners.xy, single[k % 4].xy):
                    raise SystemExit(f"{what}: frame {k} differs from the single frame")
            spent = milliseconds(call, 5) / count
            return {"what": what, "corners": len(single[0]), "ms_a_frame": spent}

        film = [frames[k % 4] for k in range(FRAMES)]
        yield timed("VGA, one by one", FRAMES, lambda: [detector(frame) for frame in film])
        yield timed("VGA, stream", FRAMES, lambda: list(detector.stream(film)))
        for count in BATCHES[:3] if quick else BATCHES:
            stack = np.stack([frames[k % 4] for k in range(count)])
            flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
            there = cl.Buffer(context, flags, hostbuf=stack)
            yield timed(f"VGA, batch of {count}", count, lambda s=stack: detector.batch(s))
            yield timed(f"VGA, {count} on the device", count, lambda b=there: detector.batch(b))


def stages() -> Iterator[Row]:
    """Yield the time of each kernel of a VGA frame, the median."""
    image = vga(TEST_SEED).image
    with Detector(shape=image.shape, profile=True) as detector:
        spent = []
        for _ in range(40):
            detector(image)
            spent.append(detector.times)
    for name in spent[-1]:
        ms = statistics.median(each.get(name, 0.0) for each in spent[5:])
        yield {"what": f"kernel {name}", "ms_a_frame": ms}


def rows(quick: bool) -> Iterator[Row]:
    yield from sizes(quick)
    yield from many(quick)
    yield from stages()


if __name__ == "__main__":
    raise SystemExit(run(__doc__, "scaling", rows, quick="small sizes, half a minute"))
