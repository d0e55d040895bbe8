"""Whether a rig fits a frame as it fitted the frame at rest."""

import numpy as np
from numpy.typing import NDArray

LEAST_FITTING = 0.75  # share of the nodes at rest that must fit
_LEAST_NODES = 16  # of a quarter of the lattice; the median of fewer is noise


class Fit:
    """The distances at rest of the nodes from their epipolar lines, from which those in other
    frames must not differ.

    at_rest: (2, R, C), half of them, in the left view, px, NaN where unknown.
    """

    def __init__(self, at_rest: NDArray[np.float32]) -> None:
        self._at_rest = at_rest
        self._usual = np.nanquantile(np.hypot(*at_rest), LEAST_FITTING)

    def is_lost(self, now: NDArray[np.float32]) -> bool:
        """Return whether the distances in a frame, as at_rest, are those of a rig that has changed.

        If a view moves, turns or is zoomed, all distances of a quarter of the lattice change alike;
        by noise, wear or a press each changes for itself. So the fit is lost if the median changes
        of the quarters are, on average, longer than the distances at rest of LEAST_FITTING of the
        nodes, and than half of the changes are from these medians.
        """
        common, scatter = [], []
        for half in np.array_split(now - self._at_rest, 2, axis=1):
            for quarter in np.array_split(half, 2, axis=2):
                known = quarter[:, np.isfinite(quarter[0])]
                if known.shape[1] >= _LEAST_NODES:
                    middle = np.median(known, axis=1, keepdims=True)
                    common.append(np.full(known.shape[1], np.hypot(*middle)))
                    scatter.append(np.hypot(*(known - middle)))
        if not common:
            return False
        bound = max(self._usual, np.median(np.concatenate(scatter)))
        return bool(np.mean(np.concatenate(common)) > bound)
