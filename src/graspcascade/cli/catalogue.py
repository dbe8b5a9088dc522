"""``graspcascade types``, ``hands``, ``objects`` and ``completion``: what there is, and what works."""

from __future__ import annotations

import contextlib
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

import numpy as np
from tyro.conf import Positional, arg

from ..core.objects import CATALOGUE, as_object
from ..hands import Hand, load_hand, shipped_hands
from . import VERBS, command_class, console, tyro_config
from .console import Friction, HandName, Json, MassG, ModelName, OwnHand, numbers, print_json, print_table


@dataclass(frozen=True)
class Types:
    """Say how likely grasps of an object are to hold, for each grasp type and each side within the hand's reach.

    It is the model's own estimate: 64 grasps of each are drawn, and none is tried.
    """

    object: Annotated[Positional[str], arg(metavar="OBJECT")]
    """Catalogue name, or a size: box:32x41x60mm, cylinder:27x80mm (diameter x height), sphere:40mm."""
    friction: Friction = None
    mass_g: MassG = None
    model: ModelName = "default"
    hand: OwnHand = None
    json: Json = False

    def run(self) -> None:
        """Print a line for each type and side."""
        from ..proposals.ranked import feasibility

        obj = console.weighed(as_object(self.object), self.mass_g)
        proposal = console.load_proposal(self.model, self.hand)
        ranked = console.as_ranked(console.with_friction(proposal, self.friction, self.model), self.model, "this")
        rows = feasibility(ranked, obj)
        if self.json:
            about = {"object": obj.name, **obj.to_json(), "mass_kg": obj.mass_kg, "friction": ranked.friction}
            print_json({"model": ranked.name, **about, "types": [row.to_json() for row in rows]})
            return
        print(f"{obj.name} of {obj.mass_kg * 1000:.3g} g, friction {ranked.friction:g}, by the model's estimate:")
        good = f"raw draws\nfrom {100 * ranked.good_enough:g} %"
        print_table(
            ["type", "side\ncm", "chance\n%", good, "works"],
            [
                [row.grasp_type, f"{row.side_axis} {row.side_m * 100:g}"]
                + [f"{100 * share:.0f}" for share in (row.chance, row.good_draws)]
                + [row.word]
                for row in rows
            ],
            left=(0, 1, 4),
        )


@dataclass(frozen=True)
class Objects:
    """List the catalogue objects, their sides and which of them the hand reaches round.

    Anything else is spelled by its size: box:32x41x60mm, cylinder:27x80mm (diameter x height), sphere:40mm.
    """

    hand: HandName = "shadow"
    json: Json = False

    def run(self) -> None:
        """Print the catalogue."""
        reach, facts, rows = load_hand(self.hand).reach_m, [], []
        for obj in CATALOGUE.values():
            graspable = {axis: site.width_m for axis, site in obj.sites(reach).items()}
            sizes = {"sides_m": obj.sides_m, "graspable_sides_m": graspable, "mass_kg": obj.mass_kg}
            facts.append({"name": obj.name, **obj.to_json(), **sizes})
            sides = ", ".join(f"{axis} {side * 100:g}" for axis, side in obj.sides_m.items())
            rows.append([obj.name, sides, ", ".join(graspable), f"{obj.mass_kg * 1000:.0f}"])
        if self.json:
            print_json(facts)
            return
        print_table(["object", "sides cm", "graspable", "mass g"], rows, left=range(3))
        print("Or a size: box:32x41x60mm, cylinder:27x80mm (diameter x height), sphere:40mm.")


@dataclass(frozen=True)
class Hands:
    """List the shipped hands, or show one of them or a hand file: `graspcascade hands show my_hand.yaml`."""

    action: Annotated[Positional[Literal["list", "show"]], arg(metavar="list|show")] = "list"
    """list the hands, or show one."""
    hand: Annotated[Positional[str], arg(metavar="NAME|FILE")] = "shadow"
    """The hand to show."""
    json: Json = False

    def run(self) -> None:
        """Print the list or one hand."""
        if self.action == "show":
            facts = _facts(load_hand(self.hand))
            print_json(facts) if self.json else _print_hand(facts)
            return
        hands = {name: load_hand(name) for name in shipped_hands()}
        if self.json:
            print_json({name: _facts(hand) for name, hand in hands.items()})
            return
        rows = [
            [name, hand.name, " ".join(hand.digits), str(len(hand.joint_names)), ", ".join(hand.wrist_joints)]
            for name, hand in hands.items()
        ]
        print_table(["--hand", "name", "digits", "joints", "wrist joints, held at zero"], rows, left=(0, 1, 2, 4))


_JOINT = ("name", "lower_deg", "upper_deg", "pregrasp_deg", "actuator")


def _facts(hand: Hand) -> dict[str, Any]:
    degrees = np.degrees([hand.lower_rad, hand.upper_rad, hand.pregrasp]).round(3).tolist()
    actuators = {joint: actuator.name for actuator in hand.actuators for joint in actuator.weights}
    joints = zip(hand.joint_names, *degrees, map(actuators.get, hand.joint_names), strict=True)
    base = hand.X_base_hand
    at = {"position_m": base.position_m.round(6).tolist(), "quat_wxyz": base.quat_wxyz.round(6).tolist()}
    return {
        "name": hand.name,
        "reach_m": hand.reach_m,
        "grasp_types": [kind.name for kind in hand.grasp_types],
        "joints": [dict(zip(_JOINT, joint, strict=True)) for joint in joints],
        "actuators": [asdict(actuator) for actuator in hand.actuators],
        "digits": {name: asdict(digit) for name, digit in hand.digits.items()},
        "palm_bodies": list(hand.palm_bodies),
        "couplings": [asdict(coupling) for coupling in hand.couplings],
        "places": {name: asdict(place) for name, place in hand.places.items()},
        "frame": {"body": hand.body, "wrist_joints_at_zero": list(hand.wrist_joints), "X_base_hand": at},
    }


def _print_hand(facts: dict[str, Any]) -> None:
    actuators = {actuator["name"]: actuator for actuator in facts["actuators"]}
    print(f"{facts['name']}: digits {', '.join(facts['digits'])}; reaches round {facts['reach_m'] * 100:g} cm")
    print(f"grasp types: {', '.join(facts['grasp_types']) or 'none'}")
    print("joints in posture order, limits in degrees:")
    rows = []
    for number, joint in enumerate(facts["joints"]):
        drive = actuators.get(joint["actuator"])
        gains = ["-", "-"] if drive is None else [f"{drive[key]:g}" for key in ("gain_nm_per_rad", "force_limit_nm")]
        angles = [f"{joint[key]:.1f}" for key in ("lower_deg", "upper_deg", "pregrasp_deg")]
        rows.append([str(number), joint["name"], *angles, joint["actuator"] or "none", *gains])
    columns = ["#", "joint", "lower", "upper", "pregrasp", "actuator", "gain\nN m/rad", "limit\nN m"]
    print_table(columns, rows, left=(0, 1, 5))
    for coupling in facts["couplings"]:
        # Of joints that share a tendon only the weighted sum is commanded.
        how = "are moved by one tendon" if coupling["kind"] == "tendon" else "follow each other"
        print(f"{' and '.join(coupling['joints'])} {how} ({coupling['name']})")
    rows = [
        [name, place["body"], numbers(1000 * np.array(place["point_m"]), "6.1f"), numbers(place["normal"], "6.3f")]
        for name, place in facts["places"].items()
    ]
    print_table(["place", "body", "point mm (x y z)", "outward normal (x y z)"], rows, left=(0, 1))
    frame, at = facts["frame"], facts["frame"]["X_base_hand"]
    wrist = ", ".join(frame["wrist_joints_at_zero"]) or "none"
    print(f"hand frame: body {frame['body']!r}, wrist joints at zero: {wrist}; in the frame of the base")
    print(f"at {at['position_m']} m, quaternion (w x y z) {at['quat_wxyz']}")


@dataclass(frozen=True)
class Completion:
    """Print the completion script of a shell, as in: source <(graspcascade completion bash)."""

    shell: Annotated[Positional[Literal["bash", "zsh"]], arg(metavar="bash|zsh")]
    """Which shell."""

    def run(self) -> None:
        """Print the script."""
        import tyro

        # tyro prints the script and then exits as after --help.
        with contextlib.suppress(SystemExit):
            commands, asked = {name: command_class(name) for name in VERBS}, ["--tyro-print-completion", self.shell]
            tyro.extras.subcommand_cli_from_dict(commands, prog="graspcascade", args=asked, config=tyro_config())
