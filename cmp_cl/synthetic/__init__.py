"""Rendered gels with exact truth, and how detections are scored against it."""

from cmp_cl.synthetic import scoring as scoring
from cmp_cl.synthetic.camera import default_rig
from cmp_cl.synthetic.rendering import Rendered, binocular_frame, render, render_stereo
from cmp_cl.synthetic.scene import Indenter, Mode, Scene, Surround, random_scene

__all__ = [
    "Indenter",
    "Mode",
    "Rendered",
    "Scene",
    "Surround",
    "binocular_frame",
    "default_rig",
    "random_scene",
    "render",
    "render_stereo",
]
