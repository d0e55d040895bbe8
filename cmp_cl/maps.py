"""The intermediate images of a frame."""

import dataclasses

import numpy as np
from numpy.typing import NDArray


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Maps:
    """Every intermediate image of a frame with BinaryRings, each (H, W) unless said otherwise.

    Maps of stages that the configuration leaves out are None. With a working scale the maps have
    the size of the scaled image.

    binary: bool, True where black.
    inner, outer: uint16 ring bits, bit i is sample i, clockwise from twelve o'clock.
    inner_transitions, outer_transitions: uint8 (Eqs. 19 and 20).
    sector_difference: uint8, d2 of Eq. 21; 255 where the inner ring does not have four runs.
    ring_difference: uint8, popcount(inner ^ outer) (Eq. 22).
    corrosion: int8, Cd of Eq. 23.
    spectrum_12, spectrum_23: float32, the smaller of |F2| - |F1| and of |F2| - |F3| over
        the two rings (Eq. 13).
    correlation: float32, max R / sqrt(n1 n2), 0 where a ring is white (Eq. 17).
    phase: float32, smallest shift of the best correlation, >= 0, rad.
    candidate: bool, after the criteria and before the gate.
    contrast: int32, min(sc1, sc2) of the gate at the maxima of `response`, 0 elsewhere.
    response: int32, R before the gate.
    score: int32, S, the response under the 5 x 5 tent.
    maximum: bool, pixels that suppression and the gate keep.
    """

    binary: NDArray[np.bool_]
    inner: NDArray[np.uint16]
    outer: NDArray[np.uint16]
    inner_transitions: NDArray[np.uint8] | None
    outer_transitions: NDArray[np.uint8] | None
    sector_difference: NDArray[np.uint8] | None
    ring_difference: NDArray[np.uint8] | None
    corrosion: NDArray[np.int8] | None
    spectrum_12: NDArray[np.float32] | None
    spectrum_23: NDArray[np.float32] | None
    correlation: NDArray[np.float32] | None
    phase: NDArray[np.float32] | None
    candidate: NDArray[np.bool_]
    contrast: NDArray[np.int32] | None
    response: NDArray[np.int32]
    score: NDArray[np.int32]
    maximum: NDArray[np.bool_]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class HarmonicMaps:
    """Every intermediate image of a frame with RingHarmonic, each (H, W).

    With a working scale the maps have the size of the scaled image. Those of octaves are left out.

    fine: uint16, the image smoothed once, in 1/16 of an 8-bit grey level.
    coarse: uint16, the image smoothed three times, likewise.
    coarse_response: int32, the response of the 5 px ring on `coarse`.
    fine_response: int32, the response of the 3 px ring on `fine`; None without the search for
        squeezed cells.
    maximum: bool, the corners that are kept, see `Corners.pixel`.
    """

    fine: NDArray[np.uint16]
    coarse: NDArray[np.uint16]
    coarse_response: NDArray[np.int32]
    fine_response: NDArray[np.int32] | None
    maximum: NDArray[np.bool_]
