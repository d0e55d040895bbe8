"""Rendered gels with exact truth, and how detections are scored against it."""

from cmp_cl.synthetic.scene import (
    Cameras,
    Indenter,
    Mode,
    Rendered,
    Rig,
    Scene,
    Surround,
    binocular_frame,
    default_rig,
    random_scene,
    render,
    render_stereo,
)

__all__ = [
    "Cameras",
    "Indenter",
    "Mode",
    "Rendered",
    "Rig",
    "Scene",
    "Surround",
    "binocular_frame",
    "default_rig",
    "random_scene",
    "render",
    "render_stereo",
]
