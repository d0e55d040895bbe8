"""The scripts of bench/: each runs to its end on few frames, and its table suits the report.

What they measure is not looked at: a name, a setting or a column that one of them still uses and
that is gone is seen here.
"""

import importlib
import shutil
import sys
from pathlib import Path

import pytest

from cmp_cl.synthetic import Indenter

pytestmark = [
    pytest.mark.exhaustive,
    # A peer runs in a process of its own, to the end of this one.
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
BENCH = Path(__file__).resolve().parents[1] / "bench"
PARTS = [  # scripts, arguments, and constants in place of the script's own
    ("detection", ["--quick"], {"DENSITIES": (20,), "INDENTERS": (Indenter.BALL,)}),
    ("speed", ["--quick"], {"BLOCK": 1, "MANY": 2}),
    ("photographs", [], {"PICTURES": ("puzzleboard/example1",), "BOARDS": ()}),
    ("sigma", ["--quick"], {"CORROSIONS": (0.3,), "SEVERITIES": (0.25, 0.5)}),
    ("numbering", ["--quick"], {"FEWER": 100}),
    ("numbering", ["--quick", "--ablation", "--families", "torn by rings"], {"FEWER": 100}),
    ("field", ["--quick"], {"STEPS": (0.25, 0.5, 0.75, 1.0, 1.25, 1.5), "FILE_FRAMES": 20}),
    ("tracking", ["--quick"], {"EACH": 2}),
    ("refraction", ["--quick"], {"RIGS": 10}),
    ("limits", ["--quick"], {}),
    ("field", ["--endure", "3"], {"STEPS": (0.25, 0.5)}),
]


@pytest.fixture
def script(monkeypatch):
    """Return a function that imports a script of bench/; some have the names of modules here."""
    names = [path.stem for path in BENCH.glob("*.py")]
    monkeypatch.syspath_prepend(str(BENCH))
    for name in names:
        monkeypatch.delitem(sys.modules, name, raising=False)
    yield importlib.import_module
    for name in names:
        sys.modules.pop(name, None)


@pytest.mark.parametrize(("name", "arguments", "constants"), PARTS)
def test_a_part_runs_and_the_report_takes_its_table(
    name, arguments, constants, script, monkeypatch, tmp_path
):
    part, report = script(name), script("report")
    if name == "photographs" and not part.DATA.is_dir():
        pytest.skip("the photographs are not here")
    for constant, value in constants.items():
        monkeypatch.setattr(part, constant, value)
    assert part.main([*arguments, "--out", str(tmp_path)]) == 0
    for table in tmp_path.glob("*.csv"):
        if table.stem in report.SECTIONS:
            assert report.SECTIONS[table.stem](tmp_path).startswith("## ")


@pytest.mark.parametrize("constants", ["octaves", "sigma"])
def test_a_search_for_constants_runs(constants, script, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["fit", constants, "1"])
    script("fit").main()
    assert capsys.readouterr().out


def test_the_search_for_settings_runs(script, monkeypatch, tmp_path):
    search = script("search")
    small = {"DENSITIES": (20,), "SEVERITIES": (0.25,), "SCENES_EACH": 1}
    for constant, value in {**small, "FOUND_SETTINGS": tmp_path / "found.json"}.items():
        monkeypatch.setattr(search, constant, value)
    assert search.main(["find_chessboard"]) == 0
    assert (tmp_path / "found.json").is_file()


def test_the_report_is_made_of_the_tables_in_results(script, monkeypatch, tmp_path):
    run = script("run")
    for table in (BENCH / "results").glob("*.csv"):
        shutil.copy(table, tmp_path)
    monkeypatch.setattr(run, "PARTS", ("report",))
    assert run.main(["--out", str(tmp_path)]) == 0
    assert "Not measured" not in (tmp_path / "REPORT.md").read_text()


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_memory_and_results_stay_the_same(device, script, monkeypatch):
    monkeypatch.setenv("CMP_CL_DEVICE", device.index)
    assert script("endurance").endure(12, openings=20) == []
