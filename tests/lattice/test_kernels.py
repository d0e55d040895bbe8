"""Links, faces, parts, the nodes of a board and its sides: the kernels equal the oracle to the
bit."""

import dataclasses

import numpy as np
import pytest
from lattice_plans import K, gel, plan_for, started
from lattices import corners_at, drawn, keep
from scenes import SCENES

from cmp_cl import detect
from cmp_cl.lattice.arrays import LOOKED, NONE, Board
from cmp_cl.lattice.kernels import ROUNDS, SIDES, TAKEN
from cmp_cl.reference.lattice import borders
from cmp_cl.reference.lattice import nodes as lattice_nodes
from cmp_cl.reference.lattice import parts as lattice
from cmp_cl.synthetic import Indenter


def assert_half_edges_equal(plan, plane, wanted):
    """Compare what the kernels say of each half-edge, by the names of the oracle."""
    count = len(wanted.root)
    found = {
        name: plan.read(buffer, np.int32)[:count]
        for name, buffer in (("twin", "twin"), ("face", "face"), ("root", "part"))
    }
    cut = plan.read("cut", np.uint8)[:count]
    found["cut"] = np.where(found["face"] >= 0, cut[np.maximum(found["face"], 0)], 0)
    levels = plan.read("levels", np.uint16).reshape(plane.shape[0], plan.step)
    np.testing.assert_array_equal(levels[:, plan.pad :][:, : plane.shape[1]], plane)
    for name, values in found.items():
        np.testing.assert_array_equal(values, getattr(wanted, name), err_msg=name)
    numbered = (wanted.root >= 0) & ~wanted.contradicted
    state = plan.read("state", np.int32).reshape(-1, 4)[:count][numbered]
    for column, name in enumerate(("column", "row", "direction")):
        np.testing.assert_array_equal(state[:, column], getattr(wanted, name)[numbered])
    faces = np.bincount(wanted.root[numbered], minlength=count) // 4
    np.testing.assert_array_equal(plan.read("faces_of_part", np.int32)[:count], faces)


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


def board_of(numbers, xy, torn):
    """Return the board of these numbers, each of which only the first corner has, with a margin."""
    corner = np.flatnonzero(numbers[:, 3] == 1)
    _, first = np.unique(numbers[corner, :2], axis=0, return_index=True)
    corner = corner[np.sort(first)]
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


def assert_equal_to_the_oracle(device, image, corners, *, change=None, full_scale=255):
    """Compare the half-edges, and the board of the largest part, or of the numbers that `change`
    makes of its. Return the parts and the board."""
    count, torn = len(corners), corners.refusal != 0
    plan = started(device, image, corners, full_scale=full_scale)
    plane = lattice.levels_of(image, full_scale)
    parts = lattice.parts(plane, corners.xy, corners.edges, torn, K)
    assert_half_edges_equal(plan, plane, parts)
    numbers = numbers_of(parts, count)
    np.testing.assert_array_equal(plan.read("numbers", np.int32).reshape(-1, 4)[:count], numbers)
    found = plan.alone() if change is None else None
    numbers = numbers if change is None else change(numbers)
    found = plan.settle(numbers) if found is None else found
    if not numbers.any():
        assert found.x.shape == (0, 0)
        return parts, found
    board = board_of(numbers, corners.xy, torn)
    taken = numbers[:, 3] == TAKEN
    wanted = lattice_nodes.settled(plane, corners.xy, torn, corners.sigma, board, K, taken)
    wanted = borders.trimmed(wanted, image.shape, K)
    sides = borders.Sides(wanted, plane, K)
    assert plan.read("border", np.int32)[SIDES:].tolist() == sides.found()
    wanted = wanted.upright()
    for name in ("owner", "firm", "x", "y", "spread"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), err_msg=name)
    np.testing.assert_array_equal(found.torn & found.there, wanted.torn & wanted.there)
    assert found.sign == wanted.sign
    return parts, found


@pytest.mark.parametrize(("severity", "seed"), [(0.5, 5), (1.5, 6), (2.0, 7), (2.0, 8)])
def test_gels(device, severity, seed):
    image = gel(severity, seed=seed, indenter=Indenter.TORUS)
    _, board = assert_equal_to_the_oracle(device, image, detect(image))
    assert np.count_nonzero(board.owner >= 0) > 250


@pytest.mark.parametrize(
    ("name", "corners"), [("board with codes of 0.85", 35), ("board in motion, turned by 15", 54)]
)
def test_boards(device, name, corners):
    image = SCENES[name].view().image
    _, board = assert_equal_to_the_oracle(device, image, detect(image))
    assert np.count_nonzero(board.owner >= 0) == corners


@pytest.mark.parametrize(("bits", "full_scale"), [(8, 255), (16, 4085)])
def test_a_crop(device, bits, full_scale):
    image = np.ascontiguousarray(gel(1.0, bits=bits)[31:170, 47:250])
    assert_equal_to_the_oracle(device, image, detect(image), full_scale=full_scale)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 9])
def test_few_corners(device, count):
    image = gel(0.5)
    assert_equal_to_the_oracle(device, image, keep(detect(image), np.arange(count)))


def test_points_on_a_line(device):
    xy = np.stack([np.arange(20, 300, 9.5), np.full(30, 100.25)], axis=1)
    corners = corners_at(xy, edges=np.tile([0, 1.5, 3.1, -1.6], (30, 1)))
    assert_equal_to_the_oracle(device, gel(0.5), corners)


@pytest.mark.parametrize("order", [(0, 1, 2), (0, 2, 1)])
@pytest.mark.parametrize("y", [100, 128])
def test_of_equal_chords_the_one_to_the_lower_corner_is_a_link(device, order, y):
    """Two corners lie as far above the boundary of a third as below it, in one bin or in two."""
    xy = np.array([(100.0, y), (120.0, y - 4), (120.0, y + 4)])
    quarter = np.array([0, 1, 1]) * np.pi / 2
    edges = (quarter[:, None] + np.arange(4) * (np.pi / 2) + np.pi) % (2 * np.pi) - np.pi
    image = np.full((200, 200), 200, np.uint8)
    image[y + 1 :] = 50
    corners = keep(corners_at(xy, edges=edges), np.array(order))
    parts, _ = assert_equal_to_the_oracle(device, image, corners)
    assert parts.twin[0] >> 2 == 1


@pytest.mark.parametrize("seed", range(6))
def test_drawn_lattices(device, seed):
    """Lattices that are torn, sheared and shuffled on a plane image, so that links contradict."""
    draw = np.random.default_rng(seed)
    rows, columns, cell = 14, 17, 10.0
    y, x = np.mgrid[:160, :200]
    image = (((x // 10 + y // 10) % 2) * 150 + 50).astype(np.uint8)
    row, column = (each.ravel() for each in np.mgrid[1:rows, 1:columns])
    xy = np.stack([column, row], axis=1) * cell - 0.5
    xy += draw.normal(0, [0, 0.4, 1.0, 1.8, 2.6, 4.0][seed], xy.shape)
    turn = np.where((row + column) % 2, 0, np.pi / 2) + draw.normal(0, 0.1 * seed, len(xy))
    edges = turn[:, None] + np.arange(4) * (np.pi / 2) + draw.normal(0, 0.05 * seed, (len(xy), 4))
    edges = (edges + np.pi) % (2 * np.pi) - np.pi
    edges[draw.random(len(xy)) < 0.02 * seed] = np.nan
    corners = keep(corners_at(xy, edges=edges), draw.permutation(len(xy)))
    assert_equal_to_the_oracle(device, image, corners)


@pytest.mark.parametrize(("radius", "has_numbers"), [(4, True), (9, False)])
def test_a_dislocation(device, radius, has_numbers):
    """Around the middle a column is two columns farther, so that no numbers fit. Faces are cut
    apart until all parts have numbers; a large part, smooth far from the middle, stays without."""
    middle, cell = 12 * radius + 0.3, 10.0
    y, x = np.mgrid[: 24 * radius, : 24 * radius] - middle
    column, row = x / cell + np.arctan2(y, x) / np.pi, y / cell
    level = np.cos(np.pi * column) * np.cos(np.pi * row)
    level[np.hypot(x, y) > cell * radius] = 0
    image = (128 + 90 * np.tanh(3 * level)).astype(np.uint8)
    parts, _ = assert_equal_to_the_oracle(device, image, detect(image))
    assert parts.cut.max() > 0
    assert parts.contradicted.any() != has_numbers


def test_noise(device):
    """Points and directions at random, on noise."""
    draw = np.random.default_rng(3)
    image = draw.integers(0, 256, (101, 133)).astype(np.uint8)
    xy = draw.random((700, 2)) * [140, 110] - 4
    corners = corners_at(xy, edges=draw.uniform(-np.pi, np.pi, (700, 4)))
    assert_equal_to_the_oracle(device, image, corners)


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
    _, board = assert_equal_to_the_oracle(device, image, corners, change=change)
    assert np.count_nonzero(board.owner >= 0) > 0.95 * len(corners)


@pytest.mark.parametrize("seed", range(3))
def test_numbers_at_random(device, seed):
    """Numbers without sense, so that places and corners are disputed."""
    image, draw = gel(1.0), np.random.default_rng(seed)
    corners = detect(image)

    def change(numbers):
        noise = draw.normal(0, 0.4, corners.xy.shape)
        place = np.rint(corners.xy / [9.0, 11.0, 13.0][seed] + noise)
        kept = draw.random(len(numbers)) < 0.7
        turn = draw.integers(0, 4, len(place))
        return np.column_stack([place, turn, kept]).astype(np.int32)

    assert_equal_to_the_oracle(device, image, corners, change=change)


def test_corners_of_another_board_are_no_nodes(device):
    image, draw = gel(1.0), np.random.default_rng(4)
    corners = detect(image)
    taken, none = draw.random((2, len(corners))) < [[0.1], [0.1]]

    def change(numbers):
        numbers = numbers.copy()
        numbers[none, 3] = 0
        numbers[taken] = TAKEN
        return numbers

    _, board = assert_equal_to_the_oracle(device, image, corners, change=change)
    assert not np.isin(board.owner[board.owner >= 0], np.flatnonzero(taken)).any()
    assert np.isin(np.flatnonzero(none & ~taken), board.owner).mean() > 0.9


def test_a_board_that_grows_to_the_last_round_ignores_the_frame_before(device):
    """A dim one after a bright one: contrasts that this left at the edge of the array counted."""
    bright, _ = drawn(18, 36)
    dim = bright // 10 + 120

    def settled(plan, image, kept):
        corners = detect(image)
        plan.take(image, corners)
        plan.enqueue(plan.launches)  # the board of a frame of several parts waits
        numbers = plan.read("numbers", np.int32).reshape(-1, 4)[: len(corners)].copy()
        place = numbers[:, :2] - numbers[:, :2].min(axis=0)
        numbers[(place >= kept).any(axis=1), 3] = 0
        return plan.settle(numbers)

    used = plan_for(device, bright, 18 * 36)
    settled(used, bright, 36)
    wanted = settled(plan_for(device, dim, 18 * 36), dim, 4)
    assert wanted.there.shape == (4 + ROUNDS, 4 + ROUNDS)
    found = settled(used, dim, 4)
    np.testing.assert_array_equal(found.owner, wanted.owner)


def test_only_corners_that_fit_the_corner_model_are_weighed_against_their_neighbours(device):
    """Whatever sigma the others have."""
    image = gel(1.5)
    corners = detect(image)
    refused = np.random.default_rng(1).random(len(corners)) < 0.3
    corners = dataclasses.replace(corners, refusal=np.where(refused, 1, corners.refusal))
    _, board = assert_equal_to_the_oracle(device, image, corners)
    mine, owner = board.owner >= 0, board.owner[board.owner >= 0]
    known = np.isfinite(corners.sigma[owner])
    assert np.count_nonzero(refused[owner] & known) > 50
    assert not board.spread[mine][refused[owner]].any()
    assert (board.spread[mine][known & ~refused[owner] & board.torn[mine]] > 0).any()


def test_places_without_a_corner(device):
    """Where corners are left out, the places that the neighbours predict become nodes."""
    image = gel(0.5)
    corners = detect(image)
    kept = np.random.default_rng(0).random(len(corners)) < 0.9
    _, board = assert_equal_to_the_oracle(device, image, keep(corners, kept))
    assert np.count_nonzero(board.owner == LOOKED) > 0.05 * len(corners)
    assert np.count_nonzero(board.owner != NONE) > 0.95 * len(corners)


def test_a_place_at_the_edge_of_the_image_gets_no_node(device):
    """Its four cells cannot be read there; corners that are seen there may be nodes."""
    for first in (28, 37):
        image = np.ascontiguousarray(gel(0.5)[first:170, first + 9 : 250])
        corners = detect(image)
        kept = np.random.default_rng(first).random(len(corners)) < 0.8
        _, board = assert_equal_to_the_oracle(device, image, keep(corners, kept))
        looked = np.stack([board.x, board.y], axis=-1)[board.owner == LOOKED]
        last = np.array(image.shape[::-1]) - 1
        assert np.minimum(looked, last - looked).min() > K.contrast_radius_px
