"""Adjusts cameras that were calibrated alone together, and refuses views that do not fit."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from cmp_cl.errors import CalibrationError
from cmp_cl.space.adjustment import Adjusted, Look, adjust, root_mean_square
from cmp_cl.space.lens import Lens
from cmp_cl.space.start import MIN_VIEWS, Alone, joined

_MAX_MISFIT = 1.0  # px: the joint reprojection error may reach this, or
_MAX_MISFIT_RATIO = 3.0  # times the largest error of a camera alone
_MOST_NAMED = 4  # moments: if more do not fit, none is named

Array = NDArray[np.float64]


class MisfitError(CalibrationError):
    """No pose between the cameras fits the views.

    odd: by moment, the cameras whose views do not fit the others; empty if the views do not show
    which these are.
    """

    def __init__(self, message: str, odd: Mapping[int, Sequence[str]]) -> None:
        super().__init__(message)
        self.odd = odd


def adjust_together(
    lens: Lens,
    looks: Sequence[Look],
    found: Mapping[str, Alone],
    board: Array,
    free: NDArray[np.bool_],
) -> Adjusted:
    """Adjust all cameras and poses of a flat board together, from the cameras alone.

    found: by name, in the order of the cameras' numbers. board: (R, C, 3). free: see `adjust`.

    Raises CalibrationError if a camera shares no moment with the others. Raises MisfitError if the
    joint reprojection error exceeds 1 px and three times the largest one of a camera alone.
    """
    adjusted = adjust(lens, looks, joined(found, board), free)
    error = root_mean_square(*adjusted.residuals)
    alone = max(each.error for each in found.values())
    limit = max(_MAX_MISFIT, _MAX_MISFIT_RATIO * alone)
    if error <= limit:
        return adjusted
    odd = _odd(lens, looks, adjusted, found, board, free, limit)
    views = " and ".join(f"view {moment} of {', '.join(odd[moment])}" for moment in odd)
    raise MisfitError(
        f"no pose between the cameras fits the views of {', '.join(found)}: together they miss by "
        f"{error:.1f} px, each alone by at most {alone:.2f} px; "
        + (f"without {views} the others fit; " if odd else "")
        + "check the shape of the board, and that all cameras see it at the same moments",
        odd,
    )


def _odd(
    lens: Lens,
    looks: Sequence[Look],
    adjusted: Adjusted,
    found: Mapping[str, Alone],
    board: Array,
    free: NDArray[np.bool_],
    limit: float,
) -> dict[int, list[str]]:
    """Return the cameras, by moment, without whose views the others fit; empty if undetermined.

    The worst view is left out until the others fit. Of two views of a moment neither is the worse
    one: both are left out.
    """
    names, rest, odd = list(found), list(looks), dict[int, list[str]]()
    while True:
        worst = rest[int(np.argmax([root_mean_square(off) for off in adjusted.residuals]))]
        seen = [look for look in rest if look.moment == worst.moment]
        out = [worst] if len(seen) > 2 else seen
        rest = [look for look in rest if all(look is not each for each in out)]
        odd.setdefault(worst.moment, []).extend(names[look.camera] for look in out)
        if len(odd) > _MOST_NAMED or not _determined(rest, len(names)):
            return {}
        kept = {
            name: dataclasses.replace(
                each,
                poses={
                    look.moment: each.poses[look.moment] for look in rest if look.camera == number
                },
            )
            for number, (name, each) in enumerate(found.items())
        }
        try:
            start = joined(kept, board)
        except CalibrationError:
            return {}
        adjusted = adjust(lens, rest, start, free)
        if root_mean_square(*adjusted.residuals) <= limit:
            return {moment: [n for n in names if n in odd[moment]] for moment in sorted(odd)}


def _determined(looks: Sequence[Look], cameras: int) -> bool:
    """Return whether each camera has enough views at moments that another one sees too."""
    moments = [look.moment for look in looks]
    shared = [look.camera for look in looks if moments.count(look.moment) > 1]
    return all(shared.count(camera) >= MIN_VIEWS for camera in range(cameras))
