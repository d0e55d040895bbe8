"""Ways across tears, and the colours along them (votes for joins)."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Float, Numbers, Units, Votes
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.reference.lattice.parts import (
    SIDE_POINTS,
    STEPS,
    Directed,
    F,
    Real,
    Whole,
    boundary,
    dot,
    inverse_root,
    length_of,
    side_sum,
)


def mean_steps(corners: Directed, twin: Whole) -> Real:
    """Return the mean length of the links of each corner, (N,) px; 0 without a link."""
    total, count = np.zeros(len(corners.at), np.float32), np.zeros(len(corners.at), np.int64)
    for s in range(4):
        h = twin[s::4]
        i = np.flatnonzero(h >= 0)
        total[i] = total[i] + length_of(corners.at[h[i] >> 2] - corners.at[i])
        count[i] += 1
    share = inverse_root(np.maximum(count, 1).astype(np.float32))
    return total * (share * share)


def votes(
    plane: NDArray[np.integer],
    corners: Directed,
    twin: Whole,
    units: Units,
    k: LatticeConstants,
) -> Votes:
    """Return the votes for where parts lie beside larger ones.

    They are of ways of up to `span` steps between their rims. A way leaves both ends along a
    boundary, and the colours beside it change after every step.
    """
    step = mean_steps(corners, twin)
    rim = np.flatnonzero(units.rim)
    reach = F(k.span + 0.5) * step[units.corner[rim]]
    pairs = [np.zeros((0, 2), np.int64)]
    for unit in rim:  # by brute force: the kernel looks in bins
        way = corners.at[units.corner[rim]] - corners.at[units.corner[unit]]
        near = dot(way, way) < reach * reach  # of the node in the smaller part
        near &= units.part[rim] > units.part[unit]
        near &= units.corner[rim] != units.corner[unit]
        other = rim[near]
        pairs.append(np.stack([np.full(len(other), unit), other], axis=1))
    first, second = np.concatenate(pairs).T
    a, b = units.corner[first], units.corner[second]
    chord = corners.at[b] - corners.at[a]
    length = length_of(chord, 1)
    s, along_a = boundary(corners.angle[a], chord)
    t, along_b = boundary(corners.angle[b], -chord)
    along = np.minimum(along_a, along_b)
    mean = F(0.5) * (step[a] + step[b])
    rotation, found = units.rotation, []
    for m in range(1, k.span + 1):
        good = (along > F(k.least_cosine) * length) & ((s + t - m) % 2 == 0)
        good &= np.abs(length - F(m) * mean) < mean
        n = np.flatnonzero(good)
        root = inverse_root(np.full(1, m, np.float32))
        part = root * root
        way, total = chord[n] * part, np.zeros(len(n), np.int64)
        for j in range(m):
            at = corners.at[a[n]] + F(j) * way
            total += side_sum(plane, at, (at + way) - at, k) * (1 - 2 * (j % 2))
        total *= 1 - 2 * (s[n] % 2)
        product = corners.contrast[a[n]].astype(np.float32) * corners.contrast[b[n]].astype(
            np.float32
        )
        share = 2 * F(1 / len(SIDE_POINTS)) * part
        share = (total.astype(np.float32) * share) * inverse_root(product)
        seen = total > 0
        n, share = n[seen], share[seen]
        weight = (np.minimum(share, F(1)) * root).astype(np.float64)
        one, other = first[n], second[n]
        direction = (s[n] + rotation[one]) % 4
        number = units.number[one] + m * STEPS[direction]
        found.append((one, other, number, direction - t[n] + 2 - rotation[other], weight))
    one, other, number, quarter, weight = (
        np.concatenate(each) for each in zip(*found, strict=True)
    )
    offset = number - units.number[other] * 1j ** (quarter % 4)
    return _summed(units.part[one], units.part[other], quarter % 4, offset, weight)


def _summed(first: Whole, second: Whole, quarter: Whole, offset: Numbers, weight: Float) -> Votes:
    """Return each placement once, with its votes, the least ones added first."""
    columns, rows = np.rint(offset.real).astype(np.int64), np.rint(offset.imag).astype(np.int64)
    key = np.stack([first, second, quarter, columns, rows], axis=1)
    each, which = np.unique(key, axis=0, return_inverse=True)
    total = np.zeros(len(each))
    for n in np.argsort(weight, kind="stable"):
        total[which[n]] += weight[n]
    part, its, turn, column, row = each.T
    return Votes(part, its, turn, column + 1j * row, total)
