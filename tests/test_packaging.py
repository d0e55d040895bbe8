"""The recipe for conda asks for what the project needs."""

import re
import tomllib
from pathlib import Path

import jinja2
import yaml

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


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
