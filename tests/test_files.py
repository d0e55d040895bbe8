"""Files are written whole or not at all, and read or refused whatever is in them."""

import os
import stat

import cv2
import numpy as np
import pytest
from stereo_data import grid_of, toed_in_rig
from videos import write_video

from cmp_cl import CmpClError, DetectorConfig, EdgeStep, Grid, SeriesWriter, StereoRig, media
from cmp_cl.files import csv_bytes, read_toml, whole_file, write_bytes
from cmp_cl.series import read_series

posix = pytest.mark.skipif(os.name == "nt", reason="modes, links and devices are others on Windows")


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    target = tmp_path / "corners.csv"
    write_bytes(target, b"old")

    def write_half():
        with whole_file(target) as file:
            file.write(b"half")
            file.flush()
            assert target.read_text() == "old"
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_half()
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["corners.csv"]


@posix
def test_a_file_keeps_its_mode_from_the_first_byte_on_and_a_link_stays_a_link(tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("old")
    secret.chmod(0o600)
    (tmp_path / "link").symlink_to(secret)
    with whole_file(tmp_path / "link") as file:
        assert stat.S_IMODE(os.stat(file.name).st_mode) == 0o600
        file.write(b"new")
    assert secret.read_text() == "new"
    assert stat.S_IMODE(secret.stat().st_mode) == 0o600
    assert (tmp_path / "link").is_symlink()
    write_bytes(tmp_path / "ours", b"")
    (tmp_path / "any").write_bytes(b"")
    modes = {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("ours", "any")}
    assert len(modes) == 1


@posix
def test_what_cannot_be_written_is_named(tmp_path):
    kept = tmp_path / "kept.csv"
    kept.write_text("old")
    kept.chmod(0o444)
    for target, error, why in (
        (kept, PermissionError, r"read-only: .*kept\.csv"),
        (tmp_path / "missing" / "file", FileNotFoundError, "there is no folder .*missing"),
        (tmp_path, OSError, "a folder or a device, not a file"),
        (os.devnull, OSError, "a folder or a device, not a file"),
    ):
        with pytest.raises(error, match=why):
            write_bytes(target, b"new")
    assert kept.read_text() == "old"
    assert os.listdir(tmp_path) == ["kept.csv"]


def test_a_csv_holds_any_text():
    rows = [("a", 'b "c",\nd'), (-1.5, os.fsdecode(b"\xff.png"))]
    assert csv_bytes(rows).decode() == 'a,"b ""c"",\nd"\n-1.5,\\udcff.png\n'


@pytest.mark.parametrize("text", [b"a = '\xff'", b"a = "])
def test_settings_that_are_damaged_are_refused(text, tmp_path):
    (tmp_path / "a.toml").write_bytes(text)
    with pytest.raises(ValueError, match="it is not TOML in UTF-8"):
        read_toml(tmp_path / "a.toml")
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbfa = 1\r\nb = 0.5\r\n")  # as Windows writes it
    assert read_toml(tmp_path / "a.toml") == {"a": 1, "b": 0.5}


NODES = np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1) * 10 + 5
BOARD = (np.indices((60, 80)) // 9).sum(axis=0).astype(np.uint8) % 2 * 150 + 40


def write_series(path):
    with SeriesWriter(path, rest=NODES, unit="px") as series:
        for number in range(3):
            series.append(index=number, time_ms=40.0 * number, displacement=0 * NODES + number)


def read_frames(path):
    return list(media.read_frames(path))


KINDS = {  # how a file is written and read
    "a.toml": (DetectorConfig(refinement=EdgeStep(cell=17.5)).save, DetectorConfig.load),
    "rig.yaml": (toed_in_rig().save, StereoRig.load),
    "rest.npz": (grid_of(NODES).save, Grid.load),
    "a.png": (lambda path: media.write_image(path, BOARD), read_frames),
    "a.jpg": (lambda path: media.write_image(path, BOARD), read_frames),
    "a.tif": (lambda path: cv2.imwritemulti(str(path), [BOARD] * 3), read_frames),
    "a.avi": (lambda path: write_video(path, [BOARD] * 4, "MJPG"), read_frames),
    "a.mp4": (lambda path: write_video(path, [BOARD] * 4, "mp4v"), read_frames),
    "press.npz": (write_series, read_series),
    "press.h5": (write_series, read_series),
}


@pytest.mark.parametrize("name", KINDS)
def test_a_file_that_is_cut_off_gives_a_result_or_an_error_of_cmp_cl(tmp_path, name):
    if name.endswith(".h5"):
        pytest.importorskip("h5py", reason="h5py is not installed")
    write, read = KINDS[name]
    write(tmp_path / name)
    read(tmp_path / name)
    whole, refused = (tmp_path / name).read_bytes(), 0
    for size in np.linspace(0, len(whole) - 1, 30).astype(int):
        (tmp_path / name).write_bytes(whole[:size])
        try:
            read(tmp_path / name)
        except CmpClError:
            refused += 1
    assert refused
