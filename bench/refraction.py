"""A press through a window and a gel: what air in place of them errs by, and what is left of it.

    python bench/refraction.py --quick      few gels, ten drawn rigs
    python bench/refraction.py              about ten minutes

A ball presses 1 mm into the pattern, seen by two cameras 45 mm away through 5 mm of acrylic. The
pixels are exact, by the renderer's bisection of Snell's law, but in the parts `images`, which finds
the corners of rendered images, and `drawn`. A row of results/refraction.csv has the part, the gel,
what is changed in the rig, and: what 1 mm reads; the RMS error of the displacement where it is
over .3 mm, um; the mean error of the position, mm. In `drawn`, where cameras are calibrated on 12
noisy views of a board, and the window on a noisy view at rest: the error of the deepest node along
the normal, um, and what the covariance of the bias says there, um; the gel's index is exact, or is
drawn and said to be uncertain by as much.
"""

import argparse
import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from environment import main_of

from cmp_cl import (
    Grid,
    NodeStatus,
    StereoRig,
    Window,
    build_grid,
    calibrate,
    detect,
    displacement,
)
from cmp_cl.space import Bias, calibrate_window
from cmp_cl.synthetic import Scene, default_rig, render_stereo
from cmp_cl.synthetic.camera import PinholeCamera, Pose, facing_both
from cmp_cl.synthetic.surface import nodes_at_rest, surface

VIEW = 1200, 800
AIR = default_rig(VIEW)
AXES, CENTRE = facing_both(AIR.R, AIR.T)
NORMAL = AXES[:, 2]
PRESS = Scene(shape=VIEW, markers=29, side=24.0, severity=0.5, seed=900001)
PITCH = PRESS.side / (PRESS.markers + 1)
ACRYLIC = 5.0, 1.49
NOISE = 0.05  # px
RIGS = 100  # that are drawn
Row = dict[str, Any]


def behind(gel: float, index: float = 1.41) -> StereoRig:
    """Return the rig with a gel that ends at the pattern."""
    distance = float(NORMAL @ CENTRE) - gel - ACRYLIC[0]
    return dataclasses.replace(AIR, window=Window(NORMAL, distance, (ACRYLIC,), index))


def seen(rig: StereoRig, xyz: np.ndarray, noise: np.random.Generator | None = None) -> list[Grid]:
    """Return the grids of both views of nodes (R, C, 3), with noise if there is a generator; nodes
    outside the image are missing."""
    cameras = (rig.K1, rig.D1, np.eye(3), np.zeros(3)), (rig.K2, rig.D2, rig.R, rig.T)
    found = []
    for camera in cameras:
        xy = PinholeCamera(*camera, rig.window).project(xyz)
        if noise is not None:
            xy = xy + noise.normal(0, NOISE, xy.shape)
        inside = ((xy >= 0) & (xy <= np.array(VIEW[::-1]) - 1)).all(axis=2)
        xy[~inside] = np.nan
        status = np.where(inside, NodeStatus.DETECTED, NodeStatus.MISSING).astype(np.uint8)
        sigma = np.where(inside, NOISE, np.nan).astype(np.float32)
        none = np.zeros((0, 2), np.int32)
        found.append(Grid(xy=xy.astype(np.float32), status=status, image_sigma=sigma, index=none))
    return found


def nodes(scene: Scene) -> np.ndarray:
    pose = Pose.of(scene, AXES, CENTRE, float(AIR.K1[0, 0]))
    return pose.place(surface(scene, nodes_at_rest(scene)))


TRUTH = nodes(PRESS.at_rest()), nodes(PRESS)
DEPTH = np.linalg.norm(TRUTH[1] - TRUTH[0], axis=2)
DEEPEST = np.unravel_index(np.argmax(DEPTH), DEPTH.shape)


def measured(rig: StereoRig, views: list[list[Grid]]) -> Row:
    """Return what a rig makes of the views at rest and now."""
    field = displacement(*(rig.triangulate(*pair) for pair in views)).raw
    true = TRUTH[1] - TRUTH[0]
    off = np.linalg.norm(field.displacement - true, axis=2)
    return {
        "reads_mm": float(field.displacement[DEEPEST] @ NORMAL / (true[DEEPEST] @ NORMAL)),
        "error_um": 1e3 * float(np.sqrt(np.nanmean(np.square(off[DEPTH > 0.3])))),
        "position_mm": float(np.nanmean(np.linalg.norm(field.position - TRUTH[0], axis=2))),
    }


def without_the_model(*, quick: bool) -> Iterator[Row]:
    for gel in (5.0, 20.0) if quick else (5.0, 10.0, 20.0):
        for index in (1.33, 1.41, 1.5):
            views = [seen(behind(gel, index), xyz) for xyz in TRUTH]
            found = measured(AIR, views)
            yield {"part": "as air", "gel_mm": gel, "index": index, **found}


def wrong_parameters(*, quick: bool) -> Iterator[Row]:
    for gel in (20.0,) if quick else (5.0, 10.0, 20.0):
        rig = behind(gel)
        window = rig.window
        views = [seen(rig, xyz) for xyz in TRUTH]
        one, two = np.radians(1) * np.eye(4)[:2]
        changed = {
            "nothing": window,
            "index of the gel +.01": dataclasses.replace(window, index=1.42),
            "index of the acrylic +.01": dataclasses.replace(window, layers=((5.0, 1.5),)),
            "acrylic +.1 mm": dataclasses.replace(window, layers=((5.1, 1.49),)),
            "distance +.1 mm": dataclasses.replace(window, distance=window.distance + 0.1),
            "tilt of 1 degree, along the baseline": window.moved(one),
            "tilt of 1 degree, across the baseline": window.moved(two),
        }
        for what, other in changed.items():
            found = measured(dataclasses.replace(rig, window=other), views)
            yield {"part": "parameters", "gel_mm": gel, "index": 1.41, "changed": what, **found}
        for what, media in (
            ("nothing, window found at rest", (ACRYLIC, (gel, 1.41))),
            ("index of the gel +.01, window found at rest", (ACRYLIC, (gel, 1.42))),
            ("acrylic +.1 mm, window found at rest", ((5.1, 1.49), (gel, 1.41))),
        ):
            fitted = calibrate_window(AIR, views[0], pitch=PITCH, media=media, index_sigma=0.0)
            found = measured(fitted, views)
            yield {"part": "parameters", "gel_mm": gel, "index": 1.41, "changed": what, **found}


def images(*, quick: bool) -> Iterator[Row]:
    for gel in (0.0, 20.0) if quick else (0.0, 5.0, 10.0, 20.0):
        rig, views, like = behind(gel) if gel else AIR, [], (None, None)
        for scene in (PRESS.at_rest(), PRESS):
            *pair, xyz = render_stereo(scene, rig)
            like = [
                build_grid(detect(each.image), each.image, shape=xyz.shape[:2], like=known)
                for each, known in zip(pair, like, strict=True)
            ]
            views.append(like)
        yield {"part": "images", "gel_mm": gel, "index": 1.41, **measured(rig, views)}


def drawn(*, quick: bool) -> Iterator[Row]:
    board = 2.5 * np.stack([*np.mgrid[-4:5, -6:6][::-1], np.zeros((9, 12))], axis=-1)
    for seed, index_sigma in itertools.product(range(RIGS // 10 if quick else RIGS), (0.0, 0.005)):
        rng, gel = np.random.default_rng(seed), (5.0, 10.0, 20.0)[seed % 3]
        boards: dict[str, list[Grid]] = {"left": [], "right": []}
        for _ in range(12):
            turn = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))[0]
            place = (board @ turn.T + [*rng.uniform(-3, 3, 2), rng.uniform(-6, 6)]) @ AXES.T
            for name, grid in zip(boards, seen(AIR, place + CENTRE, rng), strict=True):
                boards[name].append(grid)
        rig = calibrate(boards, spacing=2.5, sizes=dict.fromkeys(boards, VIEW[::-1])).rig()
        true = behind(gel)
        tilt = [*rng.normal(0, 0.02, 2), rng.normal(0, 0.5) - 1]
        move = np.array([*tilt, rng.normal(0, 1) * index_sigma])
        true = dataclasses.replace(true, window=true.window.moved(move))
        media = ACRYLIC, (gel + rng.normal(0, 1), 1.41)
        still = seen(true, TRUTH[0], rng)
        fitted = calibrate_window(rig, still, pitch=PITCH, media=media, index_sigma=index_sigma)
        pair = [fitted.triangulate(*seen(true, xyz)) for xyz in TRUTH]
        field = displacement(*pair).raw
        off = (field.displacement - (TRUTH[1] - TRUTH[0])) @ NORMAL
        shared = Bias(fitted, field.position).covariance(field.displacement)[DEEPEST]
        yield {
            "part": "drawn",
            "gel_mm": gel,
            "index": 1.41,
            "changed": f"index +-{index_sigma:g}",
            "error_um": 1e3 * float(abs(off[DEEPEST])),
            "sigma_um": 1e3 * float(np.sqrt(NORMAL @ shared @ NORMAL)),
        }


def rows(arguments: argparse.Namespace) -> Iterator[Row]:
    for part in (without_the_model, wrong_parameters, images, drawn):
        yield from part(quick=arguments.quick)


main = main_of(__doc__, {"refraction": rows}, quick="few gels, ten drawn rigs")

if __name__ == "__main__":
    raise SystemExit(main())
