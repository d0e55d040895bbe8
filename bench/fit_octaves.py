"""How the constants of the octaves were chosen: each is varied alone, on boards of our own.

    python bench/fit_octaves.py [BOARDS]        prints a table

The boards are those of `boards.drawn`; no photograph and no rendered scene is among them. The
oracle lists the maxima of every octave once, and each row decides with one constant changed. Missed
and false are means over the boards of shares of a board's corners, at most all of them, so that a
board of thousands counts like one of ten.
"""

import sys
from typing import NamedTuple

import numpy as np
from boards import Board, drawn
from scipy.spatial import cKDTree

from cmp_cl import RingHarmonic
from cmp_cl.reference import harmonic

FIRST_SEED = 700_000
RADIUS = 3  # px, of suppression
KINDS = ("all", "spread ink", "noise, wide", "noise", "clutter", "cells under 20 px")


class Settings(NamedTuple):
    """One set of the constants.

    share: least response against the reference, in 1/128; the fine one is 5/3 of it. frame_wide,
        octave_wide: least response of the ring of 8 px, one in that many; 0 leaves it out.
        octave_share: as share, in octaves. apart: px of the octave. one: whether all octaves have
        one reference. strong: least response that needs no neighbours, 1/128 of the reference; 0
        leaves the check out. around: px. aligned: neighbours opposed or alike that suffice; `askew`
        times as many opposed as askew are needed. opposed: least number, if any is aligned, that
        suffices beside octave 1. cosine: least one of opposed directions. seen: px of octave 1.
    """

    share: int = 24
    frame_wide: int = 2
    octave_wide: int = 4
    octave_share: int = 48
    apart: int = 5
    one: bool = True
    strong: int = 64
    around: int = 24
    aligned: int = 7
    opposed: int = 2
    askew: float = 2
    cosine: float = 0.816
    seen: float = 1.5


class Maxima(NamedTuple):
    """The maxima of an octave: places (N, 2) px of the frame, response, whether they are clean, the
    response of the ring of 8 px, and the direction as a complex number of length 1."""

    xy: np.ndarray
    response: np.ndarray
    clean: np.ndarray
    wide: np.ndarray
    direction: np.ndarray

    def of(self, some: np.ndarray) -> "Maxima":
        return Maxima(*(each[some] for each in self))


class Listed(NamedTuple):
    """A board, the maxima of its octaves, those of the ring of 3 px, and what it is drawn with."""

    board: Board
    octaves: list[Maxima]
    fine: Maxima
    kinds: list[str]


def listed(seed: int) -> Listed:
    """List the maxima of a board."""
    board, kinds = drawn(seed)
    mask = np.ones(board.image.shape, np.bool_)
    octaves = list(harmonic.octaves_of(board.image, RingHarmonic(), RADIUS, 255, mask))
    frame = octaves[0]
    rows, columns = np.indices(board.image.shape)
    response = harmonic.fine_measure(harmonic.harmonics(frame.once, rows, columns, harmonic.FINE))
    bound = harmonic.noise_bounds(board.image, RingHarmonic(), 255)[1]
    y, x = np.nonzero(harmonic.maxima(response, bound, RADIUS))
    passed = harmonic.looks_alike_when_squeezed(frame.once, y, x)
    y, x = y[passed], x[passed]
    around = harmonic.harmonics(frame.once, y, x, harmonic.FINE)
    fine = Maxima(np.stack([x, y], axis=1), response[y, x], y < 0, y, direction(around))
    return Listed(board, [maxima_of(octave) for octave in octaves], fine, ["all", *kinds])


def maxima_of(octave: harmonic.Octave) -> Maxima:
    size, response = 2**octave.halvings, octave.levels()
    seen = harmonic.harmonics(octave.thrice, octave.y, octave.x, harmonic.COARSE)
    return Maxima(
        (np.stack([octave.x, octave.y], axis=1) + 0.5) * size - 0.5,
        response,
        harmonic.is_clean(response, seen),
        harmonic.wide_response(octave),
        direction(seen),
    )


def direction(seen: harmonic.Harmonics) -> np.ndarray:
    vector: np.ndarray = seen.a + 1j * seen.b
    return vector / np.maximum(np.abs(vector), 1)


def decided(board: Listed, chosen: Settings) -> np.ndarray:
    """Return the corners, (N, 2), of a board."""
    references = [harmonic.reference(each.response) for each in board.octaves]
    level = max(references)
    frame, fine = board.octaves[0], board.fine
    clean = frame.clean & (frame.wide * (chosen.frame_wide or 1e9) >= frame.response)
    least = chosen.share * (level if chosen.one else references[0])
    frame = frame.of(np.where(clean, 256, 128) * frame.response >= least)
    level = level or harmonic.reference(fine.response)
    fine = fine.of(128 * fine.response >= (5 * chosen.share + 1) // 3 * level)
    every = Maxima(*map(np.concatenate, zip(frame, fine, strict=True)))
    xy = frame.xy[~lone(frame, every, board, chosen, level)]
    xy = far(fine.xy[~lone(fine, every, board, chosen, level)], xy, RADIUS)
    for n, octave in enumerate(board.octaves[1:], 1):
        least = chosen.octave_share * (level if chosen.one else references[n])
        strong = 128 * octave.response >= least
        strong &= octave.wide * (chosen.octave_wide or 1e9) >= octave.response
        xy = far(octave.xy[strong], xy, chosen.apart * 2**n)
    return xy


def lone(maxima: Maxima, every: Maxima, board: Listed, chosen: Settings, level: int) -> np.ndarray:
    """Return which maxima of the frame are weak, and neither alternate nor are seen in octave 1."""
    found = np.zeros(len(maxima.xy), np.bool_)
    if not chosen.strong or len(board.octaves) < 2:
        return found
    half = board.octaves[1]
    half = half.of(128 * half.response >= chosen.share * level)
    for n in np.flatnonzero(128 * maxima.response < chosen.strong * level):
        apart = np.abs(every.xy - maxima.xy[n]).max(axis=1)
        near = every.direction[(apart > RADIUS) & (apart <= chosen.around)]
        cosine = (near * np.conj(maxima.direction[n])).real
        opposed = np.count_nonzero(cosine <= -chosen.cosine)
        askew = np.count_nonzero(np.abs(cosine) < chosen.cosine)
        beside = np.abs(half.xy - maxima.xy[n]).max(axis=1) <= 2 * chosen.seen
        found[n] = opposed < chosen.askew * askew
        aligned = len(near) - askew
        seen = beside.any() and (aligned == 0 or opposed >= chosen.opposed)
        found[n] |= aligned < chosen.aligned and not seen
    return found


def far(added: np.ndarray, known: np.ndarray, apart: float) -> np.ndarray:
    """Return the known places and those that are farther than `apart` from them, in x or y."""
    if not len(known) or not len(added):
        return np.concatenate([known, added])
    distance, _ = cKDTree(known).query(added, p=np.inf)
    return np.concatenate([known, added[distance > apart]])


VARIED = [
    {},
    *({"share": n} for n in (16, 20, 28, 32)),
    *({"frame_wide": n} for n in (1, 3, 0)),
    *({"octave_wide": n} for n in (1, 2, 8, 0)),
    *({"octave_share": n} for n in (16, 24, 32, 40, 48, 56, 72, 80)),
    *({"apart": n} for n in (2, 3, 4, 6, 8)),
    {"one": False},
    *({"strong": n} for n in (0, 32, 48, 96, 128)),
    *({"around": n} for n in (16, 20, 32)),
    *({"aligned": n} for n in (4, 5, 6, 8)),
    *({"opposed": n} for n in (0, 1, 3)),
    *({"askew": n} for n in (0.5, 1, 3)),
    *({"cosine": n} for n in (0.71, 0.89, 0.95)),
    *({"seen": n} for n in (1, 1.5, 3)),
    *({"share": 20, "octave_share": n} for n in (32, 48, 64)),
    {"octave_share": 32, "octave_wide": 0},
    {"octave_share": 32, "octave_wide": 0, "apart": 4},
]


def main() -> None:
    boards = [listed(FIRST_SEED + n) for n in range(int(sys.argv[1]) if sys.argv[1:] else 200)]
    print(f"{len(boards)} boards; missed / false, % of a board's corners")
    print(f"{'':36}" + "".join(f"{kind:>20}" for kind in KINDS))
    for row in VARIED:
        chosen = Settings(**row)
        judged = {kind: [] for kind in KINDS}
        for each in boards:
            missed, false, count = each.board.judge(decided(each, chosen))
            if count:
                for kind in each.kinds:
                    judged[kind].append((missed / count, min(false / count, 1)))
        none = [(np.nan, np.nan)]
        shares = [100 * np.mean(judged[kind] or none, axis=0) for kind in KINDS]
        name = ", ".join(f"{name} {value}" for name, value in row.items()) or "as it is"
        print(f"{name:36}" + "".join(f"{a:12.2f} / {b:5.2f}" for a, b in shares), flush=True)


if __name__ == "__main__":
    main()
