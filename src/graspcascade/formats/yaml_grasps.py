"""Two formats in YAML: isaac_grasp 1.0 of NVIDIA Isaac Sim and Isaac ROS, and moveit_msgs/Grasp messages of ROS 2.

isaac_grasp has one gripper and one object a file. A message in ``grasps`` has the message's own fields only, so that it
can be handed to ``rosidl_runtime_py.set_message_fields`` as it is; what is beside the messages (parent link, notes)
describes the file. Nothing of ROS is needed to write or read them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import FileFormatError
from ..core.poses import Pose, rotate
from ..core.yaml_files import dump_yaml, load_yaml, yaml_files
from ..hands import Hand
from . import document as doc
from . import foreign
from .document import Assumptions, ExportOptions, GraspDocument, by_name, mapping
from .foreign import KEY, ForeignGrasp

_APPROACH_M = 0.1  # the way before closing, and back after it
MESSAGE = "moveit_msgs/msg/Grasp"
FOREARM = "forearm"
_PALM_NORMAL = np.array([0.0, -1.0, 0.0])
"""In the hand frame."""
_CHANCE = "the grasp's own chance to hold as its type asks, else the share of its type and object that held, else 0"
ISAAC_CONVENTIONS = {
    "position, orientation": "pose of the gripper frame (palm body) in the object frame, metres, quaternion w and xyz",
    "cspace_position": "joint targets to close to, radians, by name",
    "pregrasp_cspace_position": "open hand before closing, radians, by name",
    "confidence": _CHANCE,
    "object_scale": "by which the object of that name is scaled",
}
MOVEIT_CONVENTIONS = {
    "grasp_pose": "pose of the parent link in header.frame_id, metres, quaternion x y z w by name; an empty "
    "frame_id is the object's own frame",
    "pre_grasp_posture, grasp_posture": "one point each, radians, in the order of its joint_names",
    "grasp_quality": _CHANCE,
    "pre_grasp_approach": "the way the palm faces (-y of the hand frame), in the parent link's frame",
    "post_grasp_retreat": "upwards (z of the world) where poses are in the world, else the way the palm came",
    "post_place_retreat": "the way the palm came",
}


def _to_write(
    document: GraspDocument, options: ExportOptions, conventions: Mapping[str, str]
) -> tuple[Hand, list[str], list[int], dict[str, Any], list[dict[str, Any]]]:
    """Find the hand, its joints' names in the file (wrist first), their columns, and our notes on file and grasps."""
    grasps = document.grasps
    hand = doc.hand_of({"hand": grasps.hand}, options.hand)
    foreign.check_joints(foreign.without_wrist(grasps, hand.wrist_joints), hand.joint_names, hand.name)
    names = foreign.numbered((*hand.wrist_joints, *hand.joint_names), options.joint_numbering).values()
    columns = hand.columns_in(grasps.joint_names)
    notes = doc.header(document) | {"conventions": conventions}
    if not options.joint_numbering:
        notes["joint_numbering"] = 0
    chances = np.nan_to_num(options.confidence(grasps), nan=0.0).tolist()
    each = [row | {"confidence": chance} for row, chance in zip(foreign.grasp_notes(document), chances, strict=True)]
    return hand, [options.joint_prefix + name for name in names], columns, notes, each


def write_isaac(path: Path, document: GraspDocument, options: ExportOptions) -> None:
    """Write one object's grasps to a file, or to a folder a file for each object."""
    grasps = document.grasps
    hand, names, columns, notes, each = _to_write(document, options, ISAAC_CONVENTIONS)
    names = names[len(hand.wrist_joints) :]
    gripper = grasps.X_hand_object.inverse() @ hand.X_body_hand.inverse()
    rows = [
        {
            "confidence": each[i]["confidence"],
            "position": gripper.position_m[i].tolist(),
            "orientation": {"w": float(gripper.quat_wxyz[i, 0]), "xyz": gripper.quat_wxyz[i, 1:].tolist()},
            "cspace_position": by_name(names, grasps.posture[i, columns]),
            "pregrasp_cspace_position": by_name(names, grasps.pregrasp[i, columns]),
        }
        for i in range(len(grasps))
    ]
    for obj, file, mine in foreign.object_files(path, path, ".yaml", grasps.tasks, "an isaac_grasp"):
        data = {
            "format": "isaac_grasp",
            "format_version": 1.0,
            # Before the grasps, so that a file cut off among them can be told from a whole one.
            KEY: notes | {"grasps": {f"grasp_{i}": each[i] for i in mine}},
            f"object_{options.frame_keys}": obj.name,
            f"gripper_{options.frame_keys}": options.joint_prefix + hand.body,
            "object_scale": 1.0,
            "grasps": {f"grasp_{i}": rows[i] for i in mine},
        }
        comment = "isaac_grasp 1.0: gripper poses in the object frame, metres and radians; quaternions w, xyz"
        dump_yaml(file, data, comment)


def read_isaac(path: Path, assume: Assumptions) -> GraspDocument:
    """Read a file, or all files of a folder."""
    rows: list[ForeignGrasp] = []
    files: list[Mapping[str, Any]] = []
    hand = doc.hand_of({}, assume.hand)
    for file, name in foreign.input_files(path, yaml_files(path) if path.is_dir() else (), ".yaml"):
        with doc.place(name):
            data = load_yaml(file)
            if not isinstance(data, Mapping) or data.get("format") != "isaac_grasp":
                raise FileFormatError("not an isaac_grasp file (no 'format: isaac_grasp')")
            files.append(mapping(data.get(KEY)))
            hand = doc.hand_of(files[-1], assume.hand)
            rows += _isaac_grasps(data, files[-1], hand, assume)
    return foreign.foreign_document(rows, files, assume, hand)


def _isaac_grasps(
    data: Mapping[str, Any], notes: Mapping[str, Any], hand: Hand, assume: Assumptions
) -> Iterator[ForeignGrasp]:
    schema, frame = doc.shown(data.get("format_version")), _frame(data, "gripper_frame")
    if schema.strip("'") not in ("1", "1.0"):
        raise FileFormatError(f"has format_version {schema}; this version reads 1.0")
    if not isinstance(data.get("grasps"), Mapping):
        raise FileFormatError("grasps is not a mapping of grasps by name")
    if frame is not None:
        foreign.which_link(frame, [hand.body], "gripper_frame")
    foreign.check_whole(notes, len(data["grasps"]))
    numbering, noted = notes.get("joint_numbering", assume.joint_numbering), mapping(notes.get("grasps"))
    for name, row in data["grasps"].items():
        with doc.place(name):
            yield _grasp(row, data, mapping(noted.get(name)), hand, numbering)


def _grasp(row: object, data: Mapping[str, Any], notes: Mapping[str, Any], hand: Hand, numbering: int) -> ForeignGrasp:
    if not isinstance(row, Mapping):
        raise FileFormatError("is not a mapping")
    turned, opened = mapping(row.get("orientation")), row.get("pregrasp_cspace_position")
    xyz = turned.get("xyz")
    quat = [doc.number(turned.get("w"), "orientation w"), *(xyz if isinstance(xyz, list) else [])]
    gripper = doc.pose_of(row.get("position"), quat, "gripper")
    joints = partial(foreign.pick_joints, names=hand.joint_names, numbering=numbering)
    frame = _frame(data, "object_frame")
    # The last part of a frame's path, /World/box_medium being box_medium.
    named, label = (
        None if f is None else str(f).rstrip("/").rsplit("/", 1)[-1] for f in (frame, notes.get("object_label"))
    )
    return ForeignGrasp(
        joints(row.get("cspace_position"), what="cspace_position"),
        None if opened is None and not notes else joints(opened, what="pregrasp_cspace_position"),
        (gripper @ hand.X_body_hand).inverse(),
        named,
        foreign.scale_of(row.get("object_scale", data.get("object_scale", 1.0)), "object_scale"),
        row.get("confidence"),
        notes,
        None not in (named, label) and foreign.file_stem(str(named)) != foreign.file_stem(str(label)),
    )


def _frame(data: Mapping[str, Any], key: str) -> str | None:
    frame = data.get(key, data.get(f"{key}_link"))
    return None if frame is None else str(frame)


def write_moveit(path: Path, document: GraspDocument, options: ExportOptions) -> None:
    """Write a list of messages."""
    grasps = document.grasps
    hand, names, columns, notes, each = _to_write(document, options, MOVEIT_CONVENTIONS)
    placed = None if options.frame_id == "" else document.X_world_object
    wrist = hand.wrist_joints if options.parent_link == FOREARM else ()
    part = FOREARM if wrist else hand.body
    X_hand_link = _link_in_hand(hand, part)
    parent = (grasps.X_hand_object.inverse() if placed is None else grasps.hand_pose(placed)) @ X_hand_link
    facing = rotate(X_hand_link.inverse().quat_wxyz, _PALM_NORMAL)
    names = names if wrist else names[len(hand.wrist_joints) :]
    link, straight = options.joint_prefix + part, [0.0] * len(wrist)
    messages = []
    for i, name in enumerate(grasps.object_name.tolist()):
        frame = (name if placed is None else "world") if options.frame_id is None else options.frame_id
        back = _translation(link, -facing)
        up = _translation(frame, np.array([0.0, 0.0, 1.0]))
        point, turn = parent.position_m[i], np.roll(parent.quat_wxyz[i], -1)
        pose = {"position": by_name("xyz", point), "orientation": by_name("xyzw", turn)}
        messages.append(
            {
                "id": f"{grasps.grasp_type[i]}/{name}/{i}",
                "pre_grasp_posture": _trajectory(names, straight + grasps.pregrasp[i, columns].tolist()),
                "grasp_posture": _trajectory(names, straight + grasps.posture[i, columns].tolist()),
                "grasp_pose": {"header": _header(frame), "pose": pose},
                "grasp_quality": each[i]["confidence"],
                "pre_grasp_approach": _translation(link, facing),
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
        KEY: notes | {"grasps": each},
        "grasps": messages,
    }
    dump_yaml(path, data, f"{MESSAGE}: poses of {link}, metres and radians; the wrist is straight")


def read_moveit(path: Path, assume: Assumptions) -> GraspDocument:
    """Read a list of messages."""
    data = load_yaml(path)
    if not isinstance(data, Mapping) or not isinstance(data.get("grasps"), list):
        raise FileFormatError("not a file of moveit_msgs/Grasp messages (no list 'grasps')")
    notes, link, messages = mapping(data.get(KEY)), str(data.get("parent_link")), data["grasps"]
    hand = doc.hand_of(notes, assume.hand)
    links = [FOREARM, hand.body] if hand.wrist_joints else [hand.body]
    part = foreign.which_link(link, links, "parent_link")
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
            quality, touched = message.get("grasp_quality"), message.get("allowed_touch_objects") or [name]
            changed = mapping(noted).get("object_label", name) not in touched
            grasp = ForeignGrasp(target, opened, X_hand_object, name, confidence=quality, notes=mapping(noted))
            rows.append(replace(grasp, changed=changed))
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
    bent = [name for name, angle in angles.items() if name.endswith(wrist) and abs(angle) > foreign.STRAIGHT_RAD]
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


def _translation(frame: str, vector: np.ndarray[Any, Any]) -> dict[str, Any]:
    # Adding 0 takes the sign off a zero.
    direction = {"header": _header(frame), "vector": by_name("xyz", vector + 0.0)}
    return {"direction": direction, "desired_distance": _APPROACH_M, "min_distance": _APPROACH_M / 2}
