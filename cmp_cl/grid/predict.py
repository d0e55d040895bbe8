"""Predictions of nodes from their neighbours, and the mean steps between nodes."""

from typing import NamedTuple

import cv2
import numpy as np

from cmp_cl.grid.nodes import NOWHERE, Float, Index, Mask, Nodes, Points, kept_by_mask


# (weight, {(row, column): factor, ...}) of each prediction of a node from its neighbours
def _predictors() -> list[tuple[float, dict[tuple[int, int], float]]]:
    found: list[tuple[float, dict[tuple[int, int], float]]] = []
    for r, c in ((0, 1), (1, 0)):
        line = {(-r, -c): 4 / 6, (r, c): 4 / 6, (-2 * r, -2 * c): -1 / 6, (2 * r, 2 * c): -1 / 6}
        found.append((12, line))
        found.append((4, {(-r, -c): 0.5, (r, c): 0.5}))
    for r, c in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        found.append((1.5, {(r, 0): 1, (0, c): 1, (r, c): -1}))
    for r, c in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        found.append((0.7, {(r, c): 2, (2 * r, 2 * c): -1}))
        found.append((0.7, {(r, c): 3, (2 * r, 2 * c): -3, (3 * r, 3 * c): 1}))
    return found


PREDICTORS = _predictors()
STEPS = np.array(sorted({step for _, factors in PREDICTORS for step in factors}))
WEIGHTS = np.array([weight for weight, _ in PREDICTORS])
FACTORS = np.array([[factors.get((r, c), 0) for r, c in STEPS] for _, factors in PREDICTORS])
USES = (FACTORS != 0).astype(np.float64)
WEIGHTED = WEIGHTS[:, None] * FACTORS
FULL: float = WEIGHTS.sum()
KERNEL = np.zeros((7, 7))  # the mean of all predictions
KERNEL[tuple(STEPS.T + 3)] = WEIGHTED.sum(axis=0) / WEIGHTS.sum()
ALONG = np.array([[(r, c) for c in range(-2, 3)] for r in (-1, 0, 1)])  # parts of three rows
LINES = np.stack([ALONG, ALONG[..., ::-1]])  # and of columns, whose steps are taken
TOUCHED = np.kron(np.eye(2), [1, 2, 2, 1] * 3)  # how many of the 3 x 3 nodes touch each step
REACHED = np.array(  # nodes whose prediction or cell changes with the node in the middle
    [(r, c) for r in range(-3, 4) for c in range(-3, 4) if 0 in (r, c) or max(abs(r), abs(c)) < 3]
)


class Steps(NamedTuple):
    """The steps from node to node around M nodes.

    near: (2, 3, 5, M), the nodes that they join, by number in the grid with three missing nodes on
    every side. unknown: (24, M) bool, the steps from or to a missing node. share: (2, M), 1 over
    the weight of the known steps, NaN if there are none.
    """

    near: Index
    unknown: Mask
    share: Float

    @classmethod
    def of(cls, there: Mask, row: Index, column: Index) -> "Steps":
        """Return the steps around some nodes of a grid; there: (R, C), where it has nodes."""
        missing, place = _around(there, row, column)
        near = LINES[..., :1] * missing.shape[1] + LINES[..., 1:] + place
        lost = missing.take(near)
        unknown = (lost[:, :, 1:] | lost[:, :, :-1]).reshape(TOUCHED.shape[1], len(row))
        return cls(near, unknown, _inverse(TOUCHED @ ~unknown))

    def mean(self, at: Points) -> tuple[Points, Points, Float]:
        """Return the step to the next column, to the next row, and the cell at each node, (M,), px.

        They are means of the steps to and from the 3 x 3 nodes around; at: (R, C), px.
        """
        near = bordered(at).take(self.near)
        step = (near[:, :, 1:] - near[:, :, :-1]).reshape(self.unknown.shape)
        np.copyto(step, 0, where=self.unknown)
        mean: Points = (TOUCHED @ step.view(np.float64)).view(np.complex128) * self.share
        length = np.abs(mean)
        np.copyto(length, length[::-1], where=np.isnan(length))
        return mean[0], mean[1], (length[0] + length[1]) / 2


class Stencil(NamedTuple):
    """The factors by which neighbours predict M nodes.

    near: (24, M), the neighbours by number in the grid with three missing nodes on every side.
    factors: (24, 2 M), of their x and y, 0 for those that are not there. weight: (M,), of the
    predictions. share: (M,), 1 / weight, NaN for a weight of 0.
    """

    near: Index
    factors: Float
    weight: Float
    share: Float

    @classmethod
    def of(cls, there: Mask, row: Index, column: Index) -> "Stencil":
        """Return the stencil of some nodes of a grid; there: (R, C), where it has nodes."""
        missing, place = _around(there, row, column)
        near = STEPS[:, :1] * missing.shape[1] + STEPS[:, 1:] + place
        known = USES @ missing.take(near) == 0
        weight: Float = WEIGHTS @ known
        return cls(near, (WEIGHTED.T @ known).repeat(2, axis=1), weight, _inverse(weight))

    def predict(self, at: Points) -> Points:
        """Return the predictions, NaN where nothing is known; at: (R, C), px."""
        known = bordered(np.where(np.isnan(at.real), 0, at), nothing=0)
        near = known.take(self.near).view(np.float64)
        near *= self.factors
        predicted: Points = near.sum(0).view(np.complex128) * self.share
        return predicted


def predict(at: Points, row: Index, column: Index) -> tuple[Points, Float]:
    """Predict nodes from their neighbours; also return the weight of the prediction.

    Along a row or column (4 (L + R) - (LL + RR)) / 6 with weight 12 and (L + R) / 2 with 4,
    the parallelograms with 1.5, linear and quadratic extrapolation with 0.7 each.
    """
    stencil = Stencil.of(~np.isnan(at.real), row, column)
    return stencil.predict(at), stencil.weight


def predict_some(nodes: Nodes, row: Index, column: Index) -> tuple[Points, Float]:
    """Return the predictions of some nodes and their weights; if those of all nodes are kept, take
    them from there."""
    if nodes.predicted is None:
        return predict(nodes.at, row, column)
    predicted, weight = nodes.predicted
    return predicted[row, column], weight[row, column]


def predict_all(nodes: Nodes) -> tuple[Points, Float]:
    """Return the predictions of all nodes, and their weights, (R, C); keep them until a node
    changes."""
    if nodes.predicted is None:
        place, stencil, weight = _beside_missing(nodes.there)
        predicted = predict_within(nodes.at)
        predicted.ravel()[place] = stencil.predict(nodes.at)
        nodes.predicted = predicted, weight
    return nodes.predicted


@kept_by_mask
def _beside_missing(there: Mask) -> tuple[Index, Stencil, Float]:
    """Return the places, (M,), that `predict_within` leaves out, their stencil, and the weights of
    the predictions of all nodes, (R, C)."""
    place = np.flatnonzero(np.isnan(predict_within(np.where(there, 0, NOWHERE)).real))
    stencil = Stencil.of(there, *np.divmod(place, there.shape[1]))
    weight = np.full(there.shape, FULL)
    weight.ravel()[place] = stencil.weight
    return place, stencil, weight


def predict_within(at: Points) -> Points:
    """Return the predictions of all nodes, (R, C); NaN where one of the nodes around is missing."""
    pixels = np.ascontiguousarray(at).view(np.float64).reshape(*at.shape, 2)
    border = cv2.BORDER_CONSTANT  # the fastest; it is cut off
    filtered = cv2.filter2D(pixels, -1, KERNEL, borderType=border)  # skips factors of 0
    predicted = np.full(at.shape, NOWHERE)
    predicted.view(np.float64).reshape(pixels.shape)[3:-3, 3:-3] = filtered[3:-3, 3:-3]
    return predicted


def bordered(at: Points, nothing: complex = NOWHERE) -> Points:
    """Return the nodes with three more on every side, `nothing`: missing ones by default."""
    rows, columns = at.shape
    padded = np.full((rows + 6, columns + 6), nothing, np.complex128)
    padded[3:-3, 3:-3] = at
    return padded


def _around(there: Mask, row: Index, column: Index) -> tuple[Mask, Index]:
    """Return a mask of missing nodes with three of them on every side, and the places there, (M,),
    of some nodes."""
    rows, columns = there.shape
    missing = np.ones((rows + 6, columns + 6), np.bool_)
    missing[3:-3, 3:-3] = ~there
    return missing, (row + 3) * (columns + 6) + column + 3


def _inverse(weight: Float) -> Float:
    """Return 1 / weight, NaN for a weight of 0."""
    return 1 / np.where(weight == 0, np.nan, weight)


def mean_steps(at: Points, row: Index, column: Index) -> tuple[Points, Points, Float]:
    """Return the step to the next column, to the next row, and the cell there, each (M,), px.

    They are means of the steps to and from the 3 x 3 nodes around; NaN if there are none.
    """
    return Steps.of(~np.isnan(at.real), row, column).mean(at)
