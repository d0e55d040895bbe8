"""Where the cameras of a rig stand, from the board that two of them see at one moment."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError
from cmp_cl.grid.grid import Grid
from cmp_cl.space.calibration.alone import Alone
from cmp_cl.space.lens import rotation_of

Array = NDArray[np.float64]
Seen: TypeAlias = dict[tuple[str, int], Grid]  # by camera and moment

_ODD = 5.0  # a moment fits badly if it is off by this many times the median of all


class Places(NamedTuple):
    """Where cameras and boards are.

    cameras: by name, (4, 4), from the first camera's frame to that one's. boards: by moment,
    (4, 4), from the board to the first camera's frame. grids: turned to the
    numbers of the first camera that sees the board. odd: moments that fit the others badly.
    """

    cameras: dict[str, Array]
    boards: dict[int, Array]
    grids: Seen
    odd: list[int]


def place(alone: Mapping[str, Alone], grids: Seen) -> Places:
    """Place all cameras relative to the first one, the one with the most known boards next.

    A camera may be rolled, so its grid may be numbered from another corner of the board. Each turn
    of the grid that keeps its shape and the colours of its cells puts the camera at another place.
    The true place is the same at all moments, the others are not.

    Raises CalibrationError if a camera shares no moment with the others.
    """
    first, *waiting = alone
    cameras = {first: np.eye(4)}
    boards = {moment: pose_of(pose) for moment, pose in alone[first].poses.items()}
    numbered = {moment: grids[first, moment] for moment in boards}
    turned = grids.copy()
    odd: set[int] = set()
    while waiting:
        name = max(waiting, key=lambda each: len(boards.keys() & alone[each].poses.keys()))
        waiting.remove(name)
        poses = {moment: pose_of(pose) for moment, pose in alone[name].poses.items()}
        common = sorted(boards.keys() & poses.keys())
        if not common:
            raise CalibrationError(f"{name}: no moment shows the board in another camera as well")
        turns = {each: _turns(numbered[each], grids[name, each]) for each in common}
        options = {
            moment: [
                (quarter, poses[moment] @ turn @ np.linalg.inv(boards[moment]))
                for quarter, turn in turns[moment]
            ]
            for moment in common
        }
        if not all(options.values()):
            raise CalibrationError(
                f"{name}: its board has other colours or another shape than that of the others: "
                "check that all cameras see the same board, and that none is mirrored"
            )
        cameras[name], chosen, bad = _agreed(options)
        odd.update(bad)
        turned |= {(name, m): grids[name, m].turned(quarters) for m, quarters in chosen.items()}
        for moment in poses.keys() - boards.keys():
            boards[moment] = np.linalg.inv(cameras[name]) @ poses[moment]
            numbered[moment] = grids[name, moment]
    return Places(cameras, boards, turned, sorted(odd))


def _turns(one: Grid, other: Grid) -> list[tuple[int, Array]]:
    """Return the turns of the other grid that may give it the numbers of the first one.

    Each is a number of quarters, and the (4, 4) from the board's frame by the turned numbers to
    that by its own, in squares. After a quarter turn row 0 is the former last column.
    """
    found, turn = [], np.eye(4)
    for quarters in range(4):
        turned = other.turned(quarters)
        if turned.shape == one.shape and turned.parity == one.parity:
            found.append((quarters, turn))
        quarter = np.eye(4)
        quarter[:2, :2] = [[0, -1], [1, 0]]
        quarter[0, 3] = turned.shape[1] - 1
        turn = turn @ quarter
    return found


def _agreed(
    options: Mapping[int, Sequence[tuple[int, Array]]],
) -> tuple[Array, dict[int, int], list[int]]:
    """Return the place of a camera on which most moments agree best, (4, 4).

    options: by moment, the places and the quarters that give them. Returns also the quarters of
    each moment, and the moments that do not agree.
    """
    places = [place for each in options.values() for _, place in each]
    reach = float(np.median([np.linalg.norm(place[:3, 3]) for place in places])) or 1.0

    def off(one: Array, other: Array) -> float:
        difference = (one - other)[:3]
        difference[:, 3] /= reach
        return float(np.linalg.norm(difference))

    def nearest(place: Array) -> dict[int, tuple[float, int]]:
        return {
            moment: min((off(place, other), quarters) for quarters, other in each)
            for moment, each in options.items()
        }

    def score(place: Array) -> float:
        return float(np.median([distance for distance, _ in nearest(place).values()]))

    best = min(places, key=score)
    limit = _ODD * score(best)
    distances = nearest(best)
    bad = [moment for moment, (distance, _) in distances.items() if distance > limit]
    return best, {moment: quarters for moment, (_, quarters) in distances.items()}, bad


def pose_of(vector: Array) -> Array:
    """Return the (4, 4) of a rotation vector and a translation (6,)."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_of(vector)
    pose[:3, 3] = vector[3:]
    return pose


def vector_of(pose: Array) -> Array:
    """Return the rotation vector and translation of a (4, 4), (6,)."""
    return np.concatenate([cv2.Rodrigues(pose[:3, :3])[0].ravel(), pose[:3, 3]])
