"""Every command ends with 0, 1, 2 or 130, and a failure is one line."""

import argparse
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cmp_cl import CalibrationError, KernelBuildError
from cmp_cl.cli import main as cli

PROJECT = Path(__file__).parents[2]
BOARD = PROJECT / "cmp_cl" / "data" / "board.png"
(COMMANDS,) = (
    action.choices
    for action in cli._parser()._actions
    if isinstance(action, argparse._SubParsersAction)
)
FAILURES = {
    "an error of ours": (CalibrationError("no camera"), 2, "cmp-cl: no camera\n"),
    "a kernel": (KernelBuildError("no kernel"), 2, "cmp-cl: no kernel\n"),
    "a file": (FileNotFoundError(2, "No such file", "a"), 2, "cmp-cl: a: No such file\n"),
    "memory": (MemoryError(), 2, "cmp-cl: there is not enough memory for this\n"),
    "Ctrl-C": (KeyboardInterrupt(), 130, "cmp-cl: interrupted\n"),
    "a closed pipe": (BrokenPipeError(), 0, ""),
}


def least(name):
    """Return the arguments without which a command is not begun: any text or number."""
    arguments = [name]
    chosen = [
        group._group_actions[0]
        for group in COMMANDS[name]._mutually_exclusive_groups
        if group.required
    ]
    for action in COMMANDS[name]._actions:
        text = "9x9" if "x" in str(action.metavar) else "9"
        if not action.option_strings and action.nargs != "*":
            arguments.append("none.png")
        elif action.option_strings and (action.required or action in chosen):
            arguments += [action.option_strings[0], *[text] * (action.nargs or 1)]
    return arguments


@pytest.mark.parametrize("name", COMMANDS)
def test_help_is_0_and_an_unknown_option_is_2(run, name):
    status, out, err = run(name, "--help")
    assert (status, err) == (0, "")
    assert out.startswith(f"usage: cmp-cl {name}")
    status, out, err = run(*least(name), "--no-such-option")
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert "--no-such-option" in err


@pytest.mark.parametrize(("error", "status", "line"), FAILURES.values(), ids=FAILURES)
def test_what_a_command_raises_is_a_status_and_one_line(run, monkeypatch, error, status, line):
    def raises(_):
        raise error

    parser = cli._parser()
    parse = parser.parse_args

    def parsed(argv):
        arguments = parse(argv)
        arguments.run = raises
        return arguments

    monkeypatch.setattr(parser, "parse_args", parsed)
    monkeypatch.setattr(cli, "_parser", lambda: parser)
    for name in COMMANDS:
        assert run(*least(name)) == (status, "", line), name


def test_the_statuses_are_those_of_the_documentation():
    text = (PROJECT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    table = text.partition("## Exit status")[2].partition("\n## ")[0]
    assert re.findall(r"^\| (\d+) \|", table, re.MULTILINE) == ["0", "1", "2", "130"]


@pytest.mark.skipif(os.name == "nt", reason="there is no SIGTERM to send on Windows")
def test_a_signal_from_outside_ends_a_command_with_130(tmp_path):
    command = [sys.executable, "-m", "cmp_cl", "detect", *[str(BOARD)] * 5000, "--out", "c.csv"]
    child = subprocess.Popen(
        command,
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(PROJECT)},
    )
    child.stdout.readline()  # it is among the images
    child.send_signal(signal.SIGTERM)
    assert child.communicate(timeout=60)[1] == "cmp-cl: interrupted\n"
    assert child.returncode == 130
    assert os.listdir(tmp_path) == []


@pytest.mark.skipif(os.name == "nt", reason="a signal to one process alone needs POSIX")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_while_modules_are_imported_is_130_and_one_line(tmp_path, name):
    (tmp_path / "cv2.py").write_text(
        "import sys, time\nsys.stdout.write('importing\\n')\nsys.stdout.flush()\ntime.sleep(60)\n"
    )
    child = subprocess.Popen(
        [sys.executable, "-m", "cmp_cl", "devices"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), str(PROJECT)))},
        start_new_session=True,
    )
    assert child.stdout.readline() == "importing\n"
    child.send_signal(getattr(signal, name))
    assert child.communicate(timeout=60) == ("", "cmp-cl: interrupted\n")
    assert child.returncode == 130


def test_json_lines_to_a_closed_standard_output_are_refused():
    command = [sys.executable, "-m", "cmp_cl", "run", "cmp_cl/data/board.png", "--out", "-"]
    done = subprocess.run(
        ["sh", "-c", f"{' '.join(command)} >&-"],
        cwd=PROJECT,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2
    assert done.stderr == "cmp-cl: --out - needs standard output, which is closed\n"


def test_a_very_long_word_is_not_printed_whole(run):
    status, _, said = run("x" * 100_000)
    assert status == 2
    assert len(said) < 1200
    status, _, said = run("detect", "x" * 100_000)
    assert status == 2
    assert len(said) < 1200
