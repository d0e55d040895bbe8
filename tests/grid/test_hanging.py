"""The second largest region of a board, against the same in plain loops over its nodes."""

import numpy as np
import pytest
from lattice_plans import K, gel

from cmp_cl import NodeStatus, build_grid, detect
from cmp_cl.grid.choice import _hanging
from cmp_cl.lattice.arrays import LOOKED, NONE, Board


def step(at, row, column, down, right):
    """Return the mean of the steps before and after a node, or the one that is known, else None."""
    here, steps = at[row, column], []
    for r, c, sign in ((row + down, column + right, 1), (row - down, column - right, -1)):
        inside = 0 <= r < at.shape[0] and 0 <= c < at.shape[1]
        if inside and not np.isnan(at[r, c]):
            steps.append(sign * (at[r, c] - here))
    return sum(steps) / len(steps) if steps else None


def is_firm(board, at, image, row, column):
    """Return whether a node has a whole corner, and two cells of each colour that are alike."""
    along, down = step(at, row, column, 0, 1), step(at, row, column, 1, 0)
    if board.owner[row, column] < 0 or board.torn[row, column] or along is None or down is None:
        return False
    depth = K.cell_depth * min(1, K.wide_px / ((abs(along) + abs(down)) / 2))
    padded, levels = np.pad(image.astype(int), 1, mode="reflect"), []
    for way in (along + down, -along - down, down - along, along - down):
        point = at[row, column] + depth * way
        x, y = (
            int(np.clip(np.rint(each), 0, size - 1))
            for each, size in zip((point.real, point.imag), image.shape[::-1], strict=True)
        )
        levels.append(int(np.rint(padded[y : y + 3, x : x + 3].sum() / 9)))
    a, b, c, d = levels
    return abs(a - b) + abs(c - d) < K.passing * abs(a + b - c - d)


def second_region(board, image):
    at = board.x + 1j * board.y.astype(np.float64)
    left = {each for each in np.ndindex(at.shape) if is_firm(board, at, image, *each)}
    sizes = []
    while left:
        region, size = [left.pop()], 0
        while region:
            row, column = region.pop()
            size += 1
            around = {(row, column + 1), (row, column - 1), (row + 1, column), (row - 1, column)}
            region += around & left
            left -= around
        sizes.append(size)
    second = sorted(sizes)[-2] if len(sizes) > 1 else 0
    return second if second >= K.least_board else 0


@pytest.mark.parametrize("seed", range(6))
def test_regions_of_gels(device, seed):
    """Nodes are missing or rough, by chance and along a line of them."""
    image = gel(1.0, seed=seed)
    grid = build_grid(detect(image), image, device=device)
    draw = np.random.default_rng(seed)
    owner = np.where(
        grid.status == NodeStatus.MISSING, NONE, np.arange(grid.status.size).reshape(grid.shape)
    )
    torn = draw.random(grid.shape) < 0.05
    torn[:, 8] |= draw.random(grid.shape[0]) < (0, 0.6, 0.9, 1, 1, 1)[seed]
    owner[draw.random(grid.shape) < 0.05] = LOOKED
    x, y = grid.xy[..., 0], grid.xy[..., 1]
    board = Board(x=x, y=y, owner=owner, torn=torn, sign=1)
    found = _hanging(board, image)
    assert found == second_region(board, image)
    assert seed < 3 or found > 100
