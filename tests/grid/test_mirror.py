"""A part of the pattern that is the reflection of another part makes the grid ambiguous."""

import cv2
import numpy as np
import pytest

from cmp_cl import DetectorConfig, build_grid, detect
from cmp_cl.errors import GridError
from cmp_cl.grid import NodeStatus
from cmp_cl.grid.mirror import has_diagonal_seam, has_seam, repeats_reversed

CELL = 14  # px
HIGH, WIDE = 15 * CELL, 12 * CELL  # px: the view of a pattern without end


def checkerboard(
    *, errors: float, wave: float = 0.0, phase: float = 0.5, seed: int = 3
) -> np.ndarray:
    """Draw a checkerboard that continues past the image.

    errors: standard deviation of the printing errors, wave: size of a bend, phase: position of the
    first column, all in cells.
    """
    draw = np.random.default_rng(seed)
    y, x = np.indices((4 * HIGH, 4 * WIDE), np.float32) / 4 / CELL
    x, y = x + np.float32(wave) * np.sin(y / 3), y + np.float32(wave) * np.sin(x / 2)
    error = draw.normal(0, errors, (2, 24, 24)).astype(np.float32)
    x, y = (
        line + cv2.remap(each, x + 2, y + 2, cv2.INTER_LINEAR)
        for line, each in zip((x, y), error, strict=True)
    )
    board = (np.floor(x + phase) + np.floor(y)) % 2 * np.float32(160) + 45
    small = cv2.resize(board, (WIDE, HIGH), interpolation=cv2.INTER_AREA)
    noisy = cv2.GaussianBlur(small, (0, 0), 0.7) + draw.normal(0, 2, small.shape)
    return noisy.round().astype(np.uint8)


def mirrored(image: np.ndarray) -> np.ndarray:
    """Return the left part of an image and, beyond it, its reflection, as a mirror shows it."""
    kept = image[:, : 7 * CELL]
    noise = np.random.default_rng(8).integers(-2, 3, kept.shape)
    return np.hstack([kept, np.clip(kept[:, ::-1] + noise, 0, 255).astype(np.uint8)])


def numbered(image, **known):
    return build_grid(detect(image, DetectorConfig.for_cell(CELL)), image, **known)


def test_a_reflection_of_a_print_with_errors_is_doubted():
    image = mirrored(checkerboard(errors=0.03))
    grid = numbered(image)
    assert grid.shape[1] > 12
    assert grid.reflected
    assert grid.ambiguous
    assert "reflection" in grid.doubts[0]
    with pytest.raises(GridError, match="reflection"):
        numbered(image, strict=True)


@pytest.mark.parametrize("quarters", range(4))
def test_a_seam_along_a_diagonal_shows_on_a_perfect_print(quarters):
    row, column = np.indices((20, 24))
    at = CELL * (column + 1j * row)
    normal = np.exp(1j * (np.pi / 4 + 0.02))  # of the mirror, which goes through row + column = 20
    before = CELL * (20 - row + 1j * (20 - column)) - CELL * 20
    at = np.where(row + column > 20, CELL * 20 - normal**2 * before.conj(), at)
    at += np.random.default_rng(4).normal(0, 0.03, at.shape)
    at = np.rot90(at, quarters)
    assert has_diagonal_seam(at)
    assert repeats_reversed(at)


def test_a_reflection_with_a_seam_is_doubted_on_a_perfect_print():
    grid = numbered(mirrored(checkerboard(errors=0.0, phase=0.57)))
    assert grid.shape[1] > 12
    assert grid.reflected


@pytest.mark.parametrize("quarters", range(4))
def test_a_darker_reflection_is_doubted_on_a_perfect_print(quarters):
    image = mirrored(checkerboard(errors=0.0)).astype(float)
    image[:, 7 * CELL :] *= 0.8
    image = np.ascontiguousarray(np.rot90(image, quarters).round().astype(np.uint8))
    assert min(numbered(image).shape) > 12
    assert numbered(image).reflected


def shadowed(image: np.ndarray, slope: float) -> np.ndarray:
    row, column = np.indices(image.shape)
    shade = np.where(column - slope * row > 6 * CELL, 0.8, 1)
    return (image * shade).round().astype(np.uint8)


@pytest.mark.parametrize(
    ("errors", "wave", "slope"), [(0.03, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.2)]
)
def test_a_shadow_is_no_mirror(errors, wave, slope):
    image = shadowed(checkerboard(errors=errors, wave=wave), slope)
    assert not numbered(image).doubts


@pytest.mark.parametrize("errors", [0.0, 0.03])
@pytest.mark.parametrize("wave", [0.0, 0.3])
def test_a_pattern_without_a_mirror_is_not_doubted(errors, wave):
    assert not numbered(checkerboard(errors=errors, wave=wave)).doubts


def nodes(rows=20, columns=24, errors=0.03, seed=0):
    draw = np.random.default_rng(seed)
    row, column = np.indices((rows, columns))
    error = draw.normal(0, errors, (2, rows, columns))
    return 12 * (column + error[0] + 1j * (row + error[1]))


@pytest.mark.parametrize("quarters", range(4))
def test_errors_reversed_across_a_line_of_cells_are_a_reflection(quarters):
    at = nodes()
    assert not repeats_reversed(np.rot90(at, quarters))
    at[:, 14:] = 12 * 27 - at[:, 13:3:-1].conj()
    assert repeats_reversed(np.rot90(at, quarters))
    assert not has_seam(np.rot90(at, quarters))


@pytest.mark.parametrize("quarters", range(4))
def test_errors_reversed_across_a_diagonal_are_a_reflection(quarters):
    at = nodes(20, 20)
    row, column = np.nonzero(np.tri(20, k=-1))
    at[row, column] = 1j * at[column, row].conj()
    assert repeats_reversed(np.rot90(at, quarters))


def test_errors_repeated_in_the_same_order_are_no_reflection():
    at = nodes()
    at[:, 14:] = 12 * 12 + at[:, 2:12]
    assert not repeats_reversed(at)


def test_the_errors_of_all_lines_show_a_narrow_reflection():
    found = []
    for seed in range(8):
        at = nodes(60, 24, seed=seed)
        assert not repeats_reversed(at)
        at[:, 21:] = 12 * 41 - at[:, 20:17:-1].conj()
        found.append(repeats_reversed(at))
    assert all(found)


def test_errors_that_may_be_the_cameras_are_no_reflection():
    at = nodes(errors=0.002)
    at[:, 14:] = 12 * 27 - at[:, 13:3:-1].conj()
    assert not repeats_reversed(at)


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_step_across_one_line_is_a_seam_even_if_nodes_are_lost_there(lost):
    at = nodes(errors=0.005)
    assert not has_seam(at)
    at[:, 10:] += 0.2 * 12
    at[:, 10 : 10 + lost] = np.nan
    assert has_seam(at)
    assert has_seam(at.T)


def test_a_frame_like_one_with_a_reflection_is_doubted_too():
    rest = numbered(mirrored(checkerboard(errors=0.03)))
    grid = numbered(checkerboard(errors=0.03), like=rest)
    assert (grid.status == NodeStatus.DETECTED).any()
    assert grid.reflected


def test_errors_that_are_repeated_many_times_are_no_reflection():
    at = nodes(20, 32, errors=0.002)
    row, column = np.indices(at.shape)
    ripple = np.random.default_rng(4).normal(0, 1, 20)[row] * np.sin((column - 15.5) * np.pi / 4)
    assert not repeats_reversed(at + 12 * 0.06 * ripple)


@pytest.mark.parametrize(("share", "is_one"), [(0.6, False), (0.85, True)])
def test_most_of_the_errors_are_repeated_in_a_reflection(share, is_one):
    own, common = nodes(44, 44, seed=1), nodes(44, 44, seed=2)
    common[:, 22:] = 12 * 43 - common[:, 21::-1].conj()
    at = np.sqrt(1 - share**2) * own + share * common
    assert repeats_reversed(at) == is_one
