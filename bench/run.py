"""All measurements and the report, in one command.

python bench/run.py --quick         some minutes; into a folder for temporary files
python bench/run.py                 about an hour on two quiet cores; into results/
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from environment import QUICK, RESULTS

PARTS = (
    *("speed", "detection", "photographs", "sigma", "numbering", "field"),
    *("refraction", "limits", "report"),
)
WHOLE = ("photographs", "report")  # have no short form


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the short form of each part")
    parser.add_argument("--out", type=Path, help="folder of the tables")
    arguments = parser.parse_args(argv)
    out = arguments.out or (QUICK if arguments.quick else RESULTS)
    failed = []
    for part in PARTS:
        command = [sys.executable, Path(__file__).with_name(f"{part}.py"), "--out", out]
        command += ["--quick"] * (arguments.quick and part not in WHOLE)
        print(f"\n{part}", flush=True)
        start = time.perf_counter()
        if subprocess.run(command).returncode:
            failed.append(part)
        print(f"{part}: {time.perf_counter() - start:.0f} s" + " FAILED" * (part in failed))
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
