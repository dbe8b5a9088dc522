"""A hand's facts for printing."""

from __future__ import annotations

from typing import Any

import numpy as np

from .description import HandDescription
from .model import load_hand, load_spec


def hand_facts(description: HandDescription) -> dict[str, Any]:
    """Gather joints, limits, coupling, contact places and frames of a hand."""
    hand = load_hand(description)
    actuators = _actuators(description)
    degrees = np.degrees(np.stack([hand.lower_rad, hand.upper_rad, hand.pregrasp], axis=1)).round(3).tolist()
    frame = hand.X_forearm_hand
    return {
        "name": description.name,
        "hand_body": description.hand_body,
        "wrist_joints": list(description.wrist_joints),
        "joints": [
            {
                "name": name,
                "lower_deg": lower,
                "upper_deg": upper,
                "pregrasp_deg": pregrasp,
                **actuators[name],
            }
            for name, (lower, upper, pregrasp) in zip(hand.joint_names, degrees, strict=True)
        ],
        "digit_roots": dict(description.digit_roots),
        "palm_bodies": list(description.palm_bodies),
        "coupled": {name: list(joints) for name, joints in description.coupled.items()},
        "places": [
            {"name": name, "body": place.body, "point_m": list(place.point_m), "normal": list(place.normal)}
            for name, place in description.places.items()
        ],
        "tips": {digit: {"body": body, "point_m": list(point)} for digit, (body, point) in description.tips.items()},
        "X_forearm_hand": {
            "position_m": frame.position_m.round(6).tolist(),
            "quat_wxyz": frame.quat_wxyz.round(6).tolist(),
        },
    }


def _actuators(description: HandDescription) -> dict[str, dict[str, Any]]:
    """Find what drives each joint: a tendon's actuator drives two."""
    import mujoco

    model = load_spec(description).compile()
    found: dict[str, dict[str, Any]] = {}
    for number in range(model.nu):
        target = int(model.actuator_trnid[number, 0])
        by_tendon = model.actuator_trntype[number] == mujoco.mjtTrn.mjTRN_TENDON
        driven = (model.tendon(target) if by_tendon else model.joint(target)).name.removeprefix(description.prefix)
        facts = {
            "actuator": model.actuator(number).name.removeprefix(description.prefix),
            "gain_nm_per_rad": float(model.actuator_gainprm[number, 0]),
            "force_limit_nm": float(model.actuator_forcerange[number, 1]),
        }
        found |= dict.fromkeys(description.coupled.get(driven, (driven,)), facts)
    return found
