"""Hands: joints, digits, couplings and contact places, read from a hand file beside an MJCF."""

from typing import TYPE_CHECKING, Any

from .hand import Actuator, Closure, ContactPlace, Coupling, Digit, Hand, PlacePoints, is_left
from .kinematics import Kinematics, Link

if TYPE_CHECKING:
    from .hand_file import executing_hand, load_hand, read_hand_file, read_spec, shipped_hand, shipped_hands

__all__ = [
    "Actuator",
    "Closure",
    "ContactPlace",
    "Coupling",
    "Digit",
    "Hand",
    "Kinematics",
    "Link",
    "PlacePoints",
    "is_left",
]
__all__ += ["executing_hand", "load_hand", "read_hand_file", "read_spec", "shipped_hand", "shipped_hands"]


def __getattr__(name: str) -> Any:
    # Sampling takes its hand from the model's weights and should not wait for what reads hand files.
    if name in __all__:
        from . import hand_file

        return getattr(hand_file, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
