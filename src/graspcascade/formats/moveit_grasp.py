"""moveit_msgs/Grasp messages as YAML, field by field as in ROS 2; nothing of ROS is needed to write or read them.

``grasps`` is a list of messages, each of the message's own fields only, so that an element can be handed to
``rosidl_runtime_py.set_message_fields`` as it is. What is beside them (parent link, notes) describes the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import FileFormatError, InputError
from ..core.poses import Pose, rotate
from ..core.yaml_files import dump_yaml, load_yaml
from ..hands import Hand
from . import document as doc
from . import foreign
from .document import Assumptions, ExportOptions, GraspDocument, mapping
from .foreign import KEY, ForeignGrasp

MESSAGE = "moveit_msgs/msg/Grasp"
FOREARM = "forearm"
_STRAIGHT_RAD = 1e-6
_PALM_NORMAL = np.array([0.0, -1.0, 0.0])
"""In the hand frame."""
CONVENTIONS = {
    "grasp_pose": "pose of the parent link in header.frame_id, metres, quaternion x y z w by name; an empty "
    "frame_id is the object's own frame",
    "pre_grasp_posture, grasp_posture": "one point each, radians, in the order of its joint_names",
    "grasp_quality": "chance to hold; 0 where it was not measured",
    "pre_grasp_approach": "the way the palm faces (-y of the hand frame), in the parent link's frame",
    "post_grasp_retreat": "upwards (z of the world) where poses are in the world, else the way the palm came",
    "post_place_retreat": "the way the palm came",
}


def write(path: Path, document: GraspDocument, options: ExportOptions) -> None:
    """Write a list of messages."""
    grasps = document.grasps
    hand, columns, written = foreign.joints_to_write(grasps, options)
    for bent in (name for name in hand.wrist_joints if name in grasps.joint_names):
        angles = np.array([grasps.posture, grasps.pregrasp])[..., grasps.joint_names.index(bent)]
        if np.abs(angles).max(initial=0.0) > _STRAIGHT_RAD:
            raise InputError(f"the grasps bend the wrist ({bent}); only a straight wrist can be written")
    notes = foreign.file_notes(document, CONVENTIONS, options.joint_numbering)
    placed = None if options.frame_id == "" else document.X_world_object
    wrist = hand.wrist_joints if options.parent_link == FOREARM else ()
    part = FOREARM if wrist else hand.body
    X_hand_link = _link_in_hand(hand, part)
    parent = (grasps.X_hand_object.inverse() if placed is None else grasps.hand_pose(placed)) @ X_hand_link
    facing = rotate(X_hand_link.inverse().quat_wxyz, _PALM_NORMAL)
    names = [written[name] for name in (*wrist, *hand.joint_names)]
    confidence = np.nan_to_num(options.confidence(grasps), nan=0.0)
    link, straight = options.joint_prefix + part, [0.0] * len(wrist)
    messages = []
    for i, name in enumerate(grasps.object_name.tolist()):
        frame = (name if placed is None else "world") if options.frame_id is None else options.frame_id
        back = _translation(link, -facing, options.retreat_m)
        up = _translation(frame, np.array([0.0, 0.0, 1.0]), options.retreat_m)
        point, turn = parent.position_m[i], np.roll(parent.quat_wxyz[i], -1)
        pose = {"position": doc.by_name("xyz", point), "orientation": doc.by_name("xyzw", turn)}
        messages.append(
            {
                "id": f"{grasps.grasp_type[i]}/{name}/{i}",
                "pre_grasp_posture": _trajectory(names, straight + grasps.pregrasp[i, columns].tolist()),
                "grasp_posture": _trajectory(names, straight + grasps.posture[i, columns].tolist()),
                "grasp_pose": {"header": _header(frame), "pose": pose},
                "grasp_quality": float(confidence[i]),
                "pre_grasp_approach": _translation(link, facing, options.approach_m),
                "post_grasp_retreat": back if placed is None else up,
                "post_place_retreat": back,
                "max_contact_force": 0.0,
                "allowed_touch_objects": [name],
            }
        )
    data = {
        "message": MESSAGE,
        "parent_link": link,
        # Before the grasps, so that a file cut off among them can be told from a whole one.
        KEY: notes | {"grasps": foreign.grasp_notes(document, confidence)},
        "grasps": messages,
    }
    dump_yaml(path, data, f"{MESSAGE}: poses of {link}, metres and radians; the wrist is straight")


def read(path: Path, assume: Assumptions) -> GraspDocument:
    """Read a list of messages."""
    data = load_yaml(path)
    if not isinstance(data, Mapping) or not isinstance(data.get("grasps"), list):
        raise FileFormatError("not a file of moveit_msgs/Grasp messages (no list 'grasps')")
    notes, link, messages = mapping(data.get(KEY)), str(data.get("parent_link")), data["grasps"]
    hand = doc.hand_of(notes, assume.hand)
    links = [FOREARM, hand.body] if hand.wrist_joints else [hand.body]
    part = next((name for name in links if link.endswith(name)), None)
    if part is None:
        raise FileFormatError(f"parent_link is {link!r}; only poses of {' or '.join(links)} can be read")
    foreign.check_whole(notes, len(messages))
    numbering, placed = notes.get("joint_numbering", assume.joint_numbering), doc.world_pose(notes)
    rows = []
    for i, (message, noted) in enumerate(zip(messages, notes.get("grasps", [{}] * len(messages)), strict=True)):
        with doc.place(f"grasp {i}"):
            if not isinstance(message, Mapping):
                raise FileFormatError("is not a mapping")
            opened, target = (
                _angles(mapping(message.get(what)), what, hand, part, numbering)
                for what in ("pre_grasp_posture", "grasp_posture")
            )
            X_hand_object, name = _object(message, mapping(noted), _link_in_hand(hand, part), placed)
        quality = message.get("grasp_quality")
        rows.append(ForeignGrasp(target, opened, X_hand_object, name, confidence=quality, notes=mapping(noted)))
    return foreign.foreign_document(rows, [notes], assume, hand)


def _object(
    message: Mapping[str, Any], notes: Mapping[str, Any], X_hand_link: Pose, X_world_object: Pose | None
) -> tuple[Pose, str | None]:
    """Read the object's pose in the hand frame, and its name."""
    stamped = mapping(message.get("grasp_pose"))
    fields, frame = mapping(stamped.get("pose")), mapping(stamped.get("header")).get("frame_id")
    point, turn = mapping(fields.get("position")), mapping(fields.get("orientation"))
    parent = doc.pose_of([point.get(k) for k in "xyz"], [turn.get(k) for k in "wxyz"], "grasp_pose")
    X_hand_object = X_hand_link @ parent.inverse()
    if X_world_object is not None and frame != "":
        # Poses are in the object's own frame unless the notes say where in theirs the object is.
        X_hand_object = X_hand_object @ X_world_object
    touched = message.get("allowed_touch_objects")
    named = touched[0] if isinstance(touched, list) and touched else frame or None
    if not notes and frame not in (named, ""):
        raise FileFormatError(f"its pose is in frame {frame!r}, and where in that the object is, the file does not say")
    return X_hand_object, None if named is None else str(named)


def _angles(given: Mapping[str, Any], what: str, hand: Hand, link: str, numbering: int) -> dict[str, float]:
    names, points = given.get("joint_names"), given.get("points")
    if not isinstance(names, list) or not isinstance(points, list) or not points:
        raise FileFormatError(f"{what} is not a trajectory with joint names and a point")
    positions = doc.numbers(mapping(points[-1]).get("positions"), len(names), f"{what} positions")
    angles = dict(zip(map(str, names), positions, strict=True))
    wrist = tuple(foreign.numbered(hand.wrist_joints, numbering).values()) if link == FOREARM else ()
    bent = [name for name, angle in angles.items() if name.endswith(wrist) and abs(angle) > _STRAIGHT_RAD]
    if bent:
        raise FileFormatError(f"{what} bends the wrist ({', '.join(bent)}); only a straight wrist can be read")
    return foreign.pick_joints(angles, hand.joint_names, what, numbering)


def _link_in_hand(hand: Hand, link: str) -> Pose:
    """Compute the pose of a parent link in the hand frame, wrist straight."""
    return (hand.X_base_hand if link == FOREARM else hand.X_body_hand).inverse()


def _header(frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}


def _trajectory(names: list[str], positions: list[float]) -> dict[str, Any]:
    rest: dict[str, Any] = {"velocities": [], "accelerations": [], "effort": []}
    point = {"positions": positions} | rest | {"time_from_start": {"sec": 0, "nanosec": 0}}
    return {"header": _header(""), "joint_names": names, "points": [point]}


def _translation(frame: str, vector: np.ndarray[Any, Any], distance_m: float) -> dict[str, Any]:
    # Adding 0 takes the sign off a zero.
    direction = {"header": _header(frame), "vector": doc.by_name("xyz", vector + 0.0)}
    return {"direction": direction, "desired_distance": distance_m, "min_distance": distance_m / 2}
