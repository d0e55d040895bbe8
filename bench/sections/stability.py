"""Numbers at their limits, other implementations, and theory."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from sections.plots import GRID, OURS, PEER, breaking_plot, save, sigma_plot
from sections.tables import Row, conditions, left_out, named, table, table_of


def stability(result: Row, folder: Path) -> str:
    parts = ["## Numerical limits", conditions(result)]
    oracle = result["against_oracle"]
    parts.append(
        "The distance in px between the positions of the float32 kernels and those of the float64 "
        "oracle: overall, by the sine of the angle between the edge lines, by contrast, and by "
        "the number of valid rings.\n"
    )
    head = "refinement, corners, largest, 99.9 %, near a bound, frames with other corners"
    keys = "name count largest p99_9 near_a_bound_or_other_branch frames_with_other_corners"
    parts.append(table_of(named(oracle), head, keys))
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
    head = "refinement, moved right by, corners, largest difference px, step of float32"
    keys = "refinement offset corners largest float32_step"
    parts.append(table_of(result["along_position"], head, keys))
    head = "exposure, bits, missed, false, RMSE px"
    parts.append(table_of(result["depth"], head, "exposure bits missed false rmse"))
    parts.append("### corners.sigma against the real error\n")
    rows = result["sigma"]
    head = "scenes, corners, z (1 is right), rank correlation, doubtful, above 1 px"
    keys = "kind corners z rank_correlation doubtful far doubtful_of_far"
    parts.append(table_of(rows, f"{head}, doubtful of these", keys))
    sigma_plot(rows, folder / "sigma.png")
    parts.append("![sigma](sigma.png)\n\n### Single cases\n")
    parts.append(table_of(result["cases"], "case, figure, expected", "case figure expected"))
    return "\n".join(parts)


def breaking(result: Row, folder: Path) -> str:
    """Report up to which level of each difficulty each method holds."""
    parts = ["### Detection: where each method breaks\n"]
    parts.append("The levels at which at most 10 corners of 1000 are missed or false.\n")
    breaking_plot(result["breaking"], folder / "breaking.png")
    parts.append("![Where methods break](breaking.png)\n")
    body = [
        [r["sweep"], r["method"], ", ".join(f"{v:g}" for v in r["holds"]) or "none"]
        for r in result["breaking_points"]
    ]
    parts.append(table(("what gets worse", "method", "holds at"), body))
    return "\n".join(parts)


def implementations(result: Row) -> str:
    count = result["scenes"]
    rows = [[row["name"], row["device"], f"{row['same']} of {count}"] for row in result["rows"]]
    pairs = [
        [pair["one"], pair["other"], None if pair["px"] is None else f"{pair['px']:.1e}"]
        for pair in result["pairs"]
    ]
    parts = ["## Agreement between implementations", conditions(result), left_out(result)]
    parts.append(
        f"{count} scenes with their configurations. A digest covers all integer results, maps and "
        "corners; it agrees if it equals the oracle's. The second table gives the largest "
        "difference of a coordinate between two implementations.\n"
    )
    parts.append(table(("implementation", "device", "digests that agree"), rows))
    parts.append(table(("one", "other", "largest difference, px"), pairs))
    return "\n".join(parts)


def theory(result: Row, folder: Path) -> str:
    parts = ["## Theory", conditions(result)]
    parts.append(
        "Lines are the closed forms for a continuous ring, dots the values for rings of 16 "
        "samples of ideal corners. The difference is due to sampling.\n"
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
    save(figure, folder / "theory.png")
    parts.append("![Theory](theory.png)\n")
    return "\n".join(parts)
