"""The report and its plots, made from the JSON files in results/ and from nothing else.

python bench/report.py     writes results/REPORT.md, results/*.png and the table in the README
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from accuracy import unpacked
from environment import RESULTS
from field import grouped
from methods import DEFAULT
from sections.detection import accuracy, criteria, photographs, settings
from sections.field import field
from sections.grid import open_patterns, partial_views
from sections.plots import SHOWN
from sections.positions import positions
from sections.speed import scaling, speed
from sections.stability import implementations, stability, theory
from sections.tables import Row, described, is_peer, share_of, table

BEGIN, END = "<!-- by bench/report.py -->\n", "<!-- until here -->\n"


def durations(result: Row) -> str:
    """Report how long each part took."""
    form = "short" if result["quick"] else "full"
    failed = ", ".join(result["failed"]) or "none"
    parts = [f"## What the parts took\n\nThe {form} form; parts that failed: {failed}.\n"]
    rows = [*result["seconds"].items(), ("all", sum(result["seconds"].values()))]
    parts.append(table(("part", "seconds"), rows))
    return "\n".join(parts)


def read(folder: Path, name: str) -> Row | None:
    path = folder / f"{name}.json"
    return json.loads(path.read_text()) if path.is_file() else None


def figures(speed: Row, accuracy: Row) -> str:
    """Return the README's table: what each method takes, misplaces and gets right."""
    small, large = ({row["method"]: row for row in scene["rows"]} for scene in speed["scenes"])
    whole = {row["method"]: row for row in unpacked(accuracy)["rows"] if row["group"] == "all"}
    body = []
    for name, row in sorted(small.items(), key=lambda item: item[1]["ms"]):
        if not (name in SHOWN or is_peer(name)):
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
        f"{described(speed)}\nMedians of one run, from an image in host memory to positions there: "
        f"{speed['scenes'][0]['corners']} and {speed['scenes'][1]['corners']} corners; errors are "
        "those of the first. The last column is another measurement: frames of "
        f"{whole[DEFAULT]['frames']} rendered ones, from slightly to severely deformed, in which "
        "no corner is missed and none is false, with an interval of 95 %: rows whose intervals "
        "overlap are not told apart by it.\n\n" + table(head, body)
    )


def exactness(positions: Row, field: Row) -> str:
    """Return the errors by severity, in the image and in space, for the page on accuracy."""
    spaces = grouped(field["frames"], "config", "severity")
    severities = sorted({row["severity"] for row in spaces})
    body: list[list[Any]] = []
    for corrosion, print_ in ((0, "perfect print"), (1, "worn print")):
        rows = {
            row["severity"]: row
            for row in positions["groups"]
            if row["corrosion"] == corrosion and "severity" in row
        }
        body += [
            [f"{print_}: {what}, px", *(rows[each][kind]["rms"] for each in severities)]
            for kind, what in (
                ("raw position", "a corner from its image"),
                ("position", "a node behind the filter"),
                ("raw displacement", "displacement, raw"),
                ("displacement", "displacement, filtered"),
            )
        ]
    ours = next(iter(dict.fromkeys(row["config"] for row in spaces)))
    found = {row["severity"]: row for row in spaces if row["config"] == ours}
    body += [
        [f"worn print: {what}, µm", *(found[each][f"{kind}_rms_um"] for each in severities)]
        for kind, what in (
            ("raw_moved", "displacement in space, raw"),
            ("moved", "displacement in space, filtered"),
        )
    ]
    head = ("RMS error", *(f"severity {each:g}" for each in severities))
    return (
        f"Commits {positions['environment']['commit']} (px) and {field['environment']['commit']} "
        "(µm). Severity 1 is a press of 2 mm, a shear of 1.2 mm or a twist of 20 degrees; the "
        f"pattern in space is 32 mm wide.\n\n{table(head, body)}"
    )


def insert(page: str, text: str) -> None:
    """Put the text where a page of the documentation has the last one."""
    path = RESULTS.parents[1] / page
    before, rest = path.read_text("utf-8").split(BEGIN)
    path.write_text(f"{before}{BEGIN}\n{text}{END}{rest.split(END)[1]}", "utf-8")


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder of the JSON files")
    folder = parser.parse_args(argv).results
    text = [
        "# What was measured\n",
        "Made by `python bench/report.py` from the JSON files beside it.\n",
    ]
    sections = {
        "speed": speed,
        "scaling": scaling,
        "scaling-gpu": scaling,
        "accuracy": lambda result: accuracy(result, folder),
        "positions": positions,
        "field": field,
        "photographs": photographs,
        "partial_views": partial_views,
        "open_patterns": open_patterns,
        "stability": lambda result: stability(result, folder),
        "criteria": criteria,
        "implementations": implementations,
        "theory": lambda result: theory(result, folder),
        "peer_settings": settings,
        "run": durations,
    }
    for name, write in sections.items():
        result = read(RESULTS if name == "peer_settings" else folder, name)
        if result is None:
            text.append(f"## {name}\n\nNot measured: there is no {name}.json.\n")
        else:
            text.append(write(result))
    if (folder / "methods.jpg").is_file():
        text.append("## Every method on the same frame\n\n![Methods](methods.jpg)\n")
    out = folder / "REPORT.md"
    out.write_text("\n".join(text))
    print(f"wrote {out}")
    measured = [read(folder, name) for name in ("speed", "accuracy", "positions", "field")]
    if folder == RESULTS and None not in measured:
        timed, errors, places, spaces = measured
        insert("README.md", figures(timed, errors))
        insert("docs/questions/accuracy.md", exactness(places, spaces))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
