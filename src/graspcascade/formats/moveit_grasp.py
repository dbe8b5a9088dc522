"""moveit_msgs/Grasp messages as YAML, field by field as in ROS 2; nothing of ROS is needed to write or read them.

``grasps`` is a list of messages, each of the message's own fields only, so that an element can be handed to
``rosidl_runtime_py.set_message_fields`` as it is. What is beside them (parent link, notes) describes the file.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError
from ..hands import SHADOW_HAND, shadow_hand
from ..poses import Pose
from .document import GraspDocument, world_pose
from .notes import (
    KEY,
    ForeignGrasp,
    check_whole,
    file_notes,
    foreign_document,
    grasp_notes,
    mapping,
    numbers,
    pose,
    shadow_joints,
)
from .options import PARENT_LINKS, Assumptions, ExportOptions
from .yaml_text import dump_yaml, load_yaml

MESSAGE = "moveit_msgs/msg/Grasp"
_NOW = {"sec": 0, "nanosec": 0}
CONVENTIONS = {
    "grasp_pose": "pose of the parent link in header.frame_id, metres, quaternion x y z w by name",
    "pre_grasp_posture, grasp_posture": "one point each, radians, in the order of its joint_names",
    "grasp_quality": "chance to hold; 0 where it was not measured",
    "pre_grasp_approach": "along the straight fingers (z of the parent link)",
    "post_grasp_retreat": "upwards (z of the world) where poses are in the world, else back along the fingers",
}


def write(path: Path, document: GraspDocument, options: ExportOptions) -> None:
    """Write a list of messages.

    Raises:
        InputError: a value that no reader would take.
    """
    notes = file_notes(document, CONVENTIONS)
    grasps, prefix = document.grasps, options.joint_prefix
    placed = document.X_world_object
    X_frame_hand = grasps.X_hand_object.inverse() if placed is None else grasps.hand_pose(placed)
    parent = X_frame_hand @ _pose_in_hand(options.parent_link)
    wrist = SHADOW_HAND.wrist_joints if options.parent_link == "forearm" else ()
    names = [prefix + name for name in (*wrist, *grasps.joint_names)]
    quality = np.nan_to_num(options.confidence(grasps), nan=0.0).tolist()
    link = prefix + options.parent_link
    messages = []
    for i in range(len(grasps)):
        label = str(grasps.object_label[i])
        frame = options.frame_id or (label if placed is None else "world")
        lift = _translation(link, -1.0, options.retreat_m)
        back = lift if placed is None else _translation(frame, 1.0, options.retreat_m)
        messages.append(
            {
                "id": f"{grasps.grasp_type[i]}/{label}/{i}",
                "pre_grasp_posture": _trajectory(names, [0.0] * len(wrist) + grasps.pregrasp[i].tolist()),
                "grasp_posture": _trajectory(names, [0.0] * len(wrist) + grasps.posture[i].tolist()),
                "grasp_pose": {"header": _header(frame), "pose": _pose_fields(parent, i)},
                "grasp_quality": quality[i],
                "pre_grasp_approach": _translation(link, 1.0, options.approach_m),
                "post_grasp_retreat": back,
                "post_place_retreat": lift,
                "max_contact_force": 0.0,
                "allowed_touch_objects": [label],
            }
        )
    data = {
        "message": MESSAGE,
        "parent_link": link,
        # Before the grasps, so that a file cut off among them can be told from a whole one.
        KEY: notes | {"grasps": grasp_notes(grasps)},
        "grasps": messages,
    }
    dump_yaml(path, data, f"{MESSAGE}: poses of {link}, metres and radians; the wrist is straight")


def read(path: Path, assume: Assumptions) -> GraspDocument:
    """Read a list of messages.

    Raises:
        FileFormatError: it is truncated or foreign, or does not say which link its poses are of.
        InputError: something it does not say and nothing is assumed for.
    """
    data = load_yaml(path)
    if not isinstance(data, Mapping) or not isinstance(data.get("grasps"), list):
        raise FileFormatError("not a file of moveit_msgs/Grasp messages (no list 'grasps')")
    link = str(data.get("parent_link"))
    known = next((name for name in PARENT_LINKS if link.endswith(name)), None)
    if known is None:
        raise FileFormatError(f"parent_link is {link!r}; only poses of {' or '.join(PARENT_LINKS)} can be read")
    notes = mapping(data.get(KEY))
    return foreign_document(_grasps(data["grasps"], known, notes), notes, assume)


def _grasps(messages: list[Any], link: str, notes: Mapping[str, Any]) -> Iterator[ForeignGrasp]:
    check_whole(notes, len(messages))
    placed, rows = world_pose(notes), notes.get("grasps", [{}] * len(messages))
    for i, (message, row) in enumerate(zip(messages, rows, strict=True)):
        try:
            yield _grasp(message, link, placed, mapping(row))
        except FileFormatError as error:
            raise FileFormatError(f"grasp {i}: {error}") from error


def _grasp(message: object, link: str, placed: Pose | None, notes: Mapping[str, Any]) -> ForeignGrasp:
    if not isinstance(message, Mapping):
        raise FileFormatError("is not a mapping")
    stamped = mapping(message.get("grasp_pose"))
    fields = mapping(stamped.get("pose"))
    place, turn = mapping(fields.get("position")), mapping(fields.get("orientation"))
    parent = pose([place.get(k) for k in "xyz"], [turn.get(k) for k in "wxyz"], "grasp_pose")
    X_frame_hand = parent @ _pose_in_hand(link).inverse()
    # Poses are in the object's own frame unless the notes say where in that frame the object is.
    X_hand_object = X_frame_hand.inverse() if placed is None else X_frame_hand.inverse() @ placed
    frame, touched = mapping(stamped.get("header")).get("frame_id"), message.get("allowed_touch_objects")
    named = touched[0] if isinstance(touched, list) and touched else frame
    if not notes and frame != named:
        raise FileFormatError(f"its pose is in frame {frame!r}, and where in that the object is, the file does not say")
    return ForeignGrasp(
        _angles(message.get("grasp_posture"), "grasp_posture", link),
        _angles(message.get("pre_grasp_posture"), "pre_grasp_posture", link),
        X_hand_object,
        None if named is None else str(named),
        notes,
    )


def _angles(trajectory: object, what: str, link: str) -> dict[str, float]:
    found = mapping(trajectory)
    names, points = found.get("joint_names"), found.get("points")
    if not isinstance(names, list) or not isinstance(points, list) or not points:
        raise FileFormatError(f"{what} is not a trajectory with joint names and a point")
    positions = numbers(mapping(points[-1]).get("positions"), len(names), f"{what} positions")
    angles = dict(zip(map(str, names), positions, strict=True))
    bent = [n for n, angle in angles.items() if n.endswith(SHADOW_HAND.wrist_joints) and abs(angle) > 1e-6]
    if bent and link == "forearm":
        raise FileFormatError(f"{what} bends the wrist ({', '.join(bent)}); only a straight wrist can be read")
    return shadow_joints(angles, what)


def _pose_in_hand(link: str) -> Pose:
    """Give the pose of a parent link in the hand frame, wrist straight."""
    if link == SHADOW_HAND.hand_body:
        return Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    return shadow_hand().X_forearm_hand.inverse()


def _header(frame: str) -> dict[str, Any]:
    return {"stamp": dict(_NOW), "frame_id": frame}


def _trajectory(names: list[str], positions: list[float]) -> dict[str, Any]:
    point = {"positions": positions, "velocities": [], "accelerations": [], "effort": [], "time_from_start": dict(_NOW)}
    return {"header": _header(""), "joint_names": list(names), "points": [point]}


def _pose_fields(poses: Pose, row: int) -> dict[str, Any]:
    place, turn = poses.position_m[row].tolist(), poses.quat_wxyz[row].tolist()
    return {
        "position": dict(zip("xyz", place, strict=True)),
        "orientation": dict(zip("xyzw", [*turn[1:], turn[0]], strict=True)),
    }


def _translation(frame: str, z: float, distance_m: float) -> dict[str, Any]:
    direction = {"header": _header(frame), "vector": {"x": 0.0, "y": 0.0, "z": z}}
    return {"direction": direction, "desired_distance": distance_m, "min_distance": distance_m / 2}
