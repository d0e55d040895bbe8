"""The test of bench/endurance.py, for a few seconds instead of minutes."""

from pathlib import Path

import pytest

BENCH = Path(__file__).resolve().parents[1] / "bench"


@pytest.mark.exhaustive
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_memory_and_results_stay_the_same(device, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCH))
    import endurance

    found = endurance.endure(12, device.index, openings=20)
    assert endurance.failures(found) == []
    assert found["frames"] > 200
    found["changed"] += 1
    found["answers_of_openings"] += 1
    found["resident_MB"][1] += 2 * endurance.GROWTH
    found["open_files"][1] += 1
    assert len(endurance.failures(found)) == 4
