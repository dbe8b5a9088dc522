"""What other formats have no field for, and how a foreign grasp becomes one of ours.

An exported file carries these notes under one key of our own, which the tools that own the format pass over. With them
an export reads back with its type, side and sizes; without them (a file of someone else's) `Assumptions` fill in.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError, InputError
from ..grasps import Grasps
from ..hands import SHADOW_HAND, HandModel, shadow_hand
from ..objects import AXES, GraspObject, grasp_object
from ..poses import Pose, quat_conjugate, rotate
from ..taxonomy import GraspType, grasp_type
from .document import LABELS, NUMBERS, GraspDocument, build, header, world_pose
from .options import Assumptions

KEY = "graspcascade"


@dataclass(frozen=True)
class ForeignGrasp:
    """Hold one grasp as a file of another format tells it.

    Attributes:
        posture: target angles by our joint names, radians.
        pregrasp: open hand before closing likewise; None where the format has no such thing.
        X_hand_object: object pose in the hand frame, ``(3,)`` and ``(4,)``.
        object_name: what the file calls the object, None where it does not say.
        notes: our own notes on it, empty in a file of someone else's.
    """

    posture: Mapping[str, float]
    pregrasp: Mapping[str, float] | None
    X_hand_object: Pose
    object_name: str | None
    notes: Mapping[str, Any] = field(default_factory=dict)


def file_notes(document: GraspDocument, conventions: Mapping[str, str]) -> dict[str, Any]:
    """Give the notes on a whole file: the native header, and the frames and orders of the format it is in.

    Raises:
        InputError: metadata that JSON cannot hold, or a grasp or object pose that no reader would take.
    """
    _check_joints(document.grasps)
    return header(document) | {"conventions": dict(conventions)}


def grasp_notes(grasps: Grasps) -> list[dict[str, Any]]:
    """Give the notes on each grasp: its number, labels, and lengths and chances with None for unknown."""
    columns = {name: column.tolist() for name, column in grasps.columns().items() if name in (*LABELS, *NUMBERS)}
    return [
        {"number": i}
        | {name: columns[name][i] for name in LABELS}
        | {name: columns[name][i] if math.isfinite(columns[name][i]) else None for name in NUMBERS}
        for i in range(len(grasps))
    ]


def check_whole(notes: Mapping[str, Any], n: int) -> None:
    """Check that a file has as many grasps as our notes on it, where it has such notes.

    Raises:
        FileFormatError: it has not, or the notes are damaged.
    """
    if not notes:
        return
    noted = notes.get("grasps")
    if not isinstance(noted, list | Mapping):
        raise FileFormatError("its notes on the grasps are damaged")
    if len(noted) != n:
        raise FileFormatError(f"it has {n} of the {len(noted)} grasps that were written")


def mapping(value: object) -> Mapping[str, Any]:
    """Give a mapping as it is and anything else as an empty one."""
    return value if isinstance(value, Mapping) else {}


def foreign_document(found: Iterable[ForeignGrasp], notes: Mapping[str, Any], assume: Assumptions) -> GraspDocument:
    """Make a document of what a foreign file says.

    Args:
        found: its grasps.
        notes: our own notes on the file, empty in a file of someone else's.
        assume: what it does not say.

    Raises:
        FileFormatError: a value that a grasp cannot have.
        InputError: something it does not say and nothing is assumed for.
    """
    rows = list(found)
    if all("number" in row.notes for row in rows):
        rows.sort(key=lambda row: number(row.notes["number"], "number"))
    names = list(SHADOW_HAND.joint_names)
    columns: dict[str, list[Any]] = {name: [] for name in (*LABELS, *NUMBERS, "posture", "pregrasp")}
    for i, row in enumerate(rows):
        try:
            facts = _facts(row, assume)
        except FileFormatError as error:
            raise FileFormatError(f"grasp {i}: {error}") from error
        except InputError as error:
            raise InputError(f"grasp {i}: {error}") from error
        for name, value in facts.items():
            columns[name].append(value)
        columns["posture"].append([row.posture[name] for name in names])
        columns["pregrasp"].append([(row.pregrasp or _open_hand())[name] for name in names])
    arrays: dict[str, NDArray[Any]] = {name: np.array(columns[name], dtype=str) for name in LABELS}
    arrays |= {name: np.array(columns[name], dtype=np.float64) for name in NUMBERS}
    arrays |= {name: np.array(columns[name]).reshape(len(rows), len(names)) for name in ("posture", "pregrasp")}
    arrays["position_m"] = np.array([row.X_hand_object.position_m for row in rows]).reshape(len(rows), 3)
    arrays["quat_wxyz"] = np.array([row.X_hand_object.quat_wxyz for row in rows]).reshape(len(rows), 4)
    return GraspDocument(build(names, arrays), dict(mapping(notes.get("metadata"))), world_pose(notes))


def shadow_joints(angles: object, what: str) -> dict[str, float]:
    """Pick the Shadow Hand's joints out of angles by name, which may all have one prefix, such as ``rh_``.

    Raises:
        FileFormatError: angles are missing or no numbers.
    """
    if not isinstance(angles, Mapping):
        raise FileFormatError(f"{what} is not a mapping of joint names to angles")
    first, wanted = SHADOW_HAND.joint_names[0], SHADOW_HAND.joint_names
    prefixes = [name.removesuffix(first) for name in map(str, angles) if name.endswith(first)]
    for prefix in sorted(prefixes, key=len):
        if all(prefix + name in angles for name in wanted):
            return {name: number(angles[prefix + name], f"{what} of {name}") for name in wanted}
    missing = [name for name in wanted if name not in angles]
    raise FileFormatError(f"{what} lacks joints of {SHADOW_HAND.name}: {', '.join(missing)}")


def number(value: object, what: str) -> float:
    """Check a number.

    Raises:
        FileFormatError: it is not a finite number.
    """
    found = math.nan
    if isinstance(value, int | float | np.floating) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):
            found = float(value)
    if not math.isfinite(found):
        raise FileFormatError(f"{what} is {_shortened(value)}, not a finite number")
    return found


def numbers(values: object, length: int, what: str) -> list[float]:
    """Check a list of numbers.

    Raises:
        FileFormatError: it is not a list of that many finite numbers.
    """
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if not isinstance(values, Sequence) or isinstance(values, str | bytes) or len(values) != length:
        raise FileFormatError(f"{what} is not a list of {length} numbers")
    return [number(value, what) for value in values]


def pose(position_m: object, quat_wxyz: object, what: str) -> Pose:
    """Check a pose.

    Raises:
        FileFormatError: it is not three numbers and a unit quaternion.
    """
    try:
        return Pose.of(numbers(position_m, 3, f"{what} position"), numbers(quat_wxyz, 4, f"{what} quaternion"))
    except FileFormatError:
        raise
    except InputError as error:
        raise FileFormatError(f"{what}: {error}") from error


def noted_pose(notes: object) -> Pose:
    """Read a pose from our notes.

    Raises:
        FileFormatError: it is damaged.
    """
    return pose(mapping(notes).get("position_m"), mapping(notes).get("quat_wxyz"), "noted pose")


def _check_joints(grasps: Grasps) -> None:
    # Native files hold any hand's joints, the formats with notes those of this one hand.
    missing = [name for name in SHADOW_HAND.joint_names if name not in grasps.joint_names]
    if missing:
        raise InputError(
            f"the grasps lack joints of {SHADOW_HAND.name}: {', '.join(missing)}; "
            "only native files (.json, .parquet) can hold such grasps"
        )


def _facts(row: ForeignGrasp, assume: Assumptions) -> dict[str, Any]:
    kind = _kind(row, assume)
    obj = _object(row, assume)
    axis = row.notes.get("side_axis", assume.side_axis)
    axis = _nearest_side(row, kind, obj) if axis is None else obj.side_axis(str(axis))
    facts: dict[str, Any] = {"grasp_type": kind.name, "object_label": obj.label, "side_axis": axis}
    known = {name: _noted(row.notes, name) for name in NUMBERS}
    if math.isnan(known["side_m"]):
        known["side_m"] = obj.sides_m[axis]
    if math.isnan(known["grasp_size_m"]):
        hand = shadow_hand()
        known["grasp_size_m"] = float(hand.grasp_size(_ordered(row.posture, hand))[0])
    return facts | known


def _kind(row: ForeignGrasp, assume: Assumptions) -> GraspType:
    name = row.notes.get("grasp_type", assume.grasp_type)
    if name is None:
        raise InputError("the file names no grasp type; say which (grasp_type, --grasp-type)")
    return grasp_type(str(name))


def _object(row: ForeignGrasp, assume: Assumptions) -> GraspObject:
    named = row.notes.get("object_label", row.object_name)
    try:
        return grasp_object(str(named))
    except InputError as error:
        if assume.object_label is not None:
            return grasp_object(assume.object_label)
        what = "the file names no object" if named is None else str(error)
        raise InputError(
            f"{what} Only catalogue objects can be tried; say which it is (object_label, --object-label)"
        ) from error


def _nearest_side(row: ForeignGrasp, kind: GraspType, obj: GraspObject) -> str:
    """Find the graspable side whose body axis is nearest to the posture's opposition axis."""
    hand = shadow_hand()
    thumb, other = hand.opposition(_ordered(row.posture, hand), kind)
    along = np.abs(rotate(quat_conjugate(row.X_hand_object.quat_wxyz), (other - thumb)[0]))
    if obj.shape == "cylinder":
        along = np.array([np.hypot(along[0], along[1]), 0.0, along[2]])
    return max(obj.graspable_sides_m, key=lambda axis: float(along[AXES.index(axis)]))


def _ordered(posture: Mapping[str, float], hand: HandModel) -> NDArray[np.float64]:
    return np.array([[posture[name] for name in hand.joint_names]])


def _open_hand() -> dict[str, float]:
    return dict(zip(SHADOW_HAND.joint_names, SHADOW_HAND.pregrasp, strict=True))


def _noted(notes: Mapping[str, Any], name: str) -> float:
    value = notes.get(name)
    return math.nan if value is None else number(value, name)


def _shortened(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
