"""The kernels are found, assembled and compiled only here.

`Programs.kernels(stages, defines)` compiles some of the files in kernels/, each into a program of
its own. `Kernels.bind(name, *arguments)` returns a kernel with its arguments set, ready to be
launched. `programs_of(device)` returns the programs that all detectors of a process share.

A compilation takes seconds. So a file is compiled with only the macros that it names: another
configuration compiles only the stages that it changes. Implementations of OpenCL cache what they
compile, and pyopencl does for those that do not.
"""

import functools
import importlib
import os
import re
import threading
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyopencl as cl

from cmp_cl.errors import DeviceError, KernelBuildError
from cmp_cl.opencl import pocl
from cmp_cl.opencl.device import check_process, clear_errors
from cmp_cl.opencl.pocl import is_pocl

_OPTIONS = ("-cl-std=CL1.2", "-cl-kernel-arg-info")
_ROUNDED = "-cl-fp32-correctly-rounded-divide-sqrt"  # as the host's; cards have faster ones
_INCLUDE = re.compile(r'#include "(.+)"')
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
# pyopencl reads it where it cannot write its cache, and fails without it.
os.environ.setdefault("PYOPENCL_CACHE_FAILURE_FATAL", "")
_WARNINGS = threading.Lock()  # the whole process shares the filters of warnings


def kernel_folder() -> Path:
    """Return the folder of the kernels: in the package, or beside it in a checkout."""
    package = Path(__file__).parents[1]
    inside = package / "kernels"
    return inside if inside.is_dir() else package.parent / "kernels"


def source(stage: str, macros: Mapping[str, str] | None = None) -> str:
    """Return the text of kernels/STAGE.cl with its headers, each of them once.

    macros: function-like macros, "NAME(ARGUMENTS)" to text. Those that the source names are
        inserted before it.
    """
    text = _text(kernel_folder(), f"{stage}.cl")
    named = {name: body for name, body in (macros or {}).items() if _names(text, name)}
    return "\n".join([*(f"#define {name} {body}" for name, body in named.items()), text])


def _names(text: str, macro: str) -> bool:
    """Return whether a text uses a macro, in code, in a condition or in another macro."""
    return macro.partition("(")[0] in _words(text)


@functools.lru_cache(maxsize=64)
def _words(text: str) -> frozenset[str]:
    return frozenset(re.findall(r"\w+", _COMMENT.sub(" ", text)))


@functools.cache
def _text(folder: Path, name: str) -> str:
    return "\n".join(_with_headers(folder, name, set()))


def _with_headers(folder: Path, name: str, seen: set[str]) -> list[str]:
    """Return the lines of a file, in place of every #include those of the header."""
    lines = [f'#line 1 "{name}"']
    text = (folder / name).read_text(encoding="utf-8")
    for number, line in enumerate(text.splitlines(), 2):
        header = _INCLUDE.fullmatch(line)
        if header is None:
            lines.append(line)
        elif header[1] not in seen:
            seen.add(header[1])
            lines += [*_with_headers(folder, header[1], seen), f'#line {number} "{name}"']
        else:
            lines.append("")
    return lines


def _arguments(text: str) -> dict[str, list[str]]:
    """Return the names of the arguments of each kernel in a text, in order, those under a condition
    too. Not all devices keep them in a compiled program."""
    text = text.replace("\\\n", " ")
    macros = dict(re.findall(r"#define (\w+) +(.*)", text))
    found = {}
    for name, arguments in re.findall(r"__kernel void (\w+)\(([^)]*)\)", text):
        whole = re.sub(r"\w+", lambda word: macros.get(word[0], word[0]), arguments)
        found[name] = re.findall(r"(\w+)\s*(?=,|$)", whole)
    return found


class Kernels:
    """Compiled programs; no two of their kernels have the same name.

    arguments: the names of the arguments of each kernel, in order, with those that a macro leaves
    out.
    """

    def __init__(
        self, programs: Sequence[cl.Program], arguments: Mapping[str, Sequence[str]]
    ) -> None:
        _guard_invokers()
        if not all(each.kernel_names for each in programs):
            raise DeviceError(
                "a compiled program has no kernels, so the cache of compiled kernels is damaged; "
                f"remove it, for PoCL the folder {str(pocl.cache_folder())!r}"
            )
        self._programs = {name: each for each in programs for name in each.kernel_names.split(";")}
        self.arguments = arguments

    @property
    def names(self) -> set[str]:
        """Return the names of the kernels."""
        return set(self._programs)

    def bind(self, name: str, *arguments: Any) -> cl.Kernel:
        """Return a new kernel of that name with these arguments, NumPy scalars and buffers."""
        kernel = cl.Kernel(self._programs[name], name)
        kernel.set_args(*arguments)
        return kernel


class Programs:
    """The programs of a context; the same text under the same options is compiled once."""

    def __init__(self, context: cl.Context) -> None:
        self.context = context
        self._compiled: dict[tuple[str, ...], cl.Program] = {}

    def kernels(
        self,
        stages: Sequence[str],
        defines: Mapping[str, str | int],
        macros: Mapping[str, str] | None = None,
    ) -> Kernels:
        """Return the kernels of the stages.

        Raises KernelBuildError with the compiler's log; DeviceError in a forked child, and if PoCL
        cannot compile or its cache is damaged or someone else's.
        """
        check_process()
        arguments: dict[str, list[str]] = {}
        for stage in stages:
            arguments |= _arguments(source(stage))
        programs = [self._program(stage, defines, macros or {}) for stage in stages]
        return Kernels(programs, arguments)

    def _program(
        self, stage: str, defines: Mapping[str, str | int], macros: Mapping[str, str]
    ) -> cl.Program:
        text = source(stage, macros)
        named = [f"-D{name}={value}" for name, value in defines.items() if _names(text, name)]
        key = (text, *named)
        if key not in self._compiled:
            options = [*_OPTIONS, *_rounded(self.context), *named]
            self._compiled[key] = _compiled(self.context, stage, text, options)
        return self._compiled[key]


def _rounded(context: cl.Context) -> list[str]:
    """Return the option that rounds quotients and roots correctly, if all devices have it."""
    exact = cl.device_fp_config.CORRECTLY_ROUNDED_DIVIDE_SQRT
    return [_ROUNDED] if all(each.single_fp_config & exact for each in context.devices) else []


def programs_of(device: cl.Device) -> Programs:
    """Return the programs of a device, in a context of their own.

    They are kept as long as the process, because loading a compiled program takes tens of
    milliseconds, and a detector has six. Raises DeviceError in a forked child.
    """
    check_process()
    return _shared(device)


@functools.cache
def _shared(device: cl.Device) -> Programs:
    with clear_errors(device):
        return Programs(cl.Context([device]))


def _compiled(context: cl.Context, stage: str, text: str, options: list[str]) -> cl.Program:
    if any(is_pocl(device) for device in context.devices):
        pocl.check_compiler()
    try:
        return _built(cl.Program(context, text), options)
    except cl.Error as error:
        names = ", ".join(device.name for device in context.devices)
        raise KernelBuildError(
            f"the kernels of {stage} do not compile on {names}; the compiler says:\n{error}"
        ) from error


def _built(program: cl.Program, options: list[str]) -> cl.Program:
    """Compile a program, without the warnings of the compiler and of a cache that cannot be
    written."""
    with _WARNINGS, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        program.build(options=options)
    return program


class _InMemory(dict[object, object]):
    """A cache of pyopencl that ends with the process."""

    store_if_not_present = dict.setdefault


_INVOKERS = _InMemory()


def _guard_invokers() -> None:
    """Let pyopencl make the functions that call kernels in each process, not load them.

    It keeps them in SQLite, and fails if the folder cannot be written or the disk is full.
    """
    library: Any = cl
    before, library._PYOPENCL_NO_CACHE = library._PYOPENCL_NO_CACHE, True
    try:
        invoker: Any = importlib.import_module("pyopencl.invoker")  # would open the cache
    finally:
        library._PYOPENCL_NO_CACHE = before
    invoker.invoker_cache = _INVOKERS


def sum_of_terms(terms: Sequence[str], kind: str) -> str:
    """Return the sum of terms in the type `kind`, nested three at a time like SUM3 in plane.clh."""
    if len(terms) == 1:
        return terms[0]
    third = -(-len(terms) // 3)
    parts = [sum_of_terms(terms[i : i + third], kind) for i in range(0, len(terms), third)]
    return f"SUM3({kind}, {', '.join(parts + ['0'] * (3 - len(parts)))})"
