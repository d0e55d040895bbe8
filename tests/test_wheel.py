"""The wheel holds the kernels and works where it is installed; so does an editable install."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[1]

DETECT = """
import site, sys
usual = list(sys.path)
sys.path.clear()
site.addsitedir(sys.argv[1])
sys.path += usual
import cv2, cmp_cl
assert cmp_cl.__file__.startswith(sys.argv[2]), cmp_cl.__file__
print(len(cmp_cl.detect(cv2.imread(sys.argv[3], cv2.IMREAD_GRAYSCALE))))
"""


def run(*command, cwd):
    done = subprocess.run(
        [sys.executable, *map(str, command)], cwd=cwd, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def built_wheel(folder, *options):
    """Return the one wheel that hatchling builds of the project into a folder."""
    run("-m", "hatchling", "build", *options, "-d", folder, cwd=PROJECT)
    (wheel,) = folder.glob("*.whl")
    return wheel


def installed(wheel, folder):
    run(
        *("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"),
        *("--no-index", "--target", folder, wheel),
        cwd=folder.parent,
    )


def corners_found(folder, origin, cwd):
    photograph = PROJECT / "cmp_cl" / "data" / "board.png"
    return int(run("-c", DETECT, folder, origin, photograph, cwd=cwd))


@pytest.fixture(scope="session")
def wheel(tmp_path_factory):
    return built_wheel(tmp_path_factory.mktemp("dist"), "-t", "wheel")


def test_the_wheel_holds_every_kernel_and_the_photograph(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    kernels = {path.relative_to(PROJECT).as_posix() for path in PROJECT.glob("kernels/**/*.cl*")}
    assert {"kernels/harmonic.cl", "kernels/cpu/harmonic.cl"} <= kernels
    assert {f"cmp_cl/{name}" for name in kernels} <= names
    assert {"cmp_cl/data/board.png", "cmp_cl/data/NOTICE"} <= names
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"cmp_cl"}


def test_the_wheel_detects_where_there_is_nothing_but_it(wheel, tmp_path):
    target = tmp_path / "empty"
    target.mkdir()
    installed(wheel, target)
    assert corners_found(target, target, cwd=tmp_path) == 54


def test_an_editable_install_finds_the_kernels(tmp_path):
    wheel = built_wheel(tmp_path, "-t", "wheel:editable")
    target = tmp_path / "editable"
    target.mkdir()
    installed(wheel, target)
    assert corners_found(target, PROJECT / "cmp_cl", cwd=tmp_path) == 54
