"""The report, its plots, and the tables in the README and on the page of gels, made from the tables
in results/ and nothing else.

python bench/report.py     writes results/REPORT.md, results/*.png and the tables on both pages
"""

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from environment import RESULTS
from methods import DEFAULT, GRIDDED, LINES, PAPER

BUSY = 0.2  # cores at other work, above which times are not to be trusted
OURS = (LINES, DEFAULT, PAPER, GRIDDED)
IN_README = (
    DEFAULT,
    "goodFeaturesToTrack + cornerSubPix",
    "chess-corners, lean, centre of mass",
    "findChessboardCornersSB",
)
BEGIN, END = "<!-- by bench/report.py -->\n", "<!-- until here -->\n"
INTRODUCTION = """# What was measured

`python bench/report.py` makes this page from the tables beside it, and `python bench/run.py` \
makes those. Each section names the device, the versions and the commit that it was measured with.

A corner is missed if no detection matches it; a detection is false if it matches no corner. \
Matches are one to one, nearest first, within 3 px or .35 cells. A frame is right if no corner is \
missed and none is false. RMSE is that of the distance, px. Brackets hold 95 % intervals \
(Wilson's, over frames); rows whose intervals overlap do not differ significantly.
"""


# tables


def read(folder: Path, name: str) -> pd.DataFrame:
    """Return a table, with `environment` among its attributes."""
    path = folder / f"{name}.csv"
    table = pd.read_csv(path, comment="#")
    with path.open() as file:
        table.attrs["environment"] = json.loads(file.readline().removeprefix("#"))
    return table


def conditions(table: pd.DataFrame) -> str:
    """Return the line under a heading: device, driver, versions, commit, load."""
    around = table.attrs["environment"]
    packages = ", ".join(f"{name} {version}" for name, version in around["packages"].items())
    others = around.get("others") or 0
    busy = " **Others used the machine: times are rough.**" if others > BUSY else ""
    return (
        f"{around['device']}, driver {around['driver']}, {around['cpu']}, {around['cores']} cores, "
        f"{around['system']}; {packages}; commit {around['commit']}, {around['date'][:10]}; others "
        f"used {others} cores.{busy}\n"
    )


def headed(title: str, table: pd.DataFrame, *parts: str) -> str:
    """Return a section: its heading, the conditions of its table, and what is said."""
    return "\n".join([f"## {title}\n\n{conditions(table)}", *parts])


def markdown(table: pd.DataFrame) -> str:
    """Return a table as Markdown: floats with three digits, nothing as a dash."""
    lines = ["| " + " | ".join(map(str, table.columns)) + " |", "|---" * table.shape[1] + "|"]
    for _, row in table.iterrows():
        lines.append("| " + " | ".join(cell(value) for value in row) + " |")
    return "\n".join(lines) + "\n"


def cell(value: Any) -> str:
    if not isinstance(value, float):
        return str(value)
    if np.isnan(value):
        return "-"
    if value == int(value) and abs(value) < 1e6:
        return str(int(value))
    return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"


def interval(hits: float, count: float) -> tuple[float, float]:
    """Return Wilson's interval of 95 % for a share."""
    z, share = 1.96, hits / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * np.sqrt(share * (1 - share) / count + z * z / (4 * count**2)) / (1 + z * z / count)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def percent(hits: float, count: float) -> str:
    low, high = interval(hits, count)
    return f"{100 * hits / count:.0f} ({100 * low:.0f} to {100 * high:.0f})"


# detection


def summed(table: pd.DataFrame, *by: str) -> pd.DataFrame:
    """Return the counts of `detection` over groups, with errors and the median time."""
    groups = table.groupby(["method", *by], sort=False)
    whole = groups[["frames", "right", "corners", "missed", "false", "found", "squares"]].sum()
    whole["rmse"] = np.sqrt(whole["squares"] / whole["found"])
    whole["wrong"] = 1000 * (whole["missed"] + whole["false"]) / whole["corners"]
    whole["ms"] = groups["ms"].median()
    whole["share"] = 100 * whole["right"] / whole["frames"]
    of_frames = zip(whole["right"], whole["frames"], strict=True)
    whole["frames right, %"] = [percent(*each) for each in of_frames]
    return whole.reset_index()


def speed(folder: Path) -> str:
    table = read(folder, "speed")
    parts = [
        "From an image in host memory to positions in host memory; methods take turns in one run, "
        "and the answers that were timed are the ones that are scored. `times` is the ratio to our "
        "default. The paper reports 4.95 ms for 1936 corners at integer positions.\n"
    ]
    for scene, words in (("vga", "640 x 480"), ("wide", "1600 x 1200, two views")):
        rows = table[table["scene"] == scene].sort_values("ms")
        base = rows.loc[rows["method"] == DEFAULT, "ms"].iloc[0]
        shown = ["method", "ms", "ms_p95", "times", "missed", "false", "rmse"]
        parts.append(f"### {words}, {rows['corners'].iloc[0]} corners\n")
        parts.append(markdown(rows.assign(times=rows["ms"] / base)[shown]))
    return headed("Time", table, *parts)


def detection(folder: Path) -> str:
    table = read(folder, "detection")
    whole = summed(table).sort_values("ms")
    whole["missed a frame"] = whole["missed"] / whole["frames"]
    whole["false a frame"] = whole["false"] / whole["frames"]
    error_against_time(whole, folder / "error.png")
    right = summed(table, "severity").pivot(index="severity", columns="method", values="share")
    by_severity(right, folder / "severity.png", "frames right, %")
    counted = ["frames", "frames right, %", "missed a frame", "false a frame", "rmse", "ms"]
    return headed(
        "Error against run time",
        table,
        f"{whole['frames'].max()} rendered gels: every object at every severity, 20 to 44 "
        "corners a side, the print worn (wear causes most of the RMSE of every method). A method "
        "with fewer frames takes seconds for some, and sees one of three. The peers "
        "have the settings that `search.py` found for them on other scenes; ours are the same "
        "everywhere.\n",
        "![Error against run time](error.png)\n",
        markdown(whole[["method", *counted]]),
        "## Frames right, %, by severity and by density\n",
        "![Frames right by severity](severity.png)\n",
        markdown(shares(table, "severity").merge(shares(table, "markers"), on="method")),
    )


def error_against_time(whole: pd.DataFrame, path: Path) -> None:
    """Draw each method at its time and its wrong corners, and write the plot."""
    figure, axes = plt.subplots(figsize=(8, 5), layout="constrained")
    placed: list[np.ndarray] = []
    for _, row in whole.sort_values("ms").iterrows():
        at = row["ms"], max(row["wrong"], 0.01)
        axes.plot(*at, "o", color="#c1272d" if row["method"] in OURS else "#4d4d4d")
        beside = [np.log10(at) - other for other in placed]
        near = [y for x, y in beside if abs(x) < 0.6 and abs(y) < 0.25]  # decades
        placed.append(np.log10(at))
        shift = 11 * sum(abs(y) < 0.1 for y in near)  # labels of neighbours lie one above the other
        place = 4, 3 + shift if min(near, default=0) >= 0 else -10 - shift
        axes.annotate(row["method"], at, fontsize=7, xytext=place, textcoords="offset points")
    said = {"xlabel": "ms a frame, 640 x 480", "ylabel": "missed and false per 1000 corners"}
    axes.set(xscale="log", yscale="log", **said)
    axes.grid(alpha=0.25)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def by_severity(columns: pd.DataFrame, path: Path, said: str) -> None:
    """Draw each column over the severity of the press, ours bold, and write the plot."""
    names = {"xlabel": "severity of the press", "ylabel": said}
    axes = columns.plot(style=".-", colormap="tab20", figsize=(8, 4.5), grid=True, **names)
    for line in axes.lines:
        line.set_linewidth(2 if line.get_label() in OURS else 0.8)
    axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5), frameon=False)
    axes.figure.savefig(path, dpi=110, bbox_inches="tight")
    plt.close(axes.figure)


def shares(table: pd.DataFrame, by: str) -> pd.DataFrame:
    """Return the share of right frames, %, a column for each value."""
    wide = summed(table, by).pivot(index="method", columns=by, values="share").round()
    return wide.rename(columns=lambda value: f"{by} {value:g}").reset_index()


def shortfalls(folder: Path) -> str:
    """List where a peer finds more frames right than our best row, with our grid or not."""
    rows = summed(read(folder, "detection"), "markers", "severity")
    found = []
    for (markers, severity), group in rows.groupby(["markers", "severity"]):
        own = group["method"].isin(OURS)
        ours = group[own].sort_values("share").iloc[-1]
        least = interval(ours["right"], ours["frames"])[1]
        for _, peer in group[~own & (group["share"] > ours["share"])].iterrows():
            found.append(
                {
                    "corners a side": markers,
                    "severity": severity,
                    "our best": f"{ours['method']}: {ours['right']} of {ours['frames']}",
                    "peer": f"{peer['method']}: {peer['right']} of {peer['frames']}",
                    "told apart": "yes"
                    if interval(peer["right"], peer["frames"])[0] > least
                    else "no",
                }
            )
    body = markdown(pd.DataFrame(found)) if found else "Nowhere.\n"
    return f"## Where a peer finds more frames right than our best row\n\n{body}"


def photographs(folder: Path) -> str:
    table = read(folder, "photographs")
    counts = table[["missed", "false", "outside"]].astype(str).agg(" / ".join, axis=1)
    expected = dict(zip(table["photograph"], table["expected"], strict=True))
    names = {name: f"{name} ({count})" for name, count in expected.items()}

    def wide(values: pd.Series) -> pd.DataFrame:
        shown = table.assign(shown=values)
        pivoted = shown.pivot(index="method", columns="photograph", values="shown")
        return pivoted.loc[table["method"].unique(), list(names)]

    return headed(
        "Photographs: missed / false / outside",
        table,
        "False corners are counted where every corner is listed, `outside` elsewhere. The truth is "
        "a saddle fitted to the image, which favours methods that fit one; differences under .2 px "
        "mean nothing. The small boards are rendered before enlarged photographs of rooms.\n",
        markdown(wide(counts).rename(columns=names).reset_index()),
        "### Median distance from the truth, px\n",
        markdown(wide(table["median"]).reset_index()),
    )


# positions, numbers, fields


def sigma(folder: Path) -> str:
    table = read(folder, "sigma")
    usual = table[table["noise"].isna()]
    groups = usual.groupby(["kind", "corrosion"], sort=False)
    rows = groups.agg(frames=("frames", "sum"), rms=("rms", "mean"), share=("within_2", "mean"))
    rows["within 2 sigma, %"] = 100 * rows.pop("share")
    moved = usual[usual["kind"] != "position"]
    covered = 100 * moved.groupby(["severity", "kind"])["within_2"].mean().unstack()
    by_severity(covered, folder / "sigma.png", "errors within two sigma, %")
    return headed(
        "Positions, displacements, and their sigma",
        table,
        "RMS of the distance, px, and the share of coordinates within two stated sigma, %, by wear "
        "of the print (0 is a perfect one). The sigma of a position is that of the mark that is "
        "seen: where the mark sits on a worn print is not in it. A displacement cancels the wear. "
        "`raw` is before the lattice filter.\n",
        markdown(rows.reset_index()),
        "![Share within two sigma, by severity](sigma.png)\n",
    )


def ablation(folder: Path) -> str:
    table = read(folder, "ablation")
    table["told"] = table["frames right, told"] + table["frames wrong, told"]
    counts = ["right", "false", "wrong", "told", "frames refused", "frames silent"]
    rows: dict[str, dict[str, str]] = {}
    for (family, frames), group in table.groupby(["family", "frames"], sort=False):
        column, values = f"{family} ({frames})", group.set_index("method")[counts]
        for idea, own in values.iterrows():
            more = own - values.loc["all"]
            shown = own.map(str) if idea == "all" else more.map("{:+}".format).replace("+0", "0")
            text = f"{' / '.join(shown[:3])}; {' / '.join(shown[3:])}"
            kept = rows.setdefault(str(idea), {"left out": str(idea)})
            kept[column] = text if idea == "all" or more.any() else "="
    return headed(
        "What each idea of the lattice is worth",
        table,
        "Nodes right / false / wrong; frames told / refused / silently wrong, of the number in the "
        "heading. The first row has all ideas; the others say what changes (=: nothing) if one is "
        "left out. Half-edges that choose each other, closed faces and the second look at places "
        "without a corner are structure: no constant leaves them out.\n",
        markdown(pd.DataFrame(rows.values())),
    )


def as_it_is(name: str, title: str, words: str = "") -> Callable[[Path], str]:
    """Return a section that shows a whole table."""

    def section(folder: Path) -> str:
        table = read(folder, name)
        return headed(title, table, f"{words}\n", markdown(table))

    return section


# limits


def limits(folder: Path) -> str:
    table = read(folder, "limits")
    wrong = (table["missed"] + table["false"]) / table["corners"]
    table["held"] = table["level"].where(wrong <= 0.01)
    rows = table.groupby(["method", "difficulty"], sort=False)["held"].agg(
        lambda levels: ", ".join(f"{level:g}" for level in levels.dropna()) or "none"
    )
    return headed(
        "Where each method breaks",
        table,
        "The levels at which at most 10 corners of 1000 are missed or false.\n",
        markdown(rows.unstack("difficulty").reset_index()),
    )


def refraction(folder: Path) -> str:
    table = read(folder, "refraction")
    parts = dict(list(table.groupby("part", sort=False)))
    return headed(
        "A window and a gel",
        table,
        as_air(folder),
        "Behind a gel of index 1.41, with one parameter of the window changed:\n",
        _refracted(parts["parameters"]),
        "From rendered images, the parameters exact; a gel of 0 mm is air:\n",
        _refracted(parts["images"]),
        "Cameras and window calibrated on noisy views of drawn rigs. Along the normal, a press of "
        "1 mm errs by:\n",
        *(_of_drawn(str(index), rows) for index, rows in parts["drawn"].groupby("changed")),
    )


def _of_drawn(index: str, rows: pd.DataFrame) -> str:
    error, covered = rows["error_um"], rows["error_um"] < 1.96 * rows["sigma_um"]
    return (
        f"- {index}: {error.median():.2g} um, at most {error.max():.2g}; 1.96 of its bias's sigma "
        f"covers it in {percent(covered.sum(), len(rows))} % of {len(rows)} rigs\n"
    )


def as_air(folder: Path) -> str:
    """Return the table of the errors of a rig that does not know of its window."""
    table = read(folder, "refraction")
    return (
        "Without `--window`, behind 5 mm of acrylic and a gel, 45 mm from the cameras:\n\n"
        + _refracted(table[table["part"] == "as air"])
    )


def _refracted(rows: pd.DataFrame) -> str:
    names = {
        "gel_mm": "gel, mm",
        "index": "index",
        "changed": "changed",
        "reads_mm": "1 mm reads, mm",
        "error_um": "error where pressed, um RMS",
        "position_mm": "position off by, mm",
    }
    known = rows.dropna(axis="columns", how="all")
    return markdown(known.filter(names).rename(columns=names))


# the page


def figures(folder: Path) -> str:
    """Return the README's table: time, error and right frames of each method."""
    timed, detection, field = (read(folder, name) for name in ("speed", "detection", "field"))
    errors = summed(detection).set_index("method")
    value = field.set_index(["what", "case", "unit"])["value"]
    rate = field.loc[field["what"].str.startswith("cmp-cl run"), "value"].iloc[0]
    small, large = (timed[timed["scene"] == scene].set_index("method") for scene in ("vga", "wide"))
    rows = small.loc[list(IN_README)].sort_values("ms")
    own = {
        "640 x 480, ms": rows["ms"],
        "1600 x 1200, ms": large["ms"],
        "RMSE px": rows["rmse"],
        "missed / false": rows[["missed", "false"]].astype(str).agg(" / ".join, axis=1),
        "frames right, %": errors["frames right, %"],
    }
    first = f"cmp_cl, two views to their field (`run` from MJPG: {rate:.3g} a second)"
    whole = pd.DataFrame(own).reindex([first, *rows.index])
    whole.loc[first, "1600 x 1200, ms"] = value[
        "frame to field, two views", "severity to 0.5", "ms"
    ]
    text = (
        f"{conditions(timed).strip()} Medians of one run, from an image in host memory to "
        f"positions in host memory, for {small['corners'].iloc[0]} and {large['corners'].iloc[0]} "
        f"corners; errors are those of {small['corners'].iloc[0]}. The last column is over "
        f"{errors['frames'].max()} rendered frames, slightly to severely deformed, of commit "
        f"{detection.attrs['environment']['commit']}.\n\n"
    )
    return text + markdown(whole.rename_axis("method").reset_index())


def insert(page: Path, text: str) -> None:
    """Replace the text between the marks on a page."""
    before, rest = page.read_text("utf-8").split(BEGIN)
    page.write_text(f"{before}{BEGIN}{text}{END}{rest.split(END)[1]}", "utf-8")


SECTIONS: dict[str, Callable[[Path], str]] = {
    "speed": speed,
    "detection": detection,
    "photographs": photographs,
    "sigma": sigma,
    "numbering": as_it_is("numbering", "Numbers"),
    "ablation": ablation,
    "field": as_it_is("field", "From a frame to its field"),
    "refraction": refraction,
    "stiff": as_it_is("stiff", "Stiff and extreme cases", "Counts are of false corners."),
    "limits": limits,
}


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the tables")
    folder = parser.parse_args(argv).out
    text = [INTRODUCTION]
    for name, section in SECTIONS.items():
        if (folder / f"{name}.csv").is_file():
            text.append(section(folder))
        else:
            text.append(f"## {name}\n\nNot measured: there is no {name}.csv.\n")
    if (folder / "detection.csv").is_file():
        text.append(shortfalls(folder))
    (folder / "REPORT.md").write_text("\n".join(text))
    print(f"wrote {folder / 'REPORT.md'}")
    if folder == RESULTS:
        insert(RESULTS.parents[1] / "README.md", figures(folder))
        insert(RESULTS.parents[1] / "docs" / "tutorials" / "gel.md", as_air(folder))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
