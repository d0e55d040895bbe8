"""The module that builds programs: sources, errors, what is shared."""

import secrets
import shutil
import warnings

import images
import numpy as np
import pyopencl as cl
import pytest
from cases import some
from configs import CONFIGS, rings

from cmp_cl import Detector, DetectorConfig
from cmp_cl.errors import KernelBuildError
from cmp_cl.opencl import program

LOG = cl.program_build_info.LOG
IMAGE = images.eight_bits()["board"]


def test_a_kernel_that_does_not_compile_gives_the_compilers_log(device, monkeypatch, tmp_path):
    shutil.copytree(program.kernel_folder(), tmp_path, dirs_exist_ok=True)
    text = (tmp_path / "nms.cl").read_text(encoding="utf-8")
    wrong = text.replace("void score_map(", "void score_map(nonsense ", 1)
    (tmp_path / "nms.cl").write_text(wrong, encoding="utf-8")
    monkeypatch.setattr(program, "kernel_folder", lambda: tmp_path)
    with pytest.raises(KernelBuildError) as error:
        Detector(shape=IMAGE.shape, config=rings(), device=device)
    message = str(error.value)
    assert "nms" in message
    assert device.name in message
    assert "nonsense" in message


def test_a_missing_macro_is_an_error(device):
    context = cl.Context([device.handle])
    with pytest.raises(KernelBuildError, match="NMS_RADIUS must be"):
        program.Programs(context).kernels(["nms"], {})


def test_detectors_of_a_process_share_what_is_compiled(device, monkeypatch):
    image = images.texture((70, 90))
    with Detector(shape=IMAGE.shape, device=device) as first:
        monkeypatch.setattr(program, "_built", lambda *_: pytest.fail("compiled"))
        with Detector(shape=image.shape, device=device) as second:
            assert second._programs is first._programs
            assert len(second(image)) > 0
        assert len(first(IMAGE)) > 0


def test_batches_and_maps_of_a_detector_compile_nothing_anew(own_programs, device, monkeypatch):
    config = DetectorConfig(refinement=None)
    with Detector(shape=IMAGE.shape, config=config, device=device) as detector:
        compiled = []
        built = program._built
        monkeypatch.setattr(
            program, "_built", lambda *given: compiled.append(given) or built(*given)
        )
        detector.batch([IMAGE, IMAGE])
        detector.batch([IMAGE] * 3)
        list(detector.stream([IMAGE, IMAGE]))
        assert not compiled
        detector.maps(IMAGE)  # in the portable form, which other devices than CPUs have compiled
        compiled.clear()
        detector.maps(IMAGE)
        assert not compiled


@pytest.mark.parametrize("dtype", some([np.uint8, np.uint16], (np.uint8,)))
@pytest.mark.parametrize("name", some(CONFIGS, ("default",)))
def test_compilers_give_no_warnings(own_programs, device_in_form, monkeypatch, capfd, name, dtype):
    programs = []

    def compiled(source, options):
        """Compile under a macro of its own, so that no cache answers in the compiler's place."""
        built = cl.Program.build(source, [*options, f"-DTRY={secrets.randbits(31)}"])
        programs.append(built)
        return built

    monkeypatch.setattr(program, "_built", compiled)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cl.CompilerWarning)
        Detector(shape=(100, 100), dtype=dtype, config=CONFIGS[name], device=device_in_form).close()
    assert programs
    logs = [built.get_build_info(device_in_form.handle, LOG) for built in programs]
    assert "warning" not in ("".join(logs) + capfd.readouterr().err).lower()
