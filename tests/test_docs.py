"""Examples, commands and notebooks of the documentation give the results that it shows."""

import contextlib
import doctest
import glob
import importlib.util
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import matplotlib
import pytest

import cmp_cl
from cmp_cl import field, grid, measure, motion, series, space, synthetic, viz
from cmp_cl.cli.main import main

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PAGES = sorted(DOCS.rglob("*.md"))
API = [path for path in PAGES if path.parent.name == "api"]
EXECUTED = {"tutorials", "notebooks"}  # by the site, which fails if one of their cells does
EXTRAS = {"dask": "distributed", "hdf5": "h5py", "mcap": "mcap_ros2", "plot": "matplotlib"}
FOUND = re.compile(r"\.\. auto\w+:: (?:cmp_cl\.)([\w.]+)")


def blocks(path):
    """Return the fenced blocks of a page, (language, text) each."""
    return FENCE.findall(path.read_text(encoding="utf-8"))


def name_of(path):
    return path.relative_to(DOCS).with_suffix("").as_posix()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return an empty folder to run in, without a display."""
    matplotlib.use("agg")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def sections(page):
    """Return the sections of a page of the reference, heading and text, the head's first."""
    parts = re.split(r"^#{2,3} (.+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return [("", parts[0]), *zip(parts[1::2], parts[2::2], strict=True)]


def can_run(text):
    """Return whether the extra that a section asks for is installed."""
    named = re.search(r"^With the extra `(\w+)`", text, flags=re.MULTILINE)
    return named is None or importlib.util.find_spec(EXTRAS[named[1]]) is not None


@pytest.mark.parametrize("page", API, ids=name_of)
def test_examples_of_the_reference_give_what_they_show(page, folder):
    runnable = "".join(text for _, text in sections(page) if can_run(text))
    examples = "".join(text for language, text in FENCE.findall(runnable) if language == "pycon")
    parsed = doctest.DocTestParser().get_doctest(examples, {}, name_of(page), str(page), 0)
    said = []
    result = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(parsed, out=said.append)
    assert not result.failed, "".join(said)


@pytest.mark.parametrize(
    "module", [cmp_cl, field, grid, measure, motion, series, space, synthetic, viz]
)
def test_the_reference_has_every_public_name_of_a_package(module):
    text = "".join(page.read_text(encoding="utf-8") for page in API)
    shown = {name.rpartition(".")[2] for name in FOUND.findall(text)}
    assert set(module.__all__) - shown == set()


DEEP = sorted(
    {
        name.rpartition(".")[0]
        for page in API
        for name in FOUND.findall(page.read_text(encoding="utf-8"))
        if name.count(".") > 1
    }
)


@pytest.mark.parametrize("module", DEEP)
def test_after_import_cmp_cl_the_names_of_the_reference_are_there(module):
    code = f"import cmp_cl; cmp_cl.{module}"
    subprocess.run([sys.executable, "-c", code], check=True)


def command(line):
    """Run `$ cmp-cl ...`, or one of the few other commands, as a shell would."""
    words = [
        found
        for word in shlex.split(line)
        for found in (sorted(glob.glob(word)) if "*" in word else [word])
    ]
    if words[0] == "cmp-cl":
        assert main(words[1:]) == 0, line
    elif words[0] == "mkdir":
        Path(words[1]).mkdir()
    elif words[0] == "cp":
        for source in words[1:-1]:
            shutil.copy(source, words[-1])
    else:
        raise AssertionError(f"no test runs {line!r}")


def runnable(path):
    """Return whether a page has blocks to run that the site does not run."""
    kinds = {language for language, _ in blocks(path)}
    return path.parent.name not in EXECUTED and not kinds.isdisjoint({"python", "console"})


@pytest.mark.parametrize("page", [path for path in PAGES if runnable(path)], ids=name_of)
def test_every_block_of_a_page_runs_in_order(page, folder):
    names = {}
    for language, text in blocks(page):
        if language == "python":
            with contextlib.redirect_stdout(None):
                exec(compile(text, str(page), "exec"), names)
        elif language == "console":
            for line in text.splitlines():
                assert line.startswith("$ "), line
                command(line.removeprefix("$ "))


def test_the_pictures_of_the_pages_are_drawn(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    for draw in importlib.import_module("pictures").DRAWN:
        assert draw().axes, draw.__name__
