"""The report and its plots, made from the JSON files in results/ and from nothing else.

python bench/report.py     writes results/REPORT.md, results/*.png and the table in the README
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from accuracy import unpacked
from environment import RESULTS
from methods import DEFAULT, GRIDDED, LINES, PAPER
from sections.detection import (
    accuracy,
    against_time,
    criteria,
    marks,
    photographs,
    settings,
    shortfalls,
)
from sections.field import field, wrong_indices
from sections.grid import open_patterns, partial_views, surroundings
from sections.positions import positions, strain
from sections.speed import scaling, speed
from sections.stability import breaking, implementations, stability, theory
from sections.tables import Row, described, share_of, table

IN_README = (
    DEFAULT,
    LINES,
    PAPER,
    GRIDDED,
    "goodFeaturesToTrack + cornerSubPix",
    "chess-corners, lean, saddle",
    "findChessboardCornersSB",
    "libcbdetect",
)
BEGIN, END = "<!-- by bench/report.py -->\n", "<!-- until here -->\n"
INTRODUCTION = """# What was measured

`python bench/report.py` makes this page from the JSON files beside it. Each section says on which \
device, with which versions and at which commit it was measured.

A corner is missed if no detection matches it. A detection is false if it matches no corner. \
Matches are one to one, nearest first, within 3 px or 0.35 cells. A frame is right if no corner is \
missed and none is false. RMSE and percentiles are those of the distance in px, unless another \
unit is given.

The sections answer these questions:

- How fast is it, and how accurate at that speed? Time, error against time, cost by size.
- Which corners does it find? Rendered scenes, photographs, marks in cells, criteria.
- How accurate are the positions, and are their standard deviations right?
- Are the corners numbered correctly? Boards partly out of view, patterns without a border.
- How accurate is the field in space?
- Does float32 suffice, and do implementations of OpenCL agree?
- Where does it fail?
"""


def durations(result: Row) -> str:
    """Report how long each part took."""
    form = "short" if result["quick"] else "full"
    failed = ", ".join(result["failed"]) or "none"
    parts = [f"## Run time of each part\n\nThe {form} run; parts that failed: {failed}.\n"]
    rows = [*result["seconds"].items(), ("all", sum(result["seconds"].values()))]
    parts.append(table(("part", "seconds"), rows))
    return "\n".join(parts)


def read(folder: Path, name: str) -> Row | None:
    path = folder / f"{name}.json"
    return json.loads(path.read_text()) if path.is_file() else None


def figures(timed: Row, errors: Row) -> str:
    """Return the README's table: the time, the error and the right frames of each method."""
    small, large = ({row["method"]: row for row in scene["rows"]} for scene in timed["scenes"])
    whole = {row["method"]: row for row in unpacked(errors)["rows"] if row["group"] == "all"}
    body = []
    for name, row in sorted(small.items(), key=lambda item: item[1]["ms"]):
        if name not in IN_README:
            continue
        success = whole.get(name) and share_of(whole[name]["success"], whole[name]["frames"])
        found = [row["ms"], large[name]["ms"] if name in large else None, row["rmse"]]
        body.append([name, *found, f"{row['missed']} / {row['false']}", success])
    head = (
        "method",
        "640 x 480, ms",
        "1600 x 1200, ms",
        "RMSE px",
        "missed / false",
        "frames right, %",
    )
    return (
        f"{described(timed)}\nTimes are medians of one run, from an image in host memory to "
        f"positions in host memory, on frames with {timed['scenes'][0]['corners']} and "
        f"{timed['scenes'][1]['corners']} corners. RMSE, missed and false are those of the smaller "
        "frame. The last column is a separate measurement: the share of "
        f"{whole[DEFAULT]['frames']} rendered frames, from slightly to severely deformed, in which "
        "no corner is missed and none is false, with its 95 % interval. Rows whose intervals "
        "overlap do not differ significantly.\n\n" + table(head, body)
    )


def insert(page: str, text: str) -> None:
    """Replace the earlier text on a page of the documentation by this one."""
    path = RESULTS.parents[1] / page
    before, rest = path.read_text("utf-8").split(BEGIN)
    path.write_text(f"{before}{BEGIN}\n{text}{END}{rest.split(END)[1]}", "utf-8")


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of the JSON files")
    folder = parser.parse_args(argv).results
    sections = [
        ("speed", speed),
        ("accuracy", lambda result: against_time(result, folder)),
        ("scaling", scaling),
        ("scaling-gpu", scaling),
        ("accuracy", lambda result: accuracy(result, folder)),
        ("photographs", photographs),
        ("marks", marks),
        ("criteria", criteria),
        ("positions", positions),
        ("strain", strain),
        ("partial_views", partial_views),
        ("open_patterns", open_patterns),
        ("surroundings", surroundings),
        ("field", field),
        ("stability", lambda result: stability(result, folder)),
        ("implementations", implementations),
        ("theory", lambda result: theory(result, folder)),
        ("accuracy", shortfalls),
        ("stability", lambda result: breaking(result, folder)),
        ("field", wrong_indices),
        ("peer_settings", settings),
        ("run", durations),
    ]
    text, missing = [INTRODUCTION], set()
    for name, write in sections:
        result = read(RESULTS if name == "peer_settings" else folder, name)
        if result is not None:
            text.append(write(result))
        elif name not in missing:
            missing.add(name)
            text.append(f"## {name}\n\nNot measured: there is no {name}.json.\n")
    out = folder / "REPORT.md"
    out.write_text("\n".join(text))
    print(f"wrote {out}")
    timed, errors = read(folder, "speed"), read(folder, "accuracy")
    if folder == RESULTS and timed is not None and errors is not None:
        insert("README.md", figures(timed, errors))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
