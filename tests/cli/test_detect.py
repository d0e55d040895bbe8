"""detect and render: images, folders and videos to tables and pictures."""

import csv
import re
import shutil
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
from scenes import barred
from videos import write_video

import cmp_cl
from cmp_cl import Method, media
from cmp_cl.viz import METHOD_COLOURS

BOARD = Path(cmp_cl.__file__).parent / "data" / "board.png"
COLUMNS = "image frame x_px y_px pixel_x_px pixel_y_px response method sigma_px edge0_rad edge1_rad"
COLUMNS += " edge2_rad edge3_rad doubtful refusal"


def rows_of(path):
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def xy_of(rows):
    return np.array([[np.float32(row["x_px"]), np.float32(row["y_px"])] for row in rows])


def two_boards():
    board = media.read_image(BOARD)
    return np.hstack([board, np.full((len(board), 60), 200, np.uint8), board])


def test_the_board_is_found_where_opencv_finds_it(run):
    status, out, err = run("detect", BOARD, "--out", "corners.csv", "--overlay", "o.png")
    assert (status, err) == (0, "")
    rows = rows_of("corners.csv")
    assert list(rows[0]) == COLUMNS.split()
    assert f"{BOARD}: {len(rows)} corners in " in out
    assert " ms on " in out
    assert f"wrote corners.csv: {len(rows)} corners" in out
    image = cv2.imread(str(BOARD), cv2.IMREAD_GRAYSCALE)
    found, peer = cv2.findChessboardCornersSB(image, (9, 6))
    assert found
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)
    peer = cv2.cornerSubPix(image, peer.reshape(-1, 1, 2), (5, 5), (-1, -1), stop)
    assert len(rows) == len(peer) == 54
    assert np.linalg.norm(peer - xy_of(rows), axis=2).min(axis=1).max() < 0.5
    overlay = cv2.imread("o.png")
    assert overlay.shape[1] >= 1000
    assert (overlay == METHOD_COLOURS[Method.EDGE_STEP]).all(axis=2).sum() > 54 * 20


def test_a_pattern_of_known_size_is_numbered_and_looked_at_twice(run):
    scene = "render", "--markers", 30, "--indenter", "torus"
    _, out, _ = run(*scene, "--out", "gel.png", "--truth", "t.csv")
    assert "wrote gel.png: 640 x 480 px, 900 corners" in out
    run(*scene, "--out", "again.png")
    assert Path("again.png").read_bytes() == Path("gel.png").read_bytes()
    asked = ("detect", "gel.png", "--grid", "30x30", "--out", "n.csv", "--overlay", "o.png")
    status, out, err = run(*asked)
    assert (status, err) == (0, "")
    assert "corners, 900 of 900 nodes in " in out
    assert "wrote o.png" in out
    assert "wrote n.csv: 900 nodes" in out
    nodes, truth = rows_of("n.csv"), rows_of("t.csv")
    found = Counter(row["status"] for row in nodes)
    assert found["DETECTED"] > 850
    assert found["MISSING"] == 0
    for node, true in zip(nodes, truth, strict=True):
        assert (node["row"], node["column"]) == (true["row"], true["column"])
    assert np.linalg.norm(xy_of(nodes) - xy_of(truth), axis=1).max() < 3
    yellow = (cv2.imread("o.png") == (0, 215, 255)).all(axis=2)
    assert yellow.sum() >= 10 * found["SECOND_LOOK"]


def test_a_board_that_a_bar_parts_is_told_to_be_one_beside_which_corners_are(run, tmp_path):
    cv2.imwrite(str(tmp_path / "bar.png"), barred((6, 9), 30, 0, columns=(1, 1)).image)
    status, out, err = run("detect", "bar.png", "--grid", "7x9", "--overlay", "o.png")
    assert (status, "wrote o.png" in out) == (2, True)  # the corners
    assert "the board looks like 6 x 9 corners; 7 x 9 were asked for; 6 corners lie where" in err


def test_each_image_of_fewer_than_16_bits_gets_a_hint_about_full_scale(run):
    run("render", "--markers", 20, "--severity", 0, "--noise", 1, "--bits", 12, "--out", "deep.png")
    shutil.copy("deep.png", "again.png")
    status, out, err = run("detect", "deep.png", "again.png")
    assert status == 0
    assert "again.png: 400 corners" in out
    assert err.count("give a full scale of 4095 for 12 bits") == 2
    media.write_image("deep.png", media.read_image("deep.png") // 4)  # in little light
    for command in ("run --out x.npz", "detect"):
        _, _, err = run(*command.split(), "deep.png")
        assert "give a full scale of 1023 for 10 bits" in err
        assert "\n" not in err.strip()
    media.write_image("eight.png", media.read_image("deep.png") // 4)  # 8 bits in a file of 16
    assert "give a full scale of 255 for 8 bits" in run("detect", "eight.png")[2]
    status, out, err = run("detect", "deep.png", "--full-scale", 1023)
    assert ("deep.png: 400 corners" in out, err) == (True, "")
    assert "above the full scale of 255" in run("detect", "deep.png", "--full-scale", 255)[2]


def test_a_folder_is_searched_and_what_fails_in_it_is_named(run):
    Path("in").mkdir()
    names = ["a.png", "new\nline.png", "two  spaces.png"]
    for name in names:
        shutil.copy(BOARD, Path("in") / name)
    Path("in/broken.png").write_text("no image")
    Path("in/notes.txt").write_text("nothing to see")
    status, out, err = run("detect", "in", "--out", "all.csv")
    assert status == 2
    assert err == "cmp-cl: 'in/broken.png' is not an image that OpenCV can read, or is damaged\n"
    assert len(out.splitlines()) == 4
    assert r"'in/new\nline.png': " in out
    assert {row["image"] for row in rows_of("all.csv")} == {f"in/{name}" for name in names}


def test_a_video_is_searched_frame_by_frame_and_broken_frames_are_left_out(run):
    grey = media.read_image(BOARD)
    write_video("press.avi", [np.zeros_like(grey), grey, grey[::-1].copy(), grey])
    status, out, err = run("detect", "press.avi", "--out", "c.csv")
    assert (status, err) == (0, "")
    assert "press.avi: 4 frames, 40.5 corners on average, at least 0, in " in out
    assert len(out.splitlines()) == 2
    rows = rows_of("c.csv")
    assert Counter(row["frame"] for row in rows) == {"1": 54, "2": 54, "3": 54}
    second = list(media.read_frames("press.avi"))[1].image
    xy = xy_of([row for row in rows if row["frame"] == "1"])
    np.testing.assert_array_equal(xy, cmp_cl.detect(second).xy)  # the black frame set no cell
    status, out, err = run("detect", "press.avi", "--grid", "5x5")
    assert (status, err.count("not numbered")) == (2, 1)
    assert "0.0 of 25 nodes on average, at least 0" in out
    assert err.endswith("cmp-cl: press.avi: there are doubts about 3 further frames too\n")
    write_video("whole.avi", [grey] * 12)
    whole = Path("whole.avi").read_bytes()
    Path("cut.avi").write_bytes(whole[: len(whole) // 2])
    status, out, err = run("detect", "cut.avi")
    assert (status, "cut.avi: " in out) == (0, True)
    assert re.fullmatch(
        r"cmp-cl: cut.avi: \d frames left out, the first is 5: the file is cut off\n", err
    )


@pytest.mark.parametrize(
    ("inputs", "why"),
    [
        (["cut.avi"], "no frame that can be read"),
        (["cut.png"], "is not an image"),
        (["two.png", "--grid", "6x9"], "two.png: not numbered: two patterns"),
        ([BOARD, "--grid", "4x4"], "the board looks like 6 x 9 corners; 4 x 4 were asked"),
    ],
)
def test_a_table_is_kept_where_nothing_could_be_read_or_numbered(run, inputs, why):
    Path("c.csv").write_text("old")
    write_video("whole.avi", [media.read_image(BOARD)] * 3)
    Path("cut.avi").write_bytes(Path("whole.avi").read_bytes()[:6000])
    Path("cut.png").write_bytes(BOARD.read_bytes()[:2000])
    media.write_image("two.png", two_boards())
    status, out, err = run("detect", *inputs, "--out", "c.csv")
    assert status == 2
    assert why in err
    assert err.endswith("cmp-cl: nothing was found, so c.csv is not written\n")
    assert "wrote" not in out
    assert Path("c.csv").read_text() == "old"
    if "--grid" not in inputs:
        assert run("detect", *inputs, BOARD, "--out", "c.csv")[0] == 2
        assert len(rows_of("c.csv")) == 54
