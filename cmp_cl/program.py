"""The kernels: found, put together, compiled. This is the one place that builds.

`build(context, stages, defines)` compiles some of the files in kernels/ into one program;
`Kernels.bind(name, *arguments)` gives a kernel with its arguments set, ready to be launched.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyopencl as cl

from cmp_cl.errors import KernelBuildError

_HEADERS = ("plane.clh", "ring.clh")


def kernel_folder() -> Path:
    """Where the kernels are: in the package, or beside it in a checkout."""
    package = Path(__file__).parent
    for folder in (package / "kernels", package.parent / "kernels"):
        if (folder / _HEADERS[0]).is_file():
            return folder
    raise KernelBuildError(
        f"the OpenCL kernels are neither in {package / 'kernels'} nor beside the package; "
        "install cmp-cl again"
    )


def source(stages: Sequence[str], macros: Mapping[str, str] | None = None) -> str:
    """The text of the headers and of kernels/STAGE.cl for each stage.

    macros: function-like macros, "NAME(ARGUMENTS)" to text, that are put before.
    """
    folder = kernel_folder()
    text = [f"#define {name} {body}" for name, body in (macros or {}).items()]
    for name in (*_HEADERS, *(f"{stage}.cl" for stage in stages)):
        text += [f'#line 1 "{name}"', (folder / name).read_text(encoding="utf-8")]
    return "\n".join(text)


class Kernels:
    """A compiled program."""

    def __init__(self, program: cl.Program) -> None:
        self._program = program

    def bind(self, name: str, *arguments: Any) -> cl.Kernel:
        """A kernel of its own with these arguments, NumPy scalars and buffers."""
        kernel = cl.Kernel(self._program, name)
        kernel.set_args(*arguments)
        return kernel


def build(
    context: cl.Context,
    stages: Sequence[str],
    defines: Mapping[str, str | int],
    macros: Mapping[str, str] | None = None,
) -> Kernels:
    """Compile the stages; raises KernelBuildError with the compiler's log."""
    options = ["-cl-std=CL1.2", *(f"-D{name}={value}" for name, value in defines.items())]
    program = cl.Program(context, source(stages, macros))
    try:
        return Kernels(program.build(options=options))
    except cl.Error as error:
        names = ", ".join(device.name for device in context.devices)
        raise KernelBuildError(
            f"the kernels {', '.join(stages)} do not compile on {names}; the compiler says:\n{error}"
        ) from error


def sum_of_terms(terms: Sequence[int], kind: str) -> str:
    """The sum of F(k) over the terms, nested three at a time as SUM3 in plane.clh."""
    if len(terms) == 1:
        return f"F({terms[0]})"
    third = -(-len(terms) // 3)
    parts = [sum_of_terms(terms[i : i + third], kind) for i in range(0, len(terms), third)]
    return f"SUM3({kind}, {', '.join(parts + ['0'] * (3 - len(parts)))})"
