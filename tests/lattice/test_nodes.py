"""The nodes of a board and its sides: the kernels equal the oracle, positions to the bit."""

import numpy as np
import pytest
from lattice_plans import K, gel, plan_for
from lattices import keep
from scenes import SCENES

from cmp_cl import detect
from cmp_cl.lattice.arrays import LOOKED, NONE, Board
from cmp_cl.lattice.kernels import ROUNDS, SIDES, TAKEN
from cmp_cl.reference import harmonic
from cmp_cl.reference.lattice import borders
from cmp_cl.reference.lattice import nodes as lattice_nodes
from cmp_cl.reference.lattice import parts as lattice
from cmp_cl.synthetic import Indenter


def numbers_of(wanted, count):
    """Return the numbers of the corners in the largest part, (N, 4) as `LatticePlan.settle`."""
    h = np.flatnonzero((wanted.root >= 0) & ~wanted.contradicted)
    roots, faces = np.unique(wanted.root[h], return_counts=True)
    numbers = np.zeros((count, 4), np.int32)
    if len(roots):
        h = h[wanted.root[h] == roots[faces.argmax()]]
        turn = (wanted.direction[h] - h) % 4
        numbers[h >> 2] = np.stack([wanted.column[h], wanted.row[h], turn, h * 0 + 1], axis=1)
    return numbers


def alone(numbers):
    """Return the numbers without those that a corner before has."""
    numbers = numbers.copy()
    some = np.flatnonzero(numbers[:, 3] == 1)
    _, first = np.unique(numbers[some, :2], axis=0, return_index=True)
    numbers[np.delete(some, first), 3] = 0
    return numbers


def board_of(numbers, xy, torn):
    """Return the board of these numbers, with a margin."""
    corner = np.flatnonzero(numbers[:, 3] == 1)
    margin = ROUNDS + 2
    column, row, turn, _ = numbers[corner].T.astype(np.int64)
    column, row = column - column.min() + margin, row - row.min() + margin
    shape = row.max() + margin + 1, column.max() + margin + 1
    x, y = (np.full(shape, np.nan, np.float32) for _ in range(2))
    owner, rough = np.full(shape, NONE), np.zeros(shape, np.bool_)
    x[row, column], y[row, column] = xy[corner].T
    owner[row, column], rough[row, column] = corner, torn[corner]
    sign = 1 if ((-1) ** (turn + row + column)).sum() >= 0 else -1
    return Board(x=x, y=y, owner=owner, torn=rough, sign=sign)


def assert_equal_to_the_oracle(device, image, corners, *, change=None):
    """Compare the board of the largest part, or of the numbers that `change` makes of its."""
    count = len(corners)
    plan = plan_for(device, image, count)
    plan.take(image, corners.xy, corners.edges, corners.refusal)
    plan.start()
    plane = harmonic.smoothed(image, 255)[0]
    numbers = numbers_of(
        lattice.parts(plane, corners.xy, corners.edges, corners.refusal != 0, K), count
    )
    np.testing.assert_array_equal(plan.read("numbers", np.int32).reshape(-1, 4)[:count], numbers)
    if change is not None:
        numbers = change(numbers)
    alone_in_view = plan.alone() if change is None else None
    found = plan.settle(numbers) if alone_in_view is None else alone_in_view
    torn = corners.refusal != 0
    wanted = lattice_nodes.settled(
        plane,
        corners.xy,
        torn,
        board_of(alone(numbers), corners.xy, torn),
        K,
        numbers[:, 3] == TAKEN,
    )
    wanted = borders.trimmed(wanted, image.shape, K)
    sides = borders.Sides(wanted, image, K)
    assert plan.read("border", np.int32)[SIDES:].tolist() == sides.found()
    wanted = wanted.upright()
    np.testing.assert_array_equal(found.owner, wanted.owner)
    np.testing.assert_array_equal(found.torn & found.there, wanted.torn & wanted.there)
    np.testing.assert_array_equal(found.firm, wanted.firm)
    np.testing.assert_array_equal(found.x, wanted.x)
    np.testing.assert_array_equal(found.y, wanted.y)
    assert found.sign == wanted.sign
    return found


@pytest.mark.parametrize(("severity", "seed"), [(0.5, 5), (1.5, 6), (2.0, 7), (2.0, 8)])
def test_gels(device, severity, seed):
    image = gel(severity, seed=seed, indenter=Indenter.TORUS)
    board = assert_equal_to_the_oracle(device, image, detect(image))
    assert np.count_nonzero(board.owner >= 0) > 250


def test_wide_cells_with_codes(device):
    image = SCENES["board with codes of 0.85"].view().image
    board = assert_equal_to_the_oracle(device, image, detect(image))
    assert np.count_nonzero(board.owner >= 0) == 35


def test_a_crop(device):
    image = np.ascontiguousarray(gel(1.0)[31:170, 47:250])
    assert_equal_to_the_oracle(device, image, detect(image))


def test_nodes_are_dropped_and_found(device):
    """Some corners get a wrong number, and some none."""
    image, draw = gel(1.0), np.random.default_rng(2)

    def change(numbers):
        numbers = numbers.copy()
        wrong, none = draw.random((2, len(numbers))) < [[0.03], [0.2]]
        numbers[wrong, :2] += draw.integers(-3, 4, (np.count_nonzero(wrong), 2))
        numbers[none, 3] = 0
        return numbers

    corners = detect(image)
    board = assert_equal_to_the_oracle(device, image, corners, change=change)
    assert np.count_nonzero(board.owner >= 0) > 0.95 * len(corners)


@pytest.mark.parametrize("seed", range(3))
def test_numbers_at_random(device, seed):
    """Numbers without sense, so that places and corners are disputed."""
    image, draw = gel(1.0), np.random.default_rng(seed)
    corners = detect(image)

    def change(numbers):
        place = np.rint(
            corners.xy / [9.0, 11.0, 13.0][seed] + draw.normal(0, 0.4, corners.xy.shape)
        )
        kept = draw.random(len(numbers)) < 0.7
        return np.concatenate([place, draw.integers(0, 4, (len(place), 1)), kept[:, None]], axis=1)

    assert_equal_to_the_oracle(
        device, image, corners, change=lambda numbers: change(numbers).astype(np.int32)
    )


def test_corners_of_another_board_are_no_nodes(device):
    image, draw = gel(1.0), np.random.default_rng(4)
    corners = detect(image)
    taken, none = draw.random((2, len(corners))) < [[0.1], [0.1]]

    def change(numbers):
        numbers = numbers.copy()
        numbers[none, 3] = 0
        numbers[taken] = TAKEN
        return numbers

    board = assert_equal_to_the_oracle(device, image, corners, change=change)
    assert not np.isin(board.owner[board.owner >= 0], np.flatnonzero(taken)).any()
    assert np.isin(np.flatnonzero(none & ~taken), board.owner).mean() > 0.9


def test_places_without_a_corner(device):
    """Where corners are left out, the places that the neighbours predict become nodes."""
    image = gel(0.5)
    corners = detect(image)
    kept = np.random.default_rng(0).random(len(corners)) < 0.9
    board = assert_equal_to_the_oracle(device, image, keep(corners, kept))
    assert np.count_nonzero(board.owner == LOOKED) > 0.05 * len(corners)
    assert np.count_nonzero(board.owner != NONE) > 0.95 * len(corners)


def test_a_place_at_the_edge_of_the_image_gets_no_node(device):
    """Its four cells cannot be read there; corners that are seen there may be nodes."""
    for first in (28, 37):
        image = np.ascontiguousarray(gel(0.5)[first:170, first + 9 : 250])
        corners = detect(image)
        kept = np.random.default_rng(first).random(len(corners)) < 0.8
        board = assert_equal_to_the_oracle(device, image, keep(corners, kept))
        looked = np.stack([board.x, board.y], axis=-1)[board.owner == LOOKED]
        last = np.array(image.shape[::-1]) - 1
        assert np.minimum(looked, last - looked).min() > K.contrast_radius_px


@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_few_corners_have_no_board(device, count):
    image = gel(0.5)
    corners = detect(image)
    plan = plan_for(device, image, count)
    plan.take(image, *(getattr(corners, name)[:count] for name in ("xy", "edges", "refusal")))
    plan.start()
    assert plan.alone().x.shape == (0, 0)
