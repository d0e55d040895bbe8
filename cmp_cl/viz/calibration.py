"""Pictures of a calibration: the residual of every corner, and of every view."""

from typing import TYPE_CHECKING

import numpy as np

from cmp_cl.space.cameras import CamerasCalibration
from cmp_cl.viz.plots import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def residual_figure(found: CamerasCalibration) -> "Figure":
    """Draw, by camera, the corners with enlarged residuals, and the RMS of each view.

    found: the calibration. It needs matplotlib, and raises ConfigError without it.
    """
    count = len(found.cameras)
    figure = new_figure((11.0, 4.2 * count))
    grid = figure.add_gridspec(count, 3)
    for row, (name, camera) in enumerate(found.cameras.items()):
        axes = figure.add_subplot(grid[row, :2])
        places = [at for at in found.places[name] if at is not None]
        missed = [off for off in found.residuals[name] if off is not None]
        at, off = (
            np.concatenate([part.reshape(-1, 2) for part in both]) for both in (places, missed)
        )
        known = ~np.isnan(off[:, 0])
        at, off = at[known], off[known]
        length = np.linalg.norm(off, axis=1)
        width, height = camera.size
        scale = 0.04 * width / max(float(np.percentile(length, 95)), 1e-9)
        arrows = axes.quiver(
            *at.T, *(off * scale).T, length,
            angles="xy", scale_units="xy", scale=1, width=2e-3, cmap="plasma",
            clim=(0, float(length.max()) or 1.0),
        )  # fmt: skip
        axes.set(
            xlim=(-0.5, width - 0.5),
            ylim=(height - 0.5, -0.5),
            aspect="equal",
            xlabel="x / px",
            ylabel="y / px",
            title=f"{name}: measured minus projected, {scale:.0f} x; "
            f"coverage {found.coverage[name]:.0%}",
        )
        figure.colorbar(arrows, ax=axes, label="residual / px", shrink=0.85)
        bars = figure.add_subplot(grid[row, 2])
        errors = found.view_errors[name]
        bars.bar(np.arange(len(errors)), np.nan_to_num(errors))
        bars.set(xlabel="view", ylabel="RMS residual / px", title=f"{name}: by view")
        bars.grid(axis="y", alpha=0.3)
    return figure
