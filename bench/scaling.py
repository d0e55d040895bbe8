"""Measures how cost grows with pixels and frames, the gain from threads, and the start-up time.

    python bench/scaling.py --quick         small sizes, half a minute
    python bench/scaling.py                 160 x 120 to 8192 x 8192, batches up to 256 frames;
                                            writes results/scaling.json
    python bench/scaling.py --device gpu    the same on a GPU: results/scaling-gpu.json

The corners of every row are compared with those of the single frame that it repeats. The last
table compares the time of a frame with the least it could take: the bytes, operations and launches
that it needs, at the speed that this device has for each.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pyopencl as cl
from environment import environment, parser_of, write_result
from scenes import TEST_SEED, rendered, vga

import cmp_cl
from cmp_cl import Corners, Detector, DetectorConfig
from cmp_cl.synthetic import random_scene

SIZES = [(120, 160), (240, 320), (480, 640), (960, 1280), (1200, 1600), (2048, 2048), (4096, 4096)]
LARGEST = (8192, 8192)
PATCH = {"markers": 20, "severity": 0.25, "corrosion": 0.3, "shape": (240, 240)}
BATCHES = (1, 4, 16, 64, 256)
WORD_OPERATIONS = 1100  # of the criteria, on 32 pixels at once in a word
PIXEL_OPERATIONS = 5  # two sums that run along with the window, and a comparison
WORK = 256  # additions and differences that the kernel below does of each of 16 words

_KERNELS = """
__kernel void nothing(__global uint *out) {}

__kernel void operations(__global uint16 *out)
{
    size_t i = get_global_id(0);
    uint16 a = (uint16)((uint)i), b = a + 1, c = a + 2, d = a + 3;
    for (uint k = 0; k < WORK / 4; ++k) {
        a += b;
        b ^= c;
        c += d;
        d ^= a;
    }
    out[i] = a ^ b ^ c ^ d;
}
"""

_FIRST_RESULT = """
import time
start = time.perf_counter()
import numpy as np, cmp_cl
image = np.load({path!r})
imported = time.perf_counter()
with cmp_cl.Detector(shape=image.shape, device={device!r}) as detector:
    corners = detector(image)
print(imported - start, time.perf_counter() - start, len(corners))
"""


def milliseconds(run: Callable[[], object], repeats: int) -> dict[str, Any]:
    """Return median and 95th percentile of a call, after two warm-up calls."""
    spent = []
    for k in range(repeats + 2):
        start = time.perf_counter()
        run()
        if k >= 2:
            spent.append((time.perf_counter() - start) * 1e3)
    return {
        "ms": statistics.median(spent),
        "ms_p95": float(np.percentile(spent, 95)),
        "samples": repeats,
    }


def tiled(shape: tuple[int, int]) -> np.ndarray:
    """Return an image of that shape, tiled with one rendered pattern of 20 x 20 corners."""
    tile = rendered(random_scene(TEST_SEED, **PATCH)).image
    rows, columns = (-(-n // 240) for n in shape)
    return np.ascontiguousarray(np.tile(tile, (rows, columns))[: shape[0], : shape[1]])


def sizes(shapes: Sequence[tuple[int, int]], device: str | None) -> list[dict[str, Any]]:
    """Measure the cost by pixels, at a constant density of corners."""
    rows = []
    for shape in shapes:
        image = tiled(shape)
        with Detector(shape=shape, device=device) as detector:
            found = len(detector(image))
            repeats = max(3, min(60, int(3e7 / image.size)))
            timed = milliseconds(lambda d=detector, i=image: d(i), repeats)
            memory = detector.memory
        rows.append(
            {
                "shape": list(shape),
                "corners": found,
                **timed,
                "ns_per_pixel": timed["ms"] * 1e6 / image.size,
                "bytes_per_pixel": memory / image.size,
            }
        )
        print(
            f"{shape[1]:5} x {shape[0]:<5}{found:8} corners{timed['ms']:10.3f} ms"
            f"{rows[-1]['ns_per_pixel']:8.2f} ns a pixel{rows[-1]['bytes_per_pixel']:7.1f} bytes"
        )
    return rows


def stages_sparse(device: str | None) -> list[dict[str, Any]]:
    """Measure the cost of corners: the same VGA frame with none, few and all of them in view."""
    frame = vga(TEST_SEED)
    rows = []
    for share in (0.0, 0.25, 0.5, 1.0):
        image = frame.image.copy()
        image[:, int(640 * share) :] = 128
        with Detector(shape=image.shape, device=device) as detector:
            rows.append(
                {
                    "corners": len(detector(image)),
                    **milliseconds(lambda d=detector, i=image: d(i), 60),
                }
            )
        print(f"{rows[-1]['corners']:6} corners in a VGA frame: {rows[-1]['ms']:.3f} ms")
    return rows


def many(batches: Sequence[int], device: str | None) -> list[dict[str, Any]]:
    """Measure frames a second: one by one, as a stream, in batches from host and from device."""
    frames = [vga(TEST_SEED + k).image for k in range(4)]
    rows = []
    context = cl.Context([cmp_cl.select_device(device).handle])
    queue = cl.CommandQueue(context)
    with Detector(shape=frames[0].shape, queue=queue) as detector:
        single = [detector(frame) for frame in frames]

        def keep(what: str, count: int, run: Callable[[], list[Corners]], repeats: int) -> None:
            results = run()
            for k, corners in enumerate(results):
                if not np.array_equal(corners.xy, single[k % 4].xy):
                    raise SystemExit(f"{what}: frame {k} differs from the single frame")
            timed = milliseconds(run, repeats)
            each = timed["ms"] / count
            rows.append({"what": what, "frames": count, "ms_per_frame": each, **timed})
            print(f"{what:20}{each:9.3f} ms a frame{1e3 / each:10.0f} frames a second")

        keep("one by one", 64, lambda: [detector(frames[k % 4]) for k in range(64)], 5)
        keep("stream", 64, lambda: list(detector.stream(frames[k % 4] for k in range(64))), 5)
        for count in batches:
            stack = np.stack([frames[k % 4] for k in range(count)])
            keep(f"batch of {count}", count, lambda s=stack: detector.batch(s), 5)
            flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
            there = cl.Buffer(context, flags, hostbuf=stack)
            keep(f"{count} on the device", count, lambda b=there: detector.batch(b), 5)
    return rows


def threads(device: str | None) -> list[dict[str, Any]]:
    """Measure one and two threads of PoCL, each in a process of its own."""
    rows = []
    for count in (1, 2):
        # The one is read by versions before 5, the other by those since.
        names = ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT")
        limits = {} if count == os.cpu_count() else dict.fromkeys(names, str(count))
        environ = os.environ | limits
        command = [sys.executable, __file__, "--threads-child"]
        command += ["--device", device] if device else []
        answer = subprocess.run(command, env=environ, capture_output=True, text=True, check=True)
        rows.append({"threads": count, **json.loads(answer.stdout)})
        print(f"{count} threads: {rows[-1]['ms']:.3f} ms a VGA frame")
    return rows


def first_result(device: str | None) -> list[dict[str, Any]]:
    """Return the seconds from import to the corners of a VGA frame, in new processes."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "frame.npy")
        np.save(path, vga(TEST_SEED).image)
        caches = dict.fromkeys(("POCL_CACHE_DIR", "XDG_CACHE_HOME", "CUDA_CACHE_PATH"), folder)
        code = _FIRST_RESULT.format(path=path, device=device)
        for k in range(4):
            answer = subprocess.run(
                [sys.executable, "-c", code],
                env=os.environ | caches,
                capture_output=True,
                text=True,
                check=True,
            )
            imported, seconds, count = answer.stdout.split()[-3:]
            rows.append(
                {
                    "cache": "warm" if k else "cold",
                    "imports_s": float(imported),
                    "seconds": float(seconds),
                    "corners": int(count),
                }
            )
            print(f"first result, {rows[-1]['cache']} cache: {float(seconds):.2f} s")
    return rows


def abilities(device: str | None) -> dict[str, float]:
    """Measure the device's speed at each kind of work of a frame."""
    size = 64 << 20
    context = cl.Context([cmp_cl.select_device(device).handle])
    queue = cl.CommandQueue(context)
    first, second = (cl.Buffer(context, cl.mem_flags.READ_WRITE, size) for _ in range(2))
    cl.enqueue_fill_buffer(queue, first, np.uint32(1), 0, size)
    program = cl.Program(context, _KERNELS).build([f"-DWORK={WORK}"])
    nothing, operations = cl.Kernel(program, "nothing"), cl.Kernel(program, "operations")
    nothing.set_args(first)
    operations.set_args(first)
    frame, few = np.zeros(480 * 640, np.uint8), np.zeros(2, np.uint32)

    def launched(kernel: cl.Kernel, items: int, times: int) -> float:
        def run() -> None:
            for _ in range(times):
                cl.enqueue_nd_range_kernel(queue, kernel, (items,), (64,))
            queue.finish()

        return float(milliseconds(run, 20)["ms"])

    def copy() -> None:
        cl.enqueue_copy(queue, second, first)
        queue.finish()

    return {
        "copy_gb_s": 2 * size / milliseconds(copy, 10)["ms"] / 1e6,
        "operations_a_second": 1e3 * WORK * size / 4 / launched(operations, size // 64, 1),
        "launch_ms": launched(nothing, 64, 200) / 200,
        "upload_ms": milliseconds(lambda: cl.enqueue_copy(queue, first, frame), 50)["ms"],
        "answer_ms": milliseconds(lambda: cl.enqueue_copy(queue, few, first), 50)["ms"],
    }


def floor(frames: Sequence[dict[str, Any]], device: str | None) -> dict[str, float]:
    """Return the least that a VGA frame must cost, alone and among many, and the ratio to it.

    Bytes: the image once and the corners once. Operations: binarization and criteria once.
    Alone, a frame is uploaded, launches its kernels, and is asked for one answer: its corners
    and their number.
    """
    image = vga(TEST_SEED).image
    with Detector(shape=image.shape, device=device, profile=True) as detector:
        detector(image)
        launches = len(detector.times)
    able = abilities(device)
    moved = image.size + 1936 * 8
    operations = image.size * (PIXEL_OPERATIONS + WORD_OPERATIONS / 32)
    bound = min(able["copy_gb_s"] * 1e9 / moved, able["operations_a_second"] / operations)
    alone = able["upload_ms"] + launches * able["launch_ms"] + able["answer_ms"]
    one, *_ = (row["ms_per_frame"] for row in frames if row["what"] == "one by one")
    best = min(row["ms_per_frame"] for row in frames)
    return {
        **able,
        "bytes_a_frame": moved,
        "operations_a_frame": operations,
        "launches_a_frame": launches,
        "frames_a_second_at_floor": bound,
        "times_the_floor": bound * best / 1e3,
        "alone_ms_at_floor": alone,
        "alone_times_the_floor": one / alone,
    }


def main(argv: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__, quick="small sizes, half a minute")
    parser.add_argument("--device", help="as for cmp-cl: a name, an index, cpu or gpu")
    parser.add_argument("--threads-child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    device = arguments.device
    if arguments.threads_child:
        image = vga(TEST_SEED).image
        with Detector(shape=image.shape, config=DetectorConfig(), device=device) as detector:
            corners = len(detector(image))
            print(json.dumps({"corners": corners, **milliseconds(lambda: detector(image), 100)}))
        return 0
    chosen = cmp_cl.select_device(device)
    on_gpu = chosen.kind is cmp_cl.opencl.device.DeviceKind.GPU
    print(f"{chosen}, driver {chosen.driver}")
    shapes = SIZES[:4] if arguments.quick else [*SIZES, LARGEST]
    frames = many(BATCHES[:3] if arguments.quick else BATCHES, device)
    result = {
        "kind": "scaling",
        "environment": environment() | {"device": str(chosen), "driver": chosen.driver},
        "frames": frames,
        "floor": floor(frames, device),
        "sizes": sizes(shapes, device),
        "corners": stages_sparse(device),
        "first_result": first_result(device),
        "threads": threads(device) if "Portable" in chosen.platform else [],
    }
    least = result["floor"]
    print(
        f"one frame takes {least['alone_times_the_floor']:.1f} times its upload, launches and "
        f"answer; the best of many {least['times_the_floor']:.0f} times its bytes and operations"
    )
    stem = "scaling-gpu" if on_gpu else "scaling"
    write_result(result, arguments.out, quick=arguments.quick, stem=stem)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
