"""Processes frames for hours; memory must stay constant, and answers the same.

    python bench/endurance.py --minutes 20

Frames of several sizes and kinds go through stream and batch in turns, and through streams that
are begun and dropped. Every round hashes every result and compares it with the first round's.
Then detectors are opened and closed, each for devices that are listed anew. The last line is
PASSED, or FAILED with a status of 1 if a result changed, memory grew by more than the limit
after the first tenth, or files stayed open.
"""

import argparse
import dataclasses
import hashlib
import os
import time
from collections.abc import Callable, Sequence

import numpy as np

from cmp_cl import (
    AdaptiveMean,
    BinaryRings,
    Corners,
    Detector,
    DetectorConfig,
    EdgeStep,
    list_devices,
    synthetic,
)

GROWTH = 16.0  # MB by which the process may grow, because allocators keep some memory
OPENINGS = 1000
SMALL_RINGS = BinaryRings(threshold=AdaptiveMean(window=9))
RECORDINGS = (  # shape, corners a side, bits, settings
    ((480, 640), 30, 8, DetectorConfig()),
    ((240, 320), 16, 12, DetectorConfig(full_scale=4095, refinement=EdgeStep())),
    ((121, 83), 7, 8, DetectorConfig(detection=SMALL_RINGS)),
    ((97, 131), 8, 8, DetectorConfig(nms_radius=1, max_corners=64)),
)


def resident() -> float:
    """Return the memory of this process, MB."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def digest(results: Sequence[Corners]) -> str:
    """Return a digest of every byte of the results."""
    hashed = hashlib.sha256()
    for corners in results:
        for field in dataclasses.fields(Corners):
            if field.name != "device":
                hashed.update(np.asarray(getattr(corners, field.name)).tobytes())
    return hashed.hexdigest()


def frames_of(shape: tuple[int, int], markers: int, bits: int) -> list[np.ndarray]:
    """Return frames that are pressed, blank and noisy."""
    scene = synthetic.Scene(markers=markers, shape=shape, bits=bits)
    pressed = [
        synthetic.render(dataclasses.replace(scene, severity=severity, seed=seed)).image
        for seed, severity in enumerate((0.25, 0.75, 1.25))
    ]
    noise = np.random.default_rng(0).integers(0, 2**bits, shape).astype(pressed[0].dtype)
    return [*pressed, np.full_like(noise, 100), noise]


def use(detector: Detector, frames: list[np.ndarray]) -> list[Corners]:
    """Return the results of every way to give frames; some streams are dropped on the way."""
    begun = [detector.stream(frames) for _ in range(3)]
    results = [next(stream) for stream in begun]
    results += [next(stream) for stream in begun[:2]]
    del begun
    results += detector.stream(frames * 4)
    results += detector.batch(frames)
    return results + [detector(frame) for frame in frames[:2]]


def faults(once: Callable[[], object], goes_on: Callable[[int], bool]) -> list[str]:
    """Call `once` for as long as it goes on; return what is wrong, in words."""
    answers, memory, files = [], [], []
    while goes_on(len(answers)):
        answers.append(once())
        memory.append(resident())
        files.append(len(os.listdir("/proc/self/fd")))
    settled = memory[len(memory) // 10]
    print(f"{len(answers)} rounds, memory {settled:.1f} to {memory[-1]:.1f} MB, files {files[-1]}")
    wrong = {
        "rounds gave other results than the first": len(set(answers)) > 1,
        f"the process grew from {settled:.0f} MB to {memory[-1]:.0f}": (
            memory[-1] - settled > GROWTH
        ),
        "files stayed open": files[-1] > files[len(files) // 10],
    }
    return [what for what, true in wrong.items() if true]


def endure(seconds: float, openings: int = OPENINGS) -> list[str]:
    """Use detectors for that long, then open and close some; return the faults."""
    work = [
        (Detector(shape=shape, dtype=frames[0].dtype, config=config), frames)
        for shape, markers, bits, config in RECORDINGS
        for frames in [frames_of(shape, markers, bits)]
    ]

    def one_round() -> str:
        # A detector may grow later: how full a list is depends on which thread takes which rows.
        return digest([corners for each in work for corners in use(*each)])

    def one_opening() -> str:
        list_devices()
        with Detector(shape=RECORDINGS[2][0]) as detector:
            return digest([detector(work[2][1][0])])

    end = time.monotonic() + seconds
    wrong = faults(one_round, lambda rounds: rounds < 20 or time.monotonic() < end)
    for detector, _ in work:
        detector.close()
    return wrong + faults(one_opening, lambda rounds: rounds < openings)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=20)
    wrong = endure(parser.parse_args().minutes * 60)
    print(f"FAILED: {'; '.join(wrong)}" if wrong else "PASSED")
    return len(wrong) > 0


if __name__ == "__main__":
    raise SystemExit(main())
