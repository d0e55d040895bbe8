"""A series for ParaView: NAME.pvd, and a .vtp for every frame in the folder NAME_frames."""

import json
import re
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from cmp_cl.field.nodes import surface
from cmp_cl.files import first_free, write_bytes
from cmp_cl.series.base import Arrays, Description, Format, at_rest, moved_by
from cmp_cl.series.disk import Appended

_END = b"</Collection>\n</VTKFile>\n"


class ParaViewFormat(Format):
    """The nodes and the quadrilaterals between them, by time; a plane lies at z = 0.

    It needs the constant `rest` (R, C, 2 or 3), and `displacement` or `xy` in each frame. The time
    is in s, or the number of the frame if no frame has a time. The part is a complete .pvd after
    every frame. The folder is NAME_frames-2 if NAME_frames is there already, and so on.
    """

    def __init__(self, part: Path, description: Description, constants: Arrays) -> None:
        super().__init__(part, description, constants)
        at_rest(constants, "a .pvd")
        self._stem = part.with_name(re.split(r"(?i)\.pvd\.part", part.name)[0] + "_frames")
        self._folder: Path | None = None
        self._file = Appended(part)
        about = json.dumps(description.with_units())
        begin = (
            f'<?xml version="1.0"?>\n<!-- {escape(about).replace("--", "- -")} -->\n'
            '<VTKFile type="Collection" version="1.0" byte_order="LittleEndian">\n<Collection>\n'
        )
        self._file.append(begin.encode(), _END)

    def write(self, number: int, index: int, time_ms: float, frame: Arrays) -> None:
        rest, shift = moved_by(self.constants, frame, "a .pvd")
        if self._folder is None:
            self._folder = first_free(self._stem, Path.mkdir)
        name = f"{index:06}.vtp"
        write_bytes(self._folder / name, surface(rest, shift, frame))
        time = time_ms / 1e3 if np.isfinite(time_ms) else float(index)
        path = quoteattr(f"{self._folder.name}/{name}")
        line = f'<DataSet timestep="{time:.9g}" part="0" file={path}/>\n'
        self._file.append(line.encode(), _END)

    def finish(self, target: Path, frames: int) -> None:
        self.close()
        super().finish(target, frames)

    def close(self) -> None:
        self._file.close()
