"""Numbering: boards partly out of view, patterns without a border, backgrounds, mirrors."""

from sections.tables import Row, conditions, table


def partial_views(result: Row) -> str:
    """Report boards partly out of view, boards of a wrong size, and an island of corners."""
    parts = ["## Boards partly out of view", conditions(result)]
    parts.append(
        "Each image is cropped from its four sides. A node is right if it lies within 3 px of a "
        "corner and its row and column fit a single lattice. It is false if no corner lies within "
        "a quarter of a cell. `other` nodes are mostly corners whose number does not fit. Torn "
        "gels are not cropped: a ring is pressed into them at severity 2. `with a warning` counts "
        "the views in which the method says that the numbering may be wrong, `silently wrong` "
        "those in which it is wrong without a warning, which can happen only to methods that are "
        "told the size of the board. libcbdetect's answers differ from run to run.\n"
    )
    keys = ("set", "method", "views", "visible", "right", "false", "other", "refused")
    keys += ("with a warning", "silently wrong")
    parts.append(table(keys, [[row[key] for key in keys] for row in result["partial"]]))
    for name, reason in result["unavailable"].items():
        parts.append(f"Not measured: {name} ({reason}).\n")
    counts: dict[str, list[int]] = {}
    for row in result["wrong_sizes"]:
        group = counts.setdefault(row["answer"], [0, 0])
        group[tuple(row["asked"]) != (6, 9)] += 1
    parts.append(
        "Boards of 6 x 9 corners in full view; the method is told this size, or one of seven "
        "wrong ones:\n"
    )
    head = ("answer", "searched for 6 x 9", "searched for another size")
    parts.append(table(head, [[answer, *group] for answer, group in counts.items()]))
    parts.append(
        "water/ellipse_10: corners with a node that is numbered correctly within its island:\n"
    )
    rows = [
        [word, row["outside"], row["island"], row["corners"], "yes" if row["ambiguous"] else "no"]
        for word, row in result["island"].items()
    ]
    parts.append(table(("numbered", "outside", "island", "of", "ambiguous"), rows))
    return "\n".join(parts)


def open_patterns(result: Row) -> str:
    """Report the numbering against the frame at rest, without a border in view."""
    parts = ["## Patterns without a border in view", conditions(result)]
    parts.append(
        "Every frame is numbered like the frame at rest. It is right if at most one node in 500 "
        "has a wrong number. It is silently wrong if more have and the grid is not marked "
        "ambiguous. A perfect print that has moved by a whole period looks like one that has not "
        "moved: no image can tell them apart, and every such frame is ambiguous. The printing "
        "errors of a worn print move with it, and decide.\n"
    )
    for form, words in (
        ("alone", "Numbered by the frame at rest alone"),
        (
            "followed",
            "Numbered with the help of the previous frame; the pattern moves by at most 0.3 cells "
            "between two frames",
        ),
    ):
        counts = result["counts"][form]
        head = list(dict.fromkeys(verdict for group in counts.values() for verdict in group))
        rows = [[group, *(count[verdict] for verdict in head)] for group, count in counts.items()]
        parts.append(f"{words}:\n\n" + table(("frames", *head), rows))
    peers = result["lattices"]
    parts.append(
        "The peers cannot use a frame at rest. Each method therefore gets every fourteenth frame "
        "by itself. A frame is right if at most one of its nodes in 500 does not fit a single "
        "lattice, however few nodes it has. A node is false if it lies more than a quarter of a "
        "cell from every corner.\n"
    )
    parts.append(table(list(peers[0]), [list(row.values()) for row in peers]))
    parts += [f"Not measured: {name} ({why}).\n" for name, why in result["unavailable"].items()]
    return "\n".join(parts)


def surroundings(result: Row) -> str:
    """Report boards before busy backgrounds, and patterns with a mirror in the view."""
    parts = ["## Busy backgrounds and mirrors", conditions(result)]
    parts.append(
        "Rendered boards before five kinds of background. The paper around a board is none, 0.3, 1 "
        "or 2 cells wide. An answer is right if each of its nodes is a corner of the board and the "
        "numbers fit a single lattice. `background alone` answers hold no corner of the board: "
        "they are another pattern, without a warning. An answer is silently wrong if it is wrong "
        "and carries no warning.\n"
    )
    words = ("right", "right, with a warning", "refused", "wrong, with a warning")
    words += ("background alone", "silently wrong")
    head = ("background", "method", *words)
    rows = [[row[key] for key in ("ground", "method", *words)] for row in result["boards"]]
    parts.append(table(head, rows))
    parts += [f"Not measured: {name} ({why}).\n" for name, why in result["unavailable"].items()]
    parts.append(
        "Rendered patterns without a border, a part of which is a reflection. An answer is right "
        "if it holds at most three nodes of the reflection and at least 98 % of the other nodes "
        "have the right numbers. The rows without a mirror show false alarms.\n"
    )
    words = tuple(word for word in words if word != "background alone")
    keys = ("mirror", "print", "numbered", *words)
    parts.append(table(keys, [[row[key] for key in keys] for row in result["mirrors"]]))
    return "\n".join(parts)
