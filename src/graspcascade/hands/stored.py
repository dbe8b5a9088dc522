"""A hand's geometry as JSON, so that a trained model can be used without its MJCF or a physics engine."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError
from ..poses import Pose
from .description import ContactPlace, HandDescription
from .kinematics import Kinematics
from .model import HandModel


def hand_to_json(hand: HandModel) -> dict[str, Any]:
    """Give everything geometric about a hand as plain lists and numbers; collision shapes stay in the MJCF."""
    about = hand.description
    return {
        "name": about.name,
        "hand_body": about.hand_body,
        "wrist_joints": list(about.wrist_joints),
        "joint_names": list(about.joint_names),
        "coupled": {name: list(pair) for name, pair in about.coupled.items()},
        "digit_roots": dict(about.digit_roots),
        "palm_bodies": list(about.palm_bodies),
        "places": {name: [p.body, list(p.point_m), list(p.normal)] for name, p in about.places.items()},
        "tips": {digit: [body, list(point)] for digit, (body, point) in about.tips.items()},
        "pregrasp_rad": dict(about.pregrasp_rad),
        "lower_rad": hand.lower_rad.tolist(),
        "upper_rad": hand.upper_rad.tolist(),
        "X_forearm_hand": [hand.X_forearm_hand.position_m.tolist(), hand.X_forearm_hand.quat_wxyz.tolist()],
        "kinematics": hand.kinematics.to_json(),
    }


def hand_from_json(data: dict[str, Any]) -> HandModel:
    """Rebuild a hand from `hand_to_json`; it has no MJCF and cannot be put into a scene.

    Raises:
        FileFormatError: a field is missing or malformed.
    """
    try:
        description = HandDescription(
            name=data["name"],
            mjcf=Path(),
            hand_body=data["hand_body"],
            wrist_joints=tuple(data["wrist_joints"]),
            joint_names=tuple(data["joint_names"]),
            coupled={name: (pair[0], pair[1]) for name, pair in data["coupled"].items()},
            digit_roots=data["digit_roots"],
            palm_bodies=tuple(data["palm_bodies"]),
            places={name: ContactPlace(p[0], tuple(p[1]), tuple(p[2])) for name, p in data["places"].items()},
            tips={digit: (tip[0], tuple(tip[1])) for digit, tip in data["tips"].items()},
            pregrasp_rad=data["pregrasp_rad"],
        )
        return HandModel(
            description,
            Kinematics.from_json(data["kinematics"]),
            np.array(data["lower_rad"]),
            np.array(data["upper_rad"]),
            Pose.of(*data["X_forearm_hand"]),
        )
    except (KeyError, TypeError, IndexError) as error:
        raise FileFormatError(f"stored hand geometry lacks or garbles {error}") from error
