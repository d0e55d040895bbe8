"""The documentation site: sphinx-build -W docs site."""

import re
import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import pictures  # noqa: E402

PROJECT = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project = "cmp_cl"
author = "The cmp_cl authors"
copyright = author
version = release = PROJECT["version"]

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx_copybutton"]
exclude_patterns = [
    "conf.py", "pictures.py", "examples", "packaging", "docker", "_build", "**.ipynb_checkpoints",
]  # fmt: skip
source_suffix = {".md": "myst-nb", ".py": "myst-nb"}
nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
suppress_warnings = ["misc.highlighting_failure"]

html_theme = "furo"
html_title = f"cmp_cl {release}"
html_static_path: list[str] = []
html_extra_path = ["_generated/copied"]
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autoclass_content = "class"

FIELD = re.compile(r"^([A-Za-z_]\w*(?:, [A-Za-z_]\w*)*): (?=\S)")
CODE = re.compile(r"(?<![`\w:])`([^`]+)`(?!`)")


def as_restructured_text(app, what, name, obj, options, lines):
    """Turn the docstrings' `name: meaning` lines into a list, and `code` into literals."""
    out: list[str] = []
    in_list = False
    for line in lines:
        line = CODE.sub(r"``\1``", line)
        field = FIELD.match(line)
        if field and not line.startswith(("Returns", "Raises")):
            if not in_list:
                out.append("")
            names = ", ".join(f"**{part}**" for part in field[1].split(", "))
            out.append(f"* {names}: {line[field.end() :]}")
            in_list = True
        elif in_list and line.startswith("    "):
            out.append("  " + line.strip())
        else:
            if in_list and line.strip():
                out.append("")
            in_list = in_list and not line.strip()
            if line.startswith("    ") and out and not out[-1].strip():
                out += [".. code-block:: python", ""]
            out.append(line)
    lines[:] = out


def setup(app):
    app.connect("autodoc-process-docstring", as_restructured_text)
    app.connect("builder-inited", lambda app: pictures.make(HERE / "_generated"))
