"""Files written whole or not at all."""

import os
import stat

import pytest

from cmp_cl.files import read_toml, whole_file, write_bytes, write_text


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    target = tmp_path / "corners.csv"
    write_text(target, "old")

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


def test_text_is_written_as_utf_8_with_its_own_line_ends(tmp_path):
    write_text(tmp_path / "text", "müde\nLeute\r\n")
    assert (tmp_path / "text").read_bytes() == b"m\xc3\xbcde\nLeute\r\n"


def test_a_new_file_has_the_permissions_of_any_other(tmp_path):
    write_bytes(tmp_path / "ours", b"")
    (tmp_path / "any").write_bytes(b"")
    modes = {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("ours", "any")}
    assert len(modes) == 1


def test_a_durable_file_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    synced = []

    def sync(number):
        synced.append((os.fstat(number).st_size, os.path.exists(tmp_path / "a")))

    monkeypatch.setattr(os, "fsync", sync)
    write_bytes(tmp_path / "b", b"data")
    assert synced == []
    write_bytes(tmp_path / "a", b"data", durable=True)
    assert synced == [(4, False)]


@pytest.mark.skipif(os.name == "nt", reason="modes are others on Windows")
def test_a_file_keeps_its_mode_from_the_first_byte_on(tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("old")
    secret.chmod(0o600)
    with whole_file(secret) as file:
        assert stat.S_IMODE(os.stat(file.name).st_mode) == 0o600
        file.write(b"new")
    assert secret.read_text() == "new"
    assert stat.S_IMODE(secret.stat().st_mode) == 0o600


@pytest.mark.skipif(os.name == "nt", reason="modes are others on Windows")
def test_a_read_only_file_is_not_replaced(tmp_path):
    target = tmp_path / "kept.csv"
    target.write_text("old")
    target.chmod(0o444)
    with pytest.raises(PermissionError, match=r"read-only: .*kept\.csv"):
        write_text(target, "new")
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["kept.csv"]


@pytest.mark.skipif(os.name == "nt", reason="modes are others on Windows")
@pytest.mark.skipif(os.name != "nt" and os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_reported_with_the_name_that_was_given(tmp_path):
    tmp_path.chmod(0o555)
    with pytest.raises(PermissionError, match=r"cannot be written: .*new\.csv"):
        write_text(tmp_path / "new.csv", "")


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
def test_a_link_stays_a_link_and_its_target_is_written(tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "target")
    write_text(tmp_path / "link", "here")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_text() == "here"


@pytest.mark.skipif(os.name == "nt", reason="there are no device files on Windows")
def test_a_device_is_written_and_not_replaced():
    write_text(os.devnull, "nothing")
    assert stat.S_ISCHR(os.stat(os.devnull).st_mode)


def test_a_missing_folder_and_a_folder_as_a_file_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"there is no folder .*missing"):
        write_text(tmp_path / "missing" / "file", "")
    with pytest.raises(IsADirectoryError, match="is a folder, not a file"):
        write_text(tmp_path, "")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full here")
def test_a_full_disk_is_named():
    with pytest.raises(OSError, match="No space left on device: '/dev/full'"):
        write_text("/dev/full", "much")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (b"a" + b".a" * 30_000 + b" = 1", "nested too deep"),  # would take all memory
        (b"a = " + b"[" * 1000, "nested too deep"),
        (b"a = '" + b"b" * 70_000 + b"'", "over 65536 bytes"),
        (b"a = '\xff'", "not text in UTF-8"),
        (b"a = ", "Invalid value"),
    ],
)
def test_settings_that_are_too_deep_too_long_or_damaged_are_refused(text, why, tmp_path):
    (tmp_path / "a.toml").write_bytes(text)
    with pytest.raises(ValueError, match=why):
        read_toml(tmp_path / "a.toml")


def test_settings_with_a_byte_order_mark_and_other_line_ends_are_read(tmp_path):
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbfa = 1\r\nb = 0.5\r\n")
    assert read_toml(tmp_path / "a.toml") == {"a": 1, "b": 0.5}
