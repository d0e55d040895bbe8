"""What got worse between two tables of results; exits with 1 if anything did.

python bench/compare.py OLD.csv NEW.csv [--slower 1.15]

Times are compared with those of the peers in the same table: a slower machine is no slower program.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd

COUNTS = ("missed", "false", "wrong", "silent")  # of which more is worse
ERRORS = ("rmse", "rms", "p95", "figure")  # of which 5 % more is worse
TIMES = ("ms", "ms_a_frame")
KEYS = (
    *("method", "scene", "photograph", "family", "markers", "severity", "indenter", "case"),
    *("difficulty", "level", "kind", "corrosion", "noise", "what"),
)


def worse(old: pd.DataFrame, new: pd.DataFrame, slower: float) -> Iterator[str]:
    """Yield what is worse in the rows that both tables have, in words."""
    keys = [key for key in KEYS if key in old and key in new]
    both = old.merge(new, on=keys, suffixes=("_old", "_new"))
    if "method" in both and "ms_old" in both:
        peers = ~both["method"].str.startswith("cmp_cl")
        machine = (both["ms_new"] / both["ms_old"])[peers].median()
        both["ms_new"] /= machine if machine == machine else 1.0
    for _, row in both.iterrows():
        name = ", ".join(str(row[key]) for key in keys)
        for columns, factor in ((COUNTS, 1.0), (ERRORS, 1.05), (TIMES, slower)):
            for column in columns:
                if f"{column}_old" not in both:
                    continue
                before, after = row[f"{column}_old"], row[f"{column}_new"]
                if after > factor * before or (pd.isna(after) and not pd.isna(before)):
                    yield f"{name}: {column} {before:.5g} -> {after:.5g}"
        if "right_old" in both and row["right_new"] < row["right_old"]:
            yield f"{name}: right {row['right_old']} -> {row['right_new']}"


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--slower", type=float, default=1.15, help="allowed factor of the time")
    arguments = parser.parse_args(argv)
    old, new = (pd.read_csv(path, comment="#") for path in (arguments.old, arguments.new))
    lines = list(worse(old, new, arguments.slower))
    print("\n".join(f"worse: {line}" for line in lines) or "nothing got worse")
    return 1 if lines else 0


if __name__ == "__main__":
    raise SystemExit(main())
