"""The pictures of the documentation, from the library's own results.

python docs/pictures.py        # into docs/pictures
"""

import tempfile
from pathlib import Path

import cv2
import matplotlib
import numpy as np

matplotlib.use("agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

import cmp_cl
from cmp_cl.cli.main import main as cmp_cl_command
from cmp_cl.reference import detect, maps, refine
from cmp_cl.reference.edges import edge_points, fit_lines
from cmp_cl.synthetic import Indenter, Rendered, Scene, render

HERE = Path(__file__).parent
SEED = 900_100
INNER, OUTER = ((3, 2), "tab:orange"), ((5, 4), "tab:cyan")
COLOURS = ("tab:red", "tab:green", "tab:purple", "tab:blue")


def gel(**changes: object) -> Rendered:
    """Return a pressed gel of 20 x 20 corners; the same one on every call."""
    settings = {"markers": 20, "severity": 0.8, "indenter": Indenter.TORUS, "seed": SEED}
    return render(Scene(**(settings | changes)))


def shown(axes: plt.Axes, image: np.ndarray, title: str, **style: object) -> None:
    """Show an image without ticks, under a title."""
    axes.imshow(image, **({"cmap": "gray", "interpolation": "nearest"} | style))
    axes.set_title(title, fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])


def ring(radius: int, diagonal: int) -> np.ndarray:
    """Return (8, 2): the samples of a ring, clockwise from twelve o'clock."""
    a, d = radius, diagonal
    return np.array([(0, -a), (d, -d), (a, 0), (d, d), (0, a), (-d, d), (-a, 0), (-d, -d)])


def rings() -> Figure:
    """Draw a corner with two rings, and the grey levels along them."""
    scene = gel(severity=0.3, corrosion=0.5)
    x, y = np.rint(scene.truth[9, 9]).astype(int)
    image = scene.image.astype(float)
    figure, (left, right) = plt.subplots(1, 2, figsize=(7, 3), layout="constrained")
    shown(left, image, "a corner and its two rings")
    for shape, colour in (INNER, OUTER):
        at = ring(*shape) + np.array([x, y])
        left.plot(*at[[*range(8), 0]].T, "o-", color=colour, markersize=5, linewidth=1)
        grey = image[at[:, 1], at[:, 0]]
        label = f"radius {shape[0]} px"
        right.plot(np.arange(9) * 45, grey[[*range(8), 0]], "o-", color=colour, label=label)
    left.set_xlim(x - 12.5, x + 12.5)
    left.set_ylim(y + 12.5, y - 12.5)
    right.set_title("grey level along the rings: two periods", fontsize=9)
    right.set_xlabel("degrees, clockwise from twelve o'clock", fontsize=8)
    right.set_xticks(range(0, 361, 90))
    right.legend(fontsize=8)
    return figure


def response() -> Figure:
    """Draw S3, R5 and the maxima of a part of a gel."""
    scene = gel()
    found = maps(scene.image, cmp_cl.DetectorConfig(detection=cmp_cl.RingHarmonic()))
    part = slice(170, 310), slice(250, 390)
    figure, axes = plt.subplots(1, 3, figsize=(9, 3.2), layout="constrained")
    shown(axes[0], found.coarse[part], "S3: smoothed three times")
    values = found.coarse_response[part]
    most = np.abs(values).max()
    shown(axes[1], values, "R5: positive at corners", cmap="RdBu_r", vmin=-most, vmax=most)
    shown(axes[2], scene.image[part], "the maxima that are kept")
    row, column = np.nonzero(found.maximum[part])
    axes[2].plot(column, row, "o", color="tab:red", markersize=5, fillstyle="none")
    return figure


def edges() -> Figure:
    """Draw the edge points of one corner, the lines through them, and where they meet."""
    scene = gel(severity=0.5, corrosion=0.6)
    start = np.rint(scene.truth[12, 7]).astype(np.int64)[None]
    points = edge_points(scene.image, start)
    corner = refine.refine(scene.image, start, start, cmp_cl.EdgeLines()).xy[0]
    figure, axes = plt.subplots(figsize=(3.6, 3.6), layout="constrained")
    shown(axes, scene.image, "edge points on rings of 3, 4 and 5 px")
    for boundary, colour in enumerate(COLOURS):
        at = points.point[0, points.valid[0], boundary] + start[0]
        axes.plot(*at.T, "o", color=colour, markersize=5, label=f"e{boundary}")
    for pair in ((0, 2), (1, 3)):
        at = points.point[0, points.valid[0]][:, list(pair)].reshape(-1, 2) + start[0]
        line = fit_lines(at[None], np.ones((1, len(at)), bool))
        along = np.array([np.cos(line.angle[0]), np.sin(line.angle[0])])
        ends = line.centre[0] + np.array([[-8], [8]]) * along
        axes.plot(*ends.T, color="white", linewidth=1)
    axes.plot(*corner, "x", color="yellow", markersize=10, markeredgewidth=2)
    axes.set_xlim(start[0, 0] - 8.5, start[0, 0] + 8.5)
    axes.set_ylim(start[0, 1] + 8.5, start[0, 1] - 8.5)
    axes.legend(fontsize=7, loc="upper right")
    return figure


def grid() -> Figure:
    """Draw the grid of a torn gel, some of whose nodes are predicted."""
    scene = gel(markers=30, severity=1.5, seed=SEED + 11)
    found = cmp_cl.build_grid(detect(scene.image), scene.image, shape=(30, 30))
    figure, axes = plt.subplots(figsize=(4.6, 4.6), layout="constrained")
    shown(axes, scene.image, "nodes by the source of their position")
    for line in (*found.xy, *found.xy.swapaxes(0, 1)):
        axes.plot(*line.T, color="tab:cyan", linewidth=0.4)
    styles = {
        cmp_cl.NodeStatus.DETECTED: ("tab:green", 2),
        cmp_cl.NodeStatus.ATTACHED: ("tab:blue", 7),
        cmp_cl.NodeStatus.INTERPOLATED: ("tab:red", 7),
    }
    for status, (colour, size) in styles.items():
        at = found.xy[found.status == status]
        label = f"{status.name.lower().replace('_', ' ')}: {len(at)}"
        axes.plot(*at.T, "o", color=colour, markersize=size, label=label)
    middle = np.nanmean(found.xy, axis=(0, 1))
    axes.set_xlim(middle[0] - 130, middle[0] + 130)
    axes.set_ylim(middle[1] + 130, middle[1] - 130)
    axes.legend(fontsize=7, loc="lower right")
    return figure


def demo(picture: Path) -> None:
    """Write the sheet of `cmp-cl demo` as a JPEG."""
    with tempfile.TemporaryDirectory() as folder:
        cmp_cl_command(["demo", "--out", folder])
        sheet = cv2.imread(f"{folder}/sheet.png")
    small = cv2.resize(sheet, None, fx=0.7, fy=0.7, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(picture), small, [cv2.IMWRITE_JPEG_QUALITY, 85])


DRAWN = rings, response, edges, grid  # on the page of the algorithm


def main() -> int:
    """Draw the pictures; return the exit status."""
    folder = HERE / "pictures"
    demo(folder / "field.jpg")
    for draw in DRAWN:
        figure = draw()
        figure.savefig(folder / f"{draw.__name__}.png", dpi=90, metadata={"Software": None})
        plt.close(figure)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
