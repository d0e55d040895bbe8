"""The command line in an empty folder, for all of its tests."""

import signal

import pytest

from cmp_cl.cli import main as cli


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Return a function that runs cmp-cl in an empty folder: status, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def run_in_folder(*arguments):
        try:
            status = cli.main([str(argument) for argument in arguments])
        except SystemExit as stop:
            status = stop.code
        return (status, *capsys.readouterr())

    return run_in_folder


@pytest.fixture
def without_nohup():
    """Restore SIGHUP in a process that nohup has started."""
    if not hasattr(signal, "SIGHUP"):
        yield
        return
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)
