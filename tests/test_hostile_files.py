"""The damaged files of tests/fuzz_files.py, for a few seconds instead of minutes."""

import ast
import os
import struct

import fuzz_files
import numpy as np
import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="memory has no limit on Windows")


def test_damaged_files_of_every_kind_give_results_or_errors_of_cmp_cl(capsys):
    assert fuzz_files.main(["--cases", "120", "--seed", "900001"]) == 0
    counts = ast.literal_eval(capsys.readouterr().out.partition(": ")[2])
    assert sum(counts.values()) == 120
    for kind in fuzz_files.KINDS:
        assert counts[f"{kind} refused"] > 3, counts


def test_a_reader_that_ends_the_process_is_found(tmp_path, monkeypatch, capsys):
    script = tmp_path / "dies.py"
    script.write_text("print('3 settings read'); print(4, flush=True); import os; os.abort()")
    monkeypatch.setattr(fuzz_files, "__file__", str(script))
    assert fuzz_files.main(["--first", "3", "--cases", "2"]) == 1
    out = capsys.readouterr().out
    assert "FAILED with -6; again: --seed 1 --first 4" in out
    assert "'failed': 1" in out


def test_changes_are_the_same_each_time_and_change_something():
    data = struct.pack("<100I", *range(100))
    made = [fuzz_files.damaged(data, np.random.default_rng(seed)) for seed in range(50)]
    again = [fuzz_files.damaged(data, np.random.default_rng(seed)) for seed in range(50)]
    assert made == again
    assert sum(one != data for one in made) > 45
