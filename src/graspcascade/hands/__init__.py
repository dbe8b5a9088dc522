"""Hand models: the right Shadow Dexterous Hand, and a small description under which another MJCF takes its place."""

from .description import SHADOW_HAND, ContactPlace, HandDescription
from .kinematics import Kinematics, Link
from .model import HandModel, PlacePoints, load_hand, load_spec, shadow_hand
from .stored import hand_from_json, hand_to_json

__all__ = [
    "SHADOW_HAND",
    "ContactPlace",
    "HandDescription",
    "HandModel",
    "Kinematics",
    "Link",
    "PlacePoints",
    "hand_from_json",
    "hand_to_json",
    "load_hand",
    "load_spec",
    "shadow_hand",
]
