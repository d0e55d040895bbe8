"""The nodes of a frame from those of the frame before, node by node, in float64.

1. A node is expected where it moves on to as it moved last: from corner to corner, or from one
   place where it was taken to be to the next; between the two it keeps the motion that it had. It
   takes the nearest corner within .3 of the smaller local step there.
2. The colour of the corner must be that of the node: the sine of the angle between its first
   boundary and the lattice's step along the row is smaller than that with the step down the column
   (times their lengths) for one of the two, and larger for the other. An unknown boundary fits.
3. No other node took the corner.
4. The distance to what is expected is within .18 step of the mean of those of the four neighbours
   that meet 1 to 3; a node without such neighbours fails.
5. A node that fails moves as these neighbours do.
6. Along its row and its column the nodes around predict a node: with L, LL before it and R, RR
   behind it as (4 (L + R) - LL - RR) / 6, with one on both sides only as (L + R) / 2, which weighs
   a quarter. A node over .3 cell from the mean is astray.
7. Free corners within .3 step of where the next line beyond a side would be are counted, and so are
   failed nodes with a corner at the expected place, or a free one within .75 cell.
8. A node that fails or is astray is looked at again. If that finds nothing, it takes the
   prediction. For a node that fails this is where it would be if it had moved from rest as the
   quadratic surface through 16 nodes around, or more, that have corners. It is interpolated if both
   neighbours along a line have corners and are not astray.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from cmp_cl.reference.field.filter import surface_at
from cmp_cl.reference.lattice.borders import ways

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Bools = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Found:
    """nodes, motion: (R, C, 2), and how they move on. owner: (R, C), the corner, -1 without one.
    status: (R, C), 0 missing, 1 with a corner, 2 with a rough one, whose sigma is unknown, 4
    interpolated. lost, adrift: numbers of nodes that failed, and that failed beside a corner.
    beyond, gone: (4,), free corners and failed nodes of each side, top, bottom, left, right.
    margin: the least distance of a quantity from its bound, px."""

    nodes: Floats
    motion: Floats
    owner: Ints
    status: Ints
    lost: int
    adrift: int
    beyond: Ints
    gone: Ints
    margin: float


def track(
    rest: Floats, nodes: Floats, motion: Floats, seen: Bools, corners: Floats, colour: int
) -> Found:
    """Follow the nodes (R, C, 2) of a frame, `rest` those at rest, to the corners (N, 4): x, y,
    angle, sigma. motion: (R, C, 2), how they move on. seen: (R, C), those that have corners.
    colour: 1 if corners of even row + column have their first boundary along the row, else -1."""
    shape = nodes.shape[0], nodes.shape[1]
    expected = nodes + motion
    along, down = _steps(nodes)
    step = np.minimum(np.linalg.norm(along, axis=2), np.linalg.norm(down, axis=2))
    owner = np.full(shape, -1, np.int32)
    residual = np.zeros((*shape, 2))
    there = np.zeros(shape, np.bool_)  # whether a corner is at the expected place
    margins = [np.inf]
    for node in np.ndindex(*shape):
        off = corners[:, :2] - expected[node]
        far = np.linalg.norm(off, axis=1)
        if not len(far):
            continue
        nearest = int(far.argmin())
        margins.append(abs(far[nearest] - 0.3 * step[node]))
        if not far[nearest] < 0.3 * step[node]:
            continue
        residual[node] = off[nearest]
        there[node] = True
        angle = corners[nearest, 2]
        edge = np.array([np.cos(angle), np.sin(angle)])
        sign = colour * (-1) ** sum(node)
        fit = sign * (abs(_cross(edge, down[node])) - abs(_cross(along[node], edge)))
        margins += [abs(fit)] if np.isfinite(fit) else []
        if fit <= 0:
            continue
        owner[node] = nearest
    taken = np.bincount(owner[owner >= 0], minlength=len(corners))
    sole = np.array([j >= 0 and taken[j] == 1 for j in owner.ravel()]).reshape(shape)
    kept, moved = np.full(shape, -1, np.int32), expected.copy()
    for r, c in np.ndindex(*shape):
        others = [residual[n] for n in _beside((r, c)) if _inside(n, shape) and sole[n]]
        mean: Floats = np.mean(others, axis=0) if others else np.zeros(2)
        away = float(np.linalg.norm(residual[r, c] - mean))
        if sole[r, c] and others:
            margins.append(abs(away - 0.18 * step[r, c]))
        if sole[r, c] and others and away < 0.18 * step[r, c]:
            kept[r, c] = owner[r, c]
            moved[r, c] = corners[owner[r, c], :2]
        else:
            moved[r, c] += mean
    along, down = _steps(moved)
    cell = (np.linalg.norm(along, axis=2) + np.linalg.norm(down, axis=2)) / 2
    predictions = {node: _predicted(moved, node) for node in np.ndindex(*shape)}
    astray = np.zeros(shape, np.bool_)
    for node in zip(*np.nonzero(kept >= 0), strict=True):
        prediction = predictions[node]
        if prediction is None:
            continue
        apart = float(np.linalg.norm(moved[node] - prediction))
        margins.append(abs(apart - 0.3 * float(cell[node])))
        astray[node] = apart > 0.3 * float(cell[node])
    free = corners[taken == 0, :2]
    beyond = np.zeros(4, np.int32)
    for side, (line, inside, *_) in enumerate(ways(moved)):
        for one, other in zip(line, inside, strict=True):
            outward = one - other
            gap = float(np.linalg.norm(free - one - outward, axis=1).min(initial=np.inf))
            reach = 0.3 * float(np.linalg.norm(outward))
            margins.append(abs(gap - reach))
            beyond[side] += gap < reach
    lost = kept < 0
    adrift = 0
    for node in zip(*np.nonzero(lost), strict=True):
        gap = float(np.linalg.norm(free - moved[node], axis=1).min(initial=np.inf))
        margins.append(abs(gap - 0.75 * cell[node]))
        adrift += bool(there[node] or gap < 0.75 * cell[node])
    gone = [np.count_nonzero(line) for line, *_ in ways(lost)]
    good = ~lost & ~astray
    final, owner = moved.copy(), kept.copy()
    rough = np.isnan(corners[:, 3])[kept] if len(corners) else np.zeros(shape, np.bool_)
    status = np.where(rough, 2, 1).astype(np.int32)
    for node in zip(*np.nonzero(~good), strict=True):
        prediction = predictions[node]
        place = prediction
        if place is None or lost[node]:
            place = rest[node] + _surface(node, moved - rest, ~lost)
        final[node], owner[node] = place, -1
        sides = [_inside(n, shape) and bool(good[n]) for n in _beside(node)]
        status[node] = 4 if all(sides[:2]) or all(sides[2:]) else 0
    alike = np.isin(status, (1, 2)) == seen
    return Found(
        nodes=final,
        motion=np.where(alike[..., None], final - nodes, motion),
        owner=owner,
        status=status,
        lost=int(np.count_nonzero(lost)),
        adrift=adrift,
        beyond=beyond,
        gone=np.array(gone, np.int32),
        margin=float(np.min(margins)),
    )


def _steps(nodes: Floats) -> tuple[Floats, Floats]:
    """Return the steps along the rows and down the columns, central where there are two."""
    return np.gradient(nodes, axis=1), np.gradient(nodes, axis=0)


def _cross(one: Floats, two: Floats) -> float:
    return float(one[0] * two[1] - one[1] * two[0])


def _beside(node: tuple[int, int]) -> list[tuple[int, int]]:
    """Return the nodes before, behind, above and below a node."""
    r, c = node
    return [(r, c - 1), (r, c + 1), (r - 1, c), (r + 1, c)]


def _inside(node: tuple[int, int], shape: tuple[int, ...]) -> bool:
    return 0 <= node[0] < shape[0] and 0 <= node[1] < shape[1]


def _predicted(nodes: Floats, node: tuple[int, int]) -> Floats | None:
    """Return the prediction of a node from those along its lines, None without any."""
    total, mean = 0.0, np.zeros(2)
    for r, c in ((0, 1), (1, 0)):
        line = [(node[0] + far * r, node[1] + far * c) for far in (-2, -1, 1, 2)]
        if all(_inside(place, nodes.shape) for place in line):
            far, near, behind, far_behind = (nodes[place] for place in line)
            total, mean = total + 4, mean + 4 * (4 * (near + behind) - far - far_behind) / 6
        elif all(_inside(place, nodes.shape) for place in line[1:3]):
            total, mean = total + 1, mean + (nodes[line[1]] + nodes[line[2]]) / 2
    return mean / total if total else None


def _surface(node: tuple[int, int], values: Floats, known: NDArray[np.bool_]) -> Floats:
    """Return the value at a node of the quadratic surface through the known ones around.

    Those within 3 nodes, in steps of 1; 6, 1; 12, 2; 24, 4; ... until there are 16. Distances are
    in thirds of that reach.
    """
    off, size = np.argwhere(known) - node, 1
    while True:
        near = (np.abs(off) <= 3 * size).all(axis=1) & (off % max(size // 2, 1) == 0).all(axis=1)
        if np.count_nonzero(near) >= 16 or 3 * size >= max(known.shape):
            return surface_at(off[near] / size, values[known][near], 3)
        size *= 2
