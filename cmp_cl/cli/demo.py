"""`cmp-cl demo`: a rendered press, measured in space and compared with the exact truth."""

import argparse
import dataclasses
import statistics
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cmp_cl import media
from cmp_cl.cli.arguments import add_device
from cmp_cl.cli.messages import shown
from cmp_cl.errors import ConfigError
from cmp_cl.field import DisplacementField
from cmp_cl.grid import Grid, filter_positions
from cmp_cl.image import GreyImage
from cmp_cl.measure import Measured, TwoViews, cell_of
from cmp_cl.opencl.device import select_device
from cmp_cl.space import BinocularSplit, StereoRig
from cmp_cl.synthetic import (
    Indenter,
    Mode,
    Rendered,
    Scene,
    binocular_frame,
    default_rig,
    render_stereo,
)
from cmp_cl.synthetic.scoring import score
from cmp_cl.viz import (
    arrow_figure,
    corner_overlay,
    grid_overlay,
    save_figure,
    surface_figure,
)
from cmp_cl.viz.plots import Moment, sheet_figure

VIEW = (1200, 800)  # rows and columns of each view, px
SCENE = Scene(
    shape=VIEW,
    indenter=Indenter.TORUS,
    mode=Mode.TWIST,
    contact=(1.5, -1.0),
    rotation=0.02,
    seed=7,
)
_TIMES = 5  # measurements of the frame, of which the median time is told
FIELDS = "field.npz", "field.csv", "field.vtp"


def add_parser(commands: Any) -> None:
    """Add `demo` to the commands of an argparse parser."""
    parser = commands.add_parser(
        "demo",
        help="render a press in two views, measure it in space, compare it with the truth",
        description="Renders a gel at rest and under a torus that presses and twists, as two "
        "mirrors show it to one camera; finds and numbers the corners, places them in space, "
        "and writes pictures, the deformation field and a table of the errors against the "
        "exact truth.",
    )
    parser.add_argument(
        "--out",
        metavar="FOLDER",
        default="cmp-demo",
        help="where to write, made if missing; default: cmp-demo",
    )
    add_device(parser)
    parser.set_defaults(run=run)


class _Truth(NamedTuple):
    """A rendered frame: both views, the frame that holds them, the nodes in space, mm."""

    left: Rendered
    right: Rendered
    xyz: NDArray[np.float64]

    @property
    def frame(self) -> GreyImage:
        return binocular_frame(self.left, self.right)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit status."""
    begin = time.perf_counter()
    device = select_device(arguments.device)
    folder = Path(arguments.out)
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"--out {shown(folder)} is a file; give the name of a folder")
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    rig = StereoRig(*default_rig(VIEW))
    shape = (SCENE.markers, SCENE.markers)

    def tell(what: str) -> None:
        print(f"{time.perf_counter() - begin:5.1f} s  {what}", flush=True)

    rest = _Truth(*render_stereo(SCENE.at_rest(), rig))
    now = _Truth(*render_stereo(SCENE, rig))
    rows, columns = rest.frame.shape
    tell(
        f"rendered a gel at rest and pressed, {columns} x {rows} px, {shape[0]} x {shape[1]} "
        "corners per view"
    )
    split = BinocularSplit.halves(columns, rows)
    with TwoViews(rest.frame, rig, split, shape=shape, device=device) as measure:
        tell(f"found and numbered the pattern at rest on {device}")
        times = []
        for _ in range(_TIMES):
            start = time.perf_counter()
            measured = measure(now.frame)
            times.append(time.perf_counter() - start)
        spent = statistics.median(times)
        tell(
            f"found, numbered and triangulated {measured.nodes} nodes of the pressed gel in "
            f"{spent * 1e3:.0f} ms"
        )
        table = _table(measured, spent, rest, now)
        details = _details(measured, measure.rest_grids, now)
        left_at_rest = measure.rest_grids[0]
    frames = {"frames/000-rest.png": rest.frame, "frames/001-press.png": now.frame}
    written = [
        *_files(folder, rig, frames, measured.field, [*table, *details]),
        *_pictures(folder, measured, left_at_rest, table),
    ]
    tell("wrote the files")
    width = max(len(what) for what, _, _ in table)
    for what, value, unit in table:
        print(f"  {what:{width}}  {value:>8}  {unit}".rstrip())
    print(f"wrote to {shown(folder)}: {', '.join(written)}")
    print(
        "the same through files: "
        f"cmp-cl run {shown(folder / 'frames')} --stereo {shown(folder / 'rig.yaml')} "
        f"--grid {shape[0]}x{shape[1]} --out press.npz"
    )
    return 0


def wrongly_numbered(grid: Grid, view: Rendered) -> int:
    """Count the nodes that are more than half a cell from their true position."""
    off = np.linalg.norm(grid.xy - view.truth, axis=2)
    return int(np.count_nonzero(off > 0.5 * view.cell))


def _table(
    measured: Measured, spent: float, rest: _Truth, now: _Truth
) -> list[tuple[str, str, str]]:
    """Return what a reader wants to know: name, value, unit; spent: s for a frame."""
    field = measured.field
    off = (field.displacement - (now.xyz - rest.xyz))[field.valid] * 1e3
    size = np.linalg.norm(off, axis=1)
    return [
        ("rate", f"{1 / spent:.1f}", "frames per second"),
        ("nodes measured", f"{measured.nodes} of {now.xyz[..., 0].size}", ""),
        ("error of the displacement, RMS", f"{np.sqrt(np.mean(size**2)):.1f}", "um"),
        ("95 % of the errors are below", f"{np.percentile(size, 95):.1f}", "um"),
        ("largest displacement", f"{measured.largest:.3f}", "mm"),
    ]


def _details(
    measured: Measured, at_rest: tuple[Grid, Grid], now: _Truth
) -> list[tuple[str, str, str]]:
    """Return the errors in each view: name, value, unit."""
    rows = []
    sides = zip(
        ("left", "right"), (now.left, now.right), measured.corners, measured.grids, at_rest,
        strict=True,
    )  # fmt: skip
    for side, view, corners, grid, first in sides:
        answer = score(corners.xy, view.truth, view.cell, view.junctions)
        off = filter_positions(grid, rest=first)[0].xy - view.truth
        filtered = np.sqrt(np.nanmean(np.square(off).sum(axis=2)))
        rows += [
            (f"{side} view: corners missed", str(answer.missed), ""),
            (f"{side} view: false corners", str(answer.false), ""),
            (f"{side} view: nodes with a wrong number", str(wrongly_numbered(grid, view)), ""),
            (f"{side} view: error of a corner, RMS", f"{answer.rmse:.3f}", "px"),
            (f"{side} view: after the lattice filter, RMS", f"{filtered:.3f}", "px"),
        ]
    return rows


def _files(
    folder: Path,
    rig: StereoRig,
    frames: dict[str, GreyImage],
    field: DisplacementField,
    table: Sequence[Sequence[str]],
) -> list[str]:
    """Write the frames, the rig, the field with its strain, and the table; return the names."""
    for name, frame in frames.items():
        media.write_image(folder / name, frame)
    rig.save(folder / "rig.yaml")
    with_strain = field.with_strain()
    for name in FIELDS:
        with_strain.save(folder / name)
    media.write_csv(folder / "errors.csv", ("what", "value", "unit"), table)
    return [*frames, "rig.yaml", *FIELDS, "errors.csv"]


def _around(grid: Grid, view: GreyImage) -> tuple[int, int, int, int]:
    """Return the rectangle of a view that shows the pattern: left, top, right, bottom, px."""
    xy = grid.xy[grid.valid]
    edge = 2 * cell_of(grid)
    left, top = np.maximum(xy.min(axis=0) - edge, 0)
    right, bottom = xy.max(axis=0) + edge
    return int(left), int(top), min(int(right), view.shape[1]), min(int(bottom), view.shape[0])


def _pictures(
    folder: Path,
    measured: Measured,
    left_at_rest: Grid,
    table: Sequence[tuple[str, str, str]],
) -> list[str]:
    """Draw the left view and, if matplotlib is installed, the surface and one sheet of everything.

    Returns the names.
    """
    view, grid, corners = measured.views[0], measured.grids[0], measured.corners[0]
    left, top, right, bottom = _around(grid, view)
    cut, origin = view[top:bottom, left:right], np.array([left, top], np.float32)
    around = dataclasses.replace(corners, xy=corners.xy - origin)
    media.write_image(folder / "corners.png", corner_overlay(cut, around))
    numbered = dataclasses.replace(grid, xy=grid.xy - origin)
    numbered_at_rest = dataclasses.replace(left_at_rest, xy=left_at_rest.xy - origin)
    media.write_image(folder / "grid.png", grid_overlay(cut, numbered))
    written = ["corners.png", "grid.png"]
    moment = Moment(
        rest=measured.field.position,
        shift=measured.field.displacement,
        sigma=measured.field.sigma,
        unit=measured.field.unit,
        index=1,
    )
    try:
        figures = {
            "arrows.png": arrow_figure(view, left_at_rest, grid, field=measured.field),
            "surface.png": surface_figure(measured.field),
            "sheet.png": sheet_figure(
                moment,
                title="A torus presses on a gel and twists",
                view=(cut, numbered_at_rest, numbered),
                rows=[(what, f"{value} {unit}".strip()) for what, value, unit in table],
            ),
        }
    except ImportError:
        print(
            "cmp-cl: arrows and surfaces need matplotlib, which is not installed: "
            "pip install 'cmp-cl[plot]'",
            file=sys.stderr,
        )
        return written
    for name, figure in figures.items():
        save_figure(folder / name, figure)
    return [*written, *figures]
