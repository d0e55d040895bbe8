"""The same scenes on every OpenCL implementation of this machine: do whole numbers agree, and how
far apart are the refined positions?

python bench/implementations.py --out implementations.json

The scenes, configurations and digests are those of tests/test_determinism.py. `.ci/devices`
installs implementations and runs the tests on them; what is not installed is left out here.
"""

import argparse
import os
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl
from environment import environment, parser_of, write_result

import cmp_cl

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from test_determinism import DIGESTS, config_for, digest, load

ORACLE = "the oracle, float64"
LIMIT = 200  # seconds for all scenes on an implementation


def libraries() -> Iterator[tuple[str, str]]:
    """Return the name and the library of each implementation that is installed."""
    bundled = Path(pyopencl.__file__).parent / ".libs"
    for path in bundled.glob("libpocl*"):
        yield "PoCL, PyPI", str(path)
    system = {
        "PoCL, Debian": "libpocl.so.2",
        "rusticl": "libRusticlOpenCL.so.1",
        "NVIDIA": "libnvidia-opencl.so.1",
    }
    for name, library in system.items():
        if any(Path("/usr/lib").glob(f"*/{library}")):
            yield name, library
    intel = Path(sysconfig.get_paths()["data"]) / "lib" / "libintelocl.so"
    if intel.is_file():
        yield "Intel CPU", str(intel)


def measure(out: Path) -> None:
    """Detect every scene on the only device there is, and write a file."""
    device = cmp_cl.select_device()
    found: dict[str, Any] = {"device": f"{device}, {device.driver}"}
    for scene, config in DIGESTS:
        image = load(scene)
        settings = config_for(config, image)
        with cmp_cl.Detector(shape=image.shape, dtype=image.dtype, config=settings) as detector:
            corners = detector(image)
            same = digest(detector.maps(image), corners) == DIGESTS[scene, config]
        found[f"{scene}/{config}"] = corners.xy
        found[f"same {scene}/{config}"] = same
    np.savez(out, **found)


def run(name: str, library: str, folder: Path) -> dict[str, Any] | str:
    """Return the result of `measure` with that implementation alone, or why there is none."""
    vendor, out = folder / f"{name}.icd", folder / f"{name}.npz"
    vendor.write_text(library + "\n")
    around = {**os.environ, "OCL_ICD_VENDORS": str(vendor), "RUSTICL_ENABLE": "llvmpipe"}
    around["LD_LIBRARY_PATH"] = f"{Path(library).parent}:{around.get('LD_LIBRARY_PATH', '')}"
    around.pop("CMP_CL_DEVICE", None)
    command = [sys.executable, __file__, "--measure", str(out)]
    try:
        ran = subprocess.run(command, env=around, capture_output=True, text=True, timeout=LIMIT)
    except subprocess.TimeoutExpired:
        return f"not done within {LIMIT} s"
    if ran.returncode:
        return ran.stderr.strip().splitlines()[-1]
    with np.load(out) as file:
        return dict(file)


def largest_distance(one: dict[str, Any], other: dict[str, Any]) -> float | None:
    """Return the largest distance between equal corners, px; None if the corners differ."""
    largest = 0.0
    for scene, config in DIGESTS:
        a, b = one[f"{scene}/{config}"], other[f"{scene}/{config}"]
        if a.shape != b.shape:
            return None
        if len(a):
            largest = max(largest, float(np.abs(a.astype(np.float64) - b).max()))
    return largest


def oracle() -> dict[str, Any]:
    found = {}
    for scene, config in DIGESTS:
        image = load(scene)
        found[f"{scene}/{config}"] = cmp_cl.reference.detect(image, config_for(config, image)).xy
    return found


def main(argv: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.measure:
        measure(arguments.measure)
        return 0
    rows, found, failed = [], {ORACLE: oracle()}, {}
    with tempfile.TemporaryDirectory() as folder:
        for name, library in libraries():
            result = run(name, library, Path(folder))
            if isinstance(result, str):
                failed[name] = result
                continue
            found[name] = result
            same = sum(bool(result[f"same {scene}/{config}"]) for scene, config in DIGESTS)
            rows.append({"name": name, "device": str(result["device"]), "same": same})
            print(f"{name}: {same} of {len(DIGESTS)} digests agree", flush=True)
    pairs = [
        {"one": one, "other": other, "px": largest_distance(found[one], found[other])}
        for one, other in combinations(found, 2)
    ]
    around = environment()
    result = {"kind": "implementations", "environment": around, "unavailable": failed}
    result |= {"scenes": len(DIGESTS), "rows": rows, "pairs": pairs}
    write_result(result, arguments.out)
    return 0 if all(row["same"] == len(DIGESTS) for row in rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
