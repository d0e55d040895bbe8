from pathlib import Path

import pandas as pd
import pytest

BENCH = Path(__file__).resolve().parents[2] / "bench"


def timed(ms=1.0, missed=0, rmse=0.1, peer=8.0):
    own = {"scene": "vga", "method": "cmp_cl, default", "ms": ms, "missed": missed, "rmse": rmse}
    return pd.DataFrame([own, own | {"method": "a peer", "ms": peer}])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, []),
        ({"ms": 1.1}, []),
        ({"ms": 3.0, "peer": 24.0}, []),  # a slower machine
        ({"ms": 1.3}, ["ms 1 -> 1.3"]),
        ({"missed": 1}, ["missed 0 -> 1"] * 2),
        ({"rmse": 0.2}, ["rmse 0.1 -> 0.2"] * 2),
        ({"rmse": float("nan")}, ["rmse 0.1 -> nan"] * 2),
    ],
)
def test_a_figure_that_got_worse_is_named(change, words, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCH))
    import compare

    lines = list(compare.worse(timed(), timed(**change), 1.15))
    assert [line.partition(": ")[2] for line in lines] == words
