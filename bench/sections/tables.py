"""What all sections share: tables, figures with their intervals, and the conditions."""

import itertools
from collections.abc import Iterable, Sequence
from typing import Any

from positions import interval

Row = dict[str, Any]
BUSY = 0.2  # cores that others use, above which times are not to be trusted
INTERVALS = (
    "Brackets hold 95 % intervals; rows whose intervals overlap do not differ significantly. "
)


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a Markdown table; floats with 3 digits, None as a dash."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(_cell(value) for value in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def table_of(rows: Iterable[Row], head: str, keys: str) -> str:
    """Return a table of some keys of rows; head: names with ", " between, keys: with blanks."""
    return table(head.split(", "), [[row[key] for key in keys.split()] for row in rows])


def named(rows: dict[str, Row]) -> list[Row]:
    """Return the rows, each with its name in the column `name`."""
    return [{"name": name, **row} for name, row in rows.items()]


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
    return str(value)


def between(bounds: Sequence[float]) -> str:
    """Return an interval of shares in percent; a dash where one frame gives none."""
    low, high = bounds
    return f"{100 * max(low, 0):.0f} to {100 * min(high, 1):.0f}" if low == low else "-"


def percent(share: float, bounds: Sequence[float]) -> str:
    """Return a share in percent with its interval."""
    return f"{100 * share:.0f} ({between(bounds)})"


def share_of(hits: float, count: float) -> str:
    """Return a share of a count in percent, with Wilson's interval."""
    return percent(hits / count, interval(hits, count)) if count else "-"


def within(value: float, bounds: Sequence[float]) -> str:
    """Return a figure with its interval; a dash where one frame gives none."""
    low, high = bounds
    return f"{value:.3g} ({low:.3g} to {high:.3g})" if low == low else f"{value:.3g} (-)"


def apart(one: Sequence[float], other: Sequence[float]) -> bool:
    """Return whether the first interval lies wholly below the second."""
    return one[1] < other[0]


def surely_better(bounds: Sequence[Sequence[float]]) -> list[int]:
    """Count, for each row, the rows whose share is higher beyond both intervals."""
    return [sum(apart(own, other) for other in bounds) for own in bounds]


def order_of(figures: dict[str, tuple[float, Sequence[float]]]) -> str:
    """Say which errors are smaller; those whose intervals overlap are not told apart."""
    ordered = sorted(figures.items(), key=lambda item: item[1][0])
    text = ordered[0][0]
    for (_, (_, before)), (name, (_, bounds)) in itertools.pairwise(ordered):
        text += f"{' <' if apart(before, bounds) else ','} {name}"
    return text


def conditions(result: Row) -> str:
    """Return the line under a heading: what it was measured with."""
    if (result["environment"].get("others") or 0) > BUSY:
        busy = "**Other processes ran at the same time, so the times are rough.**"
        return f"{described(result)}\n{busy}\n"
    return described(result)


def described(result: Row) -> str:
    """Return device, driver, versions, commit, and how busy the machine was."""
    around = result["environment"]
    packages = ", ".join(f"{name} {version}" for name, version in around["packages"].items())
    others = around.get("others")
    return (
        f"{around['device']}, driver {around['driver']}, {around['cpu']} with {around['cores']} "
        f"cores, {around['system']}; {packages}; commit {around['commit']}, {around['date']}"
        + ("" if others is None else f"; others used {others} cores")
        + ".\n"
    )


def left_out(result: Row) -> str:
    reasons = result.get("unavailable") or {}
    return "".join(f"Left out: {name}: {reason}.\n" for name, reason in reasons.items())


def is_peer(name: str) -> bool:
    return not name.startswith("cmp_cl")
