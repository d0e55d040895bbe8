"""Fields in space."""

from field import grouped
from positions import mean_interval, rms_interval

from sections.tables import INTERVALS, Row, conditions, percent, share_of, table, within


def field(result: Row) -> str:
    parts = ["## Fields in space", conditions(result)]
    rows, columns = result["view"]
    parts.append(
        f"Rendered pairs: two views of {columns} x {rows} with {result['markers']} x "
        f"{result['markers']} corners of a pattern 32 mm wide, with exactly known cameras. Errors "
        "are distances in space, um, over all nodes of all frames: the RMSE of the position, the "
        "RMSE of the displacement from the frame at rest, and the 95th percentile of the latter "
        "(median over frames). Each `raw` column is before the lattice filter, and the column to "
        "its left after it. `within` is the percentage of errors within two standard deviations "
        "as given by sigma. The numbering of a frame is right if every corner has the right row "
        f"and column. The print is worn. {INTERVALS}Frames with the same seed share the print and "
        "the frame at rest, so the true intervals are wider.\n"
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
                within(
                    group[f"{name}_rms_um"], rms_interval([row[f"{name}_um2"] for row in frames])
                )
                for name in ("place", "raw_place", "moved", "raw_moved")
            ]
            shares = [
                percent(group[name], mean_interval([row[name] for row in frames]))
                for name in ("within_2", "raw_within_2")
            ]
            lead = [group["config"], group[key], group["frames"], share_of(right, len(frames))]
            lead.append(100 * group["nodes_placed"])
            body.append([*lead, *figures, *shares, group["moved_p95_um"], group["ms"]])
        parts.append(table(("settings", key, *head, "ms"), body))
    parts.append(
        "### Time of the numbering\n\nThe time that `detector.grid` takes after detection, on "
        "frames of a press in random order: complete frames, and frames in which the second look "
        "has to find corners.\n"
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
    parts.append(
        f"{same} of {count} frames gave the same bytes when they were measured in another order.\n"
    )
    parts.append(
        "### Boards with squares of known size\n\nMeasured sides of the squares, mm. The "
        "Bumblebee2 pairs use their published calibration; each of OpenCV's pairs uses a "
        "calibration from the other pairs. With a free board, the calibration finds the nodes of "
        "the board too, with sides of 25 mm on average: *repeated* is the deviation from the same "
        "side of the board that the other pairs found, *board* the deviation of that board's own "
        "sides, which no calibration lowers.\n"
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
            *(f"{row[key]:.3f}" if key in row else "" for key in ("repeated", "board")),
            f"{min(row['pair_means']):.3f} to {max(row['pair_means']):.3f}",
            row.get("calibration_error_px", "published"),
        ]
        for row in sorted(result["boards"], key=lambda row: row["set"])
    ]
    head = (
        "pairs",
        "settings",
        "sides",
        "true",
        "mean",
        "deviation",
        "repeated",
        "board",
        "means of pairs",
    )
    parts.append(table((*head, "reprojection error px"), body))
    return "\n".join(parts)


def wrong_indices(result: Row) -> str:
    """List the frames of the fields in space in which a corner has a wrong row or column."""
    wrong = [row for row in result["frames"] if row["wrong_index"]]
    keys = ("config", "seed", "object", "mode", "severity", "wrong_index", "nodes")
    listed = table(keys, [[row[key] for key in keys] for row in wrong]) if wrong else "None.\n"
    return f"### Fields in space: frames with a wrong index\n\n{listed}"
