"""Which module may import which: only those of its own layer and of those below it; and what
`import cmp_cl` does: it gives every public name, and changes nothing in the process."""

import ast
import dataclasses
import functools
import inspect
import re
from collections import Counter
from pathlib import Path

from children import python

import cmp_cl
from cmp_cl.lattice.constants import LatticeConstants

ROOT = Path(cmp_cl.__file__).parent
# From the bottom up; a name is that of a module, or of a package and everything in it.
LAYERS = [
    {"closing", "errors"},
    {"files", "fits"},
    {"image", "pattern"},
    {"config", "media"},
    {"corners", "points"},
    {"opencl"},
    {"stages"},
    {"lattice"},
    {"grid"},
    {"detector", "field"},
    {"series", "space"},
    {"motion", "synthetic"},
    {"reference"},
    {"viz"},
    {"cluster", "measure"},
    {"cli"},
]
ASIDE = {"__main__", "__init__"}  # the entries, which import everything


IMPORT = """
import signal, sys
before = [signal.getsignal(number) for number in signal.valid_signals()]
import cmp_cl
assert [signal.getsignal(number) for number in signal.valid_signals()] == before
for name in dir(cmp_cl):
    assert getattr(cmp_cl, name), name
assert [signal.getsignal(number) for number in signal.valid_signals()] == before
unwanted = [name for name in sys.modules if name.startswith(("cmp_cl.cli", "cmp_cl.reference"))]
assert not unwanted, unwanted
cmp_cl.reference.detect
"""


@functools.cache
def modules():
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts): path
        for path in sorted(ROOT.rglob("*.py"))
    }


@functools.cache
def imported(path):
    """Return the modules of cmp_cl that a file imports, in functions too."""
    waiting, names = [ast.parse(path.read_text(encoding="utf-8"))], set()
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "cmp_cl":
            inner = node.module.split(".")[1:]
            names |= {".".join([*inner, alias.name]) for alias in node.names}
        waiting += ast.iter_child_nodes(node)
    return {module for module in map(module_of, names) if module}


def module_of(name):
    """Return the module that a name is, or that it is in."""
    within = name.rpartition(".")[0]
    places = name, f"{name}.__init__", within, f"{within}.__init__".lstrip(".")
    return next((place for place in places if place in modules()), None)


def layer_of(module):
    top = module.split(".")[0]
    return next((n for n, layer in enumerate(LAYERS) if top in layer), None)


def test_a_module_imports_only_what_stands_below_it():
    wrong = [
        (name, other)
        for name, path in modules().items()
        for other in imported(path)
        if None not in (layer_of(name), layer_of(other)) and layer_of(other) > layer_of(name)
    ]
    assert wrong == []


def test_no_module_imports_what_imports_everything():
    assert {name for name, path in modules().items() if ASIDE & imported(path)} == set()


def test_every_module_has_a_layer():
    tops = {name.split(".")[0] for name in modules()}
    assert set().union(*LAYERS) == tops - ASIDE


def test_nothing_but_tests_and_benches_imports_the_oracle():
    importing = {
        name
        for name, path in modules().items()
        if not name.startswith("reference")
        and any(other.startswith("reference") for other in imported(path))
    }
    assert importing == set()


def test_a_folder_has_at_most_twelve_modules():
    counts = Counter(path.parent for path in modules().values() if path.name != "__init__.py")
    assert {path.name: count for path, count in counts.items() if count > 12} == {}


def test_every_constant_of_the_lattice_is_explained_and_there_are_at_most_45():
    names = [field.name for field in dataclasses.fields(LatticeConstants)]
    assert len(names) <= 45
    assert names == re.findall(r"^(\w+): ", inspect.getdoc(LatticeConstants) or "", re.M)


def test_importing_the_library_imports_no_command_no_oracle_and_leaves_signals_alone():
    python("-c", IMPORT, check=True)


def test_a_name_that_is_not_there_is_an_attribute_error():
    assert not hasattr(cmp_cl, "no_such_name")
    assert not hasattr(cmp_cl, "__wrapped__")
