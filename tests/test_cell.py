"""The cell size from the image alone."""

import cv2
import numpy as np
import pytest
from cases import some
from corner_images import board, noise

import cmp_cl
import cmp_cl.cell as cell_module
from cmp_cl.cell import estimate_blur, estimate_cell, estimate_cells
from cmp_cl.config import DetectorConfig
from cmp_cl.errors import ImageError


def by_definition(image: np.ndarray) -> float:
    """Return the median, by length, of the runs of 3 px and more between two changes along rows and
    columns. The threshold is the mean of a window of 63 px."""
    padded = np.pad(image.astype(np.int64), 31, mode="edge")
    total = cv2.integral(padded.astype(np.float64))
    total = total[63:, 63:] - total[:-63, 63:] - total[63:, :-63] + total[:-63, :-63]
    black = image.astype(np.int64) * 63 * 63 < total
    lengths = []
    for line in [*black, *black.T]:
        changes = np.flatnonzero(line[1:] != line[:-1])
        lengths += [int(n) for n in np.diff(changes) if n >= 3]
    lengths.sort()
    covered = 0
    for length in lengths:
        covered += length
        if 2 * covered >= sum(lengths):
            return float(length)
    return 24.0


@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (50, 1), (3, 90), (80, 97)])
def test_the_cell_follows_the_definition(shape):
    for image in (noise(shape), noise(shape) // 64, noise(shape).astype(np.uint16) * 257):
        assert estimate_cell(image) == by_definition(image)


@pytest.mark.parametrize("cell", [7, 10, 14.5, 20, 31])
@pytest.mark.parametrize("angle", some([0.0, 0.1, 0.5], (0.1,)))
def test_the_cell_of_a_board_is_that_of_its_squares(cell, angle):
    image, _ = board(180, 200, cell, angle=angle)
    assert 0.9 * cell <= estimate_cell(image) <= 1.25 * cell
    assert estimate_cell(image) == by_definition(image)


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (1, 1), (40, 40)])
def test_the_cell_is_24_if_there_is_nothing_to_measure(shape):
    assert estimate_cell(np.full(shape, 200, np.uint8)) == 24


def test_padding_at_the_ends_of_rows_makes_no_difference():
    image, _ = board(90, 100, 12)
    wide = np.full((90, 130), 77, np.uint8)
    wide[:, :100] = image
    assert estimate_cell(wide[:, :100]) == estimate_cell(image)


def test_an_image_of_floats_is_refused():
    with pytest.raises(ImageError, match="uint8"):
        estimate_cell(np.zeros((5, 5), np.float32))


def blurred(cell, sigma, noise=0.0):
    shape = int(10 * cell), int(12 * cell)
    image, truth = board(*shape, cell, angle=0.2, blur=0.3, samples=2)
    grey = cv2.GaussianBlur(image.astype(np.float32) * 0.4 + 60, (0, 0), sigma)
    grey += np.random.default_rng(1).normal(0, noise, image.shape)
    return np.clip(grey + 0.5, 0, 255).astype(np.uint8), truth


@pytest.mark.parametrize("cell", [45, 70, 110])
def test_wide_cells_are_measured_through_blur_and_noise(cell):
    image, _ = blurred(cell, 0.04 * cell, noise=8)
    assert 0.8 * cell <= estimate_cell(image) <= 1.4 * cell


@pytest.mark.parametrize("noise", [0, 4])
@pytest.mark.parametrize("sigma", [1.0, 2.0, 3.0])
def test_the_blur_of_edges_is_measured(sigma, noise):
    image, _ = blurred(60, sigma, noise)
    assert 0.7 * sigma <= estimate_blur(image, estimate_cells(image)) <= 1.3 * sigma


def test_a_sheet_with_a_faint_dense_pattern_is_no_cell():
    """The sheet differs more from its surround than the cells of 8 px from one another."""
    image = np.full((480, 640), 230, np.uint8)
    y, x = np.mgrid[:360, :400]
    image[60:420, 120:520] = np.where((x // 8 + y // 8) % 2, 120, 90)
    assert estimate_cell(image) == 8


def test_an_image_without_edges_has_no_blur():
    flat = np.full((40, 50), 7, np.uint8)
    assert estimate_blur(flat, estimate_cells(flat)) == 0


def test_for_image_uses_cell_and_blur():
    image, _ = board(180, 200, 10)
    assert DetectorConfig.for_image(image) == DetectorConfig.for_cell(estimate_cell(image))
    assert DetectorConfig.for_image(image).detection.fine
    wide, _ = blurred(70, 3.0)
    cells = estimate_cells(wide)
    told = DetectorConfig.for_cell(cells.side, blur=estimate_blur(wide, cells))
    assert DetectorConfig.for_image(wide) == told
    assert told.scale is not None


def test_blurred_wide_cells_are_found_and_exact(device):
    image, truth = blurred(110, 7.0, noise=8)
    height, width = image.shape
    inside = ((truth > 40) & (truth < (width - 41, height - 41))).all(axis=1)

    def errors(config):
        found = cmp_cl.detect(image, config, device).xy
        distance = np.linalg.norm(found[:, None] - truth[inside], axis=2)
        return np.minimum(distance.min(axis=0), 5)

    at_full_size = DetectorConfig.for_image(image).replace(scale=None)
    assert errors(None).max() < 2
    assert errors(None).mean() < 0.6 * errors(at_full_size).mean()


def test_a_large_image_is_sampled(monkeypatch):
    image, _ = board(480, 620, 14.5, angle=0.1, samples=2)
    whole = estimate_cell(image)
    looked_at = []
    differences = cell_module._differences
    monkeypatch.setattr(cell_module, "_MOST_PIXELS", image.size // 4)

    def noted(part):
        looked_at.append(part.size)
        return differences(part)

    monkeypatch.setattr(cell_module, "_differences", noted)
    assert estimate_cell(image) == pytest.approx(whole, abs=1)
    assert len(looked_at) > 10
    assert max(looked_at) < image.size // 3  # the halved image is looked at whole
    edges = np.full((480, 620), 90, np.uint8)  # a board in a corner is seen too
    edges[-120:, -150:] = image[:120, :150]
    assert estimate_cell(edges) == pytest.approx(whole, abs=2)
