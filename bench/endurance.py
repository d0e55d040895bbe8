"""Processes frames for hours; memory must stay constant, and answers the same.

    python bench/endurance.py --minutes 20 [--device TEXT] [--json results/endurance.json]

Frames of several sizes and kinds go through stream and batch in turns, and through streams that
are begun and dropped. Every round hashes every result and compares it with the first round's.
Then Detectors are opened and closed, each for devices that are listed anew. The last line is
PASSED, or FAILED with a status of 1 if a result changed, memory grew by more than the limit
after the first tenth, or files stayed open.
"""

import argparse
import dataclasses
import hashlib
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from cmp_cl import (
    AdaptiveMean,
    BinaryRings,
    Corners,
    Detector,
    DetectorConfig,
    EdgeStep,
    list_devices,
    select_device,
    synthetic,
)

GROWTH = 16.0  # MB by which the process may grow, because allocators keep some memory


def resident() -> float:
    """Return the memory of this process, MB."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def open_files() -> int:
    """Return the number of open files of this process."""
    return len(os.listdir("/proc/self/fd"))


def digest(results: list[Corners]) -> str:
    """Return a digest of every byte of the results."""
    hashed = hashlib.sha256()
    for corners in results:
        for field in dataclasses.fields(Corners):
            if field.name != "device":
                hashed.update(np.asarray(getattr(corners, field.name)).tobytes())
    return hashed.hexdigest()


def recordings() -> list[tuple[DetectorConfig, list[np.ndarray]]]:
    """Return frames small to VGA, of 8 and 16 bits, pressed, blank and noisy, with settings for
    each size."""
    rng = np.random.default_rng(0)
    made = []
    for shape, markers, bits, config in (
        ((480, 640), 30, 8, DetectorConfig()),
        ((240, 320), 16, 12, DetectorConfig(full_scale=4095, refinement=EdgeStep())),
        ((121, 83), 7, 8, DetectorConfig(detection=BinaryRings(threshold=AdaptiveMean(window=9)))),
        (
            (97, 131),
            8,
            8,
            DetectorConfig(detection=BinaryRings(contrast=None), nms_radius=1, max_corners=64),
        ),
    ):
        frames = [
            synthetic.render(
                synthetic.Scene(
                    markers=markers, shape=shape, severity=severity, bits=bits, seed=seed
                )
            ).image
            for seed, severity in enumerate((0.25, 0.75, 1.25))
        ]
        frames.append(np.full_like(frames[0], 100))
        frames.append(rng.integers(0, 2**bits, shape).astype(frames[0].dtype))
        made.append((config, frames))
    return made


def endure(seconds: float, device: str | None = None, openings: int = 1000) -> dict[str, Any]:
    """Run for that long, then open and close detectors; return what was counted."""
    work = recordings()
    detectors = [
        Detector(shape=frames[0].shape, dtype=frames[0].dtype, config=config, device=device)
        for config, frames in work
    ]

    def one_round() -> str:
        results: list[Corners] = []
        for detector, (_, frames) in zip(detectors, work, strict=True):
            begun = [detector.stream(frames) for _ in range(3)]
            results += [next(stream) for stream in begun]
            results += [next(stream) for stream in begun[:2]]
            del begun
            results += detector.stream(frames * 4)
            results += detector.batch(frames)
            results += [detector(frame) for frame in frames[:2]]
        return digest(results)

    frames_a_round = sum(5 * len(frames) + 7 for _, frames in work)
    first = one_round()
    begin = time.monotonic()
    rounds, changed = 1, 0
    history = []
    while time.monotonic() - begin < seconds:
        changed += one_round() != first
        rounds += 1
        memory_now = sum(detector.memory for detector in detectors)
        history.append((time.monotonic() - begin, resident(), memory_now, open_files()))
    settled = history[len(history) // 10]
    device_after = sum(detector.memory for detector in detectors)
    for detector in detectors:
        detector.close()

    config, frames = work[2]
    memory, opened = [], set()
    for _ in range(openings):
        list_devices()
        with Detector(shape=frames[0].shape, config=config, device=device) as detector:
            opened.add(digest([detector(frames[0])]))
        memory.append(resident())
    return {
        "device": str(select_device(device)),
        "seconds": round(time.monotonic() - begin, 1),
        "frames": rounds * frames_a_round,
        "rounds": rounds,
        "changed": changed,
        "answers_of_openings": len(opened),
        "digest": first[:16],
        "resident_MB": [round(settled[1], 1), round(history[-1][1], 1)],
        "resident_most_MB": round(max(each[1] for each in history), 1),
        "device_bytes": [settled[2], device_after],
        "open_files": [settled[3], history[-1][3], open_files()],
        "openings": openings,
        "openings_MB": [round(memory[openings // 10], 1), round(memory[-1], 1)] if memory else [],
    }


def failures(found: dict[str, Any]) -> list[str]:
    """Return the faults, in words."""
    wrong = []
    if found["changed"]:
        wrong.append(f"{found['changed']} rounds gave other results than the first")
    if found["answers_of_openings"] > 1:
        wrong.append(f"Detectors made anew gave {found['answers_of_openings']} different results")
    if found["resident_MB"][1] - found["resident_MB"][0] > GROWTH:
        wrong.append(
            f"the process grew from {found['resident_MB'][0]} MB to {found['resident_MB'][1]}"
        )
    if found["device_bytes"][0] != found["device_bytes"][1]:
        wrong.append(f"memory on the device: {found['device_bytes']}")
    if len(set(found["open_files"])) > 1:
        wrong.append(f"open files: {found['open_files']}")
    if found["openings_MB"] and found["openings_MB"][1] - found["openings_MB"][0] > GROWTH:
        wrong.append(f"openings: from {found['openings_MB'][0]} MB to {found['openings_MB'][1]}")
    return wrong


def main() -> int:
    """Run, and print the results and the faults."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=20)
    parser.add_argument("--openings", type=int, default=1000)
    parser.add_argument("--device")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = endure(options.minutes * 60, options.device, options.openings)
    text = json.dumps(found, indent=1)
    print(text)
    if options.json:
        options.json.write_text(text + "\n")
    wrong = failures(found)
    if wrong:
        print("FAILED:", "; ".join(wrong))
        return 1
    print(
        f"PASSED: {found['frames']} frames and {found['openings']} Detectors, the same results at "
        "the end as at the start, constant memory"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
