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
BAD = """
import os, sys, time
sys.path.insert(0, sys.argv[1])
import fuzz_files

def hang(path):
    while True:
        pass

reads = {"hung": hang, "signal 11": lambda path: os.kill(os.getpid(), 11)}
reads |= {"traceback": lambda path: 1 / 0, "over 1 GB": lambda path: b"x" * (3 << 29)}
for said, read in reads.items():
    fuzz_files.SECONDS = 2 if said == "hung" else 20
    fuzz_files.KINDS = {said: (lambda path: path.write_bytes(b"data"), read, None)}
    assert fuzz_files.outcome(said, 0, 1) == said
"""


def run(*arguments):
    done = python(*arguments, timeout=None)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("cases", some([20, 250], [20]))
def test_a_damaged_file_is_read_or_refused(cases):
    assert "'refused'" in run(SCRIPT, "--cases", cases, "--seed", 1)


@pytest.mark.exhaustive
def test_a_hang_a_crash_and_a_flood_of_memory_are_found():
    run("-c", BAD, SCRIPT.parent)
