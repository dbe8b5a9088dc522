"""What is read and written: `GraspDocument`, what a caller may say of one, the header of every file, and the checks."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from .. import hands  # not its functions: those load what reads hand files, which sampling does not need
from ..core.errors import FileFormatError, InputError, check_name, shortened
from ..core.grasps import Grasps, check_numbers
from ..core.objects import AXES, CATALOGUE, GraspObject
from ..core.outcomes import Outcomes
from ..core.poses import Pose
from ..core.records import Columns, check_widths, objects_to_json, taxonomy_to_json
from ..core.tasks import Task, Tasks
from ..hands import Hand, is_left

if TYPE_CHECKING:
    from ..studies.record import Evaluation

SCHEMA_VERSION = 1
KIND = "graspcascade grasps"
LABELS = ("grasp_type", "object_label", "side_axis")
NUMBERS = ("side_m", "grasp_size_m", "object_size_m", "probability")
UNKNOWABLE = NUMBERS[1:]
"""Columns in which not-a-number means unknown; files hold null there."""
ANGLES, POSE_PARTS = ("posture", "pregrasp"), {"position_m": 3, "quat_wxyz": 4}
_CHOICES: Mapping[str, tuple[object, ...]] = {
    "parent_link": ("forearm", "palm"),
    "frame_keys": ("frame", "frame_link"),
    "contact": ("settled", "target"),
    "joint_numbering": (0, 1),
}
_FIRST_HAND = "shadow_hand_right"
"""Hand of files that do not say: the only one there was when these were written."""
_FURTHEST_IN_WORLD_M = 1e7
_ROUNDING_RAD, _FAR_RAD, _FAR_JOINTS = 1e-3, 0.5, 3
UNITS = {"length": "metre", "angle": "radian"}
FRAMES = {
    "hand": "palm body of the hand model, wrist joints at zero",
    "object": "centre of the object; a cylinder's axis is z",
    "X_hand_object": "pose of the object in the hand frame",
    "X_world_hand": "pose of the hand frame in the world, present where an object pose in the world was given",
}


@dataclass(frozen=True)
class GraspDocument:
    """Hold a grasp file's content.

    Attributes:
        metadata: where the grasps come from, as their writer put it.
        X_world_object: object pose in the world that the hand poses were worked out for, None where there was none.
        notes: what a reader should be told of the file, such as angles beyond the hand's limits; one line each.
    """

    grasps: Grasps
    metadata: dict[str, Any] = field(default_factory=dict)
    X_world_object: Pose | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ExportOptions:
    """Say what other formats have a place for and grasps do not carry; a format ignores what it has no place for.

    Attributes:
        held_rates: held rates in [0, 1] by grasp type and object name, for grasps without a probability of their own.
        outcomes: trials of these very grasps, in their order; gives the joints and the object's pose in contact.
        contact: what formats of a hand in contact state: ``settled`` as in `outcomes`, or ``target``, which lies a
            little inside the object.
        frame_id: name of the frame that MoveIt poses are in; by default ``world`` where the object's pose in the world
            is known and the object's name where it is not; empty for the object's own frame.
        frame_keys: whether isaac_grasp says ``object_frame`` or ``object_frame_link``, and the same of the gripper.
        parent_link: link whose pose a MoveIt grasp states; with ``forearm`` the wrist joints are listed, at zero. A
            hand without a wrist has its palm only.
        joint_prefix: put before link and joint names, such as ``rh_``.
        joint_numbering: 1, or 0 to name joints as older Shadow models do, whose ``FFJ3`` is ``FFJ4`` here; angles stay.
        object_root: folder that object paths are written under; by default the exported folder's own, absolute.
        hand: the hand; by default the shipped one that the grasps are for.

    Raises:
        InputError: a rate outside [0, 1], a left hand's prefix or an unknown choice.
    """

    held_rates: Mapping[tuple[str, str], float] = field(default_factory=dict)
    outcomes: Outcomes | None = None
    contact: Literal["settled", "target"] = "settled"
    frame_id: str | None = None
    frame_keys: Literal["frame", "frame_link"] = "frame"
    parent_link: Literal["forearm", "palm"] = "forearm"
    joint_prefix: str = ""
    joint_numbering: Literal[0, 1] = 1
    object_root: str | None = None
    hand: Hand | None = None

    def __post_init__(self) -> None:
        if any(not 0 <= rate <= 1 for rate in self.held_rates.values()):
            raise InputError("a held rate must lie between 0 and 1")
        if is_left(self.joint_prefix):
            raise InputError(f"joint prefix {self.joint_prefix!r} is of a left hand; all hands here are right ones")
        for name in _CHOICES:
            check_choice(name, getattr(self, name))

    def confidence(self, grasps: Grasps) -> NDArray[np.float64]:
        """Find each grasp's own probability ``(n,)``, else the held rate of its type and object, else NaN."""

        def rate(task: Task) -> float:
            # Rates are of the catalogue's objects; a file may give one's name to an object of another size.
            known = CATALOGUE.get(task.object.name, task.object) == task.object
            return self.held_rates.get((task.grasp_type.name, task.object.name), np.nan) if known else np.nan

        return np.where(np.isnan(grasps.probability), grasps.tasks.column(rate, np.float64), grasps.probability)

    def with_rates_of(self, metadata: Mapping[str, Any]) -> ExportOptions:
        """Add the measured rates that a document's metadata carries (see `GraspSampler.measured`); own rates win."""
        carried = {}
        for key, cell in mapping(metadata.get("measured")).items():
            kind, _, name = str(key).partition("/")  # names of objects may have slashes, those of types have none
            # Metadata is free-form: what does not read as a rate is none.
            with contextlib.suppress(ArithmeticError, LookupError, TypeError, ValueError):
                if 0 <= (rate := float(cell["held"]) / float(cell["n"])) <= 1:
                    carried[kind, name] = rate
        return replace(self, held_rates=carried | dict(self.held_rates))


@dataclass(frozen=True)
class Assumptions:
    """Say of every grasp in a foreign file what the file itself does not.

    Attributes:
        grasp_type: name of a grasp type.
        object: what the file's object is, or its spelling, at the size it has; for files that name none we know.
        side_axis: body axis it is held by; None takes the side nearest to the opposition axis.
        joint_numbering: number of the outermost joints in the file's names, 0 in files for older Shadow models.
        hand: the hand; by default the shipped one that the file is for, or the Shadow Hand where it does not say.

    Raises:
        InputError: an unknown side axis or joint numbering.
    """

    grasp_type: str | None = None
    object: GraspObject | str | None = None
    side_axis: str | None = None
    joint_numbering: Literal[0, 1] = 1
    hand: Hand | None = None

    def __post_init__(self) -> None:
        check_choice("joint_numbering", self.joint_numbering)
        if self.side_axis is not None:
            check_name("side axis", self.side_axis, AXES)


def check_choice(name: str, given: object) -> None:
    """Check one of the options that have few values."""
    choices = _CHOICES[name]
    if type(given) is not type(choices[0]) or given not in choices:
        raise InputError(f"unknown {name} {shown(given)}. Valid: {', '.join(map(repr, choices))}.")


def held_rates(evaluation: Evaluation) -> dict[tuple[str, str], float]:
    """Read the held rates of an evaluation's cells by grasp type and object name."""
    return {(cell.grasp_type, cell.object_label): cell.held_rate.rate for cell in evaluation.cells if cell.n}


def header(document: GraspDocument) -> dict[str, Any]:
    """Collect what a reader needs besides the grasps themselves."""
    grasps, pose = document.grasps, document.X_world_object
    check_numbers(grasps.columns() | {"side_m": grasps.side_m})
    try:
        json.dumps(document.metadata, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"metadata that JSON cannot hold: {error}") from error
    head: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "kind": KIND,
        "written_by": f"graspcascade {version('graspcascade')}",
        "units": UNITS,
        "frames": FRAMES,
        "quaternion_order": "wxyz",
        "hand": grasps.hand,
        "joint_names": list(grasps.joint_names),
        "objects": objects_to_json(grasps.tasks),
        "metadata": document.metadata,
        **taxonomy_to_json(grasps.tasks.taxonomy),
    }
    if pose is not None:
        with place("X_world_object"):
            _one_pose(pose.position_m, pose.quat_wxyz)
        head["X_world_object"] = pose_to_json(pose)
    return check_header(head)


def check_header(head: object) -> dict[str, Any]:
    """Check what a file says of itself."""
    if not isinstance(head, dict) or head.get("kind") != KIND:
        raise FileFormatError("not a graspcascade grasp file")
    names: Any = head.get("joint_names")
    schema, order, units = head.get("schema_version"), head.get("quaternion_order"), head.get("units", UNITS)
    frames = head.get("frames", FRAMES)
    listed = isinstance(names, list) and bool(names) and all(isinstance(name, str) for name in names)
    faults = {
        f"has schema version {schema!r}; this version reads {SCHEMA_VERSION}": schema is True
        or schema != SCHEMA_VERSION,
        f"units is {shown(units)}; only metre and radian can be read": units != UNITS,
        "frames are other ones than those of this version": not isinstance(frames, dict) or FRAMES | frames != FRAMES,
        "joint_names is not a list of names": not listed,
        "joint_names names a joint twice": listed and len(set(names)) < len(names),
        f"quaternion_order is {order!r}; only 'wxyz' can be read": order != "wxyz",
        f"hand is {shown(head.get('hand'))}, not a name": not isinstance(head.get("hand", _FIRST_HAND), str),
        "metadata is missing": not isinstance(head.get("metadata"), dict),
    }
    for fault in (fault for fault, present in faults.items() if present):
        raise FileFormatError(fault)
    return head


def hand_of(head: Mapping[str, Any], given: Hand | None) -> Hand:
    """Choose the hand that a file is for: the one given, else the shipped one it names, else the Shadow Hand."""
    name, hand = _named_hand(head, given)
    if hand is None:
        raise InputError(f"grasps of {name!r}, which does not come with graspcascade, need its hand file (--hand)")
    return hand


def _named_hand(head: Mapping[str, Any], given: Hand | None) -> tuple[str, Hand | None]:
    """Read a hand's name from a header; with it the hand given, else the shipped one of that name, if there is one."""
    name = head.get("hand", _FIRST_HAND)
    if not isinstance(name, str):
        raise FileFormatError(f"hand is {shown(name)}, not a name")
    if given is not None and is_left(name) != is_left(given.name):
        raise FileFormatError(
            f"it is of hand {shown(name)}, which is not of the side of {given.name}: left and right cannot be mixed"
        )
    return name, hands.shipped_hand(name) if given is None else given


def to_document(
    head: Mapping[str, Any], joint_names: Sequence[str], columns: Columns, tasks: Tasks, hand: Hand | None
) -> GraspDocument:
    """Check the columns read from a file and make a document of them.

    The columns are `NUMBERS`, `ANGLES` and `POSE_PARTS`, one row a task. Angles must keep the limits of the
    hand, by default the shipped one that the file is for, if it is of such a hand.
    """
    name, hand = _named_hand(head, hand)
    try:
        check_numbers(columns)
        notes = () if hand is None else keep_limits(columns, joint_names, hand)
        if hand is not None and hand.name != name:
            notes = (f"the grasps are of hand {shown(name)}, not of {hand.name!r}", *notes)
    except InputError as error:
        raise FileFormatError(str(error)) from error
    check_widths(tasks, columns["side_m"])
    pose = _exact_pose(columns["position_m"], columns["quat_wxyz"])
    numbers = {key: columns[key] for key in (*ANGLES, "position_m", *UNKNOWABLE)}
    grasps = Grasps.from_columns(name, joint_names, tasks, numbers | {"quat_wxyz": pose.quat_wxyz})
    return GraspDocument(grasps, dict(mapping(head.get("metadata"))), world_pose(head), notes)


def facts(grasps: Grasps) -> Columns:
    """Columns ``(n,)`` of `LABELS` and `NUMBERS`."""
    labels = zip(LABELS, (grasps.grasp_type, grasps.object_name, grasps.side_axis), strict=True)
    return dict(labels) | {name: getattr(grasps, name) for name in NUMBERS}


def fact_rows(grasps: Grasps) -> list[dict[str, Any]]:
    """List `facts` grasp by grasp, with None for unknown, which is NaN there."""
    columns = facts(grasps)
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [{key: None if v != v else v for key, v in zip(columns, row, strict=True)} for row in rows]


def stack(rows: Sequence[Mapping[str, Any]], joint_names: Sequence[str]) -> Columns:
    """Make columns of rows, each a mapping of `NUMBERS`, angles by joint name and a pose's parts."""
    columns: Columns = {name: np.array([row[name] for row in rows], dtype=np.float64) for name in NUMBERS}
    for name in ANGLES:
        angles = [[row[name][joint] for joint in joint_names] for row in rows]
        columns[name] = np.array(angles, dtype=np.float64).reshape(-1, len(joint_names))
    for name, width in POSE_PARTS.items():
        columns[name] = np.array([row[name] for row in rows], dtype=np.float64).reshape(-1, width)
    return columns


def by_name(names: Sequence[str], angles: NDArray[np.float64]) -> dict[str, float]:
    """List one grasp's angles ``(J,)`` by the names of its joints."""
    return dict(zip(names, angles.tolist(), strict=True))


def pose_to_json(pose: Pose, row: Any = ()) -> dict[str, list[float]]:
    """Write one pose, or that of a row, as plain lists."""
    return {"position_m": pose.position_m[row].tolist(), "quat_wxyz": pose.quat_wxyz[row].tolist()}


def world_pose(head: Mapping[str, Any]) -> Pose | None:
    """Read the object pose in the world from a header."""
    stored = head.get("X_world_object")
    try:
        return None if stored is None else _one_pose(stored["position_m"], stored["quat_wxyz"])
    except (InputError, KeyError, TypeError, OverflowError) as error:
        reason = error if isinstance(error, InputError) else "not position_m and quat_wxyz of a pose"
        raise FileFormatError(f"X_world_object is damaged ({reason})") from error


@contextlib.contextmanager
def place(where: str) -> Iterator[None]:
    """Say of errors in the block where in the file they are, and of what does not read in one wording."""
    before = f"{where}: " if where else ""
    try:
        yield
    except InputError as error:
        raise type(error)(f"{before}{str(error)[:1000]}") from error
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        raise FileFormatError(f"{before}damaged, or laid out in a way that is not read") from error


def mapping(value: object) -> Mapping[str, Any]:
    """Return a mapping as it is and anything else as an empty one."""
    return value if isinstance(value, Mapping) else {}


def shown(value: object) -> str:
    """Write a value for a message, cut off where it is long."""
    try:
        return shortened(repr(value))
    except ValueError:  # Python does not write integers of more than some thousand digits
        return "a huge integer"


_LARGEST = 1e12
"""Products of larger numbers may overflow, and none of them is a length, an angle or a share."""


def number(value: object, what: str) -> float:
    """Check a number."""
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):
            if math.isfinite(value):
                read = float(value)
                if abs(read) <= _LARGEST:
                    return read
                raise FileFormatError(f"{what} is {shown(value)}, beyond any number of a grasp")
    raise FileFormatError(f"{what} is {shown(value)}, not a finite number")


def numbers(values: object, length: int, what: str) -> list[float]:
    """Check a list of numbers."""
    values = values.tolist() if isinstance(values, np.ndarray) else values
    if not isinstance(values, list | tuple) or len(values) != length:
        raise FileFormatError(f"{what} is not a list of {length} numbers")
    return [number(value, what) for value in values]


def pose_of(position_m: object, quat_wxyz: object, what: str) -> Pose:
    """Check a pose."""
    parts = numbers(position_m, 3, f"{what} position"), numbers(quat_wxyz, 4, f"{what} quaternion")
    try:
        return Pose.of(*parts)
    except InputError as error:
        raise FileFormatError(f"{what}: {error}") from error


def keep_limits(columns: Columns, joint_names: Sequence[str], hand: Hand) -> tuple[str, ...]:
    """Clip angles that rounding put past a limit, and tell of those that are well beyond."""
    limits = dict(zip(hand.joint_names, zip(hand.lower_rad, hand.upper_rad, strict=True), strict=True))
    low, high = np.array([limits.get(name, (-np.inf, np.inf)) for name in joint_names]).reshape(-1, 2).T
    notes = []
    for name in ANGLES:
        angles = columns[name]
        beyond = np.maximum(low - angles, angles - high)
        over = beyond > _ROUNDING_RAD
        if ((beyond > _FAR_RAD).sum(axis=1) >= _FAR_JOINTS).sum() * 2 > len(angles):
            far = f"in most grasps several angles of {name} are far beyond the limits of {hand.name}"
            raise InputError(f"{far}; they look like degrees, or are of another hand")
        columns[name] = np.where(over, angles, np.clip(angles, low, high))
        if over.any():
            joints = ", ".join(
                f"{joint_names[j]} {over[:, j].sum()} (by up to {beyond[:, j].max():.2g} rad)"
                for j in np.flatnonzero(over.any(axis=0)).tolist()
            )
            count = int(over.any(axis=1).sum())
            notes.append(f"{name} is beyond the joint limits of {hand.name} in {count} grasps: {joints}")
    return tuple(notes)


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
