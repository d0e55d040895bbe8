"""The documentation site: sphinx-build -W docs site."""

import re
import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).parent
PROJECT = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project = "cmp_cl"
author = "The cmp_cl authors"
copyright = author
version = release = PROJECT["version"]

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx_copybutton"]
extensions += ["sphinx-mathjax-offline"]  # equations without a network
exclude_patterns = [
    "conf.py", "pictures.py", "examples", "packaging", "docker", "_build", "**.ipynb_checkpoints",
]  # fmt: skip
source_suffix = {".md": "myst-nb", ".py": "myst-nb"}
nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_execution_in_temp = True
nb_merge_streams = True
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
suppress_warnings = ["misc.highlighting_failure"]

html_theme = "furo"
html_title = f"cmp_cl {release}"

copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
autodoc_typehints_format = "short"
autoclass_content = "class"

EXECUTED = ("tutorials/", "questions")  # their blocks run, and the site shows what they print
HEAD = """---
file_format: mystnb
kernelspec:
  name: python3
---

"""
BLOCK = re.compile(r"^```(python|console)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ARRAY = re.compile(
    r"~?(?:numpy\.)?ndarray\[tuple\[~?(?:typing\.)?Any, \.\.\.\], "
    r"~?(?:numpy\.)?dtype\[~?(?:numpy\.)?(\w+)\]\]"
)
FIELD = re.compile(r"^([A-Za-z_]\w*(?:, [A-Za-z_]\w*)*|\.\w+(?: \.\w+)*): (?=\S)")
CODE = re.compile(r"(?<![`\w:])`([^`]+)`(?!`)")
SPECIAL = re.compile(r"\|(?=\w)|(?<=\w)_(?!\w)")  # |F2| is no substitution, raw_ no link


def marked(line):
    """Return a line of a docstring as reStructuredText: code in literals, no accidental markup."""
    parts = CODE.sub(r"``\1``", line).split("``")
    parts[::2] = [SPECIAL.sub(r"\\\g<0>", part) for part in parts[::2]]
    return "``".join(parts)


def as_restructured_text(app, what, name, obj, options, lines):
    """Turn the docstrings' `name: meaning` lines into a list, and `code` into literals."""
    if what == "data":  # its docstring is that of dict or tuple
        lines.clear()
    out: list[str] = []
    in_list = False
    for line in lines:
        line = marked(line)
        field = FIELD.match(line)
        if field and not line.startswith(("Returns", "Raises")):
            if not in_list:
                out.append("")
            names = ", ".join(f"**{part}**" for part in re.split(",? ", field[1]))
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


def with_short_arrays(app, what, name, obj, options, signature, returns):
    """Return the arrays in a signature without their empty shapes."""
    return tuple(text and ARRAY.sub(r"ndarray[\1]", text) for text in (signature, returns))


def with_output(app, docname, source):
    """Turn the blocks of a page into cells of a notebook; the source stays plain Markdown."""
    if docname.startswith(EXECUTED) and BLOCK.search(source[0]):
        source[0] = HEAD + BLOCK.sub(as_cell, source[0])


def as_cell(block):
    if block[1] == "python":
        return f"```{{code-cell}} ipython3\n{block[2]}```"
    # One print: what a command writes in pieces would be shown in lines that end within a word.
    here = f"{sys.executable} -m cmp_cl"
    commands = re.sub(r"^\$ cmp-cl\b", here, block[2], flags=re.MULTILINE)
    commands = "set -e\n" + re.sub(r"^\$ ", "", commands, flags=re.MULTILINE)
    cell = (
        "import subprocess\n"
        f"done = subprocess.run({commands!r}, shell=True, capture_output=True, text=True)\n"
        "print(done.stderr + done.stdout, end='')\n"
        "done.check_returncode()\n"
    )
    return f"{block[0]}\n\n```{{code-cell}} ipython3\n:tags: [remove-input]\n{cell}```"


def setup(app):
    app.connect("source-read", with_output)
    app.connect("autodoc-process-signature", with_short_arrays)
    app.connect("autodoc-process-docstring", as_restructured_text)
