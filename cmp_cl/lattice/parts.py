"""What the host reads of the parts of a frame: their nodes, and the votes for where they lie."""

import numpy as np
from numpy.typing import NDArray

from cmp_cl.lattice.arrays import Numbers, Units, Votes, Whole
from cmp_cl.lattice.kernels import VOTE

FULL = 4  # faces around a corner inside its part


def parts_of(
    root: NDArray[np.int32],
    state: NDArray[np.int32],
    faces: NDArray[np.int32],
    votes: NDArray[np.int32],
    xy: NDArray[np.float32],
) -> tuple[Units, Votes]:
    """Return the nodes of all parts, of two faces or more, part after part, and their votes.

    root: (4 N,), state: (16 N,), faces: (4 N,), of `number_parts` in kernels/parts.cl. votes:
        (6 V,), of `find_votes` in kernels/votes.cl, in any order. xy: (N, 2), px.
    """
    roots = np.flatnonzero(faces > 1)
    roots = roots[np.argsort(-faces[roots], kind="stable")]
    rank = np.full(len(faces) + 1, -1)  # the last one is of half-edges without a part
    rank[roots] = np.arange(len(roots))
    return _units_of(rank[root], state, xy, faces[roots]), _votes_of(rank, votes)


def _units_of(
    rank: Whole, state: NDArray[np.int32], xy: NDArray[np.float32], faces: NDArray[np.int32]
) -> Units:
    part = np.ascontiguousarray(rank.reshape(-1, FULL).T)
    fresh = part >= 0  # at the first boundary of a corner in its part
    for s in range(1, FULL):
        fresh[s] &= (part[s] != part[:s]).all(axis=0)
    corner, boundary = np.nonzero(fresh.T)
    order = np.argsort(part[boundary, corner], kind="stable")
    corner, boundary = corner[order], boundary[order]
    column, row, direction, _ = state.reshape(-1, FULL, 4)[corner, boundary].T
    return Units(
        corner=corner,
        part=part[boundary, corner],
        number=column + 1j * row,
        rotation=(direction - boundary) % 4,
        rim=(part[1:] != part[0]).any(axis=0)[corner],
        at=xy[corner].astype(np.float64).view(np.complex128)[:, 0],
        faces=faces.astype(np.int64),
    )


def _votes_of(rank: Whole, votes: NDArray[np.int32]) -> Votes:
    first, second, quarter, column, row, weight = votes.reshape(-1, VOTE).T
    return summed(
        Votes(
            first=rank[first],
            second=rank[second],
            quarter=quarter.astype(np.int64),
            offset=column + 1j * row,
            weight=np.ascontiguousarray(weight).view(np.float32).astype(np.float64),
        )
    )


def summed(votes: Votes) -> Votes:
    """Return the sums of equal votes, the least ones added first, in the order of their parts."""
    pair, place = (votes.first << 32) + votes.second, keys(votes.offset)
    place += votes.quarter * (place.max(initial=0) + 1)
    order = np.lexsort((votes.weight, place, pair))
    pair, place, votes = pair[order], place[order], votes.chosen(order)
    fresh = np.ones(len(order), np.bool_)
    fresh[1:] = (pair[1:] != pair[:-1]) | (place[1:] != place[:-1])
    weight = np.bincount(fresh.cumsum() - 1, votes.weight)
    return votes.chosen(fresh)._replace(weight=weight.astype(np.float64))


def keys(number: Numbers) -> Whole:
    """Return one whole number, from 0 on, for each number, column by column."""
    column, row = (np.rint(each).astype(np.int64) for each in (number.real, number.imag))
    row -= row.min(initial=0)
    each: Whole = (column - column.min(initial=0)) * (row.max(initial=0) + 1) + row
    return each
