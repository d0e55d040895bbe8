"""The sides of a board: the kernel equals the oracle in every number."""

import numpy as np
import pytest
from lattice_plans import K, gel, plan_for

from cmp_cl import detect
from cmp_cl.lattice.arrays import NONE, Board
from cmp_cl.lattice.borders import CONTRAST, UNSEEN
from cmp_cl.reference.lattice.borders import Sides


def settled(device, image, corners, full_scale=255):
    plan = plan_for(device, image, len(corners), full_scale)
    plan.take(image, corners.xy, corners.edges, corners.refusal)
    plan.start()
    return plan, plan.settle()


def part_of(board, box):
    arrays = {name: getattr(board, name)[box] for name in ("x", "y", "owner", "torn")}
    return Board(**arrays, sign=1)


def assert_equal_to_the_oracle(plan, board, image):
    border, _ = plan.measured(board)
    sides = Sides(board, image, K)
    assert plan.read("border", np.int32)[CONTRAST:].tolist() == sides.found()
    np.testing.assert_array_equal(border.ends, sides.reach != UNSEEN)
    return border


@pytest.mark.parametrize("bits", [8, 12])
def test_a_whole_gel_ends_at_all_sides(device, bits):
    image = gel(0.5, bits=bits)
    plan, board = settled(device, image, detect(image), 2**bits - 1)
    border = assert_equal_to_the_oracle(plan, board, image)
    assert border.ends.all()
    np.testing.assert_allclose(border.reach, 1, atol=0.1)


def test_where_cells_follow_no_pattern_ends(device):
    image = gel(0.5)
    plan, board = settled(device, image, detect(image))
    border = assert_equal_to_the_oracle(plan, part_of(board, np.s_[5:, 4:-4]), image)
    assert border.follows.tolist() == [True, False, True, True]
    assert border.ends.tolist() == [False, True, False, False]


@pytest.mark.parametrize("seed", range(12))
def test_parts_of_boards(device, seed):
    """Boards cut anywhere, that miss nodes, near the edges of an image."""
    draw = np.random.default_rng(seed)
    top, left = draw.integers(0, 60, 2)
    image = np.ascontiguousarray(gel(1.0, seed=seed)[top:, left : left + 200])
    plan, board = settled(device, image, detect(image))
    for share in (0.0, 0.05, 0.3):
        first, last = np.sort(draw.integers(0, min(board.owner.shape), (2, 2)), axis=0)
        box = np.s_[first[0] : last[0] + 2, first[1] : last[1] + 2]
        nodes = draw.random(board.owner.shape) >= share
        part = part_of(board.only(nodes & (board.owner != NONE)), box)
        assert_equal_to_the_oracle(plan, part, image)
