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
# # Notebook: what the detector sees, and what its settings do
#
# `Detector.maps` returns every intermediate image. Here they are for the default rule, on a
# gel with noise.

# %%
import matplotlib.pyplot as plt
import numpy as np

import cmp_cl
from cmp_cl.synthetic import Indenter, Scene, render
from cmp_cl.synthetic.scoring import score

scene = render(Scene(markers=20, indenter=Indenter.TORUS, severity=0.8, noise=8.0, seed=900_300))
image = scene.image
with cmp_cl.Detector(shape=image.shape, dtype=image.dtype) as detector:
    maps = detector.maps(image)

part = slice(160, 320), slice(240, 400)
figure, axes = plt.subplots(1, 3, figsize=(11, 3.8), layout="constrained")
pictures = {
    "image": image,
    "smoothed three times": maps.coarse,
    "response of the 5 px ring": maps.coarse_response,
}
for axis, (title, values) in zip(axes, pictures.items(), strict=True):
    axis.imshow(values[part], cmap="gray")
    axis.set_title(title)
    axis.axis("off")
row, column = np.nonzero(maps.maximum[part])
axes[0].plot(column, row, "o", color="red", fillstyle="none")

# %% [markdown]
# ## Noise against weak corners
#
# `noise` is the least response of a corner, in standard deviations of the image's noise.
# `relative` is the least response, as a share of that of the frame's strong corners. On a gel
# with much noise, a low `noise` gives false corners, and a high one misses some:

# %%
noisy = render(Scene(markers=20, indenter=Indenter.TORUS, severity=0.8, noise=40.0, seed=900_300))
for noise in (0.5, 2.0, 8.0, 16.0):
    config = cmp_cl.DetectorConfig(detection=cmp_cl.RingHarmonic(noise=noise))
    found = score(cmp_cl.detect(noisy.image, config).xy, noisy.truth, noisy.cell, noisy.junctions)
    print(f"noise={noise:<5} missed {found.missed:3}  false {found.false:3}")

# %% [markdown]
# ## Three refinements
#
# In proportion they differ less on a worn gel than on a sharp print: most of the error is wear.

# %%
sharp = render(Scene(markers=20, severity=0.0, corrosion=0.0, seed=900_301))
refinements = {
    "none": None,
    "EdgeLines": cmp_cl.EdgeLines(),
    "EdgeStep": cmp_cl.EdgeStep(cell=scene.cell),
    "Midlines": cmp_cl.Midlines(),
}
print(f"{'':10} sharp, px  worn, px")
for name, refinement in refinements.items():
    config = cmp_cl.DetectorConfig(refinement=refinement)
    errors = [
        score(cmp_cl.detect(each.image, config).xy, each.truth, each.cell, each.junctions).rmse
        for each in (sharp, scene)
    ]
    print(f"{name:10} {errors[0]:9.3f} {errors[1]:9.3f}")
