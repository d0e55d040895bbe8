"""All measurements and the report, in one command.

python bench/run.py --quick         two or three minutes; into a folder for temporary files
python bench/run.py                 about two hours on two quiet cores; into results/
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from environment import environment

HERE = Path(__file__).parent
QUICK = Path(tempfile.gettempdir()) / "cmp_cl-bench"
PARTS = (
    "speed",
    "scaling",
    "theory",
    "criteria",
    "photographs",
    "marks",
    "partial_views",
    "open_patterns",
    "surroundings",
    "field",
    "positions",
    "accuracy",
    "stability",
)
LONG = ("implementations",)  # only in the long form
WHOLE = ("theory", "photographs", "partial_views")  # have no short form


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the short form of each part")
    parser.add_argument("--out", type=Path, help="folder for the results")
    arguments = parser.parse_args(argv)
    out = arguments.out or (QUICK if arguments.quick else HERE / "results")
    out.mkdir(parents=True, exist_ok=True)
    around = environment()
    failed = []
    seconds = {}
    parts = PARTS if arguments.quick else PARTS + LONG
    for number, part in enumerate(parts, 1):
        command = [sys.executable, str(HERE / f"{part}.py"), "--out", str(out / f"{part}.json")]
        command += ["--quick"] if arguments.quick and part not in WHOLE else []
        print(f"\n[{number} of {len(parts)}] {part}", flush=True)
        start = time.perf_counter()
        if subprocess.run(command).returncode:
            failed.append(part)
        seconds[part] = round(time.perf_counter() - start)
        print(f"{part}: {seconds[part]} s" + (" FAILED" if part in failed else ""), flush=True)
    spent = {"kind": "run", "environment": around, "quick": arguments.quick, "seconds": seconds}
    (out / "run.json").write_text(json.dumps(spent | {"failed": failed}, indent=1) + "\n")
    for part in ("picture", "report"):
        command = [sys.executable, str(HERE / f"{part}.py"), "--results", str(out)]
        if subprocess.run(command).returncode:
            failed.append(part)
    print(f"{sum(seconds.values())} s in all" + f"; FAILED: {', '.join(failed)}" * bool(failed))
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
