"""The settings of a detector: frozen dataclasses, checked when made, read from and written to TOML.

Section numbers in the docstrings are those of docs/algorithm.md.
"""

import dataclasses
import enum
import json
import math
import re
import types
import typing
from collections.abc import Mapping
from os import PathLike
from typing import Annotated, Any, NamedTuple, Self, TypeVar

import numpy as np

from cmp_cl.errors import ConfigError, check_range
from cmp_cl.files import read_toml, write_text
from cmp_cl.image import check_dtype

Part = TypeVar("Part", bound="Settings")


class Fit(enum.Enum):
    """How `Midlines` fits the centreline of a black sector."""

    LINEAR = "linear"
    QUADRATIC = "quadratic"


class Range(NamedTuple):
    """The bounds of a number, both allowed."""

    low: float
    high: float
    odd: bool = False


class Settings:
    """A base of dataclasses whose fields are checked by their types.

    A field is a number with a `Range` or a pair of such numbers, a bool, an enumeration, or another
    such dataclass; it may be one of several of these, or None.
    """

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            name, value = f"{type(self).__name__}.{field.name}", getattr(self, field.name)
            kinds, limits = _kinds_of(field)
            if limits is not None and (value is not None or types.NoneType not in kinds):
                low, high, odd = limits
                kind = int if int in kinds else float
                for each in value if tuple in kinds else (value,):
                    check_range(name, each, low, high, kind=kind, odd=odd)
            elif limits is None and not isinstance(value, kinds):
                named = " or ".join(kind.__name__ for kind in kinds)
                raise ConfigError(f"{name} must be of type {named}, not {value!r}")


def _kinds_of(field: "dataclasses.Field[Any]") -> tuple[tuple[type, ...], Range | None]:
    """Return the types that a field may have, and the range of a number."""
    kind, limits = field.type, None
    if typing.get_origin(kind) is Annotated:
        kind, limits = typing.get_args(kind)
    if typing.get_origin(kind) is tuple:
        return (tuple, typing.get_args(kind)[0]), limits
    return typing.get_args(kind) or (typing.cast(type, kind),), limits


@dataclasses.dataclass(frozen=True, kw_only=True)
class AdaptiveMean(Settings):
    """Binarization against the mean of a window (section 3.1 of the paper).

    window: side of the square window, px, odd, 3 to 255.
    offset: C, grey levels of the image as given, 0 to 65535; black iff I + C < mean.
    """

    window: Annotated[int, Range(3, 255, odd=True)] = 21
    offset: Annotated[int, Range(0, 65535)] = 0


@dataclasses.dataclass(frozen=True, kw_only=True)
class RapidCriteria(Settings):
    """The four rapid criteria (section 3.4, Eqs. 18 to 23), each with a strict bound.

    sector_threshold: bound of the sector difference d2, 1 to 16; also sets the response.
    ring_threshold: bound of the number of differing ring samples, 1 to 17.
    corrosion_threshold: bound of Cd, -4 to 17; None leaves the criterion out.
    """

    sector_threshold: Annotated[int, Range(1, 16)] = 5
    ring_threshold: Annotated[int, Range(1, 17)] = 5
    corrosion_threshold: Annotated[int | None, Range(-4, 17)] = 6


@dataclasses.dataclass(frozen=True, kw_only=True)
class SpectralCriteria(Settings):
    """The spectral criteria (section 3.3, Eqs. 13 and 17).

    correlation: bound of the normalised circular cross-correlation, 0 to 1, strict.
    phase: bound of the shift between the rings, rad, 0 to pi, strict.
    corrosion_threshold: bound of Cd, -4 to 17; None leaves the criterion out.
    """

    correlation: Annotated[float, Range(0, 1)] = 0.75
    phase: Annotated[float, Range(0, math.pi)] = math.radians(20)
    corrosion_threshold: Annotated[int | None, Range(-4, 17)] = 6


@dataclasses.dataclass(frozen=True, kw_only=True)
class SectorContrast(Settings):
    """The contrast gate, which the paper does not have.

    minimum: least contrast of a candidate, in 1/255 of full scale, 0 to 255.
    relative: least contrast as a share of the 90th percentile of the frame, 0 to 1.
    noise: least difference of the sector means, standard deviations of the noise, 0 to 100.
    """

    minimum: Annotated[float, Range(0, 255)] = 20
    relative: Annotated[float, Range(0, 1)] = 0.2
    noise: Annotated[float, Range(0, 100)] = 2.5


@dataclasses.dataclass(frozen=True, kw_only=True)
class RingHarmonic(Settings):
    """Corners by the second harmonic of the grey levels on a ring of eight samples.

    The rule has no binary image and needs no cell size.

    noise: least response of a corner, standard deviations of the noise, 0 to 100; cells
        squeezed under 6 px need twice that.
    relative: least response of a corner as a share of the reference response of the frame, 0 to 1.
        Half of it is enough if the response is at least 3/4 of the length of the second harmonic,
        a quarter if it is a fifth of the grey levels on the ring; the share for squeezed cells is
        5/3 as large.
    fine: whether a ring of 3 px searches for cells squeezed under 6 px.
    octaves: how often the frame is halved at most, 0 to 3, to find corners whose squares ink, light
        or blur joins or parts; a shorter side of a halved frame has at least 48 px. With 0, cells
        under 20 px lose nothing.
    """

    noise: Annotated[float, Range(0, 100)] = 2.0
    relative: Annotated[float, Range(0, 1)] = 0.1875
    fine: bool = True
    octaves: Annotated[int, Range(0, 3)] = 3

    @property
    def coarse_noise(self) -> int:
        """Return the noise bound of the 5 px ring, in hundredths of the mean noise amplitude.

        334 of them are one standard deviation of the response.
        """
        return math.floor(334 * self.noise + 0.5)

    @property
    def coarse_share(self) -> int:
        """Return the least response of the 5 px ring, in 1/128 of the reference."""
        return math.floor(128 * self.relative + 0.5)

    @property
    def fine_share(self) -> int:
        """Return the least response of the 3 px ring, in 1/128 of the reference."""
        return (5 * self.coarse_share + 1) // 3


@dataclasses.dataclass(frozen=True, kw_only=True)
class BinaryRings(Settings):
    """Corners by the paper's criteria on a binary image.

    threshold: binarization.
    outer_radius: radius of the outer ring, px, 4 to 5; 4 is for cells under 12 px.
    criteria: the rapid or the spectral form.
    contrast: the contrast gate, or None.
    """

    threshold: AdaptiveMean = AdaptiveMean()
    outer_radius: Annotated[int, Range(4, 5)] = 5
    criteria: RapidCriteria | SpectralCriteria = RapidCriteria()
    contrast: SectorContrast | None = SectorContrast()


@dataclasses.dataclass(frozen=True, kw_only=True)
class EdgeLines(Settings):
    """Refinement by the intersection of the two edge lines (section 3.5, Fig. 9).

    max_shift: largest distance from the rounded centroid, px, 0 to 5.
    """

    max_shift: Annotated[float, Range(0, 5)] = 2.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class EdgeStep(Settings):
    """EDGE_LINES, then one least-squares step of a corner model in uneven light.

    cell: side of a cell, px, 4 to 1000; the model is fitted within a radius of min(9, max(4.5, 0.75
        cell)) px. The default is for cells of unknown side: its radius of 6.45 px reaches only the
        next edges of cells of 6 px. On wider cells its errors are up to a fifth larger than with
        the right size. Where edges bend, as in waves of a rolling shutter, a cell of 6 takes two
        fifths off the errors, and noise moves corners by a quarter more.
    """

    cell: Annotated[float, Range(4, 1000)] = 8.6


@dataclasses.dataclass(frozen=True, kw_only=True)
class Midlines(Settings):
    """The paper's refinement, by the centrelines of the black sectors (section 3.5, Fig. 9).

    fit: straight or quadratic centrelines.
    max_shift: largest distance from the rounded centroid, px, 0 to 5.
    """

    fit: Fit = Fit.LINEAR
    max_shift: Annotated[float, Range(0, 5)] = 2.0


_TABLE_2_WINDOWS = {20: 41, 30: 31, 40: 21}
_WIDE_CELL = 20  # px; wider cells are not squeezed under 6 px


@dataclasses.dataclass(frozen=True, kw_only=True)
class DetectorConfig(Settings):
    """All settings that decide which corners are found in an image.

    detection: the detection rule, RingHarmonic or BinaryRings.
    nms_radius: radius of the window of non-maximum suppression, px, 1 to 15.
    refinement: EdgeStep, EdgeLines or Midlines, or None for centroids.
    full_scale: largest grey level of the camera (1 to 65535); None means 255 for
        uint8 and 65535 for uint16.
    max_corners: initial capacity of the list of corners, 1 to 2**26; it grows.
    """

    detection: RingHarmonic | BinaryRings = RingHarmonic()
    nms_radius: Annotated[int, Range(1, 15)] = 3
    refinement: EdgeStep | EdgeLines | Midlines | None = EdgeStep()
    full_scale: Annotated[int | None, Range(1, 65535)] = None
    max_corners: Annotated[int, Range(1, 2**26)] = 65536

    @classmethod
    def for_cell(cls, cell: float) -> Self:
        """Leave out what cells of that side, px (4 to 1000), do not need.

        Cells under 20 px need no octaves, and wider ones no search for squeezed cells. The radius
        of the refinement is that of the cell. Raises ConfigError if the cell is out of range.
        """
        check_range("DetectorConfig.for_cell(cell)", cell, 4, 1000)
        small = bool(cell < _WIDE_CELL)
        octaves = 0 if small else RingHarmonic.octaves
        return cls(
            detection=RingHarmonic(fine=small, octaves=octaves), refinement=EdgeStep(cell=cell)
        )

    @classmethod
    def paper(cls, markers: int) -> Self:
        """Return the paper's method as printed, for 20, 30 or 40 markers a side (Table 2).

        Raises ConfigError for another number.
        """
        if type(markers) is not int or markers not in _TABLE_2_WINDOWS:
            raise ConfigError(
                f"the paper's Table 2 has 20, 30 or 40 markers a side, not {markers!r}"
            )
        rings = BinaryRings(
            threshold=AdaptiveMean(window=_TABLE_2_WINDOWS[markers]),
            criteria=RapidCriteria(corrosion_threshold=4),
            contrast=None,
        )
        return cls(detection=rings, refinement=Midlines())

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some fields changed; raises as the class does."""
        return dataclasses.replace(self, **changes)

    def grey_levels(self, dtype: Any) -> int:
        """Return the largest grey level of an image of that dtype, uint8 or uint16.

        Raises ImageError for any other.
        """
        known = check_dtype(dtype)
        return int(np.iinfo(known).max) if self.full_scale is None else self.full_scale

    def save(self, path: str | PathLike[str]) -> None:
        """Write the configuration as TOML, None as false, whole or not at all; raises OSError."""
        write_text(path, "\n".join(_table(self, "")) + "\n")

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read a configuration from TOML; keys that are absent keep their defaults.

        Raises ConfigError if the file cannot be read, is not TOML, or has an unknown
        key or a value outside its range.
        """
        try:
            return _made(read_toml(path), cls)
        except OSError as error:
            why = error.strerror
            raise ConfigError(f"cannot read the configuration {str(path)!r}: {why}") from error
        except ValueError as error:
            raise ConfigError(f"{path}: {error}") from error


def _made(table: Mapping[str, Any], kind: type[Part]) -> Part:
    """Return the settings of a kind that a table of TOML describes."""
    fields = {field.name: field for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    for key in table:
        if key not in fields:
            raise ConfigError(
                f"unknown key {key!r} for {kind.__name__}; known: {', '.join(fields)}"
            )
    return kind(**{key: _read(key, value, fields[key]) for key, value in table.items()})


def _read(name: str, value: object, field: "dataclasses.Field[Any]") -> object:
    """Return the value of a field: of TOML's, false is None unless the field is a bool, a text is
    a member of an enumeration, and a table makes a part; its key `kind` says which of several."""
    kinds, _ = _kinds_of(field)
    if value is False and bool not in kinds:
        return None
    parts = {_key(kind): kind for kind in kinds if issubclass(kind, Settings)}
    if not parts:
        return kinds[0](value) if issubclass(kinds[0], enum.Enum) else value
    choice = f" whose key kind is one of {list(parts)}" if len(parts) > 1 else ""
    table = dict(value) if isinstance(value, Mapping) else {}
    key = table.pop("kind", None) if choice else next(iter(parts))
    if not isinstance(value, Mapping) or key not in list(parts):
        raise ConfigError(f"{name} must be a table{choice}, not {value!r}")
    return _made(table, parts[key])


def _key(kind: type) -> str:
    """Return how TOML calls a kind of part: edge_step for EdgeStep, rapid for RapidCriteria."""
    return re.sub(r"\B([A-Z])", r"_\1", kind.__name__.removesuffix("Criteria")).lower()


def _table(part: Settings, name: str) -> list[str]:
    """Return the lines of TOML of a part: its values, then the tables of its own parts."""
    lines: list[str] = []
    tables: list[str] = []
    for field in dataclasses.fields(part):  # type: ignore[arg-type]
        value = getattr(part, field.name)
        if isinstance(value, Settings):
            inner = f"{name}.{field.name}".removeprefix(".")
            several = sum(issubclass(kind, Settings) for kind in _kinds_of(field)[0]) > 1
            tables += [f"\n[{inner}]"] + [f'kind = "{_key(type(value))}"'] * several
            tables += _table(value, inner)
        else:
            value = value.value if isinstance(value, enum.Enum) else value
            lines.append(f"{field.name} = {json.dumps(False if value is None else value)}")
    return lines + tables
