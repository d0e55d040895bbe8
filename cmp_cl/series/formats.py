"""The files of a series: each is made from the whole part.

Each function writes the file `path`, which gets the name `target` when it is complete.
"""

import errno
import json
import os
import re
import shutil
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import FieldError
from cmp_cl.field.nodes import node_columns, surface
from cmp_cl.files import csv_bytes, new_folder, write_bytes, write_text
from cmp_cl.series.part import Arrays, Stored

_ROOM, _ROOM_OF_FRAME = 1 << 18, 64  # bytes that HDF5 needs beside the arrays, and for each frame


def write_npz(series: Stored, path: Path, _target: Path) -> None:
    """An .npz with a stack of every array, the constants, and the description as JSON in
    `about`."""
    with open(path, "wb") as file:
        np.savez(file, **series.constants, **series.arrays)  # type: ignore[arg-type]


def moved_by(constants: Arrays, frame: Arrays) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the positions at rest and the displacement of a frame, (R, C, 2 or 3) each.

    Raises FieldError if there are none.
    """
    rest, shift = constants.get("rest"), frame.get("displacement")
    if rest is None or shift is None or rest.ndim != 3 or shift.shape != rest.shape:
        raise FieldError(
            "this format needs the positions at rest and the displacement, (R, C, 2) or (R, C, 3)"
        )
    return rest, shift


def plain(value: NDArray[Any]) -> Any:
    """Return an array as nested lists for JSON, with None for NaN and infinity."""
    if value.dtype.kind == "S":
        value = np.char.decode(value, "utf-8")
    if value.dtype.kind != "f" or np.isfinite(value).all():
        return value.tolist()
    numbers = value.astype(object)
    numbers[~np.isfinite(value)] = None
    return numbers.tolist()


def write_hdf5(series: Stored, path: Path, _target: Path) -> None:
    """HDF5 with the datasets index (F,), time_ms (F,), every array (F, ...) and the constants.

    The attributes of the file are the version, the time and the settings; the attribute `unit` of a
    dataset is its unit. All values have checksums.

    HDF5 crashes if it cannot complete a file, so it begins only if there is room.
    """
    import h5py

    needed = sum(each.nbytes + _ROOM_OF_FRAME * len(each) for each in series.arrays.values())
    if shutil.disk_usage(path.parent).free < needed + _ROOM:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    units = series.about["units"]
    try:
        with h5py.File(path, "w", libver="latest") as file:
            file.attrs.update({k: v for k, v in series.about.items() if isinstance(v, str)})
            compact = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            compact.set_layout(h5py.h5d.COMPACT)  # in the header, which has a checksum
            for name, array in {**series.constants, **series.arrays}.items():
                data = np.char.encode(array, "utf-8") if array.dtype.kind == "U" else array
                how: dict[str, Any] = {"dcpl": compact}
                if array.ndim and array.size:
                    how = {"fletcher32": True}
                    if array.ndim > 1 and name in series.arrays:
                        how["chunks"] = (1, *array.shape[1:])
                dataset = file.create_dataset(name, data=data, **how)
                if name in units:
                    dataset.attrs["unit"] = units[name]
    except (RuntimeError, OSError) as error:
        said = re.search(r"errno = (\d+), error message = '([^']*)'", str(error))
        raise OSError(*((int(said[1]), said[2]) if said else (str(error),))) from error


def write_csv(series: Stored, path: Path, target: Path) -> None:
    """CSV with the units in its header; the description is in NAME.csv-metadata.json.

    Floats have 9 digits, times 15; missing ones are nan. The metadata file has the name that W3C
    recommends; it has the constants too.
    """
    with open(path, "wb") as file:
        for index, time_ms, frame in series.frames():
            moved_by(series.constants, frame)  # else there are no rows
            columns = dict(node_columns(frame, series.about["units"]))
            columns = {"frame": np.array(index), "time_ms": np.array(time_ms), **columns}
            if not file.tell():
                file.write(csv_bytes([columns]))
            kinds = ["%.9g" if each.dtype.kind == "f" else "%d" for each in columns.values()]
            kinds[1] = "%.15g"  # times since 1970 have 13 digits before the point
            table = np.stack(np.broadcast_arrays(*columns.values()), axis=1)
            np.savetxt(file, table, fmt=",".join(kinds))
    constants = {name: plain(value) for name, value in series.constants.items() if name != "about"}
    metadata = json.dumps({**series.about, "constants": constants}, indent=1)
    write_text(target.with_name(f"{target.name}-metadata.json"), metadata)


def write_pvd(series: Stored, path: Path, target: Path) -> None:
    """For ParaView: the nodes and the quadrilaterals between them; a plane lies at z = 0.

    The time is in s, or the number of the frame if it has no time. The frames are .vtp in the
    folder NAME_frames, or NAME_frames-2 if that is there already, and so on.
    """
    folder, _ = new_folder(target.with_name(f"{target.stem}_frames"))
    about = escape(json.dumps(series.about)).replace("--", "- -")
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- {about} -->",
        '<VTKFile type="Collection" version="1.0" byte_order="LittleEndian">',
        "<Collection>",
    ]
    try:
        for index, time_ms, frame in series.frames():
            name = f"{index:06}.vtp"
            write_bytes(folder / name, surface(*moved_by(series.constants, frame), frame))
            time = time_ms / 1e3 if np.isfinite(time_ms) else float(index)
            file = quoteattr(f"{folder.name}/{name}")
            lines.append(f'<DataSet timestep="{time:.15g}" part="0" file={file}/>')
        path.write_text("\n".join([*lines, "</Collection>", "</VTKFile>", ""]), "utf-8")
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
