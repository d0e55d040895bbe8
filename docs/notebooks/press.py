# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Notebook: a press, from two images to a strain field
#
# We render a gel at rest and under a ball, find the corners, number them, and look at how the
# gel has moved. Everything here works in the same way on images of your own.

# %%
import matplotlib.pyplot as plt
import numpy as np

import cmp_cl
from cmp_cl.synthetic import Indenter, Scene, default_rig, render_stereo

rig = default_rig((480, 480))
scene = Scene(markers=20, shape=(480, 480), indenter=Indenter.BALL, severity=0.8, seed=900_200)
left_rest, right_rest, truth_rest = render_stereo(scene.at_rest(), rig)
left_now, right_now, truth_now = render_stereo(scene, rig)

figure, axes = plt.subplots(1, 2, figsize=(8, 4))
for axis, view, title in zip(axes, (left_rest, left_now), ("at rest", "now"), strict=True):
    axis.imshow(view.image, cmap="gray")
    axis.set_title(title)
    axis.axis("off")

# %% [markdown]
# ## Corners and nodes
#
# `detect` finds corners; `build_grid` numbers them. `like` gives the current frame the numbers
# of the frame at rest.


# %%
def grid_of(view, like=None):
    corners = cmp_cl.detect(view.image)
    return cmp_cl.build_grid(corners, view.image, shape=(20, 20), like=like)


rest = [grid_of(view) for view in (left_rest, right_rest)]
now = [grid_of(view, like) for view, like in zip((left_now, right_now), rest, strict=True)]
for name, grid in zip(("left", "right"), now, strict=True):
    print(name, int(grid.valid.sum()), "of", grid.valid.size, "nodes")

# %% [markdown]
# ## Space

# %%
field = cmp_cl.displacement(rig.triangulate(*rest), rig.triangulate(*now)).with_strain()
length = np.linalg.norm(field.displacement, axis=2)
error = np.linalg.norm(field.displacement - (truth_now - truth_rest), axis=2)
print(f"largest displacement {np.nanmax(length):.2f} mm")
print(f"RMS error {np.sqrt(np.nanmean(error**2)) * 1000:.1f} um")

# %%
figure, axes = plt.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
pictures = {
    "displacement, mm": length,
    "strain E11": field.strain[..., 0],
    "error of the displacement, mm": error,
}
for axis, (title, values) in zip(axes, pictures.items(), strict=True):
    figure.colorbar(axis.imshow(values), ax=axis)
    axis.set_title(title)

# %% [markdown]
# The error is largest on the flank of the ball, where the print is stretched and torn most.
# `field.sigma` says so without knowing the truth:

# %%
inside = error / np.sqrt(3) < 2 * field.sigma
print(f"{np.mean(inside[field.valid]):.0%} of the errors are within two sigma")
