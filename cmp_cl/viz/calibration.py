"""The picture of a calibration: where the boards were, and what is left over."""

from typing import TYPE_CHECKING, Any

import numpy as np

from cmp_cl.space.calibration import Calibration
from cmp_cl.space.calibration.advice import covered
from cmp_cl.viz.plots import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def calibration_figure(found: Calibration) -> "Figure":
    """Draw the corners in the image of each camera; raises ConfigError without matplotlib."""
    count = len(found.cameras)
    figure = new_figure((7.0 * count, 5.0))
    for number, name in enumerate(found.cameras, 1):
        _draw_corners(figure, figure.add_subplot(1, count, number), found, name)
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
