"""Ways across tears, and the colours along them (votes for joins)."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Units, Votes
from cmp_cl.lattice.constants import LatticeConstants
from cmp_cl.reference.lattice.parts import (
    Directed,
    F,
    Real,
    Whole,
    boundary,
    inverse_root,
    length_of,
    read,
)


def mean_steps(corners: Directed, twin: Whole) -> Real:
    """Return the mean length of the links of each corner, (N,) px; 0 without a link."""
    total, count = np.zeros(len(corners.x), np.float32), np.zeros(len(corners.x), np.int64)
    for s in range(4):
        h = twin[s::4]
        i = np.flatnonzero(h >= 0)
        dx, dy = corners.x[h[i] >> 2] - corners.x[i], corners.y[h[i] >> 2] - corners.y[i]
        total[i] = total[i] + length_of(dx * dx + dy * dy)
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
    """Return the ways of up to `span` steps between the rims of two parts, in order of both units.

    A way leaves both ends along a boundary, and the colours beside it change after every step.
    """
    step = mean_steps(corners, twin)
    rim = np.flatnonzero(units.rim)
    none = np.zeros(0, np.int64)
    if len(np.unique(units.part[rim])) < 2:
        return Votes(none, none, none, none, none, np.zeros(0))
    reach = F(k.span + 0.5) * step[units.corner[rim]]
    pairs = []
    for place, unit in enumerate(rim):  # by brute force: the kernel looks in bins
        dx = corners.x[units.corner[rim]] - corners.x[units.corner[unit]]
        dy = corners.y[units.corner[rim]] - corners.y[units.corner[unit]]
        near = dx * dx + dy * dy < np.maximum(reach[place] ** 2, reach * reach)
        near &= (units.part[rim] > units.part[unit]) & (units.corner[rim] != units.corner[unit])
        other = rim[near]
        pairs.append(np.stack([np.full(len(other), unit), other], axis=1))
    first, second = np.concatenate(pairs).T
    a, b = units.corner[first], units.corner[second]
    dx, dy = corners.x[b] - corners.x[a], corners.y[b] - corners.y[a]
    length = length_of(np.maximum(dx * dx + dy * dy, F(1)))
    s, along_a = boundary(corners.angle[a], dx, dy)
    t, along_b = boundary(corners.angle[b], -dx, -dy)
    along = np.minimum(along_a, along_b)
    mean = F(0.5) * (step[a] + step[b])
    found = []
    for m in range(1, k.span + 1):
        cosine = k.least_cosine
        good = (along > F(cosine) * length) & ((s + t - m) % 2 == 0)
        good &= np.abs(length - F(m) * mean) < mean
        n = np.flatnonzero(good)
        part_x, part_y = dx[n] * F(1 / m), dy[n] * F(1 / m)
        square = np.maximum(part_x * part_x + part_y * part_y, F(1))
        depth = np.maximum(F(k.side_depth_cells), F(k.side_depth_px) * inverse_root(square))
        across, down = -(depth * part_y), depth * part_x
        total = np.zeros(len(n), np.int64)
        for j in range(m):
            for t_ in k.side_points:
                x = corners.x[a[n]] + F(j + t_) * part_x
                y = corners.y[a[n]] + F(j + t_) * part_y
                difference = read(plane, x - across, y - down) - read(plane, x + across, y + down)
                total += difference * (1 - 2 * (j % 2))
        total *= 1 - 2 * (s[n] % 2)
        product = corners.contrast[a[n]].astype(np.float32) * corners.contrast[b[n]].astype(
            np.float32
        )
        share = (total.astype(np.float32) * F(2 / (len(k.side_points) * m))) * inverse_root(product)
        seen = total > 0
        n, share = n[seen], share[seen]
        weight = (np.minimum(share, F(1)) * F(1 / np.sqrt(m))).astype(np.float64)
        found.append((first[n], second[n], s[n], t[n], np.full(len(n), m), weight))
    return Votes(*(np.concatenate(each) for each in zip(*found, strict=True)))
