"""A series for ParaView: NAME.pvd, and a .vtp for every frame in the folder NAME_frames."""

import json
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError
from cmp_cl.files import check_target, write_text
from cmp_cl.series.base import Constants, Description, FileName, Frame, Series
from cmp_cl.vtk import polydata, quadrilaterals

_END = "</Collection>\n</VTKFile>\n"


class ParaViewSeries(Series):
    """The nodes and the quadrilaterals between them, by time; a plane lies at z = 0.

    It needs the constant `rest` (R, C, 2 or 3), and `displacement` or `xy` in each frame. The time
    is in s, or the number of the frame if no frame has a time. The .pvd is complete after every
    frame, so it can be opened at any time.
    """

    def __init__(self, path: FileName, description: Description, constants: Constants) -> None:
        super().__init__(description, constants)
        if self.constants.get("rest", np.empty(0)).ndim != 3:
            raise FieldError("a .pvd needs the positions at rest, (R, C, 2) or (R, C, 3)")
        self._target = check_target(path)
        self._folder = self._target.with_name(f"{self._target.stem}_frames")
        self._file: Any = None

    def _write(self, index: int, time_ms: float, frame: Frame) -> None:
        rest = self.constants["rest"].astype(np.float64)
        shift = frame.get("displacement")
        if shift is None and "xy" in frame:
            shift = frame["xy"] - rest
        if shift is None or shift.shape != rest.shape:
            raise FieldError("a .pvd needs the displacement or the positions xy of the nodes")
        self._folder.mkdir(exist_ok=True)
        name = self._folder / f"{index:06}.vtp"
        write_text(name, _polydata(rest, shift.astype(np.float64), frame))
        if self._file is None:
            file = open(self._target, "w+b")  # noqa: SIM115, closed by files
            self._file = self.files.enter_context(file)
            about = json.dumps(self.description.with_units())
            self._file.write(
                f'<?xml version="1.0"?>\n<!-- {escape(about).replace("--", "- -")} -->\n'
                '<VTKFile type="Collection" version="1.0" byte_order="LittleEndian">\n'
                "<Collection>\n".encode()
            )
        time = time_ms / 1e3 if np.isfinite(time_ms) else float(index)
        path = quoteattr(f"{self._folder.name}/{name.name}")
        line = f'<DataSet timestep="{time:.9g}" part="0" file={path}/>\n'
        at = self._file.tell()
        self._file.write((line + _END).encode())
        self._file.flush()
        self._file.seek(at + len(line.encode()))


def _polydata(rest: NDArray[np.float64], shift: NDArray[np.float64], frame: Frame) -> str:
    """Return the valid nodes as VTK's PolyData; positions are those at rest."""
    valid = np.isfinite(rest.sum(axis=2) + shift.sum(axis=2))
    row, column = np.nonzero(valid)
    columns: dict[str, NDArray[Any]] = {
        "displacement": _in_space(shift[valid]),
        "row": row.astype(np.int32),
        "column": column.astype(np.int32),
    }
    for name, value in frame.items():
        if name != "displacement" and value.shape[:2] == valid.shape and value.ndim in (2, 3):
            columns[name] = value[valid]
    return polydata(_in_space(rest[valid]), quadrilaterals(valid), columns)


def _in_space(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N, 2) with a third coordinate of 0, or (N, 3) as they are."""
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
