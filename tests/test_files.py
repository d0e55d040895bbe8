"""Files are written whole or not at all, and read or refused whatever is in them."""

import os
import stat
from pathlib import Path

import pytest
from cases import some
from children import python

from cmp_cl.files import csv_bytes, read_toml, whole_file, write_bytes

posix = pytest.mark.skipif(os.name == "nt", reason="modes, links and devices are others on Windows")


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


def test_a_csv_holds_any_text_and_no_spreadsheet_runs_it():
    rows = [("a", 'b "c",\nd'), (-1.5, os.fsdecode(b"\xff.png")), ("=1+1", "@x")]
    assert csv_bytes(rows).decode() == 'a,"b ""c"",\nd"\n-1.5,\\udcff.png\n\'=1+1,\'@x\n'


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (b"a = '" + b"b" * 70_000 + b"'", "over 65536 bytes"),
        (b"a = '\xff'", "not text in UTF-8"),
        (b"a = ", "Invalid value"),
    ],
)
def test_settings_that_are_too_long_or_damaged_are_refused(text, why, tmp_path):
    (tmp_path / "a.toml").write_bytes(text)
    with pytest.raises(ValueError, match=why):
        read_toml(tmp_path / "a.toml")
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbfa = 1\r\nb = 0.5\r\n")  # as Windows writes it
    assert read_toml(tmp_path / "a.toml") == {"a": 1, "b": 0.5}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
@pytest.mark.parametrize("cases", some([20, 250], [20]))
def test_a_damaged_file_of_any_kind_gives_a_result_or_an_error_of_cmp_cl(cases):
    """A process of its own reads each: a library in C might end it."""
    fuzzer = Path(__file__).with_name("fuzz_files.py")
    done = python(fuzzer, "--cases", cases, "--seed", 1, timeout=None)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "'refused'" in done.stdout
