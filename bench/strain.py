"""Known strains in the plane, measured by the command line: bias, sigma, coverage.

    python bench/strain.py [--seeds 6] [--first 1000] [--json results/strain.json]

Each pair of images shows a printed checkerboard from the front, rotated, and then strained by
a known gradient, with noise. `cmp-cl run --strain --cell` measures it, through the lattice filter,
and by --raw without. For each strain the table gives the root mean square error, the median of the
stated sigma, and the share of errors within 1.96 sigma, which is 95 % if sigma is right. The exit
status is 1 if a share is outside 90 to 98 %.
"""

import argparse
import contextlib
import io
import json
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from environment import environment

from cmp_cl import media
from cmp_cl.cli import main as cli

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))

STRAINS = 1e-4, 1e-2, 0.3
SHAPE, CELL, NODES = (320, 320), 12, 14  # px
NOISE = 3.0  # grey levels
BOUNDS = 0.90, 0.98


def gradient(strain: float, direction: float) -> np.ndarray:
    """Return the gradient (2, 2) that has this principal strain, and -0.4 times it across."""
    turn = rotation(direction)
    return turn @ np.diag(np.sqrt(1 + 2 * np.array([strain, -0.4 * strain]))) @ turn.T


def rotation(angle: float) -> np.ndarray:
    """Return the matrix (2, 2) of the rotation by an angle, rad."""
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def measured(strain: float, seed: int, folder: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return the errors of the strain of all nodes, and their sigmas, (N, 3) each, by way."""
    from plane_images import moved_board

    rng = np.random.default_rng(seed)
    turn, direction = rng.uniform(-0.3, 0.3), rng.uniform(0, math.pi)
    centre = (np.array(SHAPE[::-1]) - 1) / 2
    shift = rng.uniform(-0.5, 0.5, 2)
    by = gradient(strain, direction)
    low = CELL * round((centre[0] - NODES * CELL / 2) / CELL)
    board = (low, low, low + (NODES + 1) * CELL, low + (NODES + 1) * CELL)
    frames = folder / f"{strain}-{seed}"
    frames.mkdir()
    for number, mapping in enumerate((rotation(turn), rotation(turn) @ by)):
        picture = moved_board(
            SHAPE,
            CELL,
            lambda q, mapping=mapping: (q - centre) @ (mapping - np.eye(2)).T + shift,
            board=board,
            noise=NOISE,
            seed=2 * seed + number,
        )
        media.write_image(frames / f"{number}.png", picture)
    ways = {}
    for way, more in (("filtered", []), ("raw", ["--raw"])):
        series = folder / f"{strain}-{seed}-{way}.npz"
        command = ["run", str(frames), "--grid", f"{NODES}x{NODES}", "--strain", "--cell", "1"]
        with contextlib.redirect_stdout(io.StringIO()):
            status = cli.main([*command, *more, "--out", str(series)])
        if status:
            raise SystemExit(f"{series.name}: {status}")
        with np.load(series) as found:
            off = _off(found["strain"][1], by, turn, found["homography"])
            ways[way] = off, found["strain_sigma"][1].reshape(-1, 3)
    return ways


def _off(tensor: np.ndarray, by: np.ndarray, turn: float, axes: np.ndarray) -> np.ndarray:
    """Return measured minus true along the pattern's rows and columns, (N, 3)."""
    along = axes[:2, :2] @ rotation(turn)  # from the board's axes to those of the rows
    along /= math.sqrt(abs(np.linalg.det(along)))
    true = along @ ((by.T @ by - np.eye(2)) / 2) @ along.T
    return (tensor - [true[0, 0], true[1, 1], true[0, 1]]).reshape(-1, 3)


def table(seeds: range) -> list[dict[str, Any]]:
    """Return a row for every strain."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for strain in STRAINS:
            pairs = [measured(strain, seed, Path(folder)) for seed in seeds]
            for way in pairs[0]:
                off, sigma = map(np.concatenate, zip(*(pair[way] for pair in pairs), strict=True))
                rows.append({"strain": strain, "by": way, **_errors(off, sigma, len(seeds))})
    return rows


def _errors(off: np.ndarray, sigma: np.ndarray, pairs: int) -> dict[str, Any]:
    known = np.isfinite(off) & np.isfinite(sigma)
    return {
        "pairs": pairs,
        "numbers": int(known.sum()),
        "missing": int((~known).sum()),
        "bias": float(off[known].mean()),
        "rms": float(np.sqrt(np.mean(off[known] ** 2))),
        "sigma": float(np.median(sigma[known])),
        "coverage": float(np.mean(np.abs(off[known]) < 1.96 * sigma[known])),
    }


def main() -> int:
    """Print the table; return 1 if a coverage is out of bounds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=6, help="pairs of pictures a strain")
    parser.add_argument("--first", type=int, default=1000, help="number of the first one")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = table(range(options.first, options.first + options.seeds))
    print(
        f"{'strain':>8} {'by':>8} {'numbers':>8} {'missing':>8} {'bias':>9} {'RMS':>9} {'sigma':>9}"
        "  covered"
    )
    for row in rows:
        print(
            f"{row['strain']:8g} {row['by']:>8} {row['numbers']:8} {row['missing']:8} "
            f"{row['bias']:9.1e} {row['rms']:9.1e} {row['sigma']:9.1e}  {row['coverage']:.1%}"
        )
    if options.json:
        result = {"kind": "strain", "environment": environment(), "rows": rows}
        options.json.write_text(json.dumps(result, indent=1) + "\n")
    return 0 if all(BOUNDS[0] <= row["coverage"] <= BOUNDS[1] for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
