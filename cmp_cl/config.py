"""What a detector is told: frozen dataclasses, checked when made, TOML in and out.

Section numbers in the docstrings are those of the stages: 1 binarization, 3 criteria,
4 contrast gate, 5 non-maximum suppression, 6 refinement, 7 scale.
"""

import dataclasses
import enum
import math
from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any, Self, TypeVar

from cmp_cl.errors import ConfigError
from cmp_cl.files import read_toml, write_text

if TYPE_CHECKING:
    from cmp_cl.image import GreyImage


Part = TypeVar("Part")


class Fit(enum.Enum):
    """How `Midlines` fits the centreline of a black sector."""

    LINEAR = "linear"
    QUADRATIC = "quadratic"


def _check(
    part: str, field: str, value: object, low: float, high: float, *, kind: type, odd: bool = False
) -> None:
    """Raise ConfigError unless value is a number of that kind within [low, high]."""
    noun = "an odd integer" if odd else "an integer" if kind is int else "a number"
    expected = f"{part}.{field} must be {noun} in [{low:.10g}, {high:.10g}], not {value!r}"
    numeric = int if kind is int else (int, float)
    if isinstance(value, bool) or not isinstance(value, numeric):
        raise ConfigError(f"{expected} ({type(value).__name__})")
    if not low <= value <= high or (odd and value % 2 == 0):
        raise ConfigError(expected)


@dataclasses.dataclass(frozen=True, kw_only=True)
class AdaptiveMean:
    """Binarization against the mean of a window (section 1).

    window: side of the square window, px, odd, 3 to 255.
    offset: C, grey levels of the image as given, 0 to 65535; black iff I + C < mean.
    masks: 1, or 3 for the masks at mean and mean -+ sigma/2 (then offset must be 0).
    """

    window: int = 21
    offset: int = 0
    masks: int = 1

    def __post_init__(self) -> None:
        _check("AdaptiveMean", "window", self.window, 3, 255, kind=int, odd=True)
        _check("AdaptiveMean", "offset", self.offset, 0, 65535, kind=int)
        if type(self.masks) is not int or self.masks not in (1, 3):
            raise ConfigError(f"AdaptiveMean.masks must be 1 or 3, not {self.masks!r}")
        if self.masks == 3 and self.offset:
            raise ConfigError(
                f"AdaptiveMean.offset must be 0 with masks=3, not {self.offset!r}: "
                "the outer masks already move the threshold"
            )


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
        _check("RapidCriteria", "sector_threshold", self.sector_threshold, 1, 16, kind=int)
        _check("RapidCriteria", "ring_threshold", self.ring_threshold, 1, 17, kind=int)
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
        _check("SpectralCriteria", "correlation", self.correlation, 0, 1, kind=float)
        _check("SpectralCriteria", "phase", self.phase, 0, math.pi, kind=float)
        _check_corrosion("SpectralCriteria", self.corrosion_threshold)


def _check_corrosion(part: str, value: object) -> None:
    if value is not None:
        _check(part, "corrosion_threshold", value, -4, 17, kind=int)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SectorContrast:
    """The contrast gate (section 4).

    minimum: least contrast of a candidate, in 1/255 of full scale, 0 to 255.
    relative: least contrast as a share of the 90th percentile of the frame, 0 to 1.
    noise: least difference of the sector means, standard deviations of the noise, 0 to 100;
        with three masks at least 3 are asked for, whatever it says.
    """

    minimum: float = 20
    relative: float = 0.2
    noise: float = 2.5

    def __post_init__(self) -> None:
        _check("SectorContrast", "minimum", self.minimum, 0, 255, kind=float)
        _check("SectorContrast", "relative", self.relative, 0, 1, kind=float)
        _check("SectorContrast", "noise", self.noise, 0, 100, kind=float)


@dataclasses.dataclass(frozen=True, kw_only=True)
class EdgeLines:
    """Refinement by the intersection of the two edge lines (section 6, EDGE_LINES).

    max_shift: largest distance from the rounded centroid, px, 0 to 5.
    """

    max_shift: float = 2.0

    def __post_init__(self) -> None:
        _check("EdgeLines", "max_shift", self.max_shift, 0, 5, kind=float)


@dataclasses.dataclass(frozen=True, kw_only=True)
class EdgeStep:
    """EDGE_LINES, then one least-squares step of a corner model (section 6, EDGE_STEP).

    cell: side of a cell, px, 4 to 1000; the model sees min(9, max(4.5, 0.75 cell)) px around.
    sigma0: floor of the standard deviation of a position, px, 0 to 5: 0.025 for
        print, 0.2 for a worn gel.
    """

    cell: float = 12.0
    sigma0: float = 0.025

    def __post_init__(self) -> None:
        _check("EdgeStep", "cell", self.cell, 4, 1000, kind=float)
        _check("EdgeStep", "sigma0", self.sigma0, 0, 5, kind=float)


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
        _check("Midlines", "max_shift", self.max_shift, 0, 5, kind=float)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Pyramid:
    """Several working scales, of which the one with the nearest count wins (section 7).

    factors: scale factors, each 0.05 to 4, 1 to 32 of them.
    expected: number of corners that the pattern has, at least 1.
    """

    factors: tuple[float, ...]
    expected: int

    def __post_init__(self) -> None:
        if not isinstance(self.factors, tuple) or not 1 <= len(self.factors) <= _MOST_FACTORS:
            raise ConfigError(
                f"Pyramid.factors must be a tuple of 1 to {_MOST_FACTORS} factors, "
                f"not {self.factors!r}"
            )
        for factor in self.factors:
            _check("Pyramid", "factors", factor, 0.05, 4, kind=float)
        _check("Pyramid", "expected", self.expected, 1, 2**31 - 1, kind=int)


_MOST_FACTORS = 32
_TABLE_2_WINDOWS = {20: 41, 30: 31, 40: 21}
_CRITERIA: dict[str, type] = {"rapid": RapidCriteria, "spectral": SpectralCriteria}
_REFINEMENTS: dict[str, type] = {
    "edge_lines": EdgeLines,
    "edge_step": EdgeStep,
    "midlines": Midlines,
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class DetectorConfig:
    """Everything that decides which corners are found in an image.

    threshold: binarization.
    outer_radius: radius of the outer ring, 5 px, or 4 px for cells under 12 px.
    criteria: the rapid or the spectral form.
    contrast: the contrast gate, or None.
    nms_radius: radius of the window of non-maximum suppression, px, 1 to 15.
    refinement: EdgeLines, EdgeStep or Midlines, or None for centroids.
    scale: working scale (0.05 to 4), or Pyramid, or None for the image as it is.
    full_scale: largest grey level of the camera (1 to 65535); None means 255 for
        uint8 and 65535 for uint16.
    max_corners: room for corners at the start, 1 to 2**26; it grows.
    """

    threshold: AdaptiveMean = AdaptiveMean()
    outer_radius: int = 5
    criteria: RapidCriteria | SpectralCriteria = RapidCriteria()
    contrast: SectorContrast | None = SectorContrast()
    nms_radius: int = 3
    refinement: EdgeLines | EdgeStep | Midlines | None = EdgeLines()
    scale: float | Pyramid | None = None
    full_scale: int | None = None
    max_corners: int = 65536

    def __post_init__(self) -> None:
        _check_part("threshold", self.threshold, AdaptiveMean)
        _check_part("criteria", self.criteria, RapidCriteria, SpectralCriteria)
        _check_part("contrast", self.contrast, SectorContrast, type(None))
        _check_part("refinement", self.refinement, EdgeLines, EdgeStep, Midlines, type(None))
        if type(self.outer_radius) is not int or self.outer_radius not in (4, 5):
            raise ConfigError(
                f"DetectorConfig.outer_radius must be 4 or 5, not {self.outer_radius!r}"
            )
        _check("DetectorConfig", "nms_radius", self.nms_radius, 1, 15, kind=int)
        if not isinstance(self.scale, Pyramid) and self.scale is not None:
            _check("DetectorConfig", "scale", self.scale, 0.05, 4, kind=float)
        if self.full_scale is not None:
            _check("DetectorConfig", "full_scale", self.full_scale, 1, 65535, kind=int)
        _check("DetectorConfig", "max_corners", self.max_corners, 1, 2**26, kind=int)

    @classmethod
    def for_cell(cls, cell: float) -> Self:
        """The configuration for cells of that side, px (4 to 1000).

        The window is the odd number 2 floor(floor(1.3 cell) / 2) + 1 within 9..255; the
        outer radius is 4 under 12 px; above 16 px the image is scaled by 15 / cell, and
        the window is that of a 15 px cell. Raises ConfigError for another cell.
        """
        _check("DetectorConfig", "for_cell(cell)", cell, 4, 1000, kind=float)
        scale = max(15.0 / cell, 0.05) if cell > 16 else None
        working = cell if scale is None else cell * scale
        return cls(
            threshold=AdaptiveMean(window=window_for_cell(working)),
            outer_radius=4 if working < 12 else 5,
            scale=scale,
        )

    @classmethod
    def for_image(cls, image: "GreyImage") -> Self:
        """The configuration for the cell that `estimate_cell` finds in the image.

        Raises ImageError where the image is not (H, W) uint8 or uint16.
        """
        from cmp_cl.cell import estimate_cell

        return cls.for_cell(max(estimate_cell(image), 4))

    @classmethod
    def for_grid(cls, markers: int) -> Self:
        """The defaults with the paper's Table 2 window for 20, 30 or 40 markers a side.

        Raises ConfigError for another number.
        """
        return cls(threshold=AdaptiveMean(window=_table_2_window(markers)))

    @classmethod
    def paper(cls, markers: int) -> Self:
        """The paper's method as printed, for 20, 30 or 40 markers a side (Table 2).

        Raises ConfigError for another number.
        """
        return cls(
            threshold=AdaptiveMean(window=_table_2_window(markers)),
            criteria=RapidCriteria(corrosion_threshold=4),
            contrast=None,
            refinement=Midlines(),
        )

    def replace(self, **changes: Any) -> Self:
        """A copy with some fields changed; raises ConfigError on an unknown name."""
        names = [field.name for field in dataclasses.fields(self)]
        for name in changes:
            if name not in names:
                raise ConfigError(
                    f"DetectorConfig has no field {name!r}; it has {', '.join(names)}"
                )
        return dataclasses.replace(self, **changes)

    def grey_levels(self, dtype: Any) -> int:
        """The largest grey level of an image of that dtype."""
        if self.full_scale is not None:
            return self.full_scale
        return 255 if dtype == "uint8" else 65535

    def save(self, path: str | PathLike[str]) -> None:
        """Write the configuration as TOML, whole or not at all; raises OSError."""
        write_text(path, to_toml(self))

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read a configuration from TOML; keys that are absent keep their defaults.

        Raises ConfigError where the file cannot be read, is no TOML, or has an unknown
        key or a value outside its range.
        """
        try:
            data = read_toml(path)
        except OSError as error:
            why = error.strerror
            raise ConfigError(f"cannot read the configuration {str(path)!r}: {why}") from error
        except ValueError as error:
            raise ConfigError(f"cannot read the configuration {str(path)!r}: {error}") from error
        try:
            return cls._from_dict(data)
        except ValueError as error:
            raise ConfigError(f"{path}: {error}") from error

    @classmethod
    def _from_dict(cls, data: Mapping[str, Any]) -> Self:
        values = _known(data, cls)
        if "threshold" in values:
            values["threshold"] = _part("threshold", values["threshold"], AdaptiveMean)
        if "criteria" in values:
            values["criteria"] = _chosen("criteria", values["criteria"], _CRITERIA)
        if "contrast" in values:
            values["contrast"] = _part("contrast", values["contrast"], SectorContrast)
        if "refinement" in values:
            values["refinement"] = _chosen("refinement", values["refinement"], _REFINEMENTS)
        if isinstance(values.get("scale"), Mapping):
            values["scale"] = _part("scale", values["scale"], Pyramid)
        return cls(**values)


def window_for_cell(cell: float) -> int:
    """The window of binarization for a cell, both px: about 1.3 cells, odd, 9 to 255."""
    return min(max(2 * (math.floor(1.3 * cell) // 2) + 1, 9), 255)


def _table_2_window(markers: int) -> int:
    if type(markers) is not int or markers not in _TABLE_2_WINDOWS:
        raise ConfigError(f"the paper's Table 2 has 20, 30 or 40 markers a side, not {markers!r}")
    return _TABLE_2_WINDOWS[markers]


def _check_part(field: str, value: object, *kinds: type) -> None:
    if not isinstance(value, kinds):
        names = " or ".join("None" if kind is type(None) else kind.__name__ for kind in kinds)
        raise ConfigError(f"DetectorConfig.{field} must be {names}, not {value!r}")


def _known(data: Mapping[str, Any], kind: type) -> dict[str, Any]:
    """The entries of a TOML table as field values; false stands for None."""
    names = [field.name for field in dataclasses.fields(kind)]
    for key in data:
        if key not in names:
            raise ConfigError(f"unknown key {key!r} for {kind.__name__}; known: {', '.join(names)}")
    return {key: None if value is False else value for key, value in data.items()}


def _part(field: str, value: object, kind: type[Part]) -> Part | None:
    if value is None:
        return None
    if not isinstance(value, Mapping):
        raise ConfigError(f"{field} must be a table, not {value!r}")
    values = _known(value, kind)
    if isinstance(values.get("factors"), list):
        values["factors"] = tuple(values["factors"])
    if "fit" in values:
        fits = [fit.value for fit in Fit]
        if values["fit"] not in fits:
            raise ConfigError(f"Midlines.fit must be one of {fits}, not {values['fit']!r}")
        values["fit"] = Fit(values["fit"])
    try:
        return kind(**values)
    except TypeError as error:
        raise ConfigError(f"{field}: {error}") from error


def _chosen(field: str, value: object, kinds: Mapping[str, type[Part]]) -> Part | None:
    """A part that comes in several kinds, named by the key `kind`."""
    if value is None:
        return None
    if not isinstance(value, Mapping) or value.get("kind") not in list(kinds):
        raise ConfigError(
            f"{field} must be a table whose key kind is one of {list(kinds)}, not {value!r}"
        )
    rest = {key: entry for key, entry in value.items() if key != "kind"}
    return _part(field, rest, kinds[value["kind"]])


def to_toml(config: DetectorConfig) -> str:
    """The configuration as TOML text; None is written as false."""
    top: list[str] = []
    tables: list[str] = []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            tables.append(f"\n[{field.name}]")
            kinds = {**_CRITERIA, **_REFINEMENTS}
            tables += [f'kind = "{name}"' for name, kind in kinds.items() if type(value) is kind]
            tables += [
                f"{part.name} = {_toml(getattr(value, part.name))}"
                for part in dataclasses.fields(value)
            ]
        else:
            top.append(f"{field.name} = {_toml(value)}")
    return "\n".join(top + tables) + "\n"


def _toml(value: object) -> str:
    if value is None:
        return "false"
    if isinstance(value, Fit):
        return f'"{value.value}"'
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(entry) for entry in value) + "]"
    return repr(float(value)) if isinstance(value, float) else repr(value)
