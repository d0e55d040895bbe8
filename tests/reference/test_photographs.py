"""The oracle on photographs whose corners are listed: how many it misses, how many are false."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from cmp_cl import reference
from cmp_cl.config import AdaptiveMean, BinaryRings, DetectorConfig, window_for_cell

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data"

pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="the folder of photographs is not beside the repository"
)


def missed_and_false(name: str, radius: int) -> tuple[int, int, int]:
    """Return how many corners are missed, false within the scored region, and listed.

    Corners are matched one to one, the nearest first, within a quarter of a cell and 3 px.
    """
    truth = json.loads((FOLDER / name).with_suffix(".json").read_text())
    photograph = (FOLDER / name).with_name(truth["image"])
    image = cv2.imread(str(photograph), cv2.IMREAD_GRAYSCALE)
    region = cv2.imread(str(FOLDER / f"{name}.region.png"), cv2.IMREAD_GRAYSCALE)
    cell = truth["cell_px"]["median"]
    place = np.array([(corner["x"], corner["y"]) for corner in truth["corners"]])
    sure = np.array([corner.get("sure", True) for corner in truth["corners"]])
    config = DetectorConfig(
        detection=BinaryRings(
            threshold=AdaptiveMean(window=window_for_cell(cell)), outer_radius=radius
        ),
        refinement=None,
    )
    xy = reference.detect(image, config).xy.astype(np.float64)

    near = []
    for k, found in enumerate(xy):
        distance = np.linalg.norm(place - found, axis=1)
        near += [(distance[j], k, j) for j in np.nonzero(distance < min(3, cell / 4))[0]]
    free_found = np.ones(len(xy), np.bool_)
    free_place = np.ones(len(place), np.bool_)
    for _, k, listed in sorted(near):
        if free_found[k] and free_place[listed]:
            free_found[k] = free_place[listed] = False
    column, row = np.rint(xy).astype(int).T
    scored = region[row, column] > 0
    return int((free_place & sure).sum()), int((free_found & scored).sum()), len(place)


@pytest.mark.parametrize(
    ("name", "radius", "listed", "missed", "false"),
    [
        pytest.param("water/reference_df", 5, 10994, 0, 0, marks=pytest.mark.exhaustive),
        pytest.param("water/reference_df", 4, 10994, 0, 0, marks=pytest.mark.exhaustive),
        pytest.param("water/ellipse_10", 5, 8230, 99, 4, marks=pytest.mark.exhaustive),
        pytest.param("water/ellipse_10", 4, 8230, 23, 1, marks=pytest.mark.exhaustive),
        ("puzzleboard/example1", 5, 258, 0, 0),
        ("curved/curve_4", 5, 99, 0, 0),
    ],
)
def test_no_more_corners_are_missed_or_false_than_stated(name, radius, listed, missed, false):
    found_missed, found_false, found_listed = missed_and_false(name, radius)
    assert found_listed == listed
    assert found_missed <= missed
    assert found_false <= false
