"""Errors of positions and displacements in the image, and the errors that they state."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sections.tables import Row, between, conditions, left_out, order_of, percent, table, within

KINDS = ("raw position", "position", "raw displacement", "displacement")


def positions(result: Row) -> str:
    """Report the errors before and after the lattice filter, and whether the stated ones hold."""
    parts = ["## Positions and their standard deviations", conditions(result), left_out(result)]
    parts.append(
        "Each scene is measured against its frame at rest, at the nodes that were measured and "
        "numbered correctly. `raw` is EDGE_STEP; the other columns are after the lattice filter. "
        "Errors are RMSEs of the distance, px. `worse` is the percentage of frames in which the "
        "filter increases the error of the displacement, and `worst ratio` the largest such "
        "ratio. Standard deviations are judged by the percentage of errors within one and within "
        "two of them: normal errors give 68 and 95 %. `corner` is `corners.sigma`, which covers "
        "image noise but not wear.\n"
    )
    parts.append(
        "Corrosion 0 is a perfect print, and 1 is the wear in the other sections. On a worn "
        "print, most of the raw error is the distance of the visible corner from the material "
        "point; averaging over neighbours reduces it. The 95 % intervals are over frames, because "
        "the nodes of a frame are not independent. Rows and columns whose intervals overlap do "
        "not differ significantly.\n"
    )
    for key in ("severity", "markers", "noise", None):
        others = {"severity", "markers", "noise"} - {key}
        rows = [
            row
            for row in result["groups"]
            if (key is None or key in row) and not others & row.keys()
        ]
        title = f"by {key}" if key else "overall"
        head = ("corrosion", *([key] if key else []), "frames")
        labels = [[row["corrosion"], *_label(row, key), row["frames"]] for row in rows]
        body = [
            [
                *label,
                *(within(row[kind]["rms"], row[kind]["rms_interval"]) for kind in KINDS),
                f"{100 * row['worse']:.0f} ({between(row['worse_interval'])})",
                row["worst_ratio"],
            ]
            for label, row in zip(labels, rows, strict=True)
        ]
        parts.append(f"### Errors {title}, px\n")
        parts.append(table((*head, *KINDS, "worse", "worst ratio"), body))
        body = [
            [
                *label,
                *(
                    f"{100 * row[kind]['within_1']:.0f}, "
                    + percent(row[kind]["within_2"], row[kind]["within_2_interval"])
                    for kind in (*KINDS, "corner")
                ),
            ]
            for label, row in zip(labels, rows, strict=True)
        ]
        parts.append(f"### Coverage {title}: % within one sigma, within two\n")
        parts.append(table((*head, *KINDS, "corner"), body))
    parts.append(
        "### Where the truth bends\n\nRMSE, px, on a worn print, of the nodes whose true position "
        "or displacement is more than 0.2 px off the cubic through their neighbours.\n"
    )
    body = [[kind, value["nodes"], value["rms"]] for kind, value in result["bends"].items()]
    parts.append(table(("error", "nodes", "px"), body))
    parts.append(_compared(result["compared"]))
    bound = result["bound"]
    parts.append(
        "### The bound on a perfect print\n\nImage noise limits the accuracy of any method that "
        f"uses a disc of radius 0.75 cells: the Cramer-Rao bound is {bound['bound']:.4f} px. The "
        f"noise part of EDGE_STEP's error is {bound['noise_part']:.4f} px "
        f"({100 * (bound['noise_part'] / bound['bound'] - 1):.0f} % above the bound) and its total "
        f"error {bound['all']:.4f} px, over {bound['frames']} frames.\n"
    )
    parts.append(_known(result["strains"]))
    parts.append(_resolution(result["resolution"]))
    parts.append(
        f"The filter takes {result['ms']:.2f} ms for the positions and sigma of 1936 nodes, and "
        f"{result['ms_bends']:.2f} ms for their displacements. {result['left_out']} scenes could "
        "not be numbered and are left out.\n"
    )
    return "\n".join(parts)


def _label(row: Row, key: str | None) -> list[Any]:
    """Return what a row says of its group beside its wear."""
    value = row.get(key) if key else None
    if isinstance(value, list):
        value = f"{value[0]:.1f} to {value[1]:.1f}"
    return [value] if key else []


def _compared(rows: Sequence[Row]) -> str:
    """Tabulate the errors of other methods on the corners that they find too."""
    text = (
        "### Other methods, on the corners that both find\n\nRMSE, px. In `order`, `<` means "
        "significantly smaller, and a comma means no significant difference.\n\n"
    )
    names = {"rms": "its", "edge_step": "EDGE_STEP", "filtered": "filtered"}
    body = []
    for row in rows:
        figures = {name: (row[key], row[f"{key}_interval"]) for key, name in names.items()}
        cells = [within(*each) for each in figures.values()]
        lead = [row["corrosion"], row["method"], row["frames"], row["corners"]]
        body.append([*lead, *cells, order_of(figures)])
    head = ("corrosion", "method", "frames", "corners", "its", "EDGE_STEP's", "filtered", "order")
    return text + table(head, body)


def _known(rows: Sequence[Row]) -> str:
    """Tabulate uniform stretches, in space and in the plane."""
    text = (
        "### Known strains\n\nA flat lattice of 40 x 40 nodes is stretched uniformly, and "
        "measured in space and in the plane, with 10 um of wear that travels with the material "
        "and 2 um of noise in each frame. The table gives E11 and the RMSE of the displacement.\n\n"
    )
    body = [
        [
            row["view"],
            row["field"],
            row["strain"],
            row["mean"],
            within(row["rms"], row["rms_interval"]),
            percent(row["within_2"], row["within_2_interval"]),
            within(row["displacement_um"], row["displacement_um_interval"]),
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
        "### Resolution of the strain\n\nThe strain is a sine over the columns, with the same "
        "wear and noise. The table gives the fraction of its amplitude that is measured. The "
        "resolution is the wavelength at which this fraction is one half.\n",
        table(head, body),
        "The RMSE of the displacement in the same cases, um:\n",
        table(("displacement", *(f"{wave} nodes" for wave in waves)), errors),
    ]
    return "\n".join(parts)


def strain(result: Row) -> str:
    """Report known strains in pictures, and whether their stated errors hold."""
    head = ("strain", "from", "RMSE", "median sigma", "within 1.96 sigma, %", "numbers")
    rows = [
        (
            row["strain"],
            row["by"],
            f"{row['rms']:.2g}",
            f"{row['sigma']:.2g}",
            round(100 * row["coverage"], 1),
            row["numbers"],
        )
        for row in result["rows"]
    ]
    return "\n".join(
        [
            "## Known strains in pictures",
            conditions(result),
            "Noisy images are rendered of a board that is rotated and strained. `cmp-cl run "
            "--strain --cell` measures the strain, with the lattice filter and, by `--raw`, "
            "without. If sigma is right, 95 % of the errors are within 1.96 sigma.\n",
            table(head, rows),
        ]
    )
