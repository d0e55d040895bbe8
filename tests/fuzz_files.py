"""Reads hostile files of every kind, by the library and by the command line.

    python tests/fuzz_files.py --cases 1000 --seed 1 [--only a.tif] [--first 17]

Each case damages an intact file, and a process of its own reads it, within 20 s of work and 1 GB.
The outcome must be a result, an error of cmp_cl, or a line of the command with status 2. Case K of
a seed is always the same: a failure prints its number, and the status is 1.
"""

import argparse
import contextlib
import faulthandler
import os
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "support"))
import cv2
import numpy as np
from hostile import BOARD, KINDS, damaged, with_another_array

from cmp_cl import CmpClError
from cmp_cl.cli.main import main as command

SECONDS, LONGEST, BYTES = 20, 600, 1 << 30  # of work, of waiting on a busy machine, of memory


def one_case(name: str, number: int, seed: int) -> int:
    """Read a damaged file in this folder; return 0 if it was read, 2 if it was refused."""
    rng = np.random.default_rng([seed, number + 1])
    write, read, words = KINDS[name]
    path = Path(name)
    write(path)
    if number < 0:
        pass  # as it is
    elif path.suffix in (".npz", ".h5") and rng.random() < 0.5:
        with_another_array(path, rng)
    else:
        path.write_bytes(damaged(path.read_bytes(), rng))
    if words and number >= 0 and rng.random() < 0.5:
        cv2.imwrite("both.png", np.hstack([BOARD, BOARD]))
        status = command([str(path) if word == "FILE" else word for word in words])
        assert "enough memory" not in Path("said").read_text(errors="replace")
        return status
    warnings.simplefilter("error", RuntimeWarning)
    try:
        read(path)
    except CmpClError:
        return 2
    return 0


def outcome(name: str, number: int, seed: int) -> str:
    """Return what became of a case in a process of its own; print what it said if it failed."""
    with tempfile.TemporaryDirectory() as folder:
        child = os.fork()
        if not child:
            os.chdir(folder)
            os.dup2(os.open("said", os.O_WRONLY | os.O_CREAT), 1)
            os.dup2(1, 2)
            resource.setrlimit(resource.RLIMIT_AS, (4 * BYTES, 4 * BYTES))
            resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
            signal.alarm(LONGEST)
            faulthandler.dump_traceback_later(0.9 * LONGEST)
            status = 1
            with contextlib.suppress(SystemExit):
                try:
                    status = one_case(name, number, seed)
                except BaseException:
                    traceback.print_exc()
            sys.stdout.flush()
            os._exit(status)
        _, code, used = os.wait4(child, 0)
        said = Path(folder, "said").read_text(errors="replace")
    if used.ru_maxrss << 10 > BYTES:
        found = "over 1 GB"
    elif os.WIFSIGNALED(code):
        late = os.WTERMSIG(code) in (signal.SIGALRM, signal.SIGXCPU, signal.SIGKILL)
        found = "hung" if late else f"signal {os.WTERMSIG(code)}"
    else:
        found = {0: "read", 2: "refused"}.get(os.WEXITSTATUS(code), "traceback")
    if found not in ("read", "refused"):
        print(f"{found}; again: --seed {seed} --first {number} --cases 1 --only {name}")
        print(said[-2000:], flush=True)
    return found


def main() -> int:
    """Run the cases; return 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", choices=KINDS, help="one kind of file")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    names = [options.only] if options.only else list(KINDS)
    counts: dict[str, Counter[str]] = {name: Counter() for name in names}
    for name in names:
        assert outcome(name, -1, options.seed) == "read", f"{name} is not read as it is"
    for number in range(options.first, options.first + options.cases):
        name = names[number % len(names)]
        counts[name][outcome(name, number, options.seed)] += 1
    for name, found in counts.items():
        print(name, dict(found))
    total = sum(counts.values(), Counter())
    print(f"seed {options.seed}: {total.total()} cases, {dict(total)}")
    return 1 if set(total) - {"read", "refused"} else 0


if __name__ == "__main__":
    sys.exit(main())
