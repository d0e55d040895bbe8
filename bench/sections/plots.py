"""The plots of the report."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.patheffects
import matplotlib.pyplot as plt
import matplotlib.ticker
import numpy as np
from methods import DEFAULT, FILTERED, FULL, GRIDDED, LINES, PAPER, RINGS

from sections.tables import Row, is_peer

mpl.rcParams["figure.dpi"] = 90
LEAST = 0.05  # what stands for 0 on a logarithmic axis, per thousand corners
OURS, PEER, GRID = "#c43c1e", "#3b6ea5", "#6a9a5b"
SHOWN = (DEFAULT, LINES, RINGS, GRIDDED, FULL, FILTERED, PAPER)


def front_of(points: Sequence[Row], key: str) -> list[str]:
    """Return the methods that no other beats in both time and error."""
    front, best = [], float("inf")
    for point in sorted(points, key=lambda p: (p["ms"], p[key] or 0)):
        value = point[key]
        if value is not None and value < best:
            front.append(point["method"])
            best = value
    return front


def colour_of(name: str) -> str:
    if is_peer(name) and "grid" in name:
        return GRID
    return PEER if is_peer(name) else OURS


def pareto(points: Sequence[Row], title: str, path: Path) -> None:
    """Draw two panels of numbered points, and the names beside them."""
    points = sorted((p for p in points if p["rmse"] is not None), key=lambda p: p["ms"])
    figure, axes = plt.subplots(1, 3, figsize=(15, 7), width_ratios=(5, 5, 2.6))
    for axis, key, label in zip(
        axes,
        ("per_thousand", "rmse"),
        ("missed + false per 1000 corners", "RMSE, px"),
        strict=False,
    ):
        front = front_of(points, key)
        axis.set(xscale="log", yscale="log", xlabel="ms a frame: median, and line to 95 %")
        for p in points:
            height = max(p[key], LEAST)
            colour = colour_of(p["method"])
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
        plain(axis.xaxis)
        plain(axis.yaxis)
        axis.set_ylabel(label)
        axis.grid(alpha=0.25, which="both", lw=0.4)
        _numbers(axis, [(p["ms"], max(p[key], LEAST), colour_of(p["method"])) for p in points])
    axes[0].set_title(f"nothing wrong is drawn at {LEAST}", fontsize=8)
    axes[2].axis("off")
    for number, p in enumerate(points, 1):
        axes[2].text(
            -0.15,
            1 - number / (len(points) + 1),
            f"{number}  {p['method']}",
            fontsize=7.5,
            color=colour_of(p["method"]),
            transform=axes[2].transAxes,
        )
    figure.suptitle(f"{title}: red ours, blue peers, green peers with a grid; line: Pareto front")
    save(figure, path)


def plain(axis: Any) -> None:
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


def success_plot(
    rows: dict[tuple[str, str], Row], names: Sequence[str], severities: Sequence[float], path: Path
) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(13, 6.5), sharey=True)
    panels = (
        [name for name in names if name in SHOWN],
        [
            name
            for name in names
            if is_peer(name) and "our grid" not in name and "NumPy" not in name
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
    save(figure, path)


def sigma_plot(rows: Sequence[Row], path: Path) -> None:
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
    save(figure, path)


def breaking_plot(sweeps: dict[str, Any], path: Path) -> None:
    columns = 4
    lines = -(-len(sweeps) // columns)
    figure, axes = plt.subplots(lines, columns, figsize=(16, 3.8 * lines))
    for axis, (what, curves) in zip(axes.flat, sweeps.items(), strict=False):
        for k, (name, points) in enumerate(curves.items()):
            at = [p["at"] for p in points]
            wrong = [max(p["per_thousand"], LEAST) for p in points]
            colour = plt.get_cmap("tab20")(k / 12)
            style = "--" if is_peer(name) else "-"
            wide = 1 + 0.35 * (len(curves) - k)  # of curves that coincide the earlier is wider
            axis.plot(at, wrong, style, marker=".", ms=9, color=colour, label=name, lw=wide)
        axis.axhline(10, color="grey", lw=0.6)
        axis.set(xlabel=what, yscale="log", ylim=(LEAST * 0.8, None))
        if what.startswith(("exposure", "cell")):
            axis.set_xscale("log")
            plain(axis.xaxis)
        axis.grid(alpha=0.25)
    for axis in list(axes.flat)[len(sweeps) :]:
        axis.axis("off")
    handles, labels = axes.flat[0].get_legend_handles_labels()
    list(axes.flat)[-1].legend(handles, labels, fontsize=8, loc="center")
    for line in np.atleast_2d(axes):
        line[0].set_ylabel("missed + false per 1000")
    save(figure, path)


def save(figure: Any, path: Path) -> None:
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)
