"""What each constant of the lattice is worth: other values of it, family by family.

    python bench/fit_lattice.py                      each at .8 and 1.25 times its value
    python bench/fit_lattice.py turn_price 4 6 8     one, at these values
    python bench/fit_lattice.py --families "torn by rings" --frames 24 join_bend 1 1.02 1.1

Of each family and value: the corners with a right number, with a wrong one, and false nodes. Frames
are of seeds that neither the report nor a test uses. A constant whose every value gives the same
has no reason to be one; of those that differ the table's own has the least wrong, then the most
right.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from environment import parser_of, write_table
from numbering import FAMILIES, K, of_lattice, scored
from patterns import Open, View, Views, corners_in, everywhere, picture

from cmp_cl import Corners, Detector, DetectorConfig

SEED = 5_980_000  # no report and no test uses it
FRAMES = 8  # of each family
STEPS = (0.8, 1.25)


def stretched(seed: int, count: int) -> Views:
    """Yield patterns without an end that waves stretch and squeeze up to three times."""
    draw = np.random.default_rng(seed + 77)
    for number in range(count):
        case = Open(
            cell=float(draw.uniform(9, 20)),
            rotation=float(draw.uniform(-60, 60)),
            wave=float(draw.uniform(0.9, 1.6)),
            noise=float(draw.uniform(0.5, 6)),
            sheet=seed + number,
        )
        yield everywhere(picture(case, seed + number), corners_in(case), case.cell, None)


def seen(view: View) -> tuple[View, Corners]:
    config = DetectorConfig.for_cell(view.cell)
    with Detector(shape=view.image.shape, config=config) as detector:
        return view, detector(view.image)


def others(value: object) -> list[object]:
    """Return values beside a constant's own: a number's steps, none of a table's."""
    if not isinstance(value, int | float):
        return []
    beside = [value * step for step in STEPS]
    if isinstance(value, int):
        beside = [int(np.floor(beside[0])), int(np.ceil(beside[1]))]
    return [beside[0], value, beside[1]]


def main(argv: Sequence[str] | None = None) -> int:
    views = {name: family.views for name, family in FAMILIES.items()} | {"stretched": stretched}
    names = [field.name for field in dataclasses.fields(K)]
    parser = parser_of(__doc__)
    parser.add_argument("constant", nargs="?", choices=names, help="all without one")
    parser.add_argument("values", nargs="*", type=float, help="that it gets in turn")
    parser.add_argument("--families", nargs="+", choices=views, default=list(views))
    parser.add_argument("--frames", type=int, default=FRAMES, help="of each family")
    arguments = parser.parse_args(argv)
    rows = []
    for family in arguments.families:
        frames = [seen(view) for view in views[family](SEED, arguments.frames)]
        for name in [arguments.constant] if arguments.constant else names:
            own = getattr(K, name)
            for value in [type(own)(v) for v in arguments.values] or others(own):
                ask = of_lattice(dataclasses.replace(K, **{name: value}))
                scores = [scored(view, ask(view, corners), alone=False) for view, corners in frames]
                counts = {
                    each: sum(score[each] for score in scores)
                    for each in ("right", "wrong", "false")
                }
                rows.append({"family": family, "constant": name, "value": value} | counts)
                print(f"{family:24}{name:22}{value:<10.4g}", *counts.values(), flush=True)
    write_table("fit_lattice", rows, arguments.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
