"""Whether each constant of the lattice stands: other values of it, on frames of its own.

    python bench/fit_lattice.py                      each at .8 and 1.25 times its value
    python bench/fit_lattice.py turn_price 4 6 8     one, at these values
    python bench/fit_lattice.py --families "torn by rings" --frames 24 join_bend 1 1.02 1.1

Of each value, over all families: corners with a right number and with a wrong one, false nodes,
frames that are right and without doubts, and frames that are wrong in silence; and what it costs
against the table's own. A constant stands if no other value costs clearly less. One whose values
all give the same has no reason to be one, unless it bounds the work. Grids are built without a
size, with it, and like a frame at rest, on a seed that neither the report nor a test uses.
"""

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any
from unittest import mock

import numpy as np
from environment import parser_of, write_table
from numbering import FAMILIES, NOTHING, OURS, VERDICTS, K, liked, scored
from patterns import View, stretched

from cmp_cl import Corners, Detector, DetectorConfig
from cmp_cl.errors import GridError
from cmp_cl.grid import choice
from cmp_cl.lattice import plan
from cmp_cl.lattice.constants import LatticeConstants

SEED = 5_980_000  # no report and no test uses it
FRAMES = 4  # of each family
STEPS = (0.8, 1.25)
# In nodes that are lost: a wrong number costs as much as a hundred.
COST = {"right": -1, "wrong": 100, "false": 10, "sure": -10, "silent": 1000}
LEAST = 0.001  # share of the nodes; a smaller gain is chance


def seen(view: View) -> tuple[View, Corners]:
    config = DetectorConfig.for_cell(view.cell)
    with Detector(shape=view.image.shape, config=config) as detector:
        return view, detector(view.image)


def others(value: Any) -> list[Any]:
    """Return values beside a constant's own; of a table its numbers change together."""
    if isinstance(value, tuple):
        return [tuple(each) for each in zip(*(others(v) for v in value), strict=True)]
    beside = [value * step for step in STEPS]
    return [int(np.floor(beside[0])), int(np.ceil(beside[1]))] if type(value) is int else beside


@contextlib.contextmanager
def instead(constants: LatticeConstants) -> Iterator[None]:
    """Let all grids be built with these constants."""
    plan._kept.cache_clear()
    own = mock.patch.object(plan, "LatticeConstants", return_value=constants)
    with own, mock.patch.object(choice, "K", constants):
        yield
    plan._kept.cache_clear()


def counts(
    frames: dict[str, list[tuple[View, Corners]]], changes: dict[str, Any]
) -> dict[str, int]:
    """Return what is counted of all frames, with some constants changed."""
    total = dict.fromkeys(COST, 0)

    def add(right: int, wrong: int, false: int, frames: Sequence[int]) -> None:
        more = right, wrong, false, frames[0], frames[VERDICTS.index("silent")]
        total.update(zip(COST, np.add(list(total.values()), more).tolist(), strict=True))

    with instead(dataclasses.replace(K, **changes)):
        for family, views in frames.items():
            alone = family in FAMILIES and FAMILIES[family].alone
            for view, corners in views:
                for ask in OURS.values():
                    answer: Any = NOTHING
                    with contextlib.suppress(GridError):
                        answer = ask(view, corners)
                    if answer is not None:
                        score = scored(view, answer, alone=alone)
                        verdict = np.eye(len(VERDICTS), dtype=int)[score["frame"]]
                        add(score["right"], score["wrong"], score["false"], verdict)
        if "without an end" in frames:
            for row in liked(SEED, 2 * len(frames["without an end"])):
                add(row["right"], 0, 0, [row[f"frames {word}"] for word in VERDICTS])
    return total


def main(argv: Sequence[str] | None = None) -> int:
    views = {name: family.views for name, family in FAMILIES.items()} | {"stretched": stretched}
    names = [field.name for field in dataclasses.fields(K)]
    parser = parser_of(__doc__)
    parser.add_argument("constant", nargs="?", choices=names, help="all without one")
    parser.add_argument("values", nargs="*", type=float, help="that it gets in turn")
    parser.add_argument("--families", nargs="+", choices=views, default=list(views))
    parser.add_argument("--frames", type=int, default=FRAMES, help="of each family")
    arguments = parser.parse_args(argv)
    frames = {
        name: [seen(view) for view in views[name](SEED, arguments.frames)]
        for name in arguments.families
    }
    own = counts(frames, {})
    rows: list[dict[str, Any]] = [{"constant": "", "value": "", **own, "cost": 0}]
    print(f"{'the table':40}", *own.values(), flush=True)
    for name in [arguments.constant] if arguments.constant else names:
        value = getattr(K, name)
        verdict = "nothing tells"
        for other in [type(value)(v) for v in arguments.values] or others(value):
            found = counts(frames, {name: other})
            cost = sum(COST[each] * (found[each] - own[each]) for each in COST)
            rows.append({"constant": name, "value": other, **found, "cost": cost})
            if cost < -LEAST * own["right"]:
                verdict = "another is better"
            elif found != own and verdict == "nothing tells":
                verdict = "stands"
            print(f"{name:24}{other!s:16.16}", *found.values(), "cost", cost, flush=True)
        print(f"{name:24}{value!s:16.16}", verdict, flush=True)
    write_table("fit_lattice", rows, arguments.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
