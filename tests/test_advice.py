"""Where no pattern is found, one line says why and what to try; where one is, nothing is said."""

import cv2
import images
import numpy as np
import pytest
from corner_images import board, grain

from cmp_cl import Corners, GridError, detect, measure
from cmp_cl.cli.main import main

SHAPE = (240, 320)


def grey(smooth):
    """Return grey with noise of 8 grey levels, smoothed over that many px."""
    return np.clip(128 + 8 * grain(SHAPE, smooth, 1), 0, 255).astype(np.uint8)


def advice(image) -> str:
    corners = detect(image)
    assert isinstance(corners, Corners)
    return corners.advice(image)


@pytest.mark.parametrize("smooth", [0.7, 1, 1.5, 2, 3])
def test_the_corners_of_coarse_noise_are_said_to_be_noise(smooth):
    assert "noise" in advice(grey(smooth))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_raw_image_of_a_colour_camera_is_told(dtype):
    image = board(*SHAPE, 20, samples=3)[0].astype(dtype) * (np.iinfo(dtype).max // 255)
    assert not advice(image)
    image[::2, ::2] = image[::2, ::2] * 0.6
    image[1::2, 1::2] = image[1::2, 1::2] * 0.5
    assert "COLOR_BayerRG2GRAY" in advice(image)


SHEARED = np.array([[0.6, 0.5, -90], [0, 0.75, 0]])
QUIET = {
    **{
        f"cells of {cell} px": lambda cell=cell: board(*SHAPE, cell, angle=0.3, samples=3)[0]
        for cell in (7, 12, 30, 70)
    },
    "a worn gel": lambda: images.scene(1.5).image,
    "a sheared board": lambda: cv2.warpAffine(
        board(400, 500, 20, samples=3)[0], SHEARED, (200, 290)
    ),
    "3 x 3 px": lambda: np.full((3, 3), 90, np.uint8),
    "1 row": lambda: np.full((1, 9), 90, np.uint8),
    "a ramp": lambda: np.tile(np.linspace(20, 200, 320).astype(np.uint8), (240, 1)),
    "fine noise": lambda: grey(0),
}


@pytest.mark.parametrize("name", QUIET)
def test_nothing_is_said_of_a_pattern_or_of_an_image_without_edges(name):
    assert advice(QUIET[name]()) == ""


def test_the_markers_of_a_board_that_is_numbered_for_sure_are_no_noise(tmp_path, capsys):
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    sheet = cv2.aruco.CharucoBoard((9, 7), 60, 45, markers).generateImage((580, 460), marginSize=20)
    assert "noise" in advice(sheet)
    cv2.imwrite(str(tmp_path / "sheet.png"), sheet)
    assert main(["detect", str(tmp_path / "sheet.png"), "--grid", "6x8"]) == 0
    assert capsys.readouterr().err == ""


def test_the_command_line_and_a_search_for_a_board_say_it(tmp_path, capsys):
    image = grey(1.5)
    cv2.imwrite(str(tmp_path / "noise.png"), image)
    assert main(["detect", str(tmp_path / "noise.png")]) == 0
    assert "noise or texture" in capsys.readouterr().err
    with pytest.raises(GridError, match="noise or texture"):
        measure.find_board(image, (6, 9))
