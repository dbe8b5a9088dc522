"""isaac_grasp YAML 1.0, the grasp files of NVIDIA Isaac Sim and Isaac ROS.

A file holds the grasps of one gripper and one object: the gripper frame's pose in the object frame, joint positions by
name, and a confidence. Documented with Isaac Sim's grasp editor; ``object_frame`` and ``gripper_frame`` are for human
readers there, and some releases call them ``object_frame_link`` and ``gripper_frame_link``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError, InputError
from ..hands import SHADOW_HAND
from .document import GraspDocument
from .notes import (
    KEY,
    ForeignGrasp,
    check_whole,
    file_notes,
    foreign_document,
    grasp_notes,
    mapping,
    number,
    pose,
    shadow_joints,
)
from .options import Assumptions, ExportOptions
from .yaml_text import dump_yaml, load_yaml, yaml_files

CONVENTIONS = {
    "position, orientation": "pose of the gripper frame (palm) in the object frame, metres, quaternion w and xyz",
    "cspace_position": "joint targets to close to, radians, by name",
    "pregrasp_cspace_position": "open hand before closing, radians, by name",
    "confidence": "chance to hold; 0 where it was not measured",
}


def write(path: Path, document: GraspDocument, options: ExportOptions) -> None:
    """Write one object's grasps to a file, or to a folder a file for each object.

    Raises:
        InputError: a file is to hold grasps of several objects, or a value that no reader would take.
    """
    labels = list(dict.fromkeys(document.grasps.object_label.tolist()))
    if path.is_dir():
        for label in labels:
            _write_object(
                path / f"{label}.yaml", document, np.flatnonzero(document.grasps.object_label == label), options
            )
        return
    if len(labels) != 1:
        raise InputError(
            f"an isaac_grasp file holds the grasps of one object, these are of {len(labels)} "
            f"({', '.join(labels) or 'none'}); a name without suffix makes a folder with a file for each"
        )
    _write_object(path, document, np.arange(len(document.grasps)), options)


def read(path: Path, assume: Assumptions) -> GraspDocument:
    """Read a file, or all files of a folder.

    Raises:
        FileFormatError: it is truncated or foreign, or of another gripper.
        InputError: something it does not say and nothing is assumed for.
    """
    found: list[ForeignGrasp] = []
    notes: Mapping[str, Any] = {}
    for file in yaml_files(path) if path.is_dir() else [path]:
        data = load_yaml(file)
        notes = mapping(_checked(data).get(KEY))
        found.extend(_grasps(data, notes))
    return foreign_document(found, notes, assume)


def _write_object(path: Path, document: GraspDocument, which: NDArray[np.intp], options: ExportOptions) -> None:
    grasps, prefix = document.grasps, options.joint_prefix
    gripper = grasps.X_hand_object.inverse()
    names = [prefix + name for name in grasps.joint_names]
    confidence = np.nan_to_num(options.confidence(grasps), nan=0.0).tolist()
    rows = {
        f"grasp_{i}": {
            "confidence": confidence[i],
            "position": gripper.position_m[i].tolist(),
            "orientation": {
                "w": float(gripper.quat_wxyz[i, 0]),
                "xyz": gripper.quat_wxyz[i, 1:].tolist(),
            },
            "cspace_position": dict(zip(names, grasps.posture[i].tolist(), strict=True)),
            "pregrasp_cspace_position": dict(zip(names, grasps.pregrasp[i].tolist(), strict=True)),
        }
        for i in which.tolist()
    }
    each = grasp_notes(grasps)
    notes = file_notes(document, CONVENTIONS) | {"grasps": {f"grasp_{i}": each[i] for i in which.tolist()}}
    data = {
        "format": "isaac_grasp",
        "format_version": 1.0,
        # Before the grasps, so that a file cut off among them can be told from a whole one.
        KEY: notes,
        "object_frame": str(grasps.object_label[which[0]]),
        "gripper_frame": prefix + SHADOW_HAND.hand_body,
        "grasps": rows,
    }
    dump_yaml(path, data, "isaac_grasp 1.0: gripper poses in the object frame, metres and radians; quaternions w, xyz")


def _checked(data: object) -> Mapping[str, Any]:
    if not isinstance(data, Mapping) or data.get("format") != "isaac_grasp":
        raise FileFormatError("not an isaac_grasp file (no 'format: isaac_grasp')")
    try:
        version = float(data.get("format_version", "nan"))
    except (TypeError, ValueError):
        version = float("nan")
    if version != 1.0:
        raise FileFormatError(f"has format_version {data.get('format_version')!r}; this version reads 1.0")
    if not isinstance(data.get("grasps"), Mapping):
        raise FileFormatError("grasps is not a mapping of grasps by name")
    frame = _frame(data, "gripper_frame")
    if frame is not None and not frame.endswith(SHADOW_HAND.hand_body):
        raise FileFormatError(
            f"its gripper frame is {frame!r}; only poses of the Shadow Hand's {SHADOW_HAND.hand_body} can be read"
        )
    return data


def _grasps(data: Mapping[str, Any], notes: Mapping[str, Any]) -> Iterator[ForeignGrasp]:
    object_name, noted = _frame(data, "object_frame"), mapping(notes.get("grasps"))
    check_whole(notes, len(data["grasps"]))
    for name, row in data["grasps"].items():
        try:
            yield _grasp(row, object_name, mapping(noted.get(name)))
        except FileFormatError as error:
            raise FileFormatError(f"{name}: {error}") from error


def _grasp(row: object, object_name: str | None, notes: Mapping[str, Any]) -> ForeignGrasp:
    if not isinstance(row, Mapping):
        raise FileFormatError("is not a mapping")
    turned = mapping(row.get("orientation"))
    xyz = turned.get("xyz")
    quat = [number(turned.get("w"), "orientation w"), *(xyz if isinstance(xyz, list) else [])]
    gripper = pose(row.get("position"), quat, "gripper")
    opened = row.get("pregrasp_cspace_position")
    return ForeignGrasp(
        shadow_joints(row.get("cspace_position"), "cspace_position"),
        None if opened is None and not notes else shadow_joints(opened, "pregrasp_cspace_position"),
        gripper.inverse(),
        object_name,
        notes,
    )


def _frame(data: Mapping[str, Any], key: str) -> str | None:
    """Give the last part of a frame's path, ``/World/box_medium`` being ``box_medium``."""
    frame = data.get(key, data.get(f"{key}_link"))
    return None if frame is None else str(frame).rstrip("/").rsplit("/", 1)[-1]
