"""All measurements and the report, in one command.

python bench/run.py --quick         a few minutes; into a folder for temporary files
python bench/run.py                 about an hour; into results/
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).parent
QUICK = Path(tempfile.gettempdir()) / "cmp_cl-bench"
PARTS = ("speed", "scaling", "theory", "criteria", "photographs", "accuracy", "stability")
WHOLE = ("theory", "photographs")  # have no short form


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the short form of each part")
    parser.add_argument("--out", type=Path, help="folder for the results")
    arguments = parser.parse_args(argv)
    out = arguments.out or (QUICK if arguments.quick else HERE / "results")
    out.mkdir(parents=True, exist_ok=True)
    status = 0
    for number, part in enumerate(PARTS, 1):
        command = [sys.executable, str(HERE / f"{part}.py"), "--out", str(out / f"{part}.json")]
        command += ["--quick"] if arguments.quick and part not in WHOLE else []
        print(f"\n[{number} of {len(PARTS)}] {part}", flush=True)
        start = time.perf_counter()
        failed = subprocess.run(command).returncode
        print(f"{part}: {time.perf_counter() - start:.0f} s" + (" FAILED" if failed else ""))
        status = status or failed
    for part in ("picture", "report"):
        command = [sys.executable, str(HERE / f"{part}.py"), "--results", str(out)]
        status = status or subprocess.run(command).returncode
    return status


if __name__ == "__main__":
    raise SystemExit(main())
