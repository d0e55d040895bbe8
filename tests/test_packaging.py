"""Files that other tools read: one version, the recipe, the citation, the workflows."""

import importlib.metadata
import re
import tomllib
from pathlib import Path

import jinja2
import yaml

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
KEPT = ("*.py", "*.md", "*.cff", "*.yaml", "*.yml", "*.toml", "Dockerfile")


def test_the_version_is_in_one_place():
    assert importlib.metadata.version("cmp-cl") == PROJECT["version"]
    pattern = re.compile(rf"""version\w*\s*[:=]\s*["']?v?{re.escape(PROJECT["version"])}\b""", re.I)
    holders = {
        path.relative_to(ROOT).as_posix()
        for kind in KEPT
        for folder in ("cmp_cl", "docs", "bench", ".github")
        for path in (*(ROOT / folder).rglob(kind), *ROOT.glob(kind))
        if pattern.search(path.read_text(encoding="utf-8"))
    }
    assert holders == {"pyproject.toml"}


def test_the_changelog_knows_the_version():
    text = (ROOT / "docs" / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"\n## {PROJECT['version']}\n" in text


def test_the_conda_recipe_asks_for_what_the_project_needs():
    path = ROOT / "docs" / "packaging" / "conda" / "meta.yaml"
    text = jinja2.Template(path.read_text(encoding="utf-8")).render(
        PYTHON="python",
        load_file_data=lambda name, from_recipe_dir: tomllib.loads(
            (path.parent / name).read_text(encoding="utf-8")
        ),
    )
    recipe = yaml.safe_load(text)
    assert recipe["package"] == {"name": "cmp-cl", "version": PROJECT["version"]}
    needed = {re.split(r"[ <>=]", entry)[0] for entry in recipe["requirements"]["run"]}
    wanted = {re.split(r"[<>=]", entry)[0] for entry in PROJECT["dependencies"]}
    assert needed == wanted - {"opencv-contrib-python-headless"} | {"python", "py-opencv", "pocl"}
    assert recipe["build"]["entry_points"] == ["cmp-cl = cmp_cl.__main__:main"]


def test_the_citation_names_the_licence_and_the_paper():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["license"] == PROJECT["license"]
    (paper,) = citation["references"]
    assert (paper["journal"], paper["volume"], paper["start"]) == ("Measurement", 221, 113479)


def test_the_dockerfile_runs_the_first_command_of_the_readme():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (first,) = re.findall(r"^    python3 -m venv .*\[pocl,plot\]\" && (.*)$", readme, re.MULTILINE)
    docker = (ROOT / "docs" / "docker" / "Dockerfile").read_text(encoding="utf-8")
    for command in first.split(" && "):
        words = re.sub(r" (--overlay|--out) \S+", "", command)
        assert all(word in docker for word in words.split()), command


def test_the_workflows_run_what_they_say():
    workflows = {
        path.stem: yaml.safe_load(path.read_text(encoding="utf-8"))
        for path in (ROOT / ".github" / "workflows").glob("*.yml")
    }
    runners = {job["runs-on"] for job in workflows["ci"]["jobs"].values()}
    assert {"windows-latest", "macos-latest", "ubuntu-24.04-arm"} <= runners
    for name, job in (("ci", "linux"), ("release", "test")):
        steps = workflows[name]["jobs"][job]["steps"]
        assert ".ci/run" in [step.get("run") for step in steps]
    publish = workflows["release"]["jobs"]["publish"]
    assert set(publish["needs"]) == {"test", "build"}
    used = [
        step["uses"]
        for job in workflows["release"]["jobs"].values()
        for step in job["steps"]
        if "uses" in step
    ]
    assert all(re.search(r"@[0-9a-f]{40}$", action) for action in used), "a tag can be moved"
