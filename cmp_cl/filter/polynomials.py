"""Local polynomials along an axis of a lattice, as matrices."""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FILTERS = ((0, 0), (2, 1), (2, 3), (3, 3), (4, 3), (7, 3))  # half width in nodes, degree
LEAST_SUPPORT = 0.75  # least share of a window's nodes that are measured
STRAIN_REACH = 2  # nodes on each side of a node to which the planes of a strain are fitted


def polynomial(n: int, half: int, degree: int, order: int = 0) -> Array:
    """Return the matrix (n, n) of the value at each node of the polynomial fitted to its window.

    half: half width of the window, nodes; it is moved inwards at the ends. degree: of the
        polynomial.
    order: the derivative to take, 0 for the value.
    """
    whole = np.zeros((n, n))
    for node in range(n):
        first = min(max(node - half, 0), n - 2 * half - 1)
        window = np.arange(first, first + 2 * half + 1)
        powers = (window - node)[:, None].astype(np.float64) ** np.arange(degree + 1)
        whole[node, window] = math.factorial(order) * np.linalg.pinv(powers)[order]
    return whole
