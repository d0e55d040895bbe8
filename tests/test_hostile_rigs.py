"""Calibration files that could end the process."""

import subprocess
import sys

import numpy as np
import pytest
from stereo_data import toed_in_rig

from cmp_cl import CalibrationError, StereoRig

YAML = "%YAML:1.0\n---\nK1: "
DEEP = {
    "a YAML sequence": YAML + "[" * 200_000,
    "a YAML mapping": YAML + "{a: " * 200_000,
    "YAML dashes": YAML + "\n  " + "- " * 200_000 + "1\n",
    "a JSON array": '{"K1": ' + "[" * 200_000,
    "a JSON object": '{"a":' * 200_000,
    "XML tags": '<?xml version="1.0"?>\n<opencv_storage>' + "<a>" * 200_000,
    "brackets that strings close": YAML + '["]",' * 200_000,
}


LOAD = """
import sys, cmp_cl
for path in sys.argv[1:]:
    try:
        cmp_cl.StereoRig.load(path)
    except cmp_cl.CalibrationError:
        print(path, flush=True)
"""


def test_a_deeply_nested_file_is_refused_and_does_not_end_the_process(tmp_path):
    paths = []
    for number, text in enumerate(DEEP.values()):
        paths.append(tmp_path / f"{number}.yaml")
        paths[-1].write_text(text)
    done = subprocess.run(
        [sys.executable, "-c", LOAD, *map(str, paths)],
        capture_output=True,
        text=True,
        check=False,
        env={"PYTHONPATH": ":".join(sys.path)},
    )
    refused = done.stdout.splitlines()
    names = list(DEEP)
    assert len(refused) == len(DEEP), f"{names[len(refused)]}: {done.stderr}"
    assert done.returncode == 0


@pytest.mark.parametrize("depth", [10, 1300])
def test_a_rig_is_read_from_a_file_with_many_indented_levels(depth, tmp_path):
    rig, path = toed_in_rig(), tmp_path / "rig.yaml"
    rig.save(path)
    with path.open("a") as file:
        file.writelines(f"{' ' * level}a:\n" for level in range(depth))
    again = StereoRig.load(path)
    for name in ("K1", "D1", "K2", "D2", "R", "T"):
        np.testing.assert_array_equal(getattr(again, name), getattr(rig, name))


def rig_text(tmp_path):
    toed_in_rig().save(tmp_path / "rig.yaml")
    return (tmp_path / "rig.yaml").read_text()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("unit: mm", "unit: 25", "unit must be a word such as mm"),
        ("unit: mm", 'unit: ""', "unit must be a word such as mm"),
        ("unit: mm", "unit: mm\nunit: m", "unit is given twice"),
        ("unit: mm", "unit: mm\nK1: 3", "K1 is given twice"),
        ("cols: 5\n   dt: d", "cols: 5\n   dt: i", "D1 must have dt: d or f, not 'i'"),
        ("1260.", ".nan", "K1 must be finite"),
        ("1260.", "1e308", "K1 must be finite and at most"),
        ("-0.12", ".inf", "D1 must be finite"),
    ],
)
def test_a_rig_file_with_a_wrong_entry_is_refused_in_one_line(tmp_path, old, new, words):
    text = rig_text(tmp_path)
    assert old in text
    (tmp_path / "rig.yaml").write_text(text.replace(old, new, 1))
    with pytest.raises(CalibrationError, match=rf"rig\.yaml: {words}") as refusal:
        StereoRig.load(tmp_path / "rig.yaml")
    assert "\n" not in str(refusal.value)


def test_a_rig_file_without_a_unit_is_read_in_mm_with_a_warning(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text(tmp_path).replace("unit: mm\n", ""))
    with pytest.warns(UserWarning, match=r"rig\.yaml: no unit, so T is taken to be in mm"):
        assert StereoRig.load(path).unit == "mm"
    assert StereoRig.load(path, unit="um").unit == "um"


@pytest.mark.parametrize("text", ["%YAML:1.0\n---\n- 1\n- 2\n", "[1, 2]", "%YAML:1.0\n---\n5\n"])
def test_a_file_that_is_no_map_of_names_is_refused(tmp_path, text):
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(CalibrationError):
        StereoRig.load(tmp_path / "rig.yaml")
