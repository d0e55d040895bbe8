"""Which corners are found: rendered scenes, photographs, marks, criteria, the peers' settings."""

from collections.abc import Sequence
from pathlib import Path

from accuracy import unpacked
from methods import DEFAULT, FILTERED, FULL, GRIDDED
from positions import interval

from sections.plots import front_of, pareto, success_plot
from sections.tables import (
    INTERVALS,
    Row,
    apart,
    between,
    conditions,
    described,
    is_peer,
    left_out,
    named,
    share_of,
    surely_better,
    table,
    table_of,
)

ZHANG = "Zhang's spectrum, OpenCL + our grid"


def accuracy(result: Row, folder: Path) -> str:
    result = unpacked(result)
    rows = {(row["method"], row["group"]): row for row in result["rows"]}
    names = list(dict.fromkeys(row["method"] for row in result["rows"]))
    count = rows[DEFAULT, "all"]["frames"]
    parts = ["## Detection on rendered scenes", conditions(result), left_out(result)]
    parts.append(
        f"{count} rendered scenes, with every method on each of them. The peers have the settings "
        "that `search.py` found on other scenes. Rows with `+ grid` count measured nodes only, "
        "not interpolated ones. The print is worn in all of these scenes, and wear causes most of "
        "the error of every method; the section on positions has perfect prints and other degrees "
        f"of wear. {INTERVALS}The rows are in the order of measurement. `surely better` is the "
        "number of methods that are significantly better: their interval lies wholly above "
        "(Wilson's, over frames).\n"
    )
    parts.append("### Frames right, %, by severity\n")
    groups = [f"severity {s:g}" for s in result["severities"]]
    parts.append(_rates(rows, names, groups))
    parts.append(_right(rows, result))
    parts.append("### Frames right, %, by density, by object and by mode\n")
    groups = sorted(
        {g for _, g in rows if g.startswith(("markers", "object", "mode")) and "," not in g}
    )
    parts.append(_rates(rows, names, groups))
    parts.append("### All scenes\n")
    head = "method, frames right %, surely better, missed a frame, false a frame, RMSE px, p95 px"
    keys = "method share better missed_a_frame false_a_frame rmse p95 ms ms_p95"
    bounds = [interval(rows[name, "all"]["success"], rows[name, "all"]["frames"]) for name in names]
    body = []
    for name, better in zip(names, surely_better(bounds), strict=True):
        row = rows[name, "all"]
        share = share_of(row["success"], row["frames"])
        each = {f"{kind}_a_frame": row[kind] / row["frames"] for kind in ("missed", "false")}
        body.append({**row, **each, "share": share, "better": better})
    parts.append(table_of(body, f"{head}, ms, ms 95 %", keys))
    parts.append("### Position error on the corners that both methods found, px\n")
    common = [{"rmse_lines": None, **row} for row in named(result["common"])]
    head = "method, corners, its RMSE, our default, our EDGE_LINES"
    parts.append(table_of(common, head, "name corners rmse rmse_default rmse_lines"))
    success_plot(rows, names, result["severities"], folder / "success.png")
    parts.append("![Frames right by severity](success.png)\n")
    if (folder / "methods.jpg").is_file():
        parts.append("### Every method on the same frame\n\n![Methods](methods.jpg)\n")
    return "\n".join(parts)


def against_time(result: Row, folder: Path) -> str:
    """Report errors against times of the rendered scenes, for each density."""
    result = unpacked(result)
    rows = {(row["method"], row["group"]): row for row in result["rows"]}
    names = list(dict.fromkeys(row["method"] for row in result["rows"]))
    parts = ["## Error against time", conditions(result)]
    parts.append(
        "These are the rendered scenes of the section on detection. A method is on a front if no "
        "other was both faster and more accurate in this run. Times and RMSE have no intervals "
        "here, so close rows may not differ significantly.\n"
    )
    for markers in result["densities"]:
        group = f"markers {markers}"
        points = [rows[name, group] for name in names if "NumPy" not in name or "grid" in name]
        pareto(points, f"{markers} x {markers} at 640 x 480", folder / f"pareto-{markers}.png")
        parts.append(f"### Error against time, {markers} x {markers}\n")
        parts.append(f"![Error against time](pareto-{markers}.png)\n")
        front = set(front_of(points, "per_thousand")) | set(front_of(points, "rmse"))
        body = [
            {**point, "front": "yes" if point["method"] in front else ""}
            for point in sorted(points, key=lambda point: point["ms"])
        ]
        head = "method, ms, ms 95 %, wrong per 1000, RMSE px, on a front"
        parts.append(table_of(body, head, "method ms ms_p95 per_thousand rmse front"))
    return "\n".join(parts)


def _right(rows: dict[tuple[str, str], Row], result: Row) -> str:
    """Tabulate the shares of right frames that are goals, and whether they are met in this run."""

    def share(name: str, group: str) -> float:
        return 100 * rows[name, group]["success"] / rows[name, group]["frames"]

    whole = rows[DEFAULT, "all"]
    least = min(share(DEFAULT, f"markers {markers}") for markers in result["densities"])
    false = whole["false"] / whole["frames"]
    lines = [
        ("default, at least 96 % of the frames", share(DEFAULT, "all"), 96, True),
        ("default, at least 91 % in each density", least, 91, True),
        ("default, at most .02 false a frame", false, 0.02, False),
    ]
    for severity, goal in ((1.25, 100), (1.5, 97)):
        group = f"severity {severity:g}"
        if severity in result["severities"]:
            lines += [
                (
                    f"{name}, at least {goal} % at severity {severity:g}",
                    share(name, group),
                    goal,
                    True,
                )
                for name in (GRIDDED, FULL, FILTERED)
            ]
            if (ZHANG, group) in rows:
                ahead = share(GRIDDED, group) - share(ZHANG, group)
                bounds = [
                    interval(rows[name, group]["success"], rows[name, group]["frames"])
                    for name in (GRIDDED, ZHANG)
                ]
                told = apart(*bounds) or apart(*bounds[::-1])
                words = "" if told else " (not significant)"
                lines.append((f"{GRIDDED}, % ahead of {ZHANG} there{words}", ahead, 0, True))
    body = [
        (
            goal,
            f"{figure:.3g}",
            "yes" if (figure >= bound if more else figure <= bound) else "**no**",
        )
        for goal, figure, bound, more in lines
    ]
    return table(("goal", "this run", "met"), body)


def _rates(rows: dict[tuple[str, str], Row], names: Sequence[str], groups: Sequence[str]) -> str:
    body = []
    for name in names:
        picked = [rows[name, group] for group in groups]
        body.append([name, *(share_of(row["success"], row["frames"]) for row in picked)])
    return table(("method", *groups), body)


def shortfalls(result: Row) -> str:
    """List where a peer succeeds more often: of all, or of those without a grid."""
    result = unpacked(result)
    rows = {(row["method"], row["group"]): row for row in result["rows"]}
    names = dict.fromkeys(row["method"] for row in result["rows"])
    body = []
    for markers in result["densities"]:
        for severity in result["severities"]:
            group = f"markers {markers}, severity {severity:g}"
            if severity > 1:
                continue
            for mine, gridded in ((FULL, True), (DEFAULT, False)):
                own = rows[mine, group]
                for name in names:
                    other = rows[name, group]
                    if not is_peer(name) or ("grid" in name and not gridded):
                        continue
                    if "NumPy" in name:  # the same answers as its OpenCL form
                        continue
                    if other["success"] > own["success"]:
                        ours, theirs = (interval(r["success"], r["frames"]) for r in (own, other))
                        body.append(
                            [
                                group,
                                mine,
                                f"{own['success']} of {own['frames']} ({between(ours)} %)",
                                name,
                                f"{other['success']} of {other['frames']} ({between(theirs)} %)",
                                "yes" if apart(ours, theirs) else "no",
                            ]
                        )
    text = "## Failures\n\n### Detection: where a peer succeeds more often, up to severity 1\n\n"
    if not body:
        return text + "Nowhere.\n"
    head = ("scenes", "ours", "succeeds", "peer", "succeeds", "told apart")
    return text + table(head, body)


def photographs(result: Row) -> str:
    parts = ["## Real photographs", conditions(result), left_out(result)]
    parts.append(
        "The truth is a saddle fitted to the grey image. This favours methods that fit a saddle, "
        "and differences below 0.2 px are meaningless. `scatter` needs no truth: it is the median "
        "distance of a corner from the mean of its four neighbours, in px, divided by the square "
        "root of 5/4. The curvature of the surface adds the same amount to it for all methods. "
        "False corners are counted only where every corner is listed; `outside` counts the "
        "detections elsewhere. The small boards are "
        "rendered, so their truth is exact; behind each is a part of a photograph of a room, "
        "enlarged four times, whose own corners count as `outside`.\n"
    )
    names = list(dict.fromkeys(row["photograph"] for row in result["rows"]))
    for name in names:
        rows = [row for row in result["rows"] if row["photograph"] == name]
        count = rows[0]["photographs"]
        parts.append(
            f"### {name}: {rows[0]['expected']} corners"
            + (f" in {count} photographs\n" if count > 1 else "\n")
        )
        keys = [
            "method",
            "missed",
            "false",
            "outside",
            "recall",
            "precision",
            "median",
            "p95",
            "scatter",
            "ms",
        ]
        body = []
        for row in rows:
            found = row["expected"] - row["missed"]
            shares = {
                "recall": share_of(found, row["expected"]),
                "precision": share_of(found, found + row["false"])
                if row.get("precision")
                else None,
            }
            body.append([shares.get(key, row.get(key)) for key in keys])
        parts.append(table(keys, body))
    return "\n".join(parts)


def marks(result: Row) -> str:
    parts = ["## Marks in the cells", conditions(result)]
    cells = ", ".join(map(str, result["cells"]))
    parts.append(
        f"Rendered boards with cells of {cells} px, a mark in most of "
        "them, and worn gels without marks. A mark has junctions that look like corners; "
        "`drop_marks` takes out the corners inside another corner's cell, and the last two columns "
        "are what it leaves.\n"
    )
    keys = "images frames corners missed false missed_after false_after"
    names = "marks, images, corners, missed, false, missed then, false then"
    parts.append(table_of(result["rows"], names, keys))
    return "\n".join(parts)


def criteria(result: Row) -> str:
    parts = ["## Thresholds and criteria", conditions(result)]
    parts.append(
        "The image is binarized by a threshold for each ring, or by the mean of a window; all else "
        "is the same.\n"
    )
    keys = "threshold frames success missed false rmse p95"
    parts.append(table_of(result["thresholds"], keys.replace(" ", ", "), keys))
    seen, spent = result["decisions"], result["times"]
    parts.append(
        f"Rapid and spectral criteria disagree on {100 * seen['near_disagree']:.2f} % of the "
        f"pixels within 1.5 px of a corner and on {100 * seen['far_disagree']:.3f} % of the "
        "others. From the binary image to the candidates, the rapid form takes "
        f"{spent['rapid']['ms']:.3f} ms and the spectral one {spent['spectral']['ms']:.3f} ms, "
        f"{spent['ratio']:.1f} times as long (the paper says over 20 and over 10 times for its "
        "two).\n"
    )
    return "\n".join(parts)


def settings(result: Row) -> str:
    """Report what the search for the peers' settings found, and what it was worth."""
    parts = ["## The peers' settings", described(result)]
    parts.append(
        f"`search.py` chose these settings on {result['scenes_a_density']} scenes a density, with "
        f"seeds from {result['first_seed']} on that nothing else uses. Success and the number of "
        "wrong corners are those on these scenes, with the settings found and with the peer's "
        "defaults.\n"
    )
    body = []
    for name, found in result["settings"].items():
        for markers, values in found.items():
            best, usual = (result["scores"][name][markers][which] for which in ("best", "usual"))
            body.append(
                [
                    name,
                    markers,
                    ", ".join(f"{key} {value}" for key, value in values.items()) or "none",
                    f"{best['success']} of {best['frames']}, {best['missed'] + best['false']}",
                    f"{usual['success']} of {usual['frames']}, {usual['missed'] + usual['false']}",
                ]
            )
    head = ("peer", "corners a side", "settings", "success, wrong corners", "usual settings")
    parts.append(table(head, body))
    return "\n".join(parts)
