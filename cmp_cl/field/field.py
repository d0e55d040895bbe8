"""Displacement and strain of the nodes, and their files: single fields and whole recordings."""

import base64
import contextlib
import dataclasses
import io
import math
import shutil
import struct
import zipfile
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmp_cl.errors import ConfigError, FieldError
from cmp_cl.files import check_target, whole_file, write_bytes
from cmp_cl.grid.grid import NodeStatus
from cmp_cl.media import write_csv
from cmp_cl.stereo.points import Points3D, PointStatus, largest_deviation

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class DisplacementField:
    """Where each node was at rest, and how far it has moved.

    position: (R, C, 3) float64, at rest, in `unit`, in the frame of the left camera; NaN
        unless the node is valid.
    displacement: (R, C, 3) float64, in `unit`, NaN unless the node is valid.
    sigma: (R, C) float64, standard deviation of the displacement along its most uncertain
        axis, in `unit`; NaN where unknown.
    status: (R, C) uint8 of `PointStatus`, of now; of rest where that one is not valid.
    source: (R, C) uint8 of `NodeStatus`, of the two moments the less direct one.
    strain: (R, C, 3) float64, Green-Lagrange strain E11, E22, E12 in the tangent plane of
        the rest surface, axis 1 along the rows; NaN where too few neighbours are valid;
        None where it was not asked for (`with_strain`).
    unit: name of the unit of length.
    """

    position: NDArray[np.float64]
    displacement: NDArray[np.float64]
    sigma: NDArray[np.float64]
    status: NDArray[np.uint8]
    source: NDArray[np.uint8]
    strain: NDArray[np.float64] | None
    unit: str

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(R, C), where there is a displacement."""
        return np.equal(self.status, PointStatus.VALID)

    def with_strain(self, radius: int = 2) -> "DisplacementField":
        """The same field with its in-plane strain, smoothed over 2 radius + 1 nodes a side.

        See `cmp_cl.field.green_lagrange`. Raises ConfigError where radius is not 1 to 50.
        """
        strain = green_lagrange(self.position, self.position + self.displacement, radius=radius)
        return dataclasses.replace(self, strain=strain)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the field as .npz, .csv, .ply or .vtp, by suffix, whole or not at all.

        Raises ConfigError on another suffix, OSError where the file cannot be written.
        """
        save(self, path)


def displacement(rest: Points3D, now: Points3D) -> DisplacementField:
    """How far each node has moved: now - rest per index, whatever lies between.

    The standard deviations of both moments are taken as independent.

    Raises FieldError where the shapes or the units differ.
    """
    if rest.status.shape != now.status.shape or rest.unit != now.unit:
        raise FieldError(
            f"rest has {rest.status.shape} nodes in {rest.unit}, "
            f"now has {now.status.shape} in {now.unit}"
        )
    status = np.where(now.valid, rest.status, now.status)
    valid = status == PointStatus.VALID
    source = np.maximum(rest.source, now.source)
    source[(rest.source == NodeStatus.MISSING) | (now.source == NodeStatus.MISSING)] = (
        NodeStatus.MISSING
    )
    return DisplacementField(
        position=np.where(valid[..., None], rest.xyz, np.nan),
        displacement=np.where(valid[..., None], now.xyz - rest.xyz, np.nan),
        sigma=np.where(valid, largest_deviation(rest.covariance + now.covariance), np.nan),
        status=status,
        source=source,
        strain=None,
        unit=rest.unit,
    )


def green_lagrange(rest: Array, now: Array, *, radius: int = 2) -> Array:
    """Green-Lagrange strain of a surface in its tangent plane at rest.

    rest, now: (R, C, 3) positions of the same nodes, NaN where missing. Around each node a
    plane in (column, row) is fitted to both by least squares, over the valid ones of the
    (2 radius + 1)^2 nodes, to give the tangent vectors A = (a1, a2) at rest and B now. In the
    orthonormal basis of the rest plane, axis 1 along a1 and axis 2 towards a2, with
    A = Q U: E = (U^-T B^T B U^-1 - I) / 2. Turning or shifting the surface gives 0.

    Returns (R, C, 3) E11, E22, E12 (half the engineering shear); NaN where the node is
    missing, or fewer than 6 of the window are there, or all of those on a line.

    Raises ConfigError where radius is not a whole number from 1 to 50.
    """
    if type(radius) is not int or not 1 <= radius <= 50:
        raise ConfigError(f"radius must be a whole number from 1 to 50, not {radius!r}")
    both = np.concatenate([rest, now], axis=2)
    valid = ~np.isnan(both).any(axis=2)
    tangents = _tangents(np.where(valid[..., None], both, 0), valid, radius)
    strain = np.full((*valid.shape, 3), np.nan)
    area = np.linalg.norm(np.cross(tangents[..., 0, :3], tangents[..., 1, :3]), axis=-1)
    good = valid & (area > 1e-9 * np.square(tangents[..., :3]).sum(axis=(2, 3)))
    first, second = tangents[good, :, :3], tangents[good, :, 3:]
    metric = first @ first.transpose(0, 2, 1)
    deformed = second @ second.transpose(0, 2, 1)
    lower = np.linalg.cholesky(metric)
    inverse = np.linalg.inv(lower)
    relative = inverse @ deformed @ inverse.transpose(0, 2, 1)
    strain[good, 0] = (relative[:, 0, 0] - 1) / 2
    strain[good, 1] = (relative[:, 1, 1] - 1) / 2
    strain[good, 2] = relative[:, 0, 1] / 2
    return strain


def _tangents(values: Array, valid: NDArray[np.bool_], radius: int) -> Array:
    """Slopes of the local plane by column and by row: (R, C, K) -> (R, C, 2, K), NaN if none."""
    rows, columns = valid.shape
    sums = np.zeros((rows, columns, 3, values.shape[2]))  # of 1, c, r times the values
    moments = np.zeros((rows, columns, 3, 3))
    pad = ((radius, radius), (radius, radius))
    weights = np.pad(valid.astype(np.float64), pad)
    padded = np.pad(values, (*pad, (0, 0)))
    for row in range(2 * radius + 1):
        for column in range(2 * radius + 1):
            at = slice(row, row + rows), slice(column, column + columns)
            basis = np.array([1.0, column - radius, row - radius])
            sums += basis[:, None] * padded[at][:, :, None]
            moments += np.outer(basis, basis) * weights[at][:, :, None, None]
    solvable = (moments[..., 0, 0] >= 6) & (np.linalg.det(moments) > 1e-6)
    slopes = np.full((rows, columns, 2, values.shape[2]), np.nan)
    slopes[solvable] = np.linalg.solve(moments[solvable], sums[solvable])[:, 1:]
    return slopes


def save(field: DisplacementField, path: str | PathLike[str]) -> None:
    """Write a field by suffix, whole or not at all; positions are those at rest.

    .npz: the arrays of the field under their names, for numpy.load.
    .csv: a row per node, the unit in the header, nan where missing.
    .ply: the valid nodes and the quadrilaterals between them, little-endian.
    .vtp: the same for VTK and ParaView; "Warp By Vector" shows the surface as it is now.

    Raises ConfigError on another suffix, OSError where the file cannot be written.
    """
    writers = {".npz": _save_npz, ".csv": _save_csv, ".ply": _save_ply, ".vtp": _save_vtp}
    suffix = Path(path).suffix.lower()
    if suffix not in writers:
        raise ConfigError(f"{str(path)!r}: the suffix must be one of {', '.join(writers)}")
    writers[suffix](field, path)


def _save_npz(field: DisplacementField, path: str | PathLike[str]) -> None:
    arrays: dict[str, Any] = {
        "position": field.position,
        "displacement": field.displacement,
        "sigma": field.sigma,
        "status": field.status,
        "source": field.source,
        "unit": np.array(field.unit),
    }
    if field.strain is not None:
        arrays["strain"] = field.strain
    with whole_file(path) as file:
        np.savez(file, **arrays)


def _save_csv(field: DisplacementField, path: str | PathLike[str]) -> None:
    lengths = ("x", "y", "z", "ux", "uy", "uz", "sigma")
    columns = ["row", "column", *(f"{name}_{field.unit}" for name in lengths), "status", "source"]
    arrays = [field.position, field.displacement, field.sigma[..., None]]
    if field.strain is not None:
        columns += ["e11", "e22", "e12"]
        arrays.append(field.strain)
    numbers = np.concatenate(arrays, axis=2)
    rows = (
        [
            *(row, column, *(float(number) for number in numbers[row, column, :7])),
            PointStatus(int(field.status[row, column])).name,
            NodeStatus(int(field.source[row, column])).name,
            *(float(number) for number in numbers[row, column, 7:]),
        ]
        for row, column in np.ndindex(field.status.shape)
    )
    write_csv(path, columns, rows)


def mesh(field: DisplacementField) -> tuple[dict[str, NDArray[Any]], NDArray[np.int32]]:
    """Columns of the valid nodes, and the quadrilaterals between them, (Q, 4) numbers of nodes."""
    valid = field.valid
    row, column = np.nonzero(valid)
    columns: dict[str, NDArray[Any]] = {
        "position": field.position[valid],
        "displacement": field.displacement[valid],
        "sigma": field.sigma[valid],
        "row": row.astype(np.int32),
        "column": column.astype(np.int32),
        "source": field.source[valid].astype(np.int32),
    }
    if field.strain is not None:
        columns["strain"] = field.strain[valid]
    number = np.full(valid.shape, -1, np.int32)
    number[valid] = np.arange(len(row))
    corners = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    quads = np.stack(corners, axis=-1).reshape(-1, 4)
    return columns, quads[(quads >= 0).all(axis=1)]


def _save_ply(field: DisplacementField, path: str | PathLike[str]) -> None:
    columns, quads = mesh(field)
    names = {"position": "x y z", "displacement": "ux uy uz", "strain": "e11 e22 e12"}
    properties = [
        (name, values.dtype.kind == "i")
        for key, values in columns.items()
        for name in names.get(key, key).split()
    ]
    vertices = np.empty(
        len(columns["row"]), [(name, "<i4" if whole else "<f8") for name, whole in properties]
    )
    for key, values in columns.items():
        for name, column in zip(names.get(key, key).split(), np.atleast_2d(values.T), strict=True):
            vertices[name] = column
    faces = np.empty(len(quads), [("count", "u1"), ("nodes", "<i4", 4)])
    faces["count"], faces["nodes"] = 4, quads
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment lengths in {field.unit}",
        f"element vertex {len(vertices)}",
        *(f"property {'int' if whole else 'double'} {name}" for name, whole in properties),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    text = "\n".join(header) + "\n"
    write_bytes(path, text.encode() + vertices.tobytes() + faces.tobytes())


def _save_vtp(field: DisplacementField, path: str | PathLike[str]) -> None:
    columns, quads = mesh(field)
    position = columns.pop("position")
    data = "".join(_vtk_array(name, values) for name, values in columns.items())
    text = f"""<?xml version="1.0"?>
<!-- lengths in {field.unit} -->
<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<PolyData>
<Piece NumberOfPoints="{len(position)}" NumberOfVerts="0" NumberOfLines="0" NumberOfStrips="0" \
NumberOfPolys="{len(quads)}">
<PointData Vectors="displacement">
{data}</PointData>
<Points>
{_vtk_array("Points", position)}</Points>
<Polys>
{_vtk_array("connectivity", quads.reshape(-1))}\
{_vtk_array("offsets", np.arange(4, 4 * len(quads) + 1, 4, dtype=np.int32))}</Polys>
</Piece>
</PolyData>
</VTKFile>
"""
    write_bytes(path, text.encode("utf-8"))


def _vtk_array(name: str, values: NDArray[Any]) -> str:
    kind, dtype = ("Int32", "<i4") if values.dtype.kind == "i" else ("Float64", "<f8")
    width = values.shape[1] if values.ndim == 2 else 1
    raw = values.astype(dtype).tobytes()
    body = base64.b64encode(struct.pack("<Q", len(raw)) + raw).decode("ascii")
    return (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{width}" format="binary">'
        f"\n{body}\n</DataArray>\n"
    )


class SeriesWriter:
    """Writes a recording, frame by frame, to one .npz; memory does not grow with it.

    The file holds `index` (F,) int64, `time_ms` (F,) float64, every array that `append` gets
    stacked along a first axis of F frames, and the constants (rest positions, unit) as they
    are; numpy.load reads it. It appears when the `with` block ends, also by an exception or
    Ctrl-C: then with the frames so far. Until then they lie beside it in the folder NAME.parts,
    an .npy for each array that numpy.load reads, so there must be room for two copies. Where
    there is not, or the process is killed, that folder stays; the OSError names it.

        with SeriesWriter("press.npz", rest=rest.xyz, unit="mm") as series:
            series.append(index=i, time_ms=t, displacement=field.displacement)

    Raises OSError where the folder is missing or not writable.
    """

    def __init__(self, path: str | PathLike[str], **constants: ArrayLike) -> None:
        self._path = check_target(path)
        self._constants = {name: np.asarray(value) for name, value in constants.items()}
        self._files = contextlib.ExitStack()
        self._folder = _made_folder(self._path)
        self._open = True
        self._count = 0
        self._columns: dict[str, _Column] = {}
        try:
            for name, constant in self._constants.items():
                np.save(self._folder / f"{name}.npy", constant, allow_pickle=False)
            self._add_column("index", (), np.dtype(np.int64))
            self._add_column("time_ms", (), np.dtype(np.float64))
        except BaseException:
            self._remove()
            raise

    def __len__(self) -> int:
        """Frames so far."""
        return self._count

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def append(self, *, index: int, time_ms: float, **arrays: ArrayLike) -> None:
        """Add a frame: its number, its time stamp in ms, and its arrays.

        Raises FieldError where the names, shapes or types differ from the first frame's, a
        name is one of the constants', or the series is closed, OSError where the disk is full;
        then nothing is added.
        """
        if not self._open:
            raise FieldError("the series is closed")
        frame = {name: np.asarray(value) for name, value in arrays.items()}
        self._check(frame)
        if not self._count:
            for name, value in frame.items():
                self._add_column(name, value.shape, value.dtype)
        frame["index"] = np.asarray(index, np.int64)
        frame["time_ms"] = np.asarray(time_ms, np.float64)
        try:
            for name, value in frame.items():
                self._columns[name].write(self._count, value)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self._path)) from error
        self._count += 1

    def _check(self, frame: Mapping[str, NDArray[Any]]) -> None:
        came = {name: (value.shape, value.dtype.str) for name, value in frame.items()}
        wanted = {
            name: (column.shape, column.dtype.str)
            for name, column in self._columns.items()
            if name not in ("index", "time_ms")
        }
        if self._count and came != wanted:
            raise FieldError(f"the first frame had {wanted}, this one has {came}")
        taken = sorted(came.keys() & self._constants.keys())
        if taken:
            raise FieldError(f"the series already has constants of the names {taken}")
        for name, value in frame.items():
            if value.dtype.hasobject:
                raise FieldError(f"{name} must be an array of numbers, not of {value.dtype}")

    def _add_column(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        # without a buffer, which would keep the bytes that a full disk has refused; anew where
        # the first frame was interrupted
        file = open(self._folder / f"{name}.npy", "w+b", buffering=0)  # noqa: SIM115, closed by _files
        self._columns[name] = _Column(self._files.enter_context(file), shape, dtype)

    def close(self) -> None:
        """Write the file; closing again does nothing. Raises OSError."""
        if not self._open:
            return
        self._open = False
        try:
            with self._files:
                self._write()
        except OSError as error:
            what = "1 frame" if self._count == 1 else f"{self._count} frames"
            raise OSError(
                error.errno,
                f"{error.strerror}; what was added, {what}, is in the folder "
                f"{str(self._folder)!r}, an .npy file for each array",
                str(self._path),
            ) from error
        self._remove()

    def _write(self) -> None:
        with whole_file(self._path, durable=True) as file, zipfile.ZipFile(file, "w") as archive:
            for name, value in self._constants.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, value, allow_pickle=False)
            for name, column in self._columns.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    column.copy(self._count, member)

    def _remove(self) -> None:
        self._files.close()
        shutil.rmtree(self._folder, ignore_errors=True)


def _made_folder(path: Path) -> Path:
    """A new folder for the arrays of a series: NAME.parts, or with a number where it is there."""
    folder = path.with_name(f"{path.name}.parts")
    number = 1
    while True:
        try:
            folder.mkdir()
            return folder
        except FileExistsError:
            number += 1
            folder = path.with_name(f"{path.name}.parts-{number}")
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(path)) from error


class _Column:
    """The frames of one array so far: an .npy file that grows."""

    def __init__(self, file: io.FileIO, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.file = file
        self.shape = shape
        self.dtype = dtype
        self._write_at(0, self._header(0))

    def write(self, frame: int, value: NDArray[np.generic]) -> None:
        """Write a frame in its place, also over one that was interrupted."""
        header = self._header(frame + 1)
        self._write_at(len(header) + frame * value.nbytes, value.tobytes())
        self._write_at(0, header)

    def copy(self, frames: int, target: IO[bytes]) -> None:
        """Write the first frames as one .npy."""
        header = self._header(frames)
        self._write_at(0, header)
        self.file.truncate(len(header) + frames * self.dtype.itemsize * math.prod(self.shape))
        self.file.seek(0)
        shutil.copyfileobj(self.file, target, 1 << 20)

    def _header(self, frames: int) -> bytes:
        """The header of an .npy of that many frames; NumPy makes it as long for any number."""
        header = io.BytesIO()
        np.lib.format.write_array_header_2_0(
            header,
            {
                "descr": np.lib.format.dtype_to_descr(self.dtype),
                "fortran_order": False,
                "shape": (frames, *self.shape),
            },
        )
        return header.getvalue()

    def _write_at(self, place: int, data: bytes) -> None:
        self.file.seek(place)
        rest = memoryview(data)
        while rest:  # a nearly full disk takes a part of it
            rest = rest[self.file.write(rest) :]
