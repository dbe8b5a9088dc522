"""`GraspDocument`, the header that every file of ours carries, and the checks on what is read and written."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import hands  # not its functions: those load what reads hand files, which sampling does not need
from ..core.errors import FileFormatError, InputError
from ..core.errors import shortened as cut
from ..core.grasps import Grasps
from ..core.poses import Pose
from ..core.records import objects_to_json, read_tasks
from ..hands import Hand

SCHEMA_VERSION = 1
KIND = "graspcascade grasps"
LABELS = ("grasp_type", "object_label", "side_axis")
NUMBERS = ("side_m", "grasp_size_m", "object_size_m", "probability")
UNKNOWABLE = NUMBERS[1:]
"""Columns in which not-a-number means unknown; files hold null there."""
_FIRST_HAND = "shadow_hand_right"
"""Hand of files that do not say: the only one there was when these were written."""
_FURTHEST_M, _FURTHEST_IN_WORLD_M = 1.0, 1e7
_ROUNDING_RAD, _FAR_RAD, _FAR_JOINTS = 1e-3, 0.5, 3
FRAMES = {
    "hand": "palm body of the hand model, wrist joints at zero",
    "object": "centre of the object; a cylinder's axis is z",
    "X_hand_object": "pose of the object in the hand frame",
    "X_world_hand": "pose of the hand frame in the world, present where an object pose in the world was given",
}

Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class GraspDocument:
    """Hold a grasp file's content.

    Attributes:
        grasps: the grasps.
        metadata: where they come from, as their writer put it.
        X_world_object: object pose in the world that the hand poses were worked out for, None where there was none.
        notes: what a reader should be told of the file, such as angles beyond the hand's limits; one line each.
    """

    grasps: Grasps
    metadata: dict[str, Any] = field(default_factory=dict)
    X_world_object: Pose | None = None
    notes: tuple[str, ...] = ()


def header(document: GraspDocument) -> dict[str, Any]:
    """Say what a reader needs besides the grasps themselves."""
    grasps = document.grasps
    _check_values(grasps.columns() | {"side_m": grasps.side_m})
    try:
        json.dumps(document.metadata, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"metadata that JSON cannot hold: {error}") from error
    head: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "kind": KIND,
        "written_by": f"graspcascade {version('graspcascade')}",
        "units": {"length": "metre", "angle": "radian"},
        "frames": FRAMES,
        "quaternion_order": "wxyz",
        "hand": grasps.hand,
        "joint_names": list(grasps.joint_names),
        "objects": objects_to_json(grasps.tasks),
        "metadata": document.metadata,
    }
    if document.X_world_object is not None:
        pose = document.X_world_object
        try:
            _one_pose(pose.position_m, pose.quat_wxyz)
        except InputError as error:
            raise InputError(f"X_world_object: {error}") from error
        head["X_world_object"] = pose_to_json(pose)
    return head


def check_header(head: object) -> dict[str, Any]:
    """Check what a file says of itself."""
    if not isinstance(head, dict) or head.get("kind") != KIND:
        raise FileFormatError("not a graspcascade grasp file")
    names: Any = head.get("joint_names")
    listed = isinstance(names, list) and bool(names) and all(isinstance(name, str) for name in names)
    version_read, order = head.get("schema_version"), head.get("quaternion_order")
    faults = {
        f"has schema version {version_read!r}; this version reads {SCHEMA_VERSION}": version_read != SCHEMA_VERSION,
        "joint_names is not a list of names": not listed,
        "joint_names names a joint twice": listed and len(set(names)) < len(names),
        f"quaternion_order is {order!r}; only 'wxyz' can be read": order != "wxyz",
        "metadata is missing": not isinstance(head.get("metadata"), dict),
    }
    for fault, present in faults.items():
        if present:
            raise FileFormatError(fault)
    return head


def hand_name(head: Mapping[str, Any]) -> str:
    """Read the name of the hand from a header."""
    name = head.get("hand", _FIRST_HAND)
    if not isinstance(name, str):
        raise FileFormatError(f"hand is {shortened(name)}, not a name")
    return name


def hand_of(head: Mapping[str, Any], given: Hand | None) -> Hand:
    """Choose the hand that a file is for: the one given, else the shipped one it names, else the Shadow Hand."""
    name = hand_name(head)
    hand = hands.shipped_hand(name) if given is None else given
    if hand is None:
        raise InputError(
            f"these grasps are of hand {name!r}, which does not come with graspcascade; give its hand file (--hand)"
        )
    return hand


def to_document(
    head: Mapping[str, Any], joint_names: Sequence[str], columns: Columns, objects: object, hand: Hand | None
) -> GraspDocument:
    """Check the columns read from a file and make a document of them.

    Args:
        head: what the file says of itself, see `header`.
        joint_names: names of the columns of angles.
        columns: `LABELS`, `NUMBERS`, posture, pregrasp, position_m and quat_wxyz, one row a grasp.
        objects: what the file says of its objects, by name.
        hand: whose limits the angles must keep; by default the shipped hand that the file is for, if it is one.
    """
    name = hand_name(head)
    hand = hands.shipped_hand(name) if hand is None else hand
    try:
        _check_values(columns)
        notes = () if hand is None else _keep_limits(columns, joint_names, hand)
    except InputError as error:
        raise FileFormatError(str(error)) from error
    kinds, names, axes = (columns[label] for label in LABELS)
    tasks = read_tasks(kinds, names, axes, columns["side_m"], objects)
    pose = _exact_pose(columns["position_m"], columns["quat_wxyz"])
    numbers = {key: columns[key] for key in ("posture", "pregrasp", "position_m", *UNKNOWABLE)}
    grasps = Grasps.from_columns(name, joint_names, tasks, numbers | {"quat_wxyz": pose.quat_wxyz})
    return GraspDocument(grasps, dict(mapping(head.get("metadata"))), world_pose(head), notes)


def facts(grasps: Grasps) -> Columns:
    """Columns ``(n,)`` of `LABELS` and `NUMBERS`."""
    labels = zip(LABELS, (grasps.grasp_type, grasps.object_name, grasps.side_axis), strict=True)
    return dict(labels) | {name: getattr(grasps, name) for name in NUMBERS}


def fact_rows(grasps: Grasps) -> list[dict[str, Any]]:
    """List `facts` grasp by grasp, with None for unknown."""
    columns = {
        name: [None if isinstance(v, float) and math.isnan(v) else v for v in column.tolist()]
        for name, column in facts(grasps).items()
    }
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def stack(rows: Sequence[Mapping[str, Any]], joint_names: Sequence[str]) -> Columns:
    """Make columns of rows, each a mapping of `LABELS`, `NUMBERS`, angles by joint name and a pose's parts."""
    columns: Columns = {name: np.array([row[name] for row in rows], dtype=str) for name in LABELS}
    columns |= {name: np.array([row[name] for row in rows], dtype=np.float64) for name in NUMBERS}
    for name in ("posture", "pregrasp"):
        angles = [[row[name][joint] for joint in joint_names] for row in rows]
        columns[name] = np.array(angles, dtype=np.float64).reshape(len(rows), len(joint_names))
    for name, width in (("position_m", 3), ("quat_wxyz", 4)):
        columns[name] = np.array([row[name] for row in rows], dtype=np.float64).reshape(len(rows), width)
    return columns


def pose_to_json(pose: Pose, row: Any = ()) -> dict[str, list[float]]:
    """Write one pose, or that of a row, as plain lists."""
    return {"position_m": pose.position_m[row].tolist(), "quat_wxyz": pose.quat_wxyz[row].tolist()}


def world_pose(head: Mapping[str, Any]) -> Pose | None:
    """Read the object pose in the world from a header."""
    stored = head.get("X_world_object")
    if stored is None:
        return None
    try:
        return _one_pose(stored["position_m"], stored["quat_wxyz"])
    except (InputError, KeyError, TypeError) as error:
        raise FileFormatError(f"X_world_object is damaged ({error})") from error


@contextlib.contextmanager
def place(where: str) -> Iterator[None]:
    """Say of errors in the block where in the file they are."""
    try:
        yield
    except InputError as error:
        raise type(error)(f"{where}: {error}") from error


def mapping(value: object) -> Mapping[str, Any]:
    """Return a mapping as it is and anything else as an empty one."""
    return value if isinstance(value, Mapping) else {}


def number(value: object, what: str) -> float:
    """Check a number."""
    read = math.nan
    if isinstance(value, int | float | np.number) and not isinstance(value, bool | np.complexfloating):
        with contextlib.suppress(OverflowError):
            read = float(value)
    if not math.isfinite(read):
        raise FileFormatError(f"{what} is {shortened(value)}, not a finite number")
    return read


def numbers(values: object, length: int, what: str) -> list[float]:
    """Check a list of numbers."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if not isinstance(values, Sequence) or isinstance(values, str | bytes) or len(values) != length:
        raise FileFormatError(f"{what} is not a list of {length} numbers")
    return [number(value, what) for value in values]


def pose_of(position_m: object, quat_wxyz: object, what: str) -> Pose:
    """Check a pose."""
    parts = numbers(position_m, 3, f"{what} position"), numbers(quat_wxyz, 4, f"{what} quaternion")
    try:
        return Pose.of(*parts)
    except InputError as error:
        raise FileFormatError(f"{what}: {error}") from error


def shortened(value: object) -> str:
    """Write a value for a message, cut off where it is long."""
    return cut(repr(value))


def _check_values(columns: Mapping[str, NDArray[Any]]) -> None:
    """Check the numbers of grasps that are read or written, whatever their hand."""
    for name in ("posture", "pregrasp", "position_m", "quat_wxyz", "side_m"):
        rows = np.isfinite(columns[name]).all(axis=tuple(range(1, columns[name].ndim)))
        _refuse(~rows, f"{name} is not finite")
    for name in UNKNOWABLE:
        _refuse(np.isinf(columns[name]) | (columns[name] < 0), f"{name} is not a length or chance")
    _refuse(columns["side_m"] <= 0, "side_m is not a positive length")
    _refuse(columns["probability"] > 1, "probability is above 1")
    for name in NUMBERS[:3]:
        what = f"{name} is {{:g}}, but lengths are metres; this looks like centimetres or millimetres"
        _refuse(columns[name] > _FURTHEST_M, what, columns[name])
    with np.errstate(over="ignore"):  # what is too large for a float is refused like anything else
        distance, norm = (np.linalg.norm(columns[name], axis=1) for name in ("position_m", "quat_wxyz"))
    what = "the object's centre is {:g} m from the palm, but lengths are metres; these look like millimetres"
    _refuse(distance > _FURTHEST_M, what, distance)
    _refuse(np.abs(norm - 1.0) > 1e-3, "the quaternion (qw qx qy qz) must have norm 1, got norm {:.4g}", norm)
    for name in ("posture", "pregrasp"):
        largest = np.abs(columns[name]).max(axis=1, initial=0.0)
        what = f"{name} has an angle of {{:g}}, but angles are radians; this looks like degrees"
        _refuse(largest > 2 * np.pi, what, largest)


def _keep_limits(columns: Columns, joint_names: Sequence[str], hand: Hand) -> tuple[str, ...]:
    """Clip angles that rounding put past a limit, and tell of those that are well beyond."""
    limits = dict(zip(hand.joint_names, zip(hand.lower_rad, hand.upper_rad, strict=True), strict=True))
    low, high = np.array([limits.get(name, (-np.inf, np.inf)) for name in joint_names]).reshape(-1, 2).T
    notes = []
    for name in ("posture", "pregrasp"):
        angles = columns[name]
        beyond = np.maximum(low - angles, angles - high)
        if ((beyond > _FAR_RAD).sum(axis=1) >= _FAR_JOINTS).sum() * 2 > len(angles):
            raise InputError(
                f"in most grasps several angles of {name} are far beyond the limits of {hand.name}; they look like "
                "degrees, or are of another hand"
            )
        columns[name] = np.where(beyond <= _ROUNDING_RAD, np.clip(angles, low, high), angles)
        over = beyond > _ROUNDING_RAD
        if over.any():
            joints = ", ".join(
                f"{joint_names[j]} {over[:, j].sum()} (by up to {beyond[:, j].max():.2g} rad)"
                for j in np.flatnonzero(over.any(axis=0)).tolist()
            )
            count = int(over.any(axis=1).sum())
            notes.append(f"{name} is beyond the joint limits of {hand.name} in {count} grasps: {joints}")
    return tuple(notes)


def _refuse(rows: NDArray[np.bool_], what: str, values: NDArray[np.float64] | None = None) -> None:
    if rows.any():
        row = int(np.argmax(rows))
        raise InputError(f"grasp {row}: {what if values is None else what.format(values[row])}")


def _exact_pose(position_m: Any, quat_wxyz: Any) -> Pose:
    """Check a pose, leaving quaternions that are unit already as they are: normalising would change their last bit."""
    checked = Pose.of(position_m, quat_wxyz)
    given = np.asarray(quat_wxyz, dtype=np.float64)
    same = (np.abs(given - checked.quat_wxyz) < 1e-12).all(axis=-1, keepdims=True)
    return Pose(checked.position_m, np.where(same, given, checked.quat_wxyz))


def _one_pose(position_m: Any, quat_wxyz: Any) -> Pose:
    pose = _exact_pose(position_m, quat_wxyz)
    shapes = pose.position_m.shape, pose.quat_wxyz.shape
    if shapes[0] != (3,):
        raise InputError(f"one pose, of shapes (3,) and (4,), holds for all grasps; got {shapes[0]} and {shapes[1]}")
    if np.abs(pose.position_m).max() > _FURTHEST_IN_WORLD_M:
        raise InputError(f"a position of {np.abs(pose.position_m).max():g} m is no place in the world")
    return pose
