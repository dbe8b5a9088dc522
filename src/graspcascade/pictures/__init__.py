"""Pictures drawn without a display: a hand and an object offscreen, sheets of grasps, sampled frames."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .paper import need_matplotlib, save_png
from .studio import Studio, need_renderer

if TYPE_CHECKING:
    from .frames import pose_frames
    from .sheets import Stages, grasp_strip, grasp_types_sheet, objects_sheet, stages_of

__all__ = [
    "Stages",
    "Studio",
    "grasp_strip",
    "grasp_types_sheet",
    "need_matplotlib",
    "need_renderer",
    "objects_sheet",
    "pose_frames",
    "save_png",
    "stages_of",
]


def __getattr__(name: str) -> Any:
    # Sheets run trials. What is missing to draw must be said before the physics engine loads, which may fail over it.
    if name in __all__:
        return getattr(import_module(".frames" if name == "pose_frames" else ".sheets", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
