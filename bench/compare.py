"""Lists what got worse between two result files of the same kind.

    python bench/compare.py old/speed.json results/speed.json

Rows are matched by their names and settings. A row got worse if it takes longer than `--slower`
allows, if it misses, invents, misnumbers or fails more, if an error grew by over 5 %, or if two
implementations no longer give the same positions. Machines differ: where there are peers, a time is
compared as its ratio to the median of the peers in the same run. The exit status is 1 if anything
got worse.
"""

import argparse
import json
import statistics
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

Row = dict[str, Any]
Rows = Iterator[tuple[str, Row]]

_COUNTS = ("missed", "false", "wrong")
_ERRORS = ("rmse", "p95", "error")
_UNSEEN = 1e-4  # px: positions that differ by less are alike


def _ours(rows: Iterable[Row]) -> Iterator[Row]:
    return (row for row in rows if row["method"].startswith("cmp_cl"))


def _speed(result: Row) -> Rows:
    for scene in result["scenes"]:
        # Our own times in units of the peers', which the machine slows down alike.
        peers = [r["ms"] for r in scene["rows"] if not r["method"].startswith("cmp_cl")]
        unit = statistics.median(peers) if peers else 1.0
        for row in _ours(scene["rows"]):
            yield f"{scene['scene']}: {row['method']}", row | {"ms": row["ms"] / unit}


def _accuracy(result: Row) -> Rows:
    rows = (dict(zip(result["columns"], values, strict=True)) for values in result["rows"])
    for row in _ours(rows):
        yield f"{row['group']}: {row['method']}", row | {"ms": None}


def _photographs(result: Row) -> Rows:
    for row in _ours(result["rows"]):
        yield f"{row['photograph']}: {row['method']}", row | {"ms": None}


def _field(result: Row) -> Rows:
    for row in result["by_severity"]:
        right = round(row["index_right"] * row["frames"])
        errors = {"rmse": row["moved_rms_um"], "p95": row["moved_p95_um"]}
        name = f"severity {row['severity']}: {row['config']}"
        yield name, {"frames": row["frames"], "success": right, **errors}
    for row in result["numbering"]:
        name = f"numbering, {row['form']}=, {row['stream']} frames"
        yield name, {"frames": row["frames"], "wrong": row["wrong_index"], "ms": row["ms"]}


def _scaling(result: Row) -> Rows:
    for row in result["sizes"]:
        yield f"{row['shape'][1]} x {row['shape'][0]}", row


def _implementations(result: Row) -> Rows:
    scenes = result["scenes"]
    for row in result["rows"]:
        yield f"{row['name']}: digests", {"frames": scenes, "success": row["same"]}
    for row in result["pairs"]:
        yield f"{row['one']} and {row['other']}: positions", {"distance": row["px"]}


def _marks(result: Row) -> Rows:
    for row in result["rows"]:
        kept = {"missed": row["missed_after"], "false": row["false_after"]}
        yield row["images"], {"frames": row["frames"], **kept}


def _criteria(result: Row) -> Rows:
    for row in result["thresholds"]:
        yield row["threshold"], row


def _theory(result: Row) -> Rows:
    for name, error in result["agreement"].items():
        yield name, {"error": error}


def _stability(result: Row) -> Rows:
    for row in result["depth"]:
        yield f"exposure {row['exposure']}, {row['bits']} bits", row


def _positions(result: Row) -> Rows:
    for row in result["groups"]:
        for what in ("position", "displacement"):
            name = f"corrosion {row['corrosion']}: {what}"
            yield name, {"frames": row["frames"], "rmse": row[what]["rms"]}


def _strain(result: Row) -> Rows:
    for row in result["rows"]:
        name = f"strain {row['strain']}: {row['by']}"
        yield name, {"frames": row["pairs"], "missed": row["missing"], "rmse": row["rms"]}


def _partial_views(result: Row) -> Rows:
    for row in _ours(result["partial"]):
        counts = {"false": row["false"], "wrong": row["silently wrong"], "success": row["right"]}
        yield f"{row['set']}: {row['method']}", {"frames": row["visible"], **counts}


def _open_patterns(result: Row) -> Rows:
    for form, groups in result["counts"].items():
        for group, verdicts in groups.items():
            yield f"{group}, {form}", _judged(verdicts)


def _surroundings(result: Row) -> Rows:
    for row in _ours(result["boards"]):
        yield f"{row['ground']}: {row['method']}", _judged(row)
    for row in result["mirrors"]:
        yield f"{row['mirror']}, {row['print']}, {row['numbered']}", _judged(row)


def _judged(verdicts: Row) -> Row:
    """Return the frames, those right without a warning, and those silently wrong."""
    wrong = verdicts["silently wrong"] + verdicts.get("background alone", 0)
    count = sum(value for value in verdicts.values() if isinstance(value, int))
    return {"frames": count, "success": verdicts["right"], "wrong": wrong}


READERS = {
    "speed": _speed,
    "accuracy": _accuracy,
    "photographs": _photographs,
    "field": _field,
    "scaling": _scaling,
    "implementations": _implementations,
    "marks": _marks,
    "criteria": _criteria,
    "theory": _theory,
    "stability": _stability,
    "positions": _positions,
    "strain": _strain,
    "partial_views": _partial_views,
    "open_patterns": _open_patterns,
    "surroundings": _surroundings,
}


def rows_of(result: Row) -> Rows:
    """Return the rows of a result under names that stay the same between runs."""
    if result["kind"] not in READERS:
        raise SystemExit(f"nothing is known about results of kind {result['kind']!r}")
    return READERS[result["kind"]](result)


def worse(old: Row, new: Row, slower: float) -> list[str]:
    """Return what is worse in the new row, in words."""
    found = []
    for key in _COUNTS:
        if key in old and new[key] > old[key]:
            found.append(f"{key} {old[key]} -> {new[key]}")
    if old.get("success") is not None and new["success"] < old["success"]:
        found.append(f"success {old['success']} -> {new['success']} of {new['frames']}")
    for key in _ERRORS:
        before, after = old.get(key), new.get(key)
        if before is not None and (after is None or after > 1.05 * before):
            found.append(f"{key} {before:.4f} -> {after if after is None else round(after, 4)}")
    if "distance" in old:
        before, after = old["distance"], new["distance"]  # None: not the same corners
        if before is not None and (after is None or after > max(before, _UNSEEN)):
            found.append(
                f"distance {before:.1e} -> {after if after is None else f'{after:.1e}'} px"
            )
    if old.get("ms") is not None and new["ms"] > slower * old["ms"]:
        found.append(f"{new['ms'] / old['ms']:.2f} times the time")
    return found


def comparison(old: Row, new: Row, slower: float) -> tuple[list[str], list[str]]:
    """Return lines on what got worse, and the names of rows that only one file has."""
    if old["kind"] != new["kind"]:
        raise SystemExit(f"one file is about {old['kind']}, the other about {new['kind']}")
    before, after = dict(rows_of(old)), dict(rows_of(new))
    lines = []
    for name in before:
        if name not in after:
            continue
        if before[name].get("frames") != after[name].get("frames"):
            lines.append(f"{name}: cannot be compared, the numbers of frames differ")
            continue
        lines += [f"{name}: {what}" for what in worse(before[name], after[name], slower)]
    return lines, sorted(before.keys() ^ after.keys())


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--slower", type=float, default=1.15, help="allowed factor of the time")
    arguments = parser.parse_args(argv)
    old, new = (json.loads(path.read_text()) for path in (arguments.old, arguments.new))
    lines, single = comparison(old, new, arguments.slower)
    for name in single:
        print(f"only in one file: {name}")
    for line in lines:
        print(f"worse: {line}")
    if not lines:
        print("nothing got worse")
    return 1 if lines else 0


if __name__ == "__main__":
    raise SystemExit(main())
