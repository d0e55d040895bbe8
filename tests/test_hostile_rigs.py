"""Calibration files that could end the process."""

import subprocess
import sys

import numpy as np
import pytest
from stereo_data import toed_in_rig

from cmp_cl import StereoRig

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
