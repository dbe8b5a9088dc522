"""What formats of others share: our notes beside their fields, joints by other names, and a foreign grasp made ours.

An exported file carries notes under one key of our own, which the tools that own the format pass over. With them an
export reads back with its type, side and sizes; without them (a file of someone else's) `Assumptions` fill in.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import FileFormatError, InputError
from ..core.grasps import Grasps
from ..core.objects import SHAPES, GraspObject, as_object
from ..core.poses import Pose, quat_conjugate, rotate, rotation_angle
from ..core.records import objects_from_json, types_from_json
from ..core.tasks import Task, Tasks
from ..core.taxonomy import GraspType, as_type
from ..hands import Hand, is_left
from . import document as doc
from .document import NUMBERS, Assumptions, GraspDocument, mapping, number, place

KEY = "graspcascade"
_NUMBERED = re.compile(r"(.*J)([1-9])")
_UNSCALED = (1.0, 1.0, 1.0)
STRAIGHT_RAD, _CHANGED = 1e-6, 1e-4


@dataclass(frozen=True)
class ForeignGrasp:
    """Hold one grasp as a file of another format tells it; None is what it does not say."""

    posture: Mapping[str, float]  # target angles by our joint names, radians
    pregrasp: Mapping[str, float] | None  # open hand before closing, likewise
    X_hand_object: Pose  # object in the hand frame, (3,) and (4,)
    object_name: str | None = None
    scale: Sequence[float] = _UNSCALED  # of the object of that name, along its body axes
    confidence: object = None  # what the file gives as chance to hold
    notes: Mapping[str, Any] = field(default_factory=dict)  # our own, empty in a file of someone else's
    changed: bool = False  # what the file says is no longer what our notes were written for


def check_joints(given: Sequence[str], needed: Sequence[str], hand: str) -> None:
    """Check that the joints of grasps to be written are those of a hand."""
    lacking, extra = ([n for n in ours if n not in others] for ours, others in ((needed, given), (given, needed)))
    if lacking or extra:
        fault = f"lack joints of {hand}" if lacking else f"have joints that {hand} lacks"
        native = "only native files (.json, .parquet) can hold such grasps"
        raise InputError(f"the grasps {fault}: {', '.join(lacking or extra)}; {native}")


def without_wrist(grasps: Grasps, wrist: Sequence[str]) -> list[str]:
    """List the joints of grasps apart from the wrist's, which must be straight to be left out."""
    for bent in (name for name in wrist if name in grasps.joint_names):
        angles = np.array([grasps.posture, grasps.pregrasp])[..., grasps.joint_names.index(bent)]
        if np.abs(angles).max(initial=0.0) > STRAIGHT_RAD:
            raise InputError(f"the grasps bend the wrist ({bent}); only a straight wrist can be written")
    return [name for name in grasps.joint_names if name not in wrist]


def which_link(given: str, links: Sequence[str], what: str) -> str:
    """Find which of a hand's links a file means, whose names may have a prefix such as ``rh_`` or ``/World/``."""
    for link in (link for link in links if given.endswith(link)):
        prefix = given.removesuffix(link)
        if is_left(prefix):
            raise FileFormatError(f"{what} is {given!r}, of a left hand; only right hands can be read")
        if not prefix[-1:].isalnum():
            return link
    raise FileFormatError(f"{what} is {doc.shown(given)}; only poses of {' or '.join(links)} can be read")


def input_files(path: Path, files: Iterable[Path], suffix: str) -> list[tuple[Path, str]]:
    """List the files to read, a path itself or those of a folder, each with its name in that folder."""
    listed = [(file, file.name) for file in files] if path.is_dir() else [(path, "")]
    if not listed:
        raise FileFormatError(f"the folder holds no {suffix} files")
    return sorted(listed)


def grasp_notes(document: GraspDocument) -> list[dict[str, Any]]:
    """Collect our notes on each grasp: number, labels, sizes and its own chance to hold."""
    return [{"number": i} | row for i, row in enumerate(doc.fact_rows(document.grasps))]


def file_stems(tasks: Tasks) -> dict[str, str]:
    """Name a file or folder for each object of the tasks."""
    stems = {name: file_stem(name) for name in tasks.objects}
    if len(set(stems.values())) < len(stems):
        raise InputError(f"objects {', '.join(stems)} would share a file; give them names that differ in letters")
    return stems


def object_files(
    path: Path, folder: Path, suffix: str, tasks: Tasks, what: str
) -> Iterator[tuple[GraspObject, Path, list[int]]]:
    """List each object, its file and its rows: a file each in `folder`, or `path` itself if that is to be a file."""
    if not path.is_dir() and len(tasks.objects) != 1:
        given = f"these are of {len(tasks.objects)} ({', '.join(tasks.objects) or 'none'})"
        folders = "a name without suffix makes a folder with a file for each"
        raise InputError(f"{what} file holds the grasps of one object, {given}; {folders}")
    stems = file_stems(tasks)
    for obj, rows in tasks.groups(lambda task: task.object):
        yield obj, folder / f"{stems[obj.name]}{suffix}" if path.is_dir() else path, np.flatnonzero(rows).tolist()


def numbered(names: Sequence[str], numbering: int) -> dict[str, str]:
    """Name joints as a model does that numbers a digit's outermost joint 1, as here, or 0; by our names."""
    doc.check_choice("joint_numbering", numbering)
    if numbering:
        return {name: name for name in names}
    parts = {name: _NUMBERED.fullmatch(name) for name in names}
    plain = [name for name, match in parts.items() if match is None]
    if plain:
        raise InputError(f"joint numbering 0 is for the Shadow Hand's joint names; {plain[0]!r} has no number from 1")
    return {name: f"{match[1]}{int(match[2]) - 1}" for name, match in parts.items() if match}


def pick_joints(angles: object, names: Sequence[str], what: str, numbering: int = 1) -> dict[str, float]:
    """Pick a hand's joints out of angles by name, which may all have one prefix, such as ``rh_``."""
    if not isinstance(angles, Mapping):
        raise FileFormatError(f"{what} is not a mapping of joint names to angles")
    given, theirs = {str(name): value for name, value in angles.items()}, numbered(names, numbering)
    first = theirs[names[0]]
    prefixes = sorted((name.removesuffix(first) for name in given if name.endswith(first)), key=len)
    whole = [prefix for prefix in prefixes if all(prefix + name in given for name in theirs.values())]
    for prefix in whole:
        if not is_left(prefix):
            return {name: number(given[prefix + other], f"{what} of {name}") for name, other in theirs.items()}
    if whole or (prefixes and all(is_left(prefix) for prefix in prefixes)):
        raise FileFormatError(f"{what} is of a left hand ({prefixes[0]}{first}); only right hands can be read")
    if numbering and all(_NUMBERED.fullmatch(name) for name in names):
        zero = set(numbered(names, 0).values())
        only_zero, only_one = tuple(zero - set(names)), tuple(set(names) - zero)
        lowest = max((name for name in given if name.endswith(only_zero)), default=None)
        if lowest and not any(name.endswith(only_one) for name in given):
            fault = f"{what} has joints numbered from 0 ({lowest}), other joints than ours, numbered from 1"
            raise FileFormatError(f"{fault}; state the numbering (joint_numbering=0, --joint-numbering 0)")
    missing = [name for name in theirs.values() if name not in given]
    raise FileFormatError(f"{what} lacks joints of the hand: {', '.join(missing)}")


def check_whole(notes: Mapping[str, Any], n: int) -> None:
    """Check that a file has as many grasps as our notes on it, where it has such notes."""
    noted = notes.get("grasps") if notes else [None] * n
    if not isinstance(noted, list | Mapping):
        raise FileFormatError("its notes on the grasps are damaged")
    check_count(n, len(noted))


def check_count(n: int, written: object) -> None:
    """Check that a file has as many grasps as were written to it."""
    if n != written:
        raise FileFormatError(f"it has {n} of the {doc.shown(written)} grasps that were written")


def differ(X_hand_object: Pose, angles: Mapping[str, float], noted: Mapping[str, Any]) -> bool:
    """Tell whether a pose or angles, in metres and radians, are others than those that were noted of them."""
    if not noted:
        return False
    posture, pose = mapping(noted.get("posture")), noted_pose(noted)
    apart = [angle - number(posture.get(name), f"noted {name}") for name, angle in angles.items()]
    apart += [
        *(X_hand_object.position_m - pose.position_m),
        float(rotation_angle(X_hand_object.quat_wxyz, pose.quat_wxyz)),
    ]
    return bool(np.abs(apart).max() > _CHANGED)


def noted_pose(noted: Mapping[str, Any]) -> Pose:
    """Read a pose from our notes."""
    return doc.pose_of(noted.get("position_m"), noted.get("quat_wxyz"), "noted pose")


def file_stem(name: str) -> str:
    """Name the file or folder of an object."""
    return re.sub(r"[^\w.+-]+", "_", name).lstrip(".") or "object"


def scale_of(value: object, what: str) -> list[float]:
    """Read an object's scale, one number or one for each body axis."""
    parts = np.asarray(value, dtype=object).reshape(-1).tolist()
    if len(parts) not in (1, 3):
        raise FileFormatError(f"{what} is {doc.shown(value)}, not one number or three")
    scale = [number(part, what) for part in parts] * (3 // len(parts))
    if min(scale) <= 0:
        raise FileFormatError(f"{what} is {doc.shown(value)}; a scale is above 0")
    return scale


def foreign_document(
    rows: list[ForeignGrasp], files: Sequence[Mapping[str, Any]], assume: Assumptions, hand: Hand
) -> GraspDocument:
    """Make a document of rows with a hand's joints; `files` are our notes on each file, empty in someone else's."""
    headers = [notes for notes in files if notes]
    for key in ("hand", "joint_names", "metadata", "taxonomy", "X_world_object"):
        if any(notes.get(key) != headers[0].get(key) for notes in headers):
            raise FileFormatError(f"its files differ in {key}, so they are of different exports; read them one by one")
    places = [number(row.notes["number"], "number") for row in rows if "number" in row.notes]
    if len(set(places)) < len(places):
        raise FileFormatError("two of its grasps have the same number; they are of different exports, or one is a copy")
    if len(places) == len(rows):
        rows = [row for _, row in sorted(zip(places, rows, strict=True), key=lambda pair: pair[0])]
    changed, odd = sum(row.changed for row in rows), 0
    rows = [replace(row, notes={}) if row.changed else row for row in rows]
    noted: dict[str, Any] = {}
    for name, about in ((name, about) for notes in files for name, about in mapping(notes.get("objects")).items()):
        if noted.setdefault(name, about) != about:
            raise FileFormatError(f"its files describe object {doc.shown(name)} in two ways")
    known, types = objects_from_json(noted), types_from_json(headers[0] if headers else {})
    opened = doc.by_name(hand.joint_names, hand.pregrasp)
    tasks: list[Task] = []
    facts: list[dict[str, Any]] = []
    for i, row in enumerate(rows):
        with place(f"grasp {i}"):
            named = row.notes.get("grasp_type", assume.grasp_type)
            if named is None:
                lacks = "it was changed since it was written" if row.changed else "the file names no grasp type"
                raise InputError(f"{lacks}; say which type it is (grasp_type=, --grasp-type)")
            kind, obj, chance = as_type(str(named), types), _object(row, known, assume), _chance(row)
            tasks.append(_task(row, kind, obj, assume, hand))
            read = _numbers(row, tasks[-1])
        if chance is not None:
            read["probability"] = chance
            odd += math.isnan(chance)
        read |= {"posture": row.posture, "pregrasp": row.pregrasp or opened}
        facts.append(read | vars(row.X_hand_object))
    columns = doc.stack(facts, hand.joint_names)
    missing = np.isnan(columns["grasp_size_m"])
    if missing.any():
        columns["grasp_size_m"][missing] = hand.grasp_size(columns["posture"][missing])
    head = {"hand": hand.name} | dict(headers[0] if headers else {}) | ({"X_world_object": None} if changed else {})
    document = doc.to_document(head, hand.joint_names, columns, Tasks.of(tasks), hand)
    told = {
        f"the confidence of {odd} grasps is no chance between 0 and 1 and was left out": odd,
        f"{changed} grasps were changed since they were written, and are read as those of a foreign file": changed,
    }
    return replace(document, notes=(*document.notes, *(note for note, n in told.items() if n)))


def _object(row: ForeignGrasp, known: Mapping[str, GraspObject], assume: Assumptions) -> GraspObject:
    named = row.notes.get("object_label", row.object_name)
    # File names and frames cannot hold the colon of a size.
    spelled = re.sub(rf"^({'|'.join(SHAPES)})_(?=\d)", r"\1:", str(named), flags=re.IGNORECASE)
    try:
        obj = known[str(named)] if str(named) in known else as_object(spelled)
    except InputError as error:
        if assume.object is not None:
            return as_object(assume.object)  # it is said to be this one, at the size it has
        what = "the file names no object." if named is None else str(error)
        raise InputError(f"{what} Say what it is: give --object (object=), a catalogue name or a size") from error
    if tuple(row.scale) == _UNSCALED:
        return obj
    extents = [extent * factor for extent, factor in zip(obj.extents_m, row.scale, strict=True)]
    try:
        scaled = GraspObject.from_json(obj.name, obj.to_json() | {"extents_m": extents})
    except InputError as error:
        raise FileFormatError(f"{obj.name} cannot be scaled by {list(row.scale)}: {error}") from error
    return replace(scaled, name=scaled.shape.spelling())


def _chance(row: ForeignGrasp) -> float | None:
    """Read a grasp's chance to hold, NaN where what the file says is none; None where only our notes may tell."""
    # What an export said for want of a chance of the grasp's own, such as a measured rate, is not one.
    if row.confidence is None or (row.notes and row.confidence == row.notes.get("confidence", row.confidence)):
        return None
    chance = number(row.confidence, "confidence")
    return chance if 0 <= chance <= 1 else math.nan


def _numbers(row: ForeignGrasp, task: Task) -> dict[str, Any]:
    read: dict[str, Any] = dict.fromkeys(NUMBERS, math.nan)
    read |= {name: number(row.notes[name], name) for name in NUMBERS if row.notes.get(name) is not None}
    if math.isnan(read["side_m"]) or tuple(row.scale) != _UNSCALED:
        read["side_m"] = task.site.width_m
    return read


def _task(row: ForeignGrasp, kind: GraspType, obj: GraspObject, assume: Assumptions, hand: Hand) -> Task:
    """Make a grasp's task, by default of the graspable side nearest to the posture's opposition axis."""
    axis = row.notes.get("side_axis", assume.side_axis)
    if axis is not None:
        return Task(kind, obj, obj.site(str(axis)))
    thumb, other = hand.opposition(np.array([[row.posture[name] for name in hand.joint_names]]), kind)
    along = rotate(quat_conjugate(row.X_hand_object.quat_wxyz), (other - thumb)[0])
    sites = obj.sites(hand.reach_m) or obj.sites()
    return Task(kind, obj, sites[obj.shape.nearest_side(along, sites)])
