"""What every native grasp file says: the document, its header, and the checks on what is read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError, InputError
from ..grasps import Grasps
from ..objects import grasp_object
from ..poses import Pose
from ..taxonomy import grasp_type

SCHEMA_VERSION = 1
KIND = "graspcascade grasps"
LABELS = ("grasp_type", "object_label", "side_axis")
NUMBERS = ("side_m", "grasp_size_m", "object_size_m", "probability")
UNKNOWABLE = NUMBERS[1:]
"""Columns in which not-a-number means unknown; files hold null there."""
_FINITE = ("posture", "pregrasp", "position_m", "quat_wxyz", "side_m")
FRAMES = {
    "hand": "palm body of the hand model, wrist joints at zero",
    "object": "centre of the object; a cylinder's axis is z",
    "X_hand_object": "pose of the object in the hand frame",
    "X_world_hand": "pose of the hand frame in the world, present where an object pose in the world was given",
}

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GraspDocument:
    """Hold a grasp file's content.

    Attributes:
        grasps: the grasps.
        metadata: where they come from, as their writer put it.
        X_world_object: object pose in the world that the hand poses were worked out for, None where there was none.
    """

    grasps: Grasps
    metadata: dict[str, Any] = field(default_factory=dict)
    X_world_object: Pose | None = None


def header(document: GraspDocument) -> dict[str, Any]:
    """Say what a reader needs besides the grasps themselves.

    Raises:
        InputError: metadata that JSON cannot hold, or a grasp or object pose that no reader would take.
    """
    grasps = document.grasps
    for name in _FINITE:
        if not np.isfinite(grasps.columns()[name]).all():
            raise InputError(f"{name} must be finite to be written")
    try:
        json.dumps(document.metadata, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"metadata that JSON cannot hold: {error}") from error
    objects = {label: grasp_object(label) for label in dict.fromkeys(grasps.object_label.tolist())}
    found: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "kind": KIND,
        "written_by": f"graspcascade {version('graspcascade')}",
        "units": {"length": "metre", "angle": "radian"},
        "frames": FRAMES,
        "quaternion_order": "wxyz",
        "joint_names": list(grasps.joint_names),
        "objects": {label: obj.to_json() for label, obj in objects.items()},
        "metadata": document.metadata,
    }
    if document.X_world_object is not None:
        pose = document.X_world_object
        try:
            _one_pose(pose.position_m, pose.quat_wxyz)
        except InputError as error:
            raise InputError(f"X_world_object: {error}") from error
        found["X_world_object"] = {"position_m": pose.position_m.tolist(), "quat_wxyz": pose.quat_wxyz.tolist()}
    return found


def check_header(found: object) -> dict[str, Any]:
    """Check what a file says of itself.

    Raises:
        FileFormatError: it is no grasp file, of another schema, or lacks a part.
    """
    if not isinstance(found, dict) or found.get("kind") != KIND:
        raise FileFormatError("not a graspcascade grasp file")
    if found.get("schema_version") != SCHEMA_VERSION:
        raise FileFormatError(
            f"has schema version {found.get('schema_version')!r}; this version reads {SCHEMA_VERSION}"
        )
    names = found.get("joint_names")
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise FileFormatError("joint_names is not a list of names")
    if len(set(names)) != len(names):
        raise FileFormatError("joint_names names a joint twice")
    if found.get("quaternion_order") != "wxyz":
        raise FileFormatError(f"quaternion_order is {found.get('quaternion_order')!r}; only 'wxyz' can be read")
    if not isinstance(found.get("metadata"), dict):
        raise FileFormatError("metadata is missing")
    return found


def world_pose(found: Mapping[str, Any]) -> Pose | None:
    """Read the object pose in the world from a header.

    Raises:
        FileFormatError: it is damaged, or not one pose for all grasps.
    """
    stored = found.get("X_world_object")
    if stored is None:
        return None
    try:
        return _one_pose(stored["position_m"], stored["quat_wxyz"])
    except (InputError, KeyError, TypeError) as error:
        raise FileFormatError(f"X_world_object is damaged ({error})") from error


def exact_pose(position_m: Any, quat_wxyz: Any) -> Pose:
    """Check a pose, leaving quaternions that are unit already as they are: normalising would change their last bit.

    Raises:
        InputError: as `Pose.of`.
    """
    checked = Pose.of(position_m, quat_wxyz)
    given = np.asarray(quat_wxyz, dtype=np.float64)
    same = (np.abs(given - checked.quat_wxyz) < 1e-12).all(axis=-1, keepdims=True)
    return Pose(checked.position_m, np.where(same, given, checked.quat_wxyz))


def _one_pose(position_m: Any, quat_wxyz: Any) -> Pose:
    pose = exact_pose(position_m, quat_wxyz)
    if pose.position_m.shape != (3,):
        raise InputError(
            "one pose, of shapes (3,) and (4,), holds for all grasps; "
            f"got {pose.position_m.shape} and {pose.quat_wxyz.shape}"
        )
    return pose


def build(joint_names: list[str], columns: dict[str, NDArray[Any]]) -> Grasps:
    """Check the columns read from a file and make a batch of them.

    Raises:
        FileFormatError: a value that a grasp cannot have; the message names the grasp, counted from 0.
    """
    for name in _FINITE:
        rows = np.isfinite(columns[name]).all(axis=tuple(range(1, columns[name].ndim)))
        _refuse(~rows, f"{name} is not finite")
    for name in UNKNOWABLE:
        _refuse(np.isinf(columns[name]) | (columns[name] < 0), f"{name} is not a length or chance")
    _refuse(columns["side_m"] <= 0, "side_m is not a positive length")
    _refuse(columns["probability"] > 1, "probability is above 1")
    for row, (kind, label, axis) in enumerate(zip(*(columns[name].tolist() for name in LABELS), strict=True)):
        try:
            grasp_type(kind)
            grasp_object(label).side_axis(axis)
            Pose.of(columns["position_m"][row], columns["quat_wxyz"][row])
        except InputError as error:
            raise FileFormatError(f"grasp {row}: {error}") from error
    pose = exact_pose(columns["position_m"], columns["quat_wxyz"])
    return Grasps.from_columns(joint_names, columns | {"quat_wxyz": pose.quat_wxyz})


def _refuse(rows: NDArray[np.bool_], what: str) -> None:
    if rows.any():
        raise FileFormatError(f"grasp {int(np.argmax(rows))}: {what}")
