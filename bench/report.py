"""The report and its plots, made from the JSON files in results/ and from nothing else.

python bench/report.py     writes results/REPORT.md, results/*.png and the table in the README
"""

import argparse
import itertools
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.patheffects
import matplotlib.pyplot as plt
import matplotlib.ticker
import numpy as np
from accuracy import unpacked
from environment import RESULTS
from field import grouped
from methods import DEFAULT, FILTERED, FULL, GRIDDED, LINES, PAPER, RINGS, THREE
from positions import interval, mean_interval, rms_interval

mpl.rcParams["figure.dpi"] = 90
Row = dict[str, Any]
BUSY = 0.2  # cores that others use, above which times are not to be trusted
BEGIN, END = "<!-- by bench/report.py -->\n", "<!-- until here -->\n"
LEAST = 0.05  # what stands for 0 on a logarithmic axis, per thousand corners
SHOWN = (DEFAULT, LINES, RINGS, THREE, GRIDDED, FULL, FILTERED, PAPER)
ZHANG = "Zhang's spectrum, OpenCL + our grid"
OURS, PEER, GRID = "#c43c1e", "#3b6ea5", "#6a9a5b"

# Measured by the paper on its own machine (14-core i7-12700H) and scenes: context, not a rival row.
PAPER_TIMES = "4.95 ms (its ChESS 5.04 ms), 1936 corners, integer positions"


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a Markdown table; floats with 3 digits, None as a dash."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(_cell(value) for value in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
    return str(value)


def _between(bounds: Sequence[float]) -> str:
    """Return an interval of shares in percent; a dash where one frame gives none."""
    low, high = bounds
    return f"{100 * max(low, 0):.0f} to {100 * min(high, 1):.0f}" if low == low else "-"


def _percent(share: float, bounds: Sequence[float]) -> str:
    """Return a share in percent with its interval."""
    return f"{100 * share:.0f} ({_between(bounds)})"


def _share(hits: float, count: float) -> str:
    """Return a share of a count in percent, with Wilson's interval."""
    return _percent(hits / count, interval(hits, count)) if count else "-"


def _within(value: float, bounds: Sequence[float]) -> str:
    """Return a figure with its interval; a dash where one frame gives none."""
    low, high = bounds
    return f"{value:.3g} ({low:.3g} to {high:.3g})" if low == low else f"{value:.3g} (-)"


def _apart(one: Sequence[float], other: Sequence[float]) -> bool:
    """Whether the first interval lies wholly below the second."""
    return one[1] < other[0]


def _surely_better(bounds: Sequence[Sequence[float]]) -> list[int]:
    """Count, for each row, the rows whose share is higher beyond both intervals."""
    return [sum(_apart(own, other) for other in bounds) for own in bounds]


def _order(figures: dict[str, tuple[float, Sequence[float]]]) -> str:
    """Say which errors are smaller; those whose intervals overlap are not told apart."""
    ordered = sorted(figures.items(), key=lambda item: item[1][0])
    text = ordered[0][0]
    for (_, (_, before)), (name, (_, bounds)) in itertools.pairwise(ordered):
        text += f"{' <' if _apart(before, bounds) else ','} {name}"
    return text


INTERVALS = "Brackets hold intervals of 95 %. Rows whose intervals overlap are not told apart: "


def conditions(result: Row) -> str:
    """Return the line under a heading: what it was measured with."""
    if (result["environment"].get("others") or 0) > BUSY:
        busy = "**Other work ran on this machine at the same time: its times are rough.**"
        return f"{described(result)}\n{busy}\n"
    return described(result)


def described(result: Row) -> str:
    """Return device, driver, versions, commit, and how busy the machine was."""
    around = result["environment"]
    packages = ", ".join(f"{name} {version}" for name, version in around["packages"].items())
    others = around.get("others")
    return (
        f"{around['device']}, driver {around['driver']}, {around['cpu']} with {around['cores']} "
        f"cores, {around['system']}; {packages}; commit {around['commit']}, {around['date']}"
        + ("" if others is None else f"; others used {others} cores")
        + ".\n"
    )


def left_out(result: Row) -> str:
    reasons = result.get("unavailable") or {}
    return "".join(f"Left out: {name}: {reason}.\n" for name, reason in reasons.items())


# speed


def speed(result: Row) -> str:
    parts = ["## Time", conditions(result), left_out(result)]
    parts.append(
        "Wall time from an image in host memory to positions in host memory, methods in turns in "
        "one run, the answers scored that were timed. `times` is the ratio to our default; a row "
        f"that is less right shows it. For context, the paper reports {PAPER_TIMES}.\n"
    )
    for scene in result["scenes"]:
        rows, columns = scene["shape"]
        parts.append(
            f"### {columns} x {rows}, {scene['corners']} corners, cells of {scene['cell']:.1f} px\n"
        )
        head = ("method", "ms", "95 %", "times", "missed", "false", "RMSE px", "p95 px")
        kept = sorted(scene["rows"], key=lambda row: row["ms"])
        keys = ("method", "ms", "ms_p95", "times_default", "missed", "false", "rmse", "p95")
        parts.append(table(head, [[row[key] for key in keys] for row in kept]))
        parts.append(_paced(scene))
        parts.append(_targets(scene))
        base = next(row for row in scene["rows"] if row["method"] == DEFAULT)
        stages = sorted(base["stages"].items(), key=lambda stage: -stage[1])
        parts.append(
            f"Our default with profiling: {base['wall_profiled']:.2f} ms, of which kernels "
            f"{base['kernels']:.2f} ms and host and transfers {base['host_and_transfers']:.2f} ms; "
            f"{base['bytes_per_pixel']:.1f} bytes a pixel on the device. Kernels, us: "
            + ", ".join(f"{name} {1e3 * ms:.0f}" for name, ms in stages)
            + ".\n"
        )
    return "\n".join(parts)


def _paced(scene: Row) -> str:
    """Tabulate what a frame takes when a camera gives them, and not a loop."""
    text = f"One frame every {scene['pace_ms']:g} ms; beside it the same frames in a loop:\n\n"
    head = ("method", "ms", "99 %", "loop, ms", "loop, 99 %", "times the loop's")
    keys = ("method", "ms", "ms_p99", "loop_ms", "loop_ms_p99", "times_loop")
    return text + table(head, [[row[key] for key in keys] for row in scene["paced"]])


def _targets(scene: Row) -> str:
    """Tabulate the ratios that are goals, and whether they are met in this run."""
    rows = {row["method"]: row for row in scene["rows"]}
    ms = rows[DEFAULT]["ms"]
    lean_goal, features_goal = (10, 4.5) if scene["scene"] == "vga" else (18, 7)
    lines = []
    lean = [row for name, row in rows.items() if name.startswith("chess-corners, lean")]
    if lean:
        ratio = min(row["ms"] for row in lean) / ms
        goal = f"at least {lean_goal} times faster than chess-corners' leanest"
        lines.append((goal, f"{ratio:.1f}", ratio >= lean_goal))
    if "goodFeaturesToTrack" in rows:
        ratio = rows["goodFeaturesToTrack"]["ms"] / ms
        goal = f"at least {features_goal} times faster than goodFeaturesToTrack"
        lines.append((goal, f"{ratio:.1f}", ratio >= features_goal))
    if LINES in rows:
        ratio = ms / rows[LINES]["ms"]
        lines.append(("default at most 1.7 times EDGE_LINES alone", f"{ratio:.2f}", ratio <= 1.7))
    for row in scene["paced"]:
        if row["method"] == DEFAULT:
            ratio = row["times_loop"]
            goal = f"one frame every {scene['pace_ms']:g} ms, at most 1.4 times the loop's"
            lines.append((goal, f"{ratio:.2f}", ratio <= 1.4))
    most = max(row["bytes_per_pixel"] for row in rows.values() if "bytes_per_pixel" in row)
    goal = "device memory, bytes a pixel, at most 8 in every configuration"
    lines.append((goal, f"{most:.1f}", most <= 8))
    body = [(goal, figure, "yes" if met else "**no**") for goal, figure, met in lines]
    return table(("goal", "this run", "met"), body)


# accuracy


def accuracy(result: Row, folder: Path) -> str:
    result = unpacked(result)
    rows = {(row["method"], row["group"]): row for row in result["rows"]}
    names = list(dict.fromkeys(row["method"] for row in result["rows"]))
    count = rows[DEFAULT, "all"]["frames"]
    parts = ["## Error", conditions(result), left_out(result)]
    parts.append(
        f"{count} rendered scenes, each method on each of them. A frame fails if one corner is "
        "missed or one is false. Peers have the settings that `search.py` found on other scenes. "
        "Rows `+ grid` count the nodes that were measured, not those filled in. The print is worn "
        "in all of these scenes, and wear is most of every error in px here; perfect prints and "
        "other wear stand under Positions. "
        f"{INTERVALS}they stand as they were measured, and the column `surely better` counts the "
        "rows that are ahead beyond both intervals (Wilson's, over frames).\n"
    )
    parts.append("### Success, % of frames, by severity\n")
    groups = [f"severity {s:g}" for s in result["severities"]]
    parts.append(_rates(rows, names, groups))
    parts.append(_right(rows, result))
    parts.append("### Success, % of frames, by density and by object\n")
    groups = sorted(
        {g for _, g in rows if g.startswith(("markers", "object", "mode")) and "," not in g}
    )
    parts.append(_rates(rows, names, groups))
    parts.append("### All scenes\n")
    head = (
        "method",
        "success %",
        "surely better",
        "missed a frame",
        "false a frame",
        "RMSE px",
        "p95 px",
        "ms",
        "ms 95 %",
    )
    bounds = [interval(rows[name, "all"]["success"], rows[name, "all"]["frames"]) for name in names]
    body = []
    for name, better in zip(names, _surely_better(bounds), strict=True):
        row = rows[name, "all"]
        body.append(
            [
                name,
                _share(row["success"], row["frames"]),
                better,
                row["missed"] / row["frames"],
                row["false"] / row["frames"],
                row["rmse"],
                row["p95"],
                row["ms"],
                row["ms_p95"],
            ]
        )
    parts.append(table(head, body))
    parts.append("### Position error on corners that both found, px\n")
    common = result["common"]
    parts.append(
        table(
            ("method", "corners", "its RMSE", "our default", "our EDGE_LINES"),
            [
                [n, c["corners"], c["rmse"], c["rmse_default"], c.get("rmse_lines")]
                for n, c in common.items()
            ],
        )
    )
    parts.append(_shortfalls(rows, names, result))
    _success_plot(rows, names, result["severities"], folder / "success.png")
    parts.append("![Success by severity](success.png)\n")
    for markers in result["densities"]:
        group = f"markers {markers}"
        points = [rows[name, group] for name in names if "NumPy" not in name or "grid" in name]
        _pareto(points, f"{markers} x {markers} at 640 x 480", folder / f"pareto-{markers}.png")
        parts.append(f"### Error against time, {markers} x {markers}\n")
        parts.append(f"![Error against time](pareto-{markers}.png)\n")
        parts.append(
            "A row is on a front if no other was both faster and more exact in this run; times and "
            "RMSE have no intervals here, and close rows are not told apart.\n"
        )
        front = set(_front(points, "per_thousand")) | set(_front(points, "rmse"))
        body = [
            [
                p["method"],
                p["ms"],
                p["ms_p95"],
                p["per_thousand"],
                p["rmse"],
                "yes" if p["method"] in front else "",
            ]
            for p in sorted(points, key=lambda p: p["ms"])
        ]
        head = ("method", "ms", "ms 95 %", "wrong per 1000", "RMSE px", "on a front")
        parts.append(table(head, body))
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
                told = _apart(*bounds) or _apart(*bounds[::-1])
                words = "" if told else " (not told apart)"
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
        body.append([name, *(_share(row["success"], row["frames"]) for row in picked)])
    return table(("method", *groups), body)


def _is_peer(name: str) -> bool:
    return not name.startswith("cmp_cl")


def _shortfalls(rows: dict[tuple[str, str], Row], names: Sequence[str], result: Row) -> str:
    """List where a peer is ahead: of all, or of those without a grid."""
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
                    if not _is_peer(name) or ("grid" in name and not gridded):
                        continue
                    if "NumPy" in name:  # the same answers as its OpenCL form
                        continue
                    if other["success"] > own["success"]:
                        ours, theirs = (interval(r["success"], r["frames"]) for r in (own, other))
                        body.append(
                            [
                                group,
                                mine,
                                f"{own['success']} of {own['frames']} ({_between(ours)} %)",
                                name,
                                f"{other['success']} of {other['frames']} ({_between(theirs)} %)",
                                "yes" if _apart(ours, theirs) else "no",
                            ]
                        )
    text = "### Where a peer succeeds more often than we do, up to severity 1\n\n"
    if not body:
        return text + "Nowhere.\n"
    head = ("scenes", "ours", "succeeds", "peer", "succeeds", "told apart")
    return text + table(head, body)


def _front(points: Sequence[Row], key: str) -> list[str]:
    """Return the methods that no other beats in both time and error."""
    front, best = [], float("inf")
    for point in sorted(points, key=lambda p: (p["ms"], p[key] or 0)):
        value = point[key]
        if value is not None and value < best:
            front.append(point["method"])
            best = value
    return front


def _colour(name: str) -> str:
    if _is_peer(name) and "grid" in name:
        return GRID
    return PEER if _is_peer(name) else OURS


def _pareto(points: Sequence[Row], title: str, path: Path) -> None:
    """Draw two panels of numbered points, and the names beside them."""
    points = sorted((p for p in points if p["rmse"] is not None), key=lambda p: p["ms"])
    figure, axes = plt.subplots(1, 3, figsize=(15, 7), width_ratios=(5, 5, 2.6))
    for axis, key, label in zip(
        axes,
        ("per_thousand", "rmse"),
        ("missed + false per 1000 corners", "RMSE, px"),
        strict=False,
    ):
        front = _front(points, key)
        axis.set(xscale="log", yscale="log", xlabel="ms a frame: median, and line to 95 %")
        for p in points:
            height = max(p[key], LEAST)
            colour = _colour(p["method"])
            axis.plot([p["ms"], p["ms_p95"]], [height, height], color=colour, alpha=0.2, lw=1)
            axis.plot(p["ms"], height, "o", color=colour, ms=6 if p["method"] in front else 3.5)
        line = [p for p in points if p["method"] in front]
        axis.step(
            [p["ms"] for p in line],
            [max(p[key], LEAST) for p in line],
            where="post",
            color="black",
            lw=0.8,
            alpha=0.6,
        )
        _plain(axis.xaxis)
        _plain(axis.yaxis)
        axis.set_ylabel(label)
        axis.grid(alpha=0.25, which="both", lw=0.4)
        _numbers(axis, [(p["ms"], max(p[key], LEAST), _colour(p["method"])) for p in points])
    axes[0].set_title(f"nothing wrong is drawn at {LEAST}", fontsize=8)
    axes[2].axis("off")
    for number, p in enumerate(points, 1):
        axes[2].text(
            -0.15,
            1 - number / (len(points) + 1),
            f"{number}  {p['method']}",
            fontsize=7.5,
            color=_colour(p["method"]),
            transform=axes[2].transAxes,
        )
    figure.suptitle(f"{title}: red ours, blue peers, green peers with a grid; line: Pareto front")
    _save(figure, path)


def _plain(axis: Any) -> None:
    """Label a few of 1 to 9 of each decade of a logarithmic axis, the fewer the longer it is."""
    low, high = axis.get_view_interval()
    decades = np.log10(high / low)
    steps = next(
        steps
        for longest, steps in (
            (0.5, range(1, 10)),
            (1, (1, 2, 3, 5, 7)),
            (2.2, (1, 2, 5)),
            (9, (1,)),
        )
        if decades <= longest
    )
    axis.set_major_locator(mpl.ticker.LogLocator(subs=steps))
    axis.set_major_formatter(mpl.ticker.FormatStrFormatter("%g"))
    axis.set_minor_formatter(mpl.ticker.NullFormatter())


def _numbers(axis: Any, points: Sequence[tuple[float, float, str]]) -> None:
    """Put the number of each point (x, y, colour) beside it, where nothing else is."""
    axis.figure.tight_layout()
    axis.figure.canvas.draw()
    taken = [tuple(axis.transData.transform((x, y))) for x, y, _ in points]
    turns = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    around = [(r * np.cos(t), r * np.sin(t)) for r in (10, 16, 23, 31, 40) for t in turns]
    for number, (x, y, colour) in enumerate(points, 1):
        u, v = taken[number - 1]
        dx, dy = next(
            (
                (dx, dy)
                for dx, dy in around
                if all(abs(u + dx - a) > 13 or abs(v + dy - b) > 9 for a, b in taken)
            ),
            around[0],
        )
        taken.append((u + dx, v + dy))
        axis.annotate(
            str(number),
            (x, y),
            xytext=(dx, dy),
            textcoords="offset pixels",
            ha="center",
            va="center",
            fontsize=7.5,
            color=colour,
            arrowprops={"arrowstyle": "-", "lw": 0.4, "color": colour, "shrinkA": 0, "shrinkB": 0},
            path_effects=[mpl.patheffects.withStroke(linewidth=2, foreground="white")],
        )


def _success_plot(
    rows: dict[tuple[str, str], Row], names: Sequence[str], severities: Sequence[float], path: Path
) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(13, 6.5), sharey=True)
    panels = (
        [name for name in names if name in SHOWN],
        [
            name
            for name in names
            if _is_peer(name) and "our grid" not in name and "NumPy" not in name
        ],
    )
    for axis, chosen, title in zip(
        axes, panels, ("ours", "peers, tuned on other scenes"), strict=True
    ):
        for k, name in enumerate(chosen):
            picked = [rows[name, f"severity {s:g}"] for s in severities]
            rates = [100 * row["success"] / row["frames"] for row in picked]
            marker = "os^vDP*X<>h8"[k % 12]
            colour = plt.get_cmap("tab20")(k * 2 % 20 + k // 10)
            # Of lines that coincide the earlier one is wider.
            wide = 1.2 + 4 * (len(chosen) - 1 - k) / len(chosen)
            axis.plot(severities, rates, color=colour, lw=wide, alpha=0.35)
            axis.plot(
                severities,
                rates,
                marker=marker,
                ms=4 + wide,
                mfc="none",
                lw=1,
                color=colour,
                label=name,
            )
        axis.set(title=title, xlabel="severity", ylim=(-3, 103))
        axis.grid(alpha=0.3)
        axis.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=3)
    axes[0].set_ylabel("frames with nothing missed and nothing false, %")
    _save(figure, path)


# fields in space, photographs, scaling, stability, theory


KINDS = ("raw position", "position", "raw displacement", "displacement")


def positions(result: Row) -> str:
    """Report the lattice filter: errors before and behind it, and whether the stated ones hold."""
    parts = ["## Positions, and their stated errors", conditions(result), left_out(result)]
    parts.append(
        "Each scene against its frame at rest; nodes that are measured and rightly numbered. "
        "`raw` is EDGE_STEP, the other behind the lattice filter; RMSE of the distance, px, over "
        "both axes. Corrosion 0 is a perfect print, 1 the wear of the other tables. With wear most "
        "of the raw error is that the visible corner is not where the material point is, which "
        "rewards whoever averages more. Intervals of 95 % count frames, whose nodes depend on each "
        "other; where they overlap, rows and columns are not told apart.\n"
    )
    for key in ("severity", "markers", "noise", None):
        others = {"severity", "markers", "noise"} - {key}
        rows = [
            row
            for row in result["groups"]
            if (key is None or key in row) and not others & row.keys()
        ]
        title = f"by {key}" if key else "in all"
        head = ("corrosion", *([key] if key else []), "frames")
        labels = [[row["corrosion"], *_label(row, key), row["frames"]] for row in rows]
        body = [
            [
                *label,
                *(_within(row[kind]["rms"], row[kind]["rms_interval"]) for kind in KINDS),
                f"{100 * row['worse']:.0f} ({_between(row['worse_interval'])})",
                row["worst_ratio"],
            ]
            for label, row in zip(labels, rows, strict=True)
        ]
        parts.append(f"### Errors {title}, px\n\n`worse`: frames whose displacement the filter")
        parts.append("makes worse, %, and the largest ratio of filtered to raw.\n")
        parts.append(table((*head, *KINDS, "worse", "worst ratio"), body))
        body = [
            [
                *label,
                *(
                    f"{100 * row[kind]['within_1']:.0f}, "
                    + _percent(row[kind]["within_2"], row[kind]["within_2_interval"])
                    for kind in (*KINDS, "corner")
                ),
            ]
            for label, row in zip(labels, rows, strict=True)
        ]
        parts.append(f"### Stated errors {title}\n\nCoordinates within one, two stated standard")
        parts.append(
            "deviations, %: 68 and 95 if errors are normal. `corner` is `corners.sigma`, which "
            "knows the image's noise and no wear.\n"
        )
        parts.append(table((*head, *KINDS, "corner"), body))
    parts.append("### Where the truth bends\n\nNodes whose true position or displacement is over")
    parts.append(".2 px off the cubic through their neighbours; RMSE, px, with wear.\n")
    body = [[kind, value["nodes"], value["rms"]] for kind, value in result["bends"].items()]
    parts.append(table(("error", "nodes", "px"), body))
    parts.append(_compared(result["compared"]))
    bound = result["bound"]
    parts.append(
        "### The bound on a perfect print\n\nThe noise-only Cramer-Rao bound of a disc of .75 "
        f"cell is {bound['bound']:.4f} px, the noise part of EDGE_STEP {bound['noise_part']:.4f} "
        f"px ({100 * (bound['noise_part'] / bound['bound'] - 1):.0f} % above), its whole error "
        f"{bound['all']:.4f} px; {bound['frames']} frames.\n"
    )
    parts.append(_known(result["strains"]))
    parts.append(_resolution(result["resolution"]))
    parts.append(
        f"{result['ms']:.2f} ms for positions and sigma of 1936 nodes, {result['ms_bends']:.2f} ms "
        f"for their displacements; {result['left_out']} scenes were not numbered and are left "
        "out.\n"
    )
    return "\n".join(parts)


def _label(row: Row, key: str | None) -> list[Any]:
    """Return what a row says of its group beside its wear."""
    value = row.get(key) if key else None
    if isinstance(value, list):
        value = f"{value[0]:.1f} to {value[1]:.1f}"
    return [value] if key else []


def _compared(rows: Sequence[Row]) -> str:
    """Tabulate other methods on the corners that they find too, without wear and with it."""
    parts = ["### Other methods, on the corners that they find too\n\nRMSE, px. `<`: smaller"]
    parts.append("beyond both intervals; a comma: not told apart.\n")
    names = {"rms": "its", "edge_step": "EDGE_STEP", "filtered": "filtered"}
    body = []
    for row in rows:
        figures = {name: (row[key], row[f"{key}_interval"]) for key, name in names.items()}
        cells = [_within(*each) for each in figures.values()]
        lead = [row["corrosion"], row["method"], row["frames"], row["corners"]]
        body.append([*lead, *cells, _order(figures)])
    head = ("corrosion", "method", "frames", "corners", "its", "EDGE_STEP's", "filtered", "order")
    return "\n".join([*parts, table(head, body)])


def _known(rows: Sequence[Row]) -> str:
    """Tabulate uniform stretches, in space and in the plane."""
    text = (
        "### Known strains\n\nUniform stretches of a flat lattice of 40 x 40 nodes with 10 um of "
        "wear that travels and 2 um of noise at each moment, measured in space and in the plane: "
        "E11, and the RMSE of the displacement.\n\n"
    )
    body = [
        [
            row["view"],
            row["field"],
            row["strain"],
            row["mean"],
            _within(row["rms"], row["rms_interval"]),
            _percent(row["within_2"], row["within_2_interval"]),
            _within(row["displacement_um"], row["displacement_um_interval"]),
        ]
        for row in sorted(rows, key=lambda row: (row["view"], row["field"], row["strain"]))
    ]
    head = ("view", "field", "strain", "mean found", "RMSE", "within 2, %", "displacement um")
    return text + table(head, body)


def _resolution(rows: Sequence[Row]) -> str:
    """Tabulate sines, and the wavelength at which half of the strain's amplitude is left."""
    curves: dict[tuple[str, str], list[Row]] = {}
    for row in sorted(rows, key=lambda row: row["wavelength"]):
        curves.setdefault((row["view"], row["field"]), []).append(row)
    waves = [row["wavelength"] for row in next(iter(curves.values()))]
    head = ("strain left, by wavelength", *(f"{wave} nodes" for wave in waves), "half left at")
    body = []
    for (view, name), curve in curves.items():
        left = [row["left"] for row in curve]
        half = float(np.interp(0.5, left, waves)) if left[0] < 0.5 < left[-1] else None
        said = None if half is None else f"{half:.1f} nodes"
        body.append([f"{view}, {name}", *left, said])
    errors = [
        [f"{view}, {name}", *(row["displacement_um"] for row in curve)]
        for (view, name), curve in curves.items()
    ]
    parts = [
        "### Resolution of the strain\n\nThe share that is left of the amplitude of a strain that "
        "is a sine over the columns, with the same wear and noise. The resolution is the "
        "wavelength at which half is left.\n",
        table(head, body),
        "The displacement's RMSE beside it, um:\n",
        table(("displacement", *(f"{wave} nodes" for wave in waves)), errors),
    ]
    return "\n".join(parts)


def field(result: Row) -> str:
    parts = ["## Fields in space", conditions(result)]
    rows, columns = result["view"]
    parts.append(
        f"Rendered pairs, two views of {columns} x {rows} with {result['markers']} x "
        f"{result['markers']} corners of a pattern 32 mm wide, through cameras that are known "
        "exactly. Errors are distances in space, in micrometres, over all nodes of all frames: "
        "RMSE of the position, RMSE of the displacement from the frame at rest and its 95th "
        "percentile (the median of the frames'), behind the lattice filter, and raw before it; "
        "`within` is the share of errors within two stated standard deviations. A frame counts as "
        "right in its numbering if no corner of it has a wrong row or column. The print is worn. "
        f"{INTERVALS}the frames of one seed share their print and their frame at rest, so that the "
        "true intervals are wider.\n"
    )
    head = ("frames", "numbering right %", "nodes placed %", "position", "raw", "displacement")
    head = (*head, "raw", "within %", "raw", "95 %")
    for key in ("severity", "object", "mode"):
        body = []
        for group in sorted(
            grouped(result["frames"], "config", key), key=lambda group: group["config"]
        ):
            frames = [
                row
                for row in result["frames"]
                if (row["config"], row[key]) == (group["config"], group[key])
            ]
            right = sum(row["wrong_index"] == 0 for row in frames)
            figures = [
                _within(
                    group[f"{name}_rms_um"], rms_interval([row[f"{name}_um2"] for row in frames])
                )
                for name in ("place", "raw_place", "moved", "raw_moved")
            ]
            shares = [
                _percent(group[name], mean_interval([row[name] for row in frames]))
                for name in ("within_2", "raw_within_2")
            ]
            lead = [group["config"], group[key], group["frames"], _share(right, len(frames))]
            lead.append(100 * group["nodes_placed"])
            body.append([*lead, *figures, *shares, group["moved_p95_um"], group["ms"]])
        parts.append(table(("settings", key, *head, "ms"), body))
    wrong = [row for row in result["frames"] if row["wrong_index"]]
    if wrong:
        parts.append("Frames with a wrong index:\n")
        keys = ("config", "seed", "object", "mode", "severity", "wrong_index", "nodes")
        parts.append(table(keys, [[row[key] for key in keys] for row in wrong]))
    parts.append(
        "What `detector.grid` takes for the numbering, after the detection: frames of a press in "
        "any order, whole ones and such that leave corners to the second look.\n"
    )
    body = [
        [
            f"{row['form']}=",
            row["stream"],
            f"{row['corners']:.0f}",
            row["frames"],
            row["wrong_index"],
            row["ms"],
            row["ms_p95"],
        ]
        for row in result.get("numbering", [])
    ]
    parts.append(table(("form", "frames", "corners", "runs", "wrong", "ms", "95 %"), body))
    count = sum(len(run["order"]) for run in result["orders"])
    same = sum(run["same_bytes"] for run in result["orders"])
    parts.append(f"{same} of {count} frames gave the same bytes when they came in another order.\n")
    parts.append(
        "### Boards of known squares\n\nSides of squares, mm: of the Bumblebee2 pairs with their "
        "published calibration, of each of OpenCV's pairs with the calibration of the others.\n"
    )
    if not result["boards"]:
        return "\n".join([*parts, "Left out: there were no photographs.\n"])
    body = [
        [
            row["set"],
            row["config"],
            row["sides"],
            row["true"],
            f"{row['mean']:.3f}",
            f"{row['deviation']:.3f}",
            f"{min(row['pair_means']):.3f} to {max(row['pair_means']):.3f}",
            row.get("calibration_error_px", "published"),
        ]
        for row in sorted(result["boards"], key=lambda row: row["set"])
    ]
    head = ("pairs", "settings", "sides", "true", "mean", "deviation", "means of pairs")
    parts.append(table((*head, "reprojection error px"), body))
    return "\n".join(parts)


def photographs(result: Row) -> str:
    parts = ["## Real photographs", conditions(result), left_out(result)]
    parts.append(
        "Truth is a saddle fit to the grey image: it flatters methods that fit one, and "
        "differences below 0.2 px say nothing. Beside it `scatter` asks no truth: the median "
        "distance, px, of a corner from the middle of its four neighbours, over the root of 5/4; "
        "what the surface bends is in it for all methods alike. False counts only where every "
        "corner is listed; `outside` are detections elsewhere.\n"
    )
    names = list(dict.fromkeys(row["photograph"] for row in result["rows"]))
    for name in names:
        rows = [row for row in result["rows"] if row["photograph"] == name]
        count = rows[0]["photographs"]
        parts.append(
            f"### {name}: {rows[0]['expected']} corners"
            + (f" in {count} photographs\n" if count > 1 else "\n")
        )
        keys = (
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
        )
        body = []
        for row in rows:
            found = row["expected"] - row["missed"]
            shares = {
                "recall": _share(found, row["expected"]),
                "precision": _share(found, found + row["false"]) if row.get("precision") else None,
            }
            body.append([shares.get(key, row.get(key)) for key in keys])
        parts.append(table(keys, body))
    return "\n".join(parts)


def partial_views(result: Row) -> str:
    """Report boards partly out of view, boards of a wrong size, an island."""
    parts = ["## Boards partly out of view", conditions(result)]
    parts.append(
        "Each picture is cut at its four sides. A node is right if it lies within 3 px of a "
        "corner and its numbers are those of one lattice; false, if no corner is within a quarter "
        "of a cell. `doubted` views say that their numbers may be wrong, `silent` ones are wrong "
        "and do not; only a method that is told the board's size has such numbers.\n"
    )
    keys = ("set", "method", "views", "visible", "right", "false", "other", "refused", "doubted")
    keys += ("silent",)
    parts.append(table(keys, [[row[key] for key in keys] for row in result["partial"]]))
    for name, reason in result["unavailable"].items():
        parts.append(f"Not measured: {name} ({reason}).\n")
    counts: dict[str, list[int]] = {}
    for row in result["wrong_sizes"]:
        group = counts.setdefault(row["answer"], [0, 0])
        group[tuple(row["asked"]) != (6, 9)] += 1
    parts.append(
        "Boards of 6 x 9 corners, seen whole, asked for in that size and in seven others:\n"
    )
    head = ("answer", "asked for 6 x 9", "asked for another size")
    parts.append(table(head, [[answer, *group] for answer, group in counts.items()]))
    parts.append("water/ellipse_10, corners with a node of the right number in their island:\n")
    rows = [
        [word, row["outside"], row["island"], row["corners"], "yes" if row["ambiguous"] else "no"]
        for word, row in result["island"].items()
    ]
    parts.append(table(("numbered", "outside", "island", "of", "ambiguous"), rows))
    return "\n".join(parts)


def open_patterns(result: Row) -> str:
    """Report numbers against the rest frame without a border in view."""
    parts = ["## Patterns without a border in view", conditions(result)]
    parts.append(
        "Frames are numbered like the rest frame. Right: every node has its number, but for one in "
        "500. In silence: more have not, and the frame does not say that its numbers are "
        "ambiguous. A perfect print that moved by a whole period gives the same picture as one "
        "that did not move: nothing in the frame can tell, so that every such frame is ambiguous. "
        "The errors of a worn print move with it, and tell.\n"
    )
    for form, words in (
        ("alone", "By the rest frame alone"),
        ("followed", "After the frames before, between which it moves by 0.3 cells at most"),
    ):
        counts = result["counts"][form]
        head = list(dict.fromkeys(verdict for group in counts.values() for verdict in group))
        shown = ["in silence" if verdict == "wrong" else verdict for verdict in head]
        rows = [[group, *(count[verdict] for verdict in head)] for group, count in counts.items()]
        parts.append(f"{words}:\n\n" + table(("frames", *shown), rows))
    peers = result["lattices"]
    parts.append(
        "No peer takes a rest frame. One frame in fourteen, given to each method alone: a frame is "
        "right if all its nodes have the numbers of one lattice, but for one in 500, however few "
        "they are; a node is false that is a quarter of a cell from every corner.\n"
    )
    parts.append(table(list(peers[0]), [list(row.values()) for row in peers]))
    parts += [f"Not measured: {name} ({why}).\n" for name, why in result["unavailable"].items()]
    return "\n".join(parts)


def scaling(result: Row) -> str:
    parts = [f"## Cost by size, frames and process on {result['environment']['device']}"]
    parts.append(conditions(result))
    parts.append("Bytes are all that the detector holds on the device, the image included.\n")
    rows = [
        [
            f"{r['shape'][1]} x {r['shape'][0]}",
            r["corners"],
            r["ms"],
            r["ms_p95"],
            r["ns_per_pixel"],
            r["bytes_per_pixel"],
        ]
        for r in result["sizes"]
    ]
    head = ("image", "corners", "ms", "ms 95 %", "ns a pixel", "device bytes a pixel")
    parts.append(table(head, rows))
    parts.append(
        table(
            ("corners in a VGA frame", "ms"), [[r["corners"], r["ms"]] for r in result["corners"]]
        )
    )
    rows = [[r["what"], r["ms_per_frame"], 1e3 / r["ms_per_frame"]] for r in result["frames"]]
    parts.append(table(("VGA frames", "ms a frame", "frames a second"), rows))
    parts.append(_floor(result["floor"]))
    if result["threads"]:
        parts.append(
            table(
                ("threads", "ms", "ms 95 %"),
                [[r["threads"], r["ms"], r["ms_p95"]] for r in result["threads"]],
            )
        )
    rows = [[r["cache"], r["imports_s"], r["seconds"]] for r in result["first_result"]]
    parts.append(table(("kernel cache", "imports, s", "first result in a new process, s"), rows))
    return "\n".join(parts)


def _floor(floor: Row) -> str:
    return (
        f"A VGA frame moves at least {floor['bytes_a_frame']} bytes, the image and the corners "
        f"once, and needs {floor['operations_a_frame'] / 1e6:.0f} million operations. This device "
        f"copies {floor['copy_gb_s']:.1f} GB/s and does "
        f"{floor['operations_a_second'] / 1e9:.0f} thousand million operations of 32 bits a "
        f"second, which would be {floor['frames_a_second_at_floor']:.0f} frames a second; the best "
        f"of these rows takes {floor['times_the_floor']:.0f} times as long. A single frame is an "
        f"upload ({1e3 * floor['upload_ms']:.0f} us), {floor['launches_a_frame']} launches "
        f"({1e3 * floor['launch_ms']:.1f} us each if the kernels were empty) and one answer "
        f"({1e3 * floor['answer_ms']:.0f} us): {floor['alone_ms_at_floor']:.3f} ms; it takes "
        f"{floor['alone_times_the_floor']:.1f} times as long.\n"
    )


def stability(result: Row, folder: Path) -> str:
    parts = ["## Numbers at their limits", conditions(result)]
    head = (
        "refinement",
        "corners",
        "largest",
        "99.9 %",
        "near a bound",
        "frames with other corners",
    )
    oracle = result["against_oracle"]
    parts.append("float32 kernels against the float64 oracle, px.\n")
    parts.append(
        table(
            head,
            [
                [
                    n,
                    r["count"],
                    r["largest"],
                    r["p99_9"],
                    r["near_a_bound_or_other_branch"],
                    r["frames_with_other_corners"],
                ]
                for n, r in oracle.items()
            ],
        )
    )
    for key in ("by_sine", "by_contrast", "by_rings"):
        body = [
            [n, f"{r['from']:g} to {r['to']:g}", r["count"], r["largest"], r["p99_9"]]
            for n, o in oracle.items()
            for r in o[key]
            if r["count"]
        ]
        parts.append(
            table(("refinement", key.replace("_", " "), "corners", "largest", "99.9 %"), body)
        )
    rows = result["along_position"]
    parts.append(
        table(
            ("refinement", "moved right by", "corners", "largest difference px", "step of float32"),
            [
                [r["refinement"], r["offset"], r["corners"], r["largest"], r["float32_step"]]
                for r in rows
            ],
        )
    )
    rows = result["depth"]
    parts.append(
        table(
            ("exposure", "bits", "missed", "false", "RMSE px"),
            [[r["exposure"], r["bits"], r["missed"], r["false"], r["rmse"]] for r in rows],
        )
    )
    parts.append("### corners.sigma against the real error\n")
    rows = result["sigma"]
    parts.append(
        table(
            (
                "scenes",
                "corners",
                "z (1 is right)",
                "rank correlation",
                "doubtful",
                "above 1 px",
                "doubtful of these",
            ),
            [
                [
                    r["kind"],
                    r["corners"],
                    r["z"],
                    r["rank_correlation"],
                    r["doubtful"],
                    r["far"],
                    r["doubtful_of_far"],
                ]
                for r in rows
            ],
        )
    )
    _sigma_plot(rows, folder / "sigma.png")
    parts.append("![sigma](sigma.png)\n\n### Single cases\n")
    parts.append(
        table(
            ("case", "figure", "expected"),
            [[r["case"], r["figure"], r["expected"]] for r in result["cases"]],
        )
    )
    parts.append("### Where each method breaks\n")
    parts.append("Levels at which at most 10 corners of 1000 are missed or false.\n")
    _breaking_plot(result["breaking"], folder / "breaking.png")
    parts.append("![Where methods break](breaking.png)\n")
    body = [
        [r["sweep"], r["method"], ", ".join(f"{v:g}" for v in r["holds"]) or "none"]
        for r in result["breaking_points"]
    ]
    parts.append(table(("what gets worse", "method", "holds at"), body))
    return "\n".join(parts)


def _sigma_plot(rows: Sequence[Row], path: Path) -> None:
    figure, axis = plt.subplots(figsize=(5, 4.4))
    for row in rows:
        sigma = [d["sigma"] for d in row["deciles"]]
        error = [d["error"] for d in row["deciles"]]
        axis.plot(sigma, error, "o-", ms=4, label=row["kind"])
    high = axis.get_xlim()[1]
    axis.plot([0, high], [0, high], color="grey", lw=0.8, label="equal")
    axis.set(
        xlabel="sigma, px, ten groups",
        ylabel="real error per axis, px",
        xlim=(0, high),
        ylim=(0, None),
    )
    axis.legend(fontsize=8)
    axis.grid(alpha=0.3)
    _save(figure, path)


def _breaking_plot(sweeps: dict[str, Any], path: Path) -> None:
    columns = 4
    lines = -(-len(sweeps) // columns)
    figure, axes = plt.subplots(lines, columns, figsize=(16, 3.8 * lines))
    for axis, (what, curves) in zip(axes.flat, sweeps.items(), strict=False):
        for k, (name, points) in enumerate(curves.items()):
            at = [p["at"] for p in points]
            wrong = [max(p["per_thousand"], LEAST) for p in points]
            colour = plt.get_cmap("tab20")(k / 12)
            style = "--" if _is_peer(name) else "-"
            wide = 1 + 0.35 * (len(curves) - k)  # of curves that coincide the earlier is wider
            axis.plot(at, wrong, style, marker=".", ms=9, color=colour, label=name, lw=wide)
        axis.axhline(10, color="grey", lw=0.6)
        axis.set(xlabel=what, yscale="log", ylim=(LEAST * 0.8, None))
        if what.startswith(("exposure", "cell")):
            axis.set_xscale("log")
            _plain(axis.xaxis)
        axis.grid(alpha=0.25)
    for axis in list(axes.flat)[len(sweeps) :]:
        axis.axis("off")
    handles, labels = axes.flat[0].get_legend_handles_labels()
    list(axes.flat)[-1].legend(handles, labels, fontsize=8, loc="center")
    for line in np.atleast_2d(axes):
        line[0].set_ylabel("missed + false per 1000")
    _save(figure, path)


def criteria(result: Row) -> str:
    parts = ["## Thresholds and criteria", conditions(result)]
    parts.append("A threshold for each ring against the mean of the window, all else the same.\n")
    keys = ("threshold", "frames", "success", "missed", "false", "rmse", "p95")
    parts.append(table(keys, [[row[key] for key in keys] for row in result["thresholds"]]))
    seen, spent = result["decisions"], result["times"]
    parts.append(
        f"Rapid and spectral criteria disagree on {100 * seen['near_disagree']:.2f} % of the "
        f"pixels within 1.5 px of a corner and on {100 * seen['far_disagree']:.3f} % of the "
        "others. From the binary image to the candidates the rapid form takes "
        f"{spent['rapid']['ms']:.3f} ms and the spectral one {spent['spectral']['ms']:.3f} ms, "
        f"{spent['ratio']:.1f} times as long (the paper says over 20 and over 10 times for its "
        "two).\n"
    )
    return "\n".join(parts)


def implementations(result: Row) -> str:
    count = result["scenes"]
    rows = [[row["name"], row["device"], f"{row['same']} of {count}"] for row in result["rows"]]
    pairs = [
        [pair["one"], pair["other"], None if pair["px"] is None else f"{pair['px']:.1e}"]
        for pair in result["pairs"]
    ]
    parts = ["## One implementation and another", conditions(result), left_out(result)]
    parts.append(
        f"{count} scenes and configurations: a digest of all whole numbers, maps and corners, "
        "against that of the oracle, and the largest difference of a coordinate of a corner.\n"
    )
    parts.append(table(("implementation", "device", "digests that agree"), rows))
    parts.append(table(("one", "other", "largest difference, px"), pairs))
    return "\n".join(parts)


def theory(result: Row, folder: Path) -> str:
    parts = ["## Theory", conditions(result)]
    parts.append(
        "Closed forms on a continuous ring (thin lines) against rings of 16 samples from ideal "
        "corners (dots); the differences are the sampling.\n"
    )
    parts.append(table(("quantity", "rms difference"), list(result["agreement"].items())))
    figure, axes = plt.subplots(2, 3, figsize=(14, 7.5))
    for axis, along in zip(axes[0], ("width", "azimuth", "shift"), strict=True):
        curves = result[along]
        for k, colour in enumerate((GRID, OURS, PEER)):
            axis.plot(
                curves["at"], np.array(curves["inner_sampled"])[:, k], ".", ms=2.5, color=colour
            )
            axis.plot(
                curves["at"],
                np.array(curves["inner_formula"])[:, k],
                color=colour,
                lw=1,
                label=f"|F{k + 1}|",
            )
        unit = "px" if along == "shift" else "rad"
        axis.set(xlabel=f"{along}, {unit}, inner ring", ylabel="magnitude")
        axis.legend(fontsize=8)
    for axis, (name, curve) in zip(axes[1], result["correlation"].items(), strict=True):
        axis.plot(curve["sampled"], "o", ms=4, color=OURS, label="sampled")
        axis.plot(curve["formula"], lw=1, color="black", label="formula")
        axis.axhline(0.75, color="grey", lw=0.7)
        axis.set(
            xlabel=f"turn, samples; sectors of {name} rad", ylabel="correlation", ylim=(0, 1.1)
        )
        axis.legend(fontsize=8)
    _save(figure, folder / "theory.png")
    parts.append("![Theory](theory.png)\n")
    return "\n".join(parts)


def _save(figure: Any, path: Path) -> None:
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def settings(result: Row) -> str:
    """Report what the search for the peers' settings found, and what it was worth."""
    parts = ["## The peers' settings", described(result)]
    parts.append(
        f"Searched on {result['scenes_a_density']} scenes a density, seeds "
        f"{result['first_seed']} and up, which nothing else uses. Success and wrong corners are "
        "those on these scenes, with the settings found and with the usual ones.\n"
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
        if not (name in SHOWN or _is_peer(name)):
            continue
        success = whole.get(name) and _share(whole[name]["success"], whole[name]["frames"])
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
