"""The sides of a board: the kernel equals the oracle in every number."""

import dataclasses

import numpy as np
import pytest
from cases import some
from lattice_plans import K, gel, plan_for, started

from cmp_cl import detect
from cmp_cl.lattice.arrays import NONE, UNSEEN, Board, Border
from cmp_cl.lattice.kernels import FIRM, LAYOUT, ROUGH, SIDES
from cmp_cl.reference.lattice.borders import Sides, trimmed
from cmp_cl.reference.lattice.parts import levels_of


def part_of(board, box):
    arrays = {name: getattr(board, name)[box] for name in ("x", "y", "owner", "torn")}
    return Board(**arrays, sign=1)


def lay(plan, board):
    layout = np.zeros(LAYOUT, np.int32)
    layout[3:6] = *board.owner.shape, board.sign
    plan.write("layout", layout)
    plan.write("result", np.stack([board.x, board.y], axis=2))
    plan.write("owner", board.owner.astype(np.int32))


def assert_equal_to_the_oracle(plan, board, image):
    rows, columns = board.owner.shape
    lay(plan, board)
    plan.write("border", np.array([0, rows, 0, columns], np.int32))
    plan.enqueue([each for each in plan.lay if each[0] == "measure_border"])
    found = plan.read("border", np.int32)[SIDES:]
    sides = Sides(board, levels_of(image, 255), K)
    assert found.tolist() == sides.found()
    np.testing.assert_array_equal(Border.of(found).ends, sides.reach != UNSEEN)


@pytest.mark.parametrize("seed", some(range(12), range(6)))
def test_parts_of_boards(device, seed):
    """Boards cut anywhere, that miss nodes, near the edges of an image."""
    draw = np.random.default_rng(seed)
    top, left = draw.integers(0, 60, 2)
    image = np.ascontiguousarray(gel(1.0, seed=seed)[top:, left : left + 200])
    plan = started(device, image, detect(image))
    board = plan.alone()
    for share in (0.0, 0.05, 0.3):
        first, last = np.sort(draw.integers(0, min(board.owner.shape), (2, 2)), axis=0)
        box = np.s_[first[0] : last[0] + 2, first[1] : last[1] + 2]
        nodes = draw.random(board.owner.shape) >= share
        part = part_of(dataclasses.replace(board, owner=np.where(nodes, board.owner, NONE)), box)
        assert_equal_to_the_oracle(plan, part, image)


@pytest.mark.parametrize("seed", range(20))
def test_outer_lines_of_few_nodes_are_taken_off(device, seed):
    """A full board, turned by any angle, with up to three lines at each side that hold a share of
    their nodes, some of whose places lie outside the image."""
    draw = np.random.default_rng(seed)
    shape, (rows, columns) = (240, 320), draw.integers(8, 16, 2)
    nodes = np.ones((rows, columns), np.bool_)
    for line in range(int(draw.integers(1, 4))):
        for way in (nodes, nodes[::-1], nodes.T, nodes.T[::-1]):
            way[line] &= draw.random(way.shape[1]) < draw.choice([0.3, 0.75, 0.85, 1.0])
    nodes = np.pad(nodes, 1)
    row, column = np.indices(nodes.shape)
    turn = np.exp(1j * draw.uniform(0, 2 * np.pi))
    away = column - columns / 2 + 1j * (row - rows / 2)
    at = away * turn * 15 + complex(*draw.uniform((100, 80), (220, 160)))
    x, y = (np.where(nodes, each, np.nan).astype(np.float32) for each in (at.real, at.imag))
    owner = np.where(nodes, row * nodes.shape[1] + column, NONE)
    torn, alike = draw.random((2, *nodes.shape)) < [[[0.1]], [[0.8]]]
    board = Board(x=x, y=y, owner=owner, torn=torn, sign=1, firm=alike & nodes & ~torn)
    plan = plan_for(device, np.zeros(shape, np.uint8), nodes.size)
    lay(plan, board)
    plan.write("kind", np.where(board.torn, ROUGH, FIRM * board.firm).astype(np.uint8))
    plan.enqueue([each for each in plan.lay if each[0] == "cut_board"])
    wanted = trimmed(board, shape, K)
    top, bottom, left, right = plan.read("border", np.int32, SIDES)
    np.testing.assert_array_equal(owner[top:bottom, left:right], wanted.owner)
    assert 0 < wanted.owner.size < nodes.size
