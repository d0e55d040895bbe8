"""The test of bench/endurance.py, for a few seconds instead of minutes."""

import contextlib
from pathlib import Path

import pytest

BENCH = Path(__file__).resolve().parents[1] / "bench"


@pytest.mark.exhaustive
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_memory_and_results_stay_the_same(device, monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(BENCH))
    monkeypatch.setenv("CMP_CL_DEVICE", device.index)
    import endurance

    assert endurance.endure(12, openings=20) == []
    with contextlib.ExitStack() as opened:
        kept = []

        def leaks():
            kept.append(b"1" * 2**23 + bytes([len(kept)]))
            opened.enter_context((tmp_path / "file").open("w"))
            return len(kept)

        assert len(endurance.faults(leaks, lambda rounds: rounds < 40)) == 3
