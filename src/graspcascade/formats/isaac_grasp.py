"""isaac_grasp YAML 1.0, the grasp files of NVIDIA Isaac Sim and Isaac ROS: one gripper and one object a file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import FileFormatError
from ..core.yaml_files import dump_yaml, load_yaml, yaml_files
from ..hands import Hand
from . import foreign
from .document import GraspDocument, hand_of, mapping, number, place, pose_of
from .foreign import KEY, ForeignGrasp
from .options import Assumptions, ExportOptions

CONVENTIONS = {
    "position, orientation": "pose of the gripper frame (palm body) in the object frame, metres, quaternion w and xyz",
    "cspace_position": "joint targets to close to, radians, by name",
    "pregrasp_cspace_position": "open hand before closing, radians, by name",
    "confidence": "chance to hold; 0 where it was not measured",
    "object_scale": "by which the object of that name is scaled",
}


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
            "cspace_position": dict(zip(names, grasps.posture[i, columns].tolist(), strict=True)),
            "pregrasp_cspace_position": dict(zip(names, grasps.pregrasp[i, columns].tolist(), strict=True)),
        }
        for i in range(len(grasps))
    ]
    each, in_folder = foreign.grasp_notes(document, confidence), path.is_dir()
    if not in_folder:
        foreign.only_object(grasps.tasks, "an isaac_grasp")
    for name, stem in foreign.file_stems(grasps.tasks).items():
        mine = [i for i, other in enumerate(grasps.object_name.tolist()) if other == name]
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
        comment = "isaac_grasp 1.0: gripper poses in the object frame, metres and radians; quaternions w, xyz"
        dump_yaml(path / f"{stem}.yaml" if in_folder else path, data, comment)


def read(path: Path, assume: Assumptions) -> GraspDocument:
    """Read a file, or all files of a folder."""
    rows: list[ForeignGrasp] = []
    files: list[Mapping[str, Any]] = []
    hand = hand_of({}, assume.hand)
    for file in yaml_files(path) if path.is_dir() else [path]:
        data = load_yaml(file)
        if not isinstance(data, Mapping) or data.get("format") != "isaac_grasp":
            raise FileFormatError("not an isaac_grasp file (no 'format: isaac_grasp')")
        files.append(mapping(data.get(KEY)))
        hand = hand_of(files[-1], assume.hand)
        _check(data, hand)
        rows.extend(_grasps(data, files[-1], hand, assume))
    return foreign.foreign_document(rows, files, assume, hand)


def _check(data: Mapping[str, Any], hand: Hand) -> None:
    if str(data.get("format_version")) not in ("1", "1.0"):
        raise FileFormatError(f"has format_version {data.get('format_version')!r}; this version reads 1.0")
    if not isinstance(data.get("grasps"), Mapping):
        raise FileFormatError("grasps is not a mapping of grasps by name")
    frame = _frame(data, "gripper_frame")
    if frame is not None and not frame.endswith(hand.body):
        raise FileFormatError(f"its gripper frame is {frame!r}; only poses of {hand.name}'s {hand.body} can be read")


def _grasps(
    data: Mapping[str, Any], notes: Mapping[str, Any], hand: Hand, assume: Assumptions
) -> Iterator[ForeignGrasp]:
    noted = mapping(notes.get("grasps"))
    foreign.check_whole(notes, len(data["grasps"]))
    numbering = notes.get("joint_numbering", assume.joint_numbering)
    for name, row in data["grasps"].items():
        with place(name):
            if not isinstance(row, Mapping):
                raise FileFormatError("is not a mapping")
            yield _grasp(row, data, mapping(noted.get(name)), hand, numbering)


def _grasp(
    row: Mapping[str, Any], data: Mapping[str, Any], notes: Mapping[str, Any], hand: Hand, numbering: int
) -> ForeignGrasp:
    turned = mapping(row.get("orientation"))
    xyz = turned.get("xyz")
    quat = [number(turned.get("w"), "orientation w"), *(xyz if isinstance(xyz, list) else [])]
    gripper, opened = pose_of(row.get("position"), quat, "gripper"), row.get("pregrasp_cspace_position")

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
