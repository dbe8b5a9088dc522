"""Pictures drawn without a display: a hand and an object offscreen, sheets of grasps, sampled frames."""

from .paper import check_png, need_matplotlib, save_png
from .render import Renderer, View, need_renderer
from .sheets import grasp_strip

__all__ = [
    "Renderer",
    "View",
    "check_png",
    "grasp_strip",
    "need_matplotlib",
    "need_renderer",
    "save_png",
]
