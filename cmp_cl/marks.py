"""Corners that marks in the cells look like, told from the pattern's by the length of their edges.

A dot, a ring or a code in a cell has points where black and white meet four times, and close by
they look like corners. But an edge of a checkerboard's corner runs straight on to the next corner,
a whole cell away, and there its polarity changes. Edges of marks are shorter, or bend away.
"""

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.arrays import Frame, as_frame
from cmp_cl.corners import Corners, Method
from cmp_cl.errors import ConfigError, ImageError
from cmp_cl.image import GreyImage

Whole = NDArray[np.int64]
Reals = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Chosen on rendered boards of 10 to 60 px cells, plain and with dots, rings, crosses, squares,
# codes, and on pressed gels of severity 0.25 to 1.75.
FIRST_STEP, LONGEST = 2.5, 128.0  # px, of the walk along an edge
LEAST_SIDE, SIDE = 1.25, 0.12  # px, and share of the way: how far beside the edge levels are read
CONTRAST = 0.35  # share of the edge's own contrast close to the corner
MOST = 1.5  # the other end of an edge lies at most that many times as far as it could be followed
LEAST_BACK = 0.35  # share of the way that the edge of the other end must come back
ASIDE = 0.2  # share of the way by which the other end may lie beside the edge
OPPOSITE = -0.85  # largest cosine between the edges of both ends
INSIDE = 0.8  # share of a cell's side that is inside it
BESIDE = 0.08  # of a cell's side: a corner this far outside still counts as inside
# times INSIDE of the cell's sides over the edges of a corner in it, where two or one of them end
LONGER, MUCH_LONGER = 1.2, 2.0
LEAST_SINE = 0.3  # between two edges that span a cell
LEAST_CELL = 9.0  # px; in smaller ones torn corners are like marks
ROW = 16.0  # px, of the bins in which pairs are searched


def drop_marks(corners: Corners, image: Frame) -> Corners:
    """Return the corners without those inside another corner's cell.

    It is for boards whose cells hold dots, rings or codes. Two successive edges of a corner span
    its cell. A corner inside goes if at least one of the two edges ends at a corner whose own edge
    comes back, and both are longer than its edges: by half where both end so, else two and a half
    times. Cells under 9 px are left alone. On a plain pattern no cell holds a corner; but where its
    cells are under 10 px and its print is torn, up to one corner in a thousand goes. So ask for it
    where cells have marks. A smaller board that lies within one cell of a larger one is taken for
    its marks.

    corners: as a detector returns them, with edges. image: (H, W) uint8 or uint16 that they were
    found in.

    Raises ImageError if the image is no grey image, or smaller than the corners say; ConfigError
    if they were refined by Midlines, or not at all.
    """
    grey = as_frame(image)
    if not len(corners):
        return corners
    x, y = corners.xy.max(axis=0)
    if x > grey.shape[1] + 2 or y > grey.shape[0] + 2:  # refined ones may lie a little outside
        raise ImageError(f"the corners are not of this image, {grey.shape}: one is beyond it")
    if np.isin(corners.method, (Method.CENTROID, Method.MIDLINE, Method.CUSP)).any():
        raise ConfigError(
            "the corners have no edges: detect them with refinement EdgeStep or EdgeLines"
        )
    kept = ~inside_cells(corners, grey)
    changes: dict[str, Any] = {
        field.name: value[kept]
        for field in dataclasses.fields(corners)
        if isinstance(value := getattr(corners, field.name), np.ndarray)
    }
    return dataclasses.replace(corners, **changes)


def inside_cells(corners: Corners, image: GreyImage) -> Flags:
    """Return (N,): whether a corner lies inside another one's cell."""
    xy = corners.xy.astype(np.float64)
    known: Flags = np.all(np.isfinite(corners.edges), axis=1)
    angle = np.where(known[:, None], corners.edges, 0).astype(np.float64)
    ahead = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    length = edge_lengths(image, xy, ahead, known)
    longest = length.max(axis=1)
    one, other = _pairs_within(xy, np.where(longest > 0, MOST * longest + 2, 0))
    ends = edge_ends(xy, ahead, length, one, other)

    ended = ends >= 0
    side = INSIDE * np.where(ended[..., None], xy[ends] - xy[:, None], ahead * length[..., None])
    long = np.hypot(side[..., 0], side[..., 1])
    own = np.sort(length, axis=1)[:, 1:3].mean(axis=1)
    away = xy[other] - xy[one]
    dropped = np.zeros(len(xy), np.bool_)
    for k in range(4):
        follows = (k + 1) % 4
        first, second = side[one, k], side[one, follows]
        shorter = np.minimum(long[one, k], long[one, follows])
        area = _cross(first, second)
        count = ended[one, k].astype(np.int64) + ended[one, follows]
        ratio = np.where(count == 2, LONGER, MUCH_LONGER)
        cell = np.abs(area) > LEAST_SINE * long[one, k] * long[one, follows]
        cell &= (count > 0) & (shorter > ratio * own[other]) & (shorter > INSIDE * LEAST_CELL)
        area = np.where(cell, area, 1)
        along, down = _cross(away, second) / area, _cross(first, away) / area
        low = -BESIDE / INSIDE
        cell &= (along > low) & (down > low) & (along < 1) & (down < 1)
        dropped[other[cell]] = True
    return dropped


def edge_lengths(image: GreyImage, xy: Reals, ahead: Reals, known: Flags) -> Reals:
    """Return (N, 4): how far each edge runs straight on with the polarity it has at the corner, px.

    Grey levels are compared on both sides of it, further apart with the distance, so that it may
    bend a little. ahead: (N, 4, 2), unit vectors. known: (N,), the others get 0.
    """
    grey = cv2.GaussianBlur(image, (3, 3), 0).astype(np.float32)
    rows, columns = grey.shape
    start = np.repeat(xy, 4, axis=0)
    along = ahead.reshape(-1, 2)
    across = np.stack([along[:, 1], -along[:, 0]], axis=-1)
    across[1::2] *= -1  # polarities alternate around a corner
    length, contrast = np.zeros(len(start)), np.zeros(len(start))
    walking = np.flatnonzero(np.repeat(known, 4))
    step, taken = FIRST_STEP, 0
    while len(walking) and step <= LONGEST:
        middle = start[walking] + step * along[walking]
        beside = max(LEAST_SIDE, SIDE * step) * across[walking]
        bright = np.rint(middle + beside).astype(np.int64)
        dark = np.rint(middle - beside).astype(np.int64)
        inside = (np.minimum(bright, dark) >= 0).all(axis=1)
        inside &= (np.maximum(bright, dark) < (columns, rows)).all(axis=1)
        walking, bright, dark = walking[inside], bright[inside], dark[inside]
        difference = grey[bright[:, 1], bright[:, 0]] - grey[dark[:, 1], dark[:, 0]]
        if taken < 3:
            contrast[walking] = np.maximum(contrast[walking], difference)
        walking = walking[(difference > CONTRAST * contrast[walking]) & (difference > 0)]
        length[walking] = step
        step += 0.12 * step + 0.4
        taken += 1
    return length.reshape(-1, 4)


def edge_ends(xy: Reals, ahead: Reals, length: Reals, one: Whole, other: Whole) -> Whole:
    """Return (N, 4): the corner at the end of each edge, -1 where it has none.

    one, other: (P,), pairs of corners that are looked at. The other corner's edge comes back along
    this one, and has the other polarity.
    """
    away = xy[other] - xy[one]
    apart = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-9)
    edge = np.argmax(np.einsum("pkc,pc->pk", ahead[one], away), axis=1)
    back = np.argmin(np.einsum("pkc,pc->pk", ahead[other], away), axis=1)
    seen, returned = length[one, edge], length[other, back]
    along = np.einsum("pc,pc->p", ahead[one, edge], away)
    aside = np.abs(_cross(ahead[one, edge], away))
    facing = np.einsum("pc,pc->p", ahead[one, edge], ahead[other, back])
    fits = (edge + back) % 2 == 1
    fits &= (facing < OPPOSITE) & (aside < ASIDE * along)
    fits &= (seen > 0) & (along > 0.85 * seen) & (along < MOST * seen + 2)
    fits &= (returned > LEAST_BACK * along) & (seen > LEAST_BACK * along)
    chosen = np.flatnonzero(fits)
    chosen = chosen[np.argsort(-apart[chosen], kind="stable")]  # the nearest is written last
    ends = np.full(length.shape, -1, np.int64)
    ends[one[chosen], edge[chosen]] = other[chosen]
    return ends


def _cross(first: Reals, second: Reals) -> Reals:
    product: Reals = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    return product


def _pairs_within(xy: Reals, reach: Reals) -> tuple[Whole, Whole]:
    """Return two (P,): each corner with those that lie in its square of half side `reach`, px, and
    a little above and below."""
    row = np.floor(xy[:, 1] / ROW)
    stride = 4 * (xy[:, 0].max() + reach.max() + 1)  # more than any x that is searched for
    key = row * stride + xy[:, 0]
    order = np.argsort(key, kind="stable")
    key = key[order]
    most = int(np.ceil(reach.max() / ROW))
    firsts, seconds = [], []
    for shift in range(-most, most + 1):
        one = np.flatnonzero(reach > (abs(shift) - 1) * ROW)
        middle = (row[one] + shift) * stride + xy[one, 0]
        start = np.searchsorted(key, middle - reach[one])
        count = np.searchsorted(key, middle + reach[one]) - start
        offset = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        firsts.append(np.repeat(one, count))
        seconds.append(order[np.repeat(start, count) + offset])
    first, second = np.concatenate(firsts), np.concatenate(seconds)
    apart = first != second
    return first[apart], second[apart]
