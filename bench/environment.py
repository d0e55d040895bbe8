"""What all parts share: their arguments, their tables, and the environment of a measurement."""

import argparse
import csv
import datetime
import json
import os
import platform
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import cv2

import cmp_cl

RESULTS = Path(__file__).with_name("results")
QUICK = Path(tempfile.gettempdir()) / "cmp_cl-bench"
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"  # photographs, not in the repository
Row = Mapping[str, Any]
_PACKAGES = ("numpy", "pyopencl", "pocl-binary-distribution", "chess_corners", "libCBDetect")


def environment() -> dict[str, Any]:
    """Return the environment of a measurement, as plain values for JSON."""
    device = cmp_cl.select_device()
    packages = {"opencv": cv2.__version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            packages[name] = version(name)
        except PackageNotFoundError:
            packages[name] = "not installed"
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "commit": _commit(),
        "device": str(device),
        "driver": device.driver,
        "cpu": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.release()}",
        "packages": packages,
        "others": others(),
    }


def main_of(
    doc: str,
    tables: Mapping[str, Callable[[argparse.Namespace], Iterable[Row]]],
    *,
    quick: str | None = None,
    options: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> Callable[..., int]:
    """Return the `main` of a part: it prints the rows as they come, and writes each table that has
    rows as NAME.csv.

    doc: of the part. tables: what yields the rows of each, from the arguments. quick: the help of
    --quick, by which tables go into the folder for temporary files; None if a part has no short
    form. options: further arguments, as for argparse.
    """
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    if quick is not None:
        parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--out", type=Path, help="folder of the tables")
    for name, settings in options.items():
        parser.add_argument(f"--{name}", **settings)

    def main(argv: Sequence[str] | None = None) -> int:
        arguments = parser.parse_args(argv)
        usual = QUICK if quick is not None and arguments.quick else RESULTS
        for name, rows in tables.items():
            table = []
            for row in rows(arguments):
                table.append(row)
                print(", ".join(f"{key} {_short(value)}" for key, value in row.items()), flush=True)
            if table:
                _write(arguments.out or usual, name, table)
        return 0

    return main


def _write(folder: Path, name: str, rows: Sequence[Row]) -> None:
    """Write rows as NAME.csv: one row a measurement, one column a quantity.

    The first line is a comment with `environment()` as JSON; pandas reads the rest with
    comment="#".
    """
    path = folder / f"{name}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with path.open("w", newline="") as file:
        file.write(f"# {json.dumps(environment())}\n")
        table = csv.DictWriter(file, columns, lineterminator="\n")
        table.writeheader()
        table.writerows({key: _short(value) for key, value in row.items()} for row in rows)
    print(f"wrote {path}")


def _short(value: Any) -> Any:
    """Return floats with five digits, and nothing for NaN."""
    if not isinstance(value, float):
        return value
    return "" if value != value else f"{value:.5g}"


def others(seconds: float = 1.0) -> float | None:
    """Return the cores that other programs kept busy while this one slept; None if the system
    does not say."""
    try:
        before = _busy()
        time.sleep(seconds)
        return round((_busy() - before) / seconds, 2)
    except OSError:
        return None


def _busy() -> float:
    """Return the seconds that all cores together have worked since the system started."""
    user, nice, system, *_ = Path("/proc/stat").read_text().split()[1:]
    return (int(user) + int(nice) + int(system)) / os.sysconf("SC_CLK_TCK")


def _commit() -> str:
    """Return the commit of the tree, marked if files other than results differ from it."""
    here = Path(__file__).parent
    try:
        commit = _git(here, "rev-parse", "--short", "HEAD")
        changed = _git(here, "status", "--porcelain", "--", "..", ":!results")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return commit + ("+changes" if changed else "")


def _git(folder: Path, *arguments: str) -> str:
    answer = subprocess.run(
        ["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=True
    )
    return answer.stdout.strip()
