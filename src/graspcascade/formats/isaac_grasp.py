"""isaac_grasp YAML 1.0, the grasp files of NVIDIA Isaac Sim and Isaac ROS: one gripper and one object a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import FileFormatError
from ..core.yaml_files import dump_yaml, load_yaml, yaml_files
from ..hands import Hand
from . import foreign
from .document import Assumptions, ExportOptions, GraspDocument, by_name, hand_of, mapping, number, place, pose_of
from .foreign import KEY, ForeignGrasp

CONVENTIONS = {
    "position, orientation": "pose of the gripper frame (palm body) in the object frame, metres, quaternion w and xyz",
    "cspace_position": "joint targets to close to, radians, by name",
    "pregrasp_cspace_position": "open hand before closing, radians, by name",
    "confidence": "chance to hold; 0 where it was not measured",
    "object_scale": "by which the object of that name is scaled",
}
_COMMENT = "isaac_grasp 1.0: gripper poses in the object frame, metres and radians; quaternions w, xyz"


def write(path: Path, document: GraspDocument, options: ExportOptions) -> None:
    """Write one object's grasps to a file, or to a folder a file for each object."""
    grasps = document.grasps
    hand, columns, written = foreign.joints_to_write(grasps, options)
    names = [written[name] for name in hand.joint_names]
    notes = foreign.file_notes(document, CONVENTIONS, options.joint_numbering)
    confidence = np.nan_to_num(options.confidence(grasps), nan=0.0)
    gripper = grasps.X_hand_object.inverse() @ hand.X_body_hand.inverse()
    rows = [
        {
            "confidence": float(confidence[i]),
            "position": gripper.position_m[i].tolist(),
            "orientation": {"w": float(gripper.quat_wxyz[i, 0]), "xyz": gripper.quat_wxyz[i, 1:].tolist()},
            "cspace_position": by_name(names, grasps.posture[i, columns]),
            "pregrasp_cspace_position": by_name(names, grasps.pregrasp[i, columns]),
        }
        for i in range(len(grasps))
    ]
    each = foreign.grasp_notes(document, confidence)
    for name, file, mine in foreign.object_files(path, path, ".yaml", grasps.tasks, "an isaac_grasp"):
        data = {
            "format": "isaac_grasp",
            "format_version": 1.0,
            # Before the grasps, so that a file cut off among them can be told from a whole one.
            KEY: notes | {"grasps": {f"grasp_{i}": each[i] for i in mine}},
            f"object_{options.frame_keys}": name,
            f"gripper_{options.frame_keys}": options.joint_prefix + hand.body,
            "object_scale": 1.0,
            "grasps": {f"grasp_{i}": rows[i] for i in mine},
        }
        dump_yaml(file, data, _COMMENT)


def read(path: Path, assume: Assumptions) -> GraspDocument:
    """Read a file, or all files of a folder."""
    rows: list[ForeignGrasp] = []
    files: list[Mapping[str, Any]] = []
    hand = hand_of({}, assume.hand)
    for file in yaml_files(path) if path.is_dir() else [path]:
        data = load_yaml(file)
        if not isinstance(data, Mapping) or data.get("format") != "isaac_grasp":
            raise FileFormatError("not an isaac_grasp file (no 'format: isaac_grasp')")
        notes, frame = mapping(data.get(KEY)), _frame(data, "gripper_frame")
        files.append(notes)
        hand = hand_of(notes, assume.hand)
        if str(data.get("format_version")) not in ("1", "1.0"):
            raise FileFormatError(f"has format_version {data.get('format_version')!r}; this version reads 1.0")
        if not isinstance(data.get("grasps"), Mapping):
            raise FileFormatError("grasps is not a mapping of grasps by name")
        if frame is not None and not frame.endswith(hand.body):
            what = f"{hand.name}'s {hand.body}"
            raise FileFormatError(f"its gripper frame is {frame!r}; only poses of {what} can be read")
        foreign.check_whole(notes, len(data["grasps"]))
        numbering, noted = notes.get("joint_numbering", assume.joint_numbering), mapping(notes.get("grasps"))
        for name, row in data["grasps"].items():
            with place(name):
                rows.append(_grasp(row, data, mapping(noted.get(name)), hand, numbering))
    return foreign.foreign_document(rows, files, assume, hand)


def _grasp(row: object, data: Mapping[str, Any], notes: Mapping[str, Any], hand: Hand, numbering: int) -> ForeignGrasp:
    if not isinstance(row, Mapping):
        raise FileFormatError("is not a mapping")
    turned, opened = mapping(row.get("orientation")), row.get("pregrasp_cspace_position")
    xyz = turned.get("xyz")
    quat = [number(turned.get("w"), "orientation w"), *(xyz if isinstance(xyz, list) else [])]
    gripper = pose_of(row.get("position"), quat, "gripper")

    def joints(angles: object, what: str) -> dict[str, float]:
        return foreign.pick_joints(angles, hand.joint_names, what, numbering)

    return ForeignGrasp(
        joints(row.get("cspace_position"), "cspace_position"),
        None if opened is None and not notes else joints(opened, "pregrasp_cspace_position"),
        (gripper @ hand.X_body_hand).inverse(),
        _frame(data, "object_frame"),
        foreign.scale_of(row.get("object_scale", data.get("object_scale", 1.0)), "object_scale"),
        row.get("confidence"),
        notes,
    )


def _frame(data: Mapping[str, Any], key: str) -> str | None:
    """Read the last part of a frame's path, ``/World/box_medium`` being ``box_medium``."""
    frame = data.get(key, data.get(f"{key}_link"))
    return None if frame is None else str(frame).rstrip("/").rsplit("/", 1)[-1]
