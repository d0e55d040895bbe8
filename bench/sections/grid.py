"""Numbering: boards partly out of view, patterns without a border."""

from sections.tables import Row, conditions, table


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
