"""`cmp-cl demo`: render a press in two views, measure it in space, compare it with the truth."""

import argparse
import statistics
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cmp_cl import media
from cmp_cl.cli.arguments import add, add_device
from cmp_cl.cli.messages import shown
from cmp_cl.errors import ConfigError
from cmp_cl.measure import Measured, TwoViews
from cmp_cl.opencl.device import select_device
from cmp_cl.space import BinocularSplit
from cmp_cl.synthetic import Indenter, Mode, Scene, binocular_frame, default_rig, render_stereo
from cmp_cl.viz import Moment, save_figure, sheet_figure
from cmp_cl.viz.plots import new_figure

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
FIELDS = "field.npz", "field.csv", "field.vtp"  # for NumPy, a spreadsheet, ParaView


DESCRIPTION = """\
Renders a gel at rest and under a torus that presses and twists, as two mirrors show it to one
camera; finds and numbers the corners, places them in space, prints the errors against the exact
truth, and writes a sheet of pictures, the deformation field, and the frames. It needs matplotlib.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    what = "where to write, made if missing; default: cmp-demo"
    add(parser, "--out FOLDER", what, default="cmp-demo")
    add_device(parser)


def run(arguments: argparse.Namespace) -> int:
    device = select_device(arguments.device)
    new_figure((1, 1))  # matplotlib is missed now, not after the rendering
    folder = Path(arguments.out)
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"--out {shown(folder)} is a file; give the name of a folder")
    frames = folder / "frames"
    others = {*folder.glob("*")} - {frames}
    if others and not (frames / "000-rest.png").exists():  # a rig.yaml there is not of a demo
        raise ConfigError(f"--out {shown(folder)} holds other files; give the name of a new folder")
    frames.mkdir(parents=True, exist_ok=True)
    rig = default_rig(VIEW)
    shape = (SCENE.markers, SCENE.markers)
    *at_rest_views, rest = render_stereo(SCENE.at_rest(), rig)
    *pressed_views, now = render_stereo(SCENE, rig)
    at_rest, pressed = binocular_frame(*at_rest_views), binocular_frame(*pressed_views)
    rows, columns = pressed.shape
    print(f"rendered a gel at rest and pressed, {columns} x {rows} px", flush=True)
    split = BinocularSplit.halves(columns, rows)
    with TwoViews(at_rest, rig, split, shape=shape, device=device) as measure:
        times = []
        for _ in range(_TIMES):
            start = time.perf_counter()
            measured = measure(pressed)
            times.append(time.perf_counter() - start)
        spent = statistics.median(times)
    print(f"measured it on {device}", flush=True)
    table = _table(measured, spent, now - rest)
    media.write_image(frames / "000-rest.png", at_rest)
    media.write_image(frames / "001-press.png", pressed)
    rig.save(folder / "rig.yaml")
    for name in FIELDS:
        measured.field.with_strain().save(folder / name)
    told = "; ".join(f"{what} {value}" for what, value in table)
    sheet = sheet_figure(Moment.of(measured.field, 1), title=f"A torus presses and twists: {told}")
    save_figure(folder / "sheet.png", sheet)
    width = max(len(what) for what, _ in table)
    for what, value in table:
        print(f"  {what:{width}}  {value}")
    print(f"wrote sheet.png, {', '.join(FIELDS)}, rig.yaml and frames to {shown(folder)}")
    print(
        "the same through files: "
        f"cmp-cl run {shown(frames)} --stereo {shown(folder / 'rig.yaml')} "
        f"--grid {shape[0]}x{shape[1]} --out press.npz"
    )
    return 0


def _table(measured: Measured, spent: float, truth: NDArray[np.float64]) -> list[tuple[str, str]]:
    """Return what a reader wants to know: name and value.

    spent: s for a frame. truth: the displacement, (R, C, 3) mm.
    """
    off = 1e3 * np.linalg.norm(measured.field.displacement - truth, axis=2)[measured.field.valid]
    return [
        ("rate", f"{1 / spent:.1f} frames per second"),
        ("nodes measured", f"{measured.nodes} of {truth[..., 0].size}"),
        ("error of the displacement, RMS", f"{np.sqrt(np.mean(off**2)):.1f} um"),
        ("95 % of the errors are below", f"{np.percentile(off, 95):.1f} um"),
        ("largest displacement", f"{measured.largest:.3f} mm"),
    ]
