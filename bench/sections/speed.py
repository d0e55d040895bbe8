"""Time of a frame, and cost by size, frames and process."""

from methods import DEFAULT, LINES

from sections.tables import Row, conditions, left_out, table, table_of

# Measured by the paper on its own machine (14-core i7-12700H) and scenes: context, not a rival row.
PAPER_TIMES = "4.95 ms (its ChESS 5.04 ms), 1936 corners, integer positions"


def speed(result: Row) -> str:
    parts = ["## Time", conditions(result), left_out(result)]
    parts.append(
        "Wall time from an image in host memory to positions in host memory. The methods take "
        "turns in one run, and the results that were timed are the ones that are scored. `times` "
        f"is the ratio to our default. For comparison, the paper reports {PAPER_TIMES}.\n"
    )
    for scene in result["scenes"]:
        rows, columns = scene["shape"]
        parts.append(
            f"### {columns} x {rows}, {scene['corners']} corners, cells of {scene['cell']:.1f} px\n"
        )
        kept = sorted(scene["rows"], key=lambda row: row["ms"])
        head = "method, ms, 95 %, times, missed, false, RMSE px, p95 px"
        keys = "method ms ms_p95 times_default missed false rmse p95"
        parts.append(table_of(kept, head, keys))
        parts.append(_paced(scene))
        parts.append(_targets(scene))
        base = next(row for row in scene["rows"] if row["method"] == DEFAULT)
        stages = sorted(base["stages"].items(), key=lambda stage: -stage[1])
        parts.append(
            f"With profiling on, our default takes {base['wall_profiled']:.2f} ms: kernels "
            f"{base['kernels']:.2f} ms, host and transfers {base['host_and_transfers']:.2f} ms. It "
            f"uses {base['bytes_per_pixel']:.1f} bytes per pixel on the device. Times of the "
            "kernels, us: " + ", ".join(f"{name} {1e3 * ms:.0f}" for name, ms in stages) + ".\n"
        )
    return "\n".join(parts)


def _paced(scene: Row) -> str:
    """Tabulate the time of a frame at the pace of a camera, beside that in a loop."""
    text = (
        f"A frame every {scene['pace_ms']:g} ms, as from a camera, and the same frames in a loop "
        "without a pause:\n\n"
    )
    head = ("method", "ms", "99 %", "loop, ms", "loop, 99 %", "times the loop's")
    keys = ("method", "ms", "ms_p99", "loop_ms", "loop_ms_p99", "times_loop")
    return text + table(head, [[row[key] for key in keys] for row in scene["paced"]])


def _targets(scene: Row) -> str:
    """Tabulate the ratios that are goals, and whether they are met in this run."""
    rows = {row["method"]: row for row in scene["rows"]}
    ms = rows[DEFAULT]["ms"]
    lean = [row["ms"] for name, row in rows.items() if name.startswith("chess-corners, lean")]
    features = [row["ms"] for name, row in rows.items() if name == "goodFeaturesToTrack"]
    lean_goal, features_goal = (10, 4.5) if scene["scene"] == "vga" else (18, 7)
    lines = []
    for name, own in ((DEFAULT, "default"), (LINES, "EDGE_LINES")):
        for least, peer, theirs in (
            (lean_goal, "the leanest chess-corners", lean),
            (features_goal, "goodFeaturesToTrack", features),
        ):
            if theirs and name in rows:
                ratio = min(theirs) / rows[name]["ms"]
                goal = f"{own} at least {least} times as fast as {peer}"
                lines.append((goal, f"{ratio:.1f}", ratio >= least))
    if LINES in rows:
        ratio = ms / rows[LINES]["ms"]
        lines.append(
            ("default at most 1.7 times as long as EDGE_LINES alone", f"{ratio:.2f}", ratio <= 1.7)
        )
    for row in scene["paced"]:
        if row["method"] == DEFAULT:
            ratio = row["times_loop"]
            goal = f"a frame every {scene['pace_ms']:g} ms: at most 1.4 times as long as in a loop"
            lines.append((goal, f"{ratio:.2f}", ratio <= 1.4))
    most = max(row["bytes_per_pixel"] for row in rows.values() if "bytes_per_pixel" in row)
    goal = "at most 8 bytes of device memory per pixel, in every configuration"
    lines.append((goal, f"{most:.1f}", most <= 8))
    body = [(goal, figure, "yes" if met else "**no**") for goal, figure, met in lines]
    return table(("goal", "this run", "met"), body)


def scaling(result: Row) -> str:
    parts = [f"## Cost by size, frames and process on {result['environment']['device']}"]
    parts.append(conditions(result))
    parts.append("Bytes are all the device memory of the detector, including the image.\n")
    rows = [{**row, "image": "{1} x {0}".format(*row["shape"])} for row in result["sizes"]]
    head = "image, corners, ms, ms 95 %, ns per pixel, device bytes per pixel"
    parts.append(table_of(rows, head, "image corners ms ms_p95 ns_per_pixel bytes_per_pixel"))
    parts.append(table_of(result["corners"], "corners in a VGA frame, ms", "corners ms"))
    rows = [[r["what"], r["ms_per_frame"], 1e3 / r["ms_per_frame"]] for r in result["frames"]]
    parts.append(table(("VGA frames", "ms a frame", "frames a second"), rows))
    parts.append(_floor(result["floor"]))
    if result["threads"]:
        parts.append(table_of(result["threads"], "threads, ms, ms 95 %", "threads ms ms_p95"))
    rows = [[r["cache"], r["imports_s"], r["seconds"]] for r in result["first_result"]]
    parts.append(table(("kernel cache", "imports, s", "first result in a new process, s"), rows))
    return "\n".join(parts)


def _floor(floor: Row) -> str:
    return (
        f"A VGA frame must move at least {floor['bytes_a_frame']} bytes (the image and the "
        f"corners, once each) and needs {floor['operations_a_frame'] / 1e6:.0f} million "
        f"operations. This device copies {floor['copy_gb_s']:.1f} GB/s and does "
        f"{floor['operations_a_second'] / 1e9:.0f} billion 32-bit operations per second, which "
        f"allows at most {floor['frames_a_second_at_floor']:.0f} frames per second. The fastest "
        f"row above takes {floor['times_the_floor']:.0f} times as long. A single frame needs an "
        f"upload ({1e3 * floor['upload_ms']:.0f} us), {floor['launches_a_frame']} launches "
        f"({1e3 * floor['launch_ms']:.1f} us each if the kernels are empty) and one download "
        f"({1e3 * floor['answer_ms']:.0f} us), together {floor['alone_ms_at_floor']:.3f} ms. Ours "
        f"takes {floor['alone_times_the_floor']:.1f} times as long.\n"
    )
