"""Pictures drawn without a display: a hand and an object offscreen, sheets of grasps, sampled frames."""

from .frames import pose_frames
from .paper import need_matplotlib, save_png
from .sheets import Stages, grasp_strip, grasp_types_sheet, objects_sheet, stages_of
from .studio import Studio

__all__ = [
    "Stages",
    "Studio",
    "grasp_strip",
    "grasp_types_sheet",
    "need_matplotlib",
    "objects_sheet",
    "pose_frames",
    "save_png",
    "stages_of",
]
