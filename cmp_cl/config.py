"""The settings of a detector: frozen dataclasses, checked when made, read from and written to TOML.

Section numbers in the docstrings are those of docs/algorithm.md.
"""

import dataclasses
import enum
import math
from collections.abc import Mapping
from os import PathLike
from typing import Any, Self, TypeVar

import numpy as np

from cmp_cl.errors import ConfigError, check_range
from cmp_cl.files import check_path, read_toml, write_text
from cmp_cl.image import check_dtype

Part = TypeVar("Part")


class Fit(enum.Enum):
    """How `Midlines` fits the centreline of a black sector."""

    LINEAR = "linear"
    QUADRATIC = "quadratic"


@dataclasses.dataclass(frozen=True, kw_only=True)
class AdaptiveMean:
    """Binarization against the mean of a window (section 1).

    window: side of the square window, px, odd, 3 to 255.
    offset: C, grey levels of the image as given, 0 to 65535; black iff I + C < mean.
    """

    window: int = 21
    offset: int = 0

    def __post_init__(self) -> None:
        check_range("AdaptiveMean.window", self.window, 3, 255, kind=int, odd=True)
        check_range("AdaptiveMean.offset", self.offset, 0, 65535, kind=int)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RapidCriteria:
    """The four integer criteria (section 3a, Eqs. 18 to 23), each with a strict bound.

    sector_threshold: bound of the sector difference d2, 1 to 16; also sets the response.
    ring_threshold: bound of the number of differing ring samples, 1 to 17.
    corrosion_threshold: bound of Cd, -4 to 17; None leaves the criterion out.
    """

    sector_threshold: int = 5
    ring_threshold: int = 5
    corrosion_threshold: int | None = 6

    def __post_init__(self) -> None:
        check_range("RapidCriteria.sector_threshold", self.sector_threshold, 1, 16, kind=int)
        check_range("RapidCriteria.ring_threshold", self.ring_threshold, 1, 17, kind=int)
        _check_corrosion("RapidCriteria", self.corrosion_threshold)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SpectralCriteria:
    """The four spectral criteria (section 3b, Eqs. 13 and 17).

    correlation: bound of the normalised circular cross-correlation, 0 to 1, strict.
    phase: bound of the shift between the rings, rad, 0 to pi, strict.
    corrosion_threshold: bound of Cd, -4 to 17; None leaves the criterion out.
    """

    correlation: float = 0.75
    phase: float = math.radians(20)
    corrosion_threshold: int | None = 6

    def __post_init__(self) -> None:
        check_range("SpectralCriteria.correlation", self.correlation, 0, 1)
        check_range("SpectralCriteria.phase", self.phase, 0, math.pi)
        _check_corrosion("SpectralCriteria", self.corrosion_threshold)


def _check_corrosion(part: str, value: object) -> None:
    if value is not None:
        check_range(f"{part}.corrosion_threshold", value, -4, 17, kind=int)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SectorContrast:
    """The contrast gate (section 4).

    minimum: least contrast of a candidate, in 1/255 of full scale, 0 to 255.
    relative: least contrast as a share of the 90th percentile of the frame, 0 to 1.
    noise: least difference of the sector means, standard deviations of the noise, 0 to 100.
    """

    minimum: float = 20
    relative: float = 0.2
    noise: float = 2.5

    def __post_init__(self) -> None:
        check_range("SectorContrast.minimum", self.minimum, 0, 255)
        check_range("SectorContrast.relative", self.relative, 0, 1)
        check_range("SectorContrast.noise", self.noise, 0, 100)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RingHarmonic:
    """Corners by the second harmonic of the grey levels on a ring of eight samples.

    The rule has no binary image and needs no cell size.

    noise: least response of a corner, standard deviations of the noise, 0 to 100; cells
        squeezed under 6 px need twice that.
    relative: least response of a corner as a share of the reference response of the frame, 0 to 1.
        Half of it is enough if the response is at least 3/4 of the length of the second harmonic;
        the share for squeezed cells is 5/3 as large.
    fine: whether a ring of 3 px searches for cells squeezed under 6 px.
    octaves: how often the frame is halved at most, 0 to 3, to find corners whose squares ink, light
        or blur joins or parts; a shorter side of a halved frame has at least 48 px. With 0, cells
        under 20 px lose nothing.
    """

    noise: float = 2.0
    relative: float = 0.1875
    fine: bool = True
    octaves: int = 3

    def __post_init__(self) -> None:
        check_range("RingHarmonic.noise", self.noise, 0, 100)
        check_range("RingHarmonic.relative", self.relative, 0, 1)
        if type(self.fine) is not bool:
            raise ConfigError(f"RingHarmonic.fine must be True or False, not {self.fine!r}")
        check_range("RingHarmonic.octaves", self.octaves, 0, 3, kind=int)

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
class BinaryRings:
    """Corners by the paper's criteria on a binary image.

    threshold: binarization.
    outer_radius: radius of the outer ring, 5 px, or 4 px for cells under 12 px.
    criteria: the rapid or the spectral form.
    contrast: the contrast gate, or None.
    """

    threshold: AdaptiveMean = AdaptiveMean()
    outer_radius: int = 5
    criteria: RapidCriteria | SpectralCriteria = RapidCriteria()
    contrast: SectorContrast | None = SectorContrast()

    def __post_init__(self) -> None:
        _check_part("BinaryRings", "threshold", self.threshold, AdaptiveMean)
        _check_part("BinaryRings", "criteria", self.criteria, RapidCriteria, SpectralCriteria)
        _check_part("BinaryRings", "contrast", self.contrast, SectorContrast, type(None))
        if type(self.outer_radius) is not int or self.outer_radius not in (4, 5):
            raise ConfigError(f"BinaryRings.outer_radius must be 4 or 5, not {self.outer_radius!r}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class EdgeLines:
    """Refinement by the intersection of the two edge lines (section 6, EDGE_LINES).

    max_shift: largest distance from the rounded centroid, px, 0 to 5.
    """

    max_shift: float = 2.0

    def __post_init__(self) -> None:
        check_range("EdgeLines.max_shift", self.max_shift, 0, 5)


@dataclasses.dataclass(frozen=True, kw_only=True)
class EdgeStep:
    """EDGE_LINES, then one least-squares step of a corner model in uneven light (section 6,
    EDGE_STEP).

    cell: side of a cell, px, 4 to 1000; the model is fitted within a radius of min(9, max(4.5, 0.75
        cell)) px. The default is for cells of unknown side: its radius of 6.45 px reaches only the
        next edges of cells of 6 px. On wider cells its errors are up to a fifth larger than with
        the right size.
    """

    cell: float = 8.6

    def __post_init__(self) -> None:
        check_range("EdgeStep.cell", self.cell, 4, 1000)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Midlines:
    """Refinement by the centrelines of the black sectors (section 6, MIDLINE and CUSP).

    fit: straight or quadratic centrelines.
    max_shift: largest distance from the rounded centroid, px, 0 to 5.
    """

    fit: Fit = Fit.LINEAR
    max_shift: float = 2.0

    def __post_init__(self) -> None:
        if not isinstance(self.fit, Fit):
            raise ConfigError(f"Midlines.fit must be Fit.LINEAR or Fit.QUADRATIC, not {self.fit!r}")
        check_range("Midlines.max_shift", self.max_shift, 0, 5)


_TABLE_2_WINDOWS = {20: 41, 30: 31, 40: 21}
_WIDE_CELL = 20  # px; wider cells are not squeezed under 6 px
_PARTS: dict[str, dict[str, type]] = {  # of each field that has parts, by the key `kind`
    "detection": {"ring_harmonic": RingHarmonic, "binary_rings": BinaryRings},
    "threshold": {"adaptive_mean": AdaptiveMean},
    "criteria": {"rapid": RapidCriteria, "spectral": SpectralCriteria},
    "contrast": {"sector_contrast": SectorContrast},
    "refinement": {"edge_step": EdgeStep, "edge_lines": EdgeLines, "midlines": Midlines},
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class DetectorConfig:
    """All settings that decide which corners are found in an image.

    detection: the detection rule, RingHarmonic or BinaryRings.
    nms_radius: radius of the window of non-maximum suppression, px, 1 to 15.
    refinement: EdgeStep, EdgeLines or Midlines, or None for centroids.
    scale: working scale (0.05 to 4), or None for the image at full size.
    full_scale: largest grey level of the camera (1 to 65535); None means 255 for
        uint8 and 65535 for uint16.
    max_corners: initial capacity of the list of corners, 1 to 2**26; it grows.
    """

    detection: RingHarmonic | BinaryRings = RingHarmonic()
    nms_radius: int = 3
    refinement: EdgeStep | EdgeLines | Midlines | None = EdgeStep()
    scale: float | None = None
    full_scale: int | None = None
    max_corners: int = 65536

    def __post_init__(self) -> None:
        part = "DetectorConfig"
        _check_part(part, "detection", self.detection, RingHarmonic, BinaryRings)
        _check_part(part, "refinement", self.refinement, EdgeStep, EdgeLines, Midlines, type(None))
        check_range(f"{part}.nms_radius", self.nms_radius, 1, 15, kind=int)
        if self.scale is not None:
            check_range(f"{part}.scale", self.scale, 0.05, 4)
            octaves = isinstance(self.detection, RingHarmonic) and self.detection.octaves
            if octaves and self.scale != 1:
                raise ConfigError(
                    f"{part}.scale is for BinaryRings, or for RingHarmonic(octaves=0): octaves see "
                    f"cells of every size, not {self.scale!r}"
                )
        if self.full_scale is not None:
            check_range(f"{part}.full_scale", self.full_scale, 1, 65535, kind=int)
        check_range(f"{part}.max_corners", self.max_corners, 1, 2**26, kind=int)

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
        """Return a copy with some fields changed; raises ConfigError on an unknown name."""
        names = [field.name for field in dataclasses.fields(self)]
        for name in changes:
            if name not in names:
                raise ConfigError(
                    f"DetectorConfig has no field {name!r}; it has {', '.join(names)}"
                )
        return dataclasses.replace(self, **changes)

    def grey_levels(self, dtype: Any) -> int:
        """Return the largest grey level of an image of that dtype, uint8 or uint16.

        Raises ImageError for any other.
        """
        known = check_dtype(dtype)
        return int(np.iinfo(known).max) if self.full_scale is None else self.full_scale

    def save(self, path: str | PathLike[str]) -> None:
        """Write the configuration as TOML, whole or not at all; raises OSError."""
        write_text(path, to_toml(self))

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read a configuration from TOML; keys that are absent keep their defaults.

        Raises ConfigError if the file cannot be read, is not TOML, or has an unknown
        key or a value outside its range.
        """
        check_path(path, ConfigError)
        try:
            data = read_toml(path)
        except OSError as error:
            why = error.strerror
            raise ConfigError(f"cannot read the configuration {str(path)!r}: {why}") from error
        except ValueError as error:
            raise ConfigError(f"cannot read the configuration {str(path)!r}: {error}") from error
        try:
            return _made("configuration", data, cls)
        except ValueError as error:
            raise ConfigError(f"{path}: {error}") from error


def _check_part(part: str, field: str, value: object, *kinds: type) -> None:
    if not isinstance(value, kinds):
        names = " or ".join("None" if kind is type(None) else kind.__name__ for kind in kinds)
        raise ConfigError(f"{part}.{field} must be {names}, not {value!r}")


def _known(data: Mapping[str, Any], kind: type) -> dict[str, Any]:
    """Return the entries of a TOML table as field values; false means None unless the field is a
    bool."""
    types = {field.name: field.type for field in dataclasses.fields(kind)}
    for key in data:
        if key not in types:
            raise ConfigError(f"unknown key {key!r} for {kind.__name__}; known: {', '.join(types)}")
    return {
        key: None if value is False and types[key] is not bool else value
        for key, value in data.items()
    }


def _part(field: str, value: object) -> Any:
    """Return the part that a table describes, None for false; of several kinds of a field, the key
    `kind` names one."""
    if value is None or value is False:
        return None
    kinds = _PARTS[field]
    choice = f" whose key kind is one of {list(kinds)}" if len(kinds) > 1 else ""
    table = dict(value) if isinstance(value, Mapping) else {}
    kind = table.pop("kind", None) if choice else next(iter(kinds))
    if not isinstance(value, Mapping) or kind not in list(kinds):
        raise ConfigError(f"{field} must be a table{choice}, not {value!r}")
    return _made(field, table, kinds[kind])


def _made(field: str, table: Mapping[str, Any], kind: type[Part]) -> Part:
    """Return the dataclass of a kind that a table of its fields describes."""
    values = {
        name: _part(name, value) if name in _PARTS else value
        for name, value in _known(table, kind).items()
    }
    if "fit" in values:
        fits = [fit.value for fit in Fit]
        if values["fit"] not in fits:
            raise ConfigError(f"Midlines.fit must be one of {fits}, not {values['fit']!r}")
        values["fit"] = Fit(values["fit"])
    try:
        return kind(**values)
    except TypeError as error:
        raise ConfigError(f"{field}: {error}") from error


def to_toml(config: DetectorConfig) -> str:
    """Return the configuration as TOML text; None is written as false."""
    return "\n".join(_table(config, "")) + "\n"


def _table(part: Any, name: str) -> list[str]:
    """Return the lines of a part: its values, then the tables of its own parts."""
    several = [kinds for kinds in _PARTS.values() if len(kinds) > 1]
    known = {made: kind for kinds in several for kind, made in kinds.items()}
    lines = [f'kind = "{known[type(part)]}"'] if type(part) in known else []
    tables: list[str] = []
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        if dataclasses.is_dataclass(value):
            inner = f"{name}.{field.name}" if name else field.name
            tables += [f"\n[{inner}]", *_table(value, inner)]
        else:
            lines.append(f"{field.name} = {_toml(value)}")
    return lines + tables


def _toml(value: object) -> str:
    if value is None:
        return "false"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Fit):
        return f'"{value.value}"'
    return repr(float(value)) if isinstance(value, float) else repr(value)
