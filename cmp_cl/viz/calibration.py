"""The picture of a calibration: where the boards were, how they were tilted, what is left over."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from cmp_cl.space.calibration import Calibration
from cmp_cl.space.calibration.advice import covered, tilts
from cmp_cl.viz.plots import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_NAMED = 20  # views; more have numbers


def calibration_figure(found: Calibration, names: Mapping[str, Sequence[str]]) -> "Figure":
    """Draw, a row for each camera: the corners in its image, the tilts of the board, the errors.

    names: by camera, the name of each view. Raises ConfigError without matplotlib.
    """
    count = len(found.cameras)
    figure = new_figure((13.0, 4.0 * count))
    grid = figure.add_gridspec(count, 3, width_ratios=[1.7, 1.0, 1.2])
    for row, name in enumerate(found.cameras):
        _draw_corners(figure, figure.add_subplot(grid[row, 0]), found, name)
        _draw_tilts(figure.add_subplot(grid[row, 1], projection="polar"), found, name)
        _draw_errors(figure.add_subplot(grid[row, 2]), found, name, names[name])
    return figure


def _draw_corners(figure: "Figure", axes: Any, found: Calibration, name: str) -> None:
    """Draw the corners and their enlarged residuals, and shade the cells without a corner."""
    width, height = found.cameras[name].size
    both = zip(found.grids[name], found.residuals[name], strict=True)
    pairs = [
        (grid.xy[grid.valid], off[grid.valid]) for grid, off in both if grid and off is not None
    ]
    at, off = (np.concatenate(each) for each in zip(*pairs, strict=True))
    seen = covered(found, name)
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    axes.imshow(
        np.where(seen, np.nan, 1.0), extent=extent, cmap="Reds", vmin=0, vmax=4, aspect="equal"
    )
    length = np.linalg.norm(off, axis=1)
    scale = 0.04 * width / max(float(np.percentile(length, 95)), 1e-9)
    arrows = axes.quiver(
        *at.T, *(off * scale).T, length,
        angles="xy", scale_units="xy", scale=1, width=2.5e-3, cmap="viridis",
        clim=(0, float(length.max()) or 1.0),
    )  # fmt: skip
    axes.set(
        xlim=extent[:2],
        ylim=extent[2:],
        xlabel="x / px",
        ylabel="y / px",
        title=f"{name}: boards in {seen.mean():.0%} of the image; residuals x {scale:.0f}",
    )
    figure.colorbar(arrows, ax=axes, label="residual / px", shrink=0.85)


def _draw_tilts(axes: Any, found: Calibration, name: str) -> None:
    """Draw the direction and the angle by which each board is tilted from facing the camera."""
    across, down = tilts(found, name).T
    axes.plot(np.arctan2(-down, across), np.hypot(across, down), "o", color="tab:blue", alpha=0.8)
    axes.set_rlim(0, max(45.0, float(np.hypot(across, down).max()) * 1.1))
    axes.set_rticks([20, 40])
    axes.set_rlabel_position(90)
    axes.set_xticks(np.radians([0, 90, 180, 270]), ["right", "up", "left", "down"])
    axes.set_xlabel("tilt of the boards / degrees")


def _draw_errors(axes: Any, found: Calibration, name: str, names: Sequence[str]) -> None:
    """Draw the error of each view; those that are not used have no bar."""
    errors = found.view_errors[name]
    number = np.arange(len(errors))
    axes.bar(number, np.nan_to_num(errors), color="0.45")
    axes.set(xlabel="view", ylabel="RMS residual / px", title="error of each view")
    axes.grid(axis="y", alpha=0.3)
    if len(errors) <= _MOST_NAMED:
        axes.set_xticks(number, [each[-16:] for each in names], rotation=60, ha="right")
        axes.set_xlabel("")
    else:
        axes.locator_params(axis="x", integer=True)
