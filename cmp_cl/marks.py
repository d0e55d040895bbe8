"""False corners on marks in the cells. The length of their edges shows that they are false.

A dot, a ring or a code in a cell has points around which black and white alternate four times, so
that they look like corners. But an edge at a corner of a checkerboard runs straight to the next
corner, a whole cell away, and its polarity changes there. Edges of marks are shorter, or bend away.
"""

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cmp_cl.corners import Corners, Method
from cmp_cl.errors import ConfigError, ImageError, check_kind
from cmp_cl.image import Frame, GreyImage, as_frame

Whole = NDArray[np.int64]
Reals = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Chosen on rendered boards of 10 to 60 px cells, plain and with dots, rings, crosses, squares,
# codes, and on pressed gels of severity 0.25 to 1.75.
FIRST_STEP, LONGEST = 2.5, 128.0  # px, the first and the last distance along an edge
LEAST_SIDE, SIDE = 1.25, 0.12  # px, and share of the distance: how far beside an edge it is read
CONTRAST = 0.35  # least contrast, as a share of that close to the corner
MOST = 1.5  # greatest distance of an edge's other end, over the distance to which it was followed
LEAST_BACK = 0.35  # share of the distance over which the edge of the other end must lead back
ASIDE = 0.2  # share of the distance by which the other end may lie beside the edge
OPPOSITE = -0.85  # largest cosine between the edges of both ends
INSIDE = 0.8  # share of a cell's side that is inside it
BESIDE = 0.08  # share of a cell's side: a corner that far outside still counts as inside
# times INSIDE of the cell's sides over the edges of a corner in it, where two or one of them end
LONGER, MUCH_LONGER = 1.2, 2.0
LEAST_SINE = 0.3  # of the angle between two edges that span a cell
LEAST_CELL = 9.0  # px; in smaller cells torn corners look like marks
ROW = 16.0  # px, height of the bins in which pairs are searched


def drop_marks(corners: Corners, image: Frame) -> Corners:
    """Return the corners without those inside another corner's cell.

    It is for boards whose cells hold dots, rings or codes. Two successive edges of a corner span
    its cell. A corner inside that cell is dropped if at least one of the two edges ends at a corner
    whose own edge leads back, and both edges are longer than its own edges: by half if both end so,
    else two and a half times. Cells under 9 px are left alone. Use it only for boards with marks:
    on a plain pattern with torn edges and cells under 10 px it drops up to one corner in a
    thousand. A smaller board within one cell of a larger one is taken for marks.

    corners: the result of a detector, with edges. image: the image that they were found in, (H, W)
        uint8 or uint16.

    Raises ImageError if the image is not grey, or a corner lies outside it; ConfigError if the
    corners are no Corners, or were refined by Midlines or not at all.
    """
    check_kind("corners", corners, Corners, ConfigError)
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
    """Return (N,) bool, True for corners that lie inside another corner's cell."""
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
    """Return (N, 4): the distance over which each edge keeps its direction and polarity, px.

    Grey levels on both sides of the edge are compared; they are taken further apart with the
    distance, so that the edge may bend a little. xy: (N, 2). ahead: (N, 4, 2), unit vectors along
    the edges. known: (N,), which corners to follow; the others get 0.
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
    """Return (N, 4): the index of the corner at the end of each edge, -1 if there is none.

    xy, ahead: as in `edge_lengths`, which gives `length`. one, other: (P,), the pairs of corners to
        examine. The other corner has an edge that leads back along this one with the opposite
        polarity.
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
    # The nearest is written last, and stays.
    chosen = chosen[np.argsort(-apart[chosen], kind="stable")]
    ends = np.full(length.shape, -1, np.int64)
    ends[one[chosen], edge[chosen]] = other[chosen]
    return ends


def _cross(first: Reals, second: Reals) -> Reals:
    product: Reals = first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]
    return product


def _pairs_within(xy: Reals, reach: Reals) -> tuple[Whole, Whole]:
    """Return two (P,): the pairs of a corner and the corners in the square of half side `reach`,
    px, around it; some lie a little above or below the square."""
    row = np.floor(xy[:, 1] / ROW)
    stride = 4 * (xy[:, 0].max() + reach.max() + 1)  # more than any x of a search
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
