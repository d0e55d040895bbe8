import importlib.util
import json
import sys
from pathlib import Path

import pytest

from cmp_cl import list_devices
from cmp_cl.cli.main import main

BENCH = Path(__file__).resolve().parents[2] / "bench"


def load(name):
    spec = importlib.util.spec_from_file_location(f"bench_{name}", BENCH / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_each_device_is_timed_and_its_answer_is_checked(capsys, monkeypatch):
    monkeypatch.setattr("cmp_cl.cli.devices.FRAMES", 2)
    assert main(["devices", "--time"]) == 0
    head, *rows = capsys.readouterr().out.partition("1936 corners")[2].splitlines()[1:]
    assert head.split()[:2] == ["index", "median"]
    assert [row.split()[0] for row in rows] == [device.index for device in list_devices()]
    for _, median, late, missed, false, rmse in map(str.split, rows):
        assert 0 < float(median) <= float(late)
        assert (missed, false) == ("0", "0")
        assert float(rmse) < 0.3


def speed_result(ms=1.0, missed=0, rmse=0.1):
    row = {"method": "cmp_cl, default", "ms": ms, "frames": 2, "success": 2, "missed": missed}
    row |= {"false": 0, "rmse": rmse, "p95": 0.2}
    peer = row | {"method": "a peer", "ms": 8.0}
    return {"kind": "speed", "scenes": [{"scene": "vga", "rows": [row, peer]}]}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, None),
        ({"ms": 1.1}, None),
        ({"ms": 1.3}, "1.30 times the time"),
        ({"missed": 1}, "missed 0 -> 1"),
        ({"rmse": 0.2}, "rmse 0.1000 -> 0.2"),
    ],
)
def test_a_figure_that_got_worse_is_named(change, words):
    compare = load("compare")
    lines, single = compare.comparison(speed_result(), speed_result(**change), 1.15)
    assert single == []
    if words is None:
        assert lines == []
    else:
        assert lines == [f"vga: cmp_cl, default: {words}"]


def test_a_slower_machine_is_not_a_slower_program():
    compare = load("compare")
    slow = speed_result(ms=3.0)
    slow["scenes"][0]["rows"][1]["ms"] = 24.0
    assert compare.comparison(speed_result(), slow, 1.15) == ([], [])


def test_a_wrong_index_and_a_larger_error_in_space_are_worse():
    compare = load("compare")
    row = {"config": "run", "severity": 1.0, "frames": 4, "index_right": 1.0}
    row |= {"moved_rms_um": 10.0, "moved_p95_um": 20.0}
    old = {"kind": "field", "by_severity": [row], "numbering": []}
    new = old | {"by_severity": [row | {"index_right": 0.75, "moved_rms_um": 11.0}]}
    assert compare.comparison(old, old, 1.15) == ([], [])
    lines, _ = compare.comparison(old, new, 1.15)
    assert lines == [
        "severity 1.0: run: success 4 -> 3 of 4",
        "severity 1.0: run: rmse 10.0000 -> 11.0",
    ]


def test_a_wrong_number_and_a_slower_numbering_are_worse():
    compare = load("compare")
    row = {"form": "like", "stream": "torn", "frames": 120, "wrong_index": 0, "ms": 3.0}
    old = {"kind": "field", "by_severity": [], "numbering": [row]}
    new = old | {"numbering": [row | {"wrong_index": 2, "ms": 3.6}]}
    assert compare.comparison(old, old, 1.15) == ([], [])
    assert compare.comparison(old, new, 1.15)[0] == [
        "numbering, like=, torn frames: wrong 0 -> 2",
        "numbering, like=, torn frames: 1.20 times the time",
    ]


def implementations(same=18, px=1.5e-5):
    rows = [{"name": "one", "same": 18}, {"name": "other", "same": same}]
    pairs = [{"one": "one", "other": "other", "px": px}]
    return {"kind": "implementations", "scenes": 18, "rows": rows, "pairs": pairs}


@pytest.mark.parametrize(
    ("change", "lines"),
    [
        ({"px": 3e-5}, []),
        ({"same": 17}, ["other: digests: success 18 -> 17 of 18"]),
        ({"px": 2e-3}, ["one and other: positions: distance 1.5e-05 -> 2.0e-03 px"]),
        ({"px": None}, ["one and other: positions: distance 1.5e-05 -> None px"]),
    ],
)
def test_an_implementation_that_no_longer_agrees_is_worse(change, lines):
    compare = load("compare")
    assert compare.comparison(implementations(), implementations(**change), 1.15) == (lines, [])


def test_an_implementation_that_is_gone_is_named():
    gone = implementations()
    gone["rows"] = gone["rows"][:1]
    lines, single = load("compare").comparison(implementations(), gone, 1.15)
    assert (lines, single) == ([], ["other: digests"])


def test_an_answer_that_is_silently_wrong_now_is_worse():
    row = {"ground": "keys", "method": "cmp_cl", "right": 3, "silently wrong": 0}
    row |= {"right, with a warning": 1, "background alone": 0, "refused": 1}
    old = {"kind": "surroundings", "boards": [row], "mirrors": []}
    new = old | {"boards": [row | {"right": 2, "silently wrong": 1}]}
    assert load("compare").comparison(old, new, 1.15)[0] == [
        "keys: cmp_cl: wrong 0 -> 1",
        "keys: cmp_cl: success 3 -> 2 of 5",
    ]


def test_every_kind_of_result_is_known():
    known = load("compare").READERS
    for path in (BENCH / "results").glob("*.json"):
        kind = json.loads(path.read_text(encoding="utf-8"))["kind"]
        assert kind in known or kind in ("run", "peer settings"), kind


def test_results_of_different_kinds_are_refused():
    compare = load("compare")
    with pytest.raises(SystemExit, match="one file is about speed"):
        compare.comparison(speed_result(), {"kind": "accuracy"}, 1.15)
