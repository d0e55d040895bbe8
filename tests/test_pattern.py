"""The printed pattern: every format, when it is rendered, shows the requested pattern."""

import struct

import cv2
import numpy as np
import pytest
import resvg_py

import cmp_cl
from cmp_cl.cli.main import main
from cmp_cl.pattern import Checkerboard

DPI = 254  # 10 px a mm
PX = DPI / 25.4


def png_pixels(path):
    return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)


def svg_pixels(path):
    data = resvg_py.svg_to_bytes(svg_path=str(path), dpi=DPI)
    return cv2.imdecode(np.frombuffer(bytes(data), np.uint8), cv2.IMREAD_GRAYSCALE)


RENDERERS = {"png": png_pixels, "svg": svg_pixels}


@pytest.mark.parametrize("suffix", RENDERERS)
def test_corners_are_found_where_they_were_drawn(tmp_path, suffix):
    board = Checkerboard(shape=(6, 9), cell=1.5)
    board.save(tmp_path / f"board.{suffix}", dpi=DPI)
    image = RENDERERS[suffix](tmp_path / f"board.{suffix}")
    found = cmp_cl.build_grid(cmp_cl.detect(image), image, shape=(6, 9))
    wanted = board.corners * PX - 0.5
    assert found.valid.all()
    assert np.linalg.norm(found.xy - wanted, axis=2).max() < 0.35
    assert image.shape == (105, 150)


def test_a_png_states_its_resolution(tmp_path):
    Checkerboard(shape=(3, 3), cell=2).save(tmp_path / "board.png", dpi=DPI)
    data = (tmp_path / "board.png").read_bytes()
    assert struct.unpack(">IIB", data[data.index(b"pHYs") + 4 :][:9]) == (10_000, 10_000, 1)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"shape": (0, 4)}, "shape must be"),
        ({"shape": (2000, 2000)}, "more than"),
        ({"cell": -1}, "cell"),
        ({"cell": float("nan")}, "cell"),
        ({"cell": 0.01}, "has 0 x 0 px"),
        ({"cell": 250}, "and a .png from 1 to 100 million"),
    ],
)
def test_patterns_that_cannot_be_drawn_are_refused(tmp_path, wrong, says):
    with pytest.raises(cmp_cl.ConfigError, match=says):
        Checkerboard(**{"shape": (4, 4), "cell": 4, **wrong}).save(tmp_path / "board.png", dpi=DPI)


def test_the_command_writes_the_pattern_that_it_reports(tmp_path, capsys):
    out = tmp_path / "gel.svg"
    assert main(["pattern", "--grid", "20x30", "--cell", "1", "--out", str(out)]) == 0
    assert "20 x 30 corners, cells of 1 mm" in capsys.readouterr().out
    (drawn,) = (path for path in out.read_text().split("<path") if path.count("M ") > 20)
    assert drawn.count("M ") == 21 * 31 // 2 + 1  # black cells
