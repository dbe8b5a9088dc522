"""``graspcascade hands`` and ``graspcascade objects``: what there is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg

from ..errors import unknown
from ..objects import CATALOGUE, DENSITY_KG_M3
from .console import print_json, print_table


@dataclass(frozen=True)
class Objects:
    """List the catalogue objects, their sides and which of them the hand reaches round."""

    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        """Print the catalogue."""
        found = [
            {
                "label": obj.label,
                "shape": obj.shape,
                "extents_m": list(obj.extents_m),
                "sides_m": obj.sides_m,
                "graspable_sides_m": obj.graspable_sides_m,
                "mass_kg": obj.volume_m3 * DENSITY_KG_M3,
            }
            for obj in CATALOGUE.values()
        ]
        if self.json:
            print_json(found)
            return
        rows = [
            [
                obj.label,
                ", ".join(f"{axis} {side * 100:g}" for axis, side in obj.sides_m.items()),
                ", ".join(obj.graspable_sides_m),
                f"{obj.volume_m3 * DENSITY_KG_M3 * 1000:.0f}",
            ]
            for obj in CATALOGUE.values()
        ]
        print_table(["object", "sides cm", "graspable", "mass g"], rows, left=range(3))


@dataclass(frozen=True)
class Hands:
    """List the hands, or show one: `graspcascade hands show shadow_hand_right`."""

    action: Annotated[Positional[Literal["list", "show"]], arg(metavar="list|show")] = "list"
    """list the hands, or show one."""
    name: Annotated[Positional[str], arg(metavar="NAME")] = "shadow_hand_right"
    """The hand to show."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        """Print the list or one hand."""
        from ..hands import SHADOW_HAND

        hands = {SHADOW_HAND.name: SHADOW_HAND}
        if self.action == "list":
            if self.json:
                names = ("name", "joint_names", "wrist_joints")
                print_json([{name: getattr(hand, name) for name in names} for hand in hands.values()])
            else:
                rows = [[h.name, str(len(h.joint_names)), ", ".join(h.wrist_joints)] for h in hands.values()]
                print_table(["hand", "joints", "wrist joints, held at zero"], rows, left=(0, 2))
            return
        # The beginning of a name will do while it is the beginning of one only.
        meant = [name for name in hands if name == self.name] or [name for name in hands if name.startswith(self.name)]
        if len(meant) != 1 or not self.name:
            raise unknown("hand", self.name, hands)
        from ..hands.facts import hand_facts

        facts = hand_facts(hands[meant[0]])
        if self.json:
            print_json(facts)
        else:
            _print_hand(facts)


def _print_hand(facts: dict[str, Any]) -> None:
    print(f"{facts['name']}: joints in posture order, limits in degrees")
    print_table(
        ["#", "joint", "lower", "upper", "pregrasp", "actuator", "gain\nN m/rad", "limit\nN m"],
        [_joint_row(number, joint) for number, joint in enumerate(facts["joints"])],
        left=(0, 1),
    )
    print("Joints that share an actuator are moved by one tendon: only their sum is commanded.")
    print_table(
        ["place", "body", "point mm (x y z)", "outward normal (x y z)"],
        [
            [
                p["name"],
                p["body"],
                " ".join(f"{v * 1000:6.1f}" for v in p["point_m"]),
                " ".join(f"{v:6.3f}" for v in p["normal"]),
            ]
            for p in facts["places"]
        ],
        left=(0, 1),
    )
    frame = facts["X_forearm_hand"]
    print(f"hand frame: body {facts['hand_body']!r}, wrist joints {', '.join(facts['wrist_joints'])} at zero;")
    print(f"in the forearm base at {frame['position_m']} m, quaternion (w x y z) {frame['quat_wxyz']}")


def _joint_row(number: int, joint: dict[str, Any]) -> list[str]:
    degrees = [f"{joint[key]:.1f}" for key in ("lower_deg", "upper_deg", "pregrasp_deg")]
    drive = [joint["actuator"], f"{joint['gain_nm_per_rad']:g}", f"{joint['force_limit_nm']:g}"]
    return [str(number), joint["name"], *degrees, *drive]
