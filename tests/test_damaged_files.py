"""A damaged file of any kind gives a result or an error of cmp_cl, and nothing else.

Each file is read by a process of its own: a library in C might end it.
"""

import os
from pathlib import Path

import pytest
from cases import some
from children import python

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
SCRIPT = Path(__file__).with_name("fuzz_files.py")


@pytest.mark.parametrize("cases", some([20, 250], [20]))
def test_a_damaged_file_is_read_or_refused(cases):
    done = python(SCRIPT, "--cases", cases, "--seed", 1, timeout=None)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "'refused'" in done.stdout
