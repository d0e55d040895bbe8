"""The one place that builds: sources, errors, kept binaries."""

import dataclasses
import re
import secrets
import warnings
from pathlib import Path

import images
import numpy as np
import pyopencl as cl
import pytest
from comparison import assert_same_bytes
from configs import rings

from cmp_cl import (
    AdaptiveMean,
    BinaryRings,
    Detector,
    DetectorConfig,
    DeviceKind,
    EdgeStep,
    Fit,
    Midlines,
    SpectralCriteria,
)
from cmp_cl.errors import KernelBuildError
from cmp_cl.opencl import caches, program

IMAGE = images.eight_bits()["board"]


@pytest.fixture
def altered(monkeypatch, tmp_path):
    """altered(name, old, new): kernels of which one file has been changed."""

    def make(name, old, new):
        for path in program.kernel_folder().iterdir():
            text = path.read_text(encoding="utf-8")
            if path.name == name:
                assert old in text
                text = text.replace(old, new, 1)
            (tmp_path / path.name).write_text(text, encoding="utf-8")
        monkeypatch.setattr(program, "kernel_folder", lambda: tmp_path)

    return make


def test_the_source_is_headers_and_stages_with_their_lines():
    text = program.source(["nms", "collect"], {"F(x)": "g(x)"})
    assert text.startswith("#define F(x) g(x)\n")
    names = re.findall(r'^#line 1 "(.*)"$', text, re.MULTILINE)
    assert names == ["plane.clh", "ring.clh", "nms.cl", "collect.cl"]
    assert (program.kernel_folder() / "nms.cl").read_text(encoding="utf-8") in text


def test_a_kernel_that_does_not_compile_gives_the_compilers_log(altered, device):
    altered("nms.cl", "__kernel void score_map(", "__kernel void score_map(nonsense ")
    with pytest.raises(KernelBuildError) as error:
        Detector(shape=IMAGE.shape, device=device)
    message = str(error.value)
    assert "nms" in message
    assert device.name in message
    assert "nonsense" in message


def test_a_missing_macro_is_an_error(device):
    context = cl.Context([device.handle])
    with pytest.raises(KernelBuildError, match="PIXEL must be"):
        program.build(context, ["nms"], {})
    with pytest.raises(KernelBuildError, match="OUTER_RADIUS must be"):
        program.build(context, ["nms"], {"PIXEL": "uchar", "PAD": 16, "OUTER_RADIUS": 6})


CONFIGS = {
    "default": DetectorConfig(),
    "rings": rings(),
    "three masks, step, scaled": DetectorConfig(
        detection=BinaryRings(threshold=AdaptiveMean(masks=3)), refinement=EdgeStep(), scale=0.5
    ),
    "midlines": DetectorConfig(
        detection=BinaryRings(contrast=None), refinement=Midlines(fit=Fit.QUADRATIC)
    ),
    "spectral": DetectorConfig(detection=BinaryRings(criteria=SpectralCriteria()), refinement=None),
}


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
@pytest.mark.parametrize("kind", [DeviceKind.CPU, DeviceKind.GPU], ids=lambda kind: kind.value)
def test_compilers_have_nothing_to_remark(device, monkeypatch, capfd, kind, config, dtype):
    programs = []

    def compiled(source, options):
        """Under a macro of its own, so that no cache answers in the compiler's place."""
        built = cl.Program.build(source, [*options, f"-DTRY={secrets.randbits(31)}"])
        programs.append(built)
        return built

    monkeypatch.setattr(program, "_built", compiled)
    monkeypatch.setattr(program, "_place", lambda *_: None)
    device = dataclasses.replace(device, kind=kind)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cl.CompilerWarning)
        Detector(shape=(64, 64), dtype=dtype, config=config, device=device).close()
    log = programs[0].get_build_info(device.handle, cl.program_build_info.LOG)
    assert "warning" not in (log + capfd.readouterr().err).lower()


def test_missing_kernels(monkeypatch, tmp_path):
    monkeypatch.setattr(program, "__file__", str(tmp_path / "package" / "opencl" / "program.py"))
    with pytest.raises(KernelBuildError, match="install cmp-cl again"):
        program.kernel_folder()


def test_one_changed_offset_of_a_ring_changes_the_masks(altered, device, detector_for):
    expected = detector_for(IMAGE).maps(IMAGE)
    altered("ring.clh", "F(1, 1, -3)", "F(1, 2, -3)")
    with Detector(shape=IMAGE.shape, device=device) as detector:
        found = detector.maps(IMAGE)
    np.testing.assert_array_equal(found.binary, expected.binary)
    changed = np.bitwise_or.reduce((found.inner ^ expected.inner).ravel())
    assert changed == 1 << 1


@pytest.mark.parametrize("count", [1, 2, 3, 4, 9, 10, 21, 255])
def test_a_sum_has_every_term_once(count):
    terms = [f"F({k})" for k in range(count)]
    text = program.sum_of_terms(terms, "uint")
    assert re.findall(r"F\(\d+\)", text) == terms
    value = eval(text.replace("uint, ", ""), {"F": lambda k: 2**k, "SUM3": lambda *each: sum(each)})
    assert value == 2**count - 1


# --- kept binaries -------------------------------------------------------------------------


@pytest.fixture
def kept(monkeypatch, tmp_path):
    """An empty cache folder."""
    monkeypatch.setattr(
        caches.platformdirs, "user_cache_path", lambda *args, **named: tmp_path / "cache"
    )
    monkeypatch.delenv("PYOPENCL_NO_CACHE", raising=False)
    return tmp_path / "cache"


def detect(device):
    with Detector(shape=IMAGE.shape, config=DetectorConfig(refinement=None), device=device) as one:
        return one(IMAGE)


def test_a_program_is_compiled_once_and_kept(kept, device, monkeypatch):
    first = detect(device)
    (path,) = kept.iterdir()
    data = path.read_bytes()
    monkeypatch.setattr(program, "_keep", lambda *args: pytest.fail("compiled again"))
    assert_same_bytes(detect(device), first)
    assert path.read_bytes() == data
    assert [path.name for path in kept.iterdir()] == [path.name]


@pytest.mark.parametrize("damage", ["truncated", "changed", "empty", "a folder"])
def test_a_damaged_binary_is_written_anew(kept, device, damage):
    first = detect(device)
    (path,) = kept.iterdir()
    data = path.read_bytes()
    path.unlink()
    if damage == "a folder":
        path.mkdir()
    else:
        worse = {"truncated": data[:-9], "changed": data[:-1] + b"?", "empty": b""}[damage]
        path.write_bytes(worse)
    assert_same_bytes(detect(device), first)
    if damage != "a folder":
        assert len(path.read_bytes()) > 32


def test_a_cache_that_cannot_be_written_costs_only_time(kept, device):
    kept.write_text("a file where the folder should be")
    assert len(detect(device)) > 20


def test_the_cache_can_be_switched_off(kept, device, monkeypatch):
    monkeypatch.setenv("PYOPENCL_NO_CACHE", "1")
    assert len(detect(device)) > 20
    assert not kept.exists()


# --- the index -----------------------------------------------------------------------------


def test_the_index_names_every_kernel_and_no_other():
    folder = program.kernel_folder()
    index = (folder / "README.md").read_text(encoding="utf-8")
    in_table = [line.split("|")[1] for line in index.splitlines() if line.startswith("| ")]
    files = {path.name for path in folder.glob("*.cl")}
    kernels = {
        name
        for file in files
        for name in re.findall(r"__kernel void (\w+)\(", (folder / file).read_text("utf-8"))
    }
    named = {name for cell in in_table for name in re.findall(r"`([a-z_]+)`", cell)}
    assert {name for cell in in_table for name in re.findall(r"\*\*(.+)\*\*", cell)} == files
    assert named == kernels


def test_every_kernel_file_has_a_test():
    tests = Path(__file__).parent
    for path in program.kernel_folder().glob("*.cl"):
        name = "test_markers.py" if path.stem == "markers" else f"test_kernel_{path.stem}.py"
        assert (tests / name).is_file()
