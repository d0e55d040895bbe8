"""What the documentation shows has run: examples, commands, notebooks."""

import contextlib
import doctest
import glob
import re
import shlex
import shutil
from pathlib import Path

import matplotlib
import pytest

import cmp_cl
from cmp_cl import field, grid, series, stereo, synthetic, viz
from cmp_cl.cli.main import main

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PAGES = sorted(path for path in DOCS.rglob("*.md") if "_generated" not in path.parts)
API = [path for path in PAGES if path.parent.name == "api"]
LONG = {"gel", "calibration", "gpu"}  # tutorials of more than a few seconds
FOUND = re.compile(r"\.\. auto\w+:: (?:cmp_cl\.)([\w.]+)")


def blocks(path):
    """The fenced blocks of a page, (language, text) each."""
    return FENCE.findall(path.read_text(encoding="utf-8"))


def name_of(path):
    return path.relative_to(DOCS).with_suffix("").as_posix()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder to run in, without a display."""
    matplotlib.use("agg")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", API, ids=name_of)
def test_examples_of_the_reference_give_what_they_show(page, folder):
    examples = "".join(text for language, text in blocks(page) if language == "pycon")
    if not examples:
        pytest.skip("it shows none")
    parsed = doctest.DocTestParser().get_doctest(examples, {}, name_of(page), str(page), 0)
    said = []
    result = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(parsed, out=said.append)
    assert not result.failed, "".join(said)


def test_the_reference_has_every_public_name():
    shown = {name for page in API for name in FOUND.findall(page.read_text(encoding="utf-8"))}
    modules = {
        "arrays",
        "cameras",
        "measure",
        "media",
        "series",
    }  # their names are shown one by one
    assert set(cmp_cl.__all__) - modules - shown == set()


@pytest.mark.parametrize("module", [field, grid, series, stereo, synthetic, viz])
def test_the_reference_has_every_public_name_of_a_package(module):
    text = "".join(page.read_text(encoding="utf-8") for page in API)
    shown = {name.rpartition(".")[2] for name in FOUND.findall(text)}
    assert set(module.__all__) - shown == set()


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
    return any(language in ("python", "console") for language, _ in blocks(path))


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(
            path, marks=[pytest.mark.exhaustive] if path.stem in LONG else [], id=name_of(path)
        )
        for path in PAGES
        if runnable(path)
    ],
)
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


@pytest.mark.exhaustive
@pytest.mark.parametrize("path", sorted((DOCS / "notebooks").glob("*.py")), ids=lambda p: p.stem)
def test_notebooks_run(path, folder):
    jupytext = pytest.importorskip("jupytext")
    notebook = jupytext.read(path, fmt="py:percent")
    names = {}
    for cell in notebook.cells:
        if cell.cell_type == "code":
            exec(compile(cell.source, str(path), "exec"), names)


def test_links_between_pages_lead_somewhere():
    for page in PAGES:
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for target in re.findall(r"\]\(([^)#:\s]+)(?:#[\w-]+)?\)", text):
            if not target.startswith("_generated/"):  # made when the site is built
                assert (page.parent / target).exists(), f"{page}: {target}"


def test_questions_are_answered_in_their_first_paragraph():
    for page in (DOCS / "questions").glob("*.md"):
        title, first = page.read_text(encoding="utf-8").split("\n\n")[:2]
        assert title.startswith("# ")
        assert 40 <= len(first.split()) <= 140, page


def test_the_glossary_is_in_order():
    text = (DOCS / "glossary.md").read_text(encoding="utf-8")
    words = [line.lower() for line in re.findall(r"^(.+)\n: ", text, flags=re.MULTILINE)]
    assert words == sorted(words)
    assert len(words) > 50
