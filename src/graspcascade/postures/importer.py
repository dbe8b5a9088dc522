"""Recorded postures from and to CSV: a type column and joint columns by name, in degrees or radians."""

from __future__ import annotations

import csv
import difflib
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..errors import FileFormatError, InputError
from ..files import write_staged
from ..hands import HandModel
from ..taxonomy import grasp_type
from .labelled import LabelledPostures

Unit = Literal["deg", "rad"]
TYPE_COLUMNS = ("grasp_type", "type")
_RADIANS = {"deg": math.radians(1.0), "rad": 1.0}
_JOINT_LIKE = re.compile(r"^[a-z]{2}j\d+$|_(deg|rad)$", re.IGNORECASE)
_ROUNDING_RAD = 1e-6
"""An angle this little beyond a limit was at the limit before it was written with a few digits."""


@dataclass(frozen=True)
class _JointColumn:
    header: str
    field: int
    joint: int
    radians_per_unit: float


def import_postures(path: Path | str, hand: HandModel, *, unit: Unit | None = None) -> LabelledPostures:
    """Read recorded postures.

    Columns are ``grasp_type`` (or ``type``) and ``<JOINT>_deg`` or ``<JOINT>_rad``; a bare ``<JOINT>`` needs `unit`.
    Joints without a column are 0. Wrist joints, which grasps hold straight, and columns that are no joints are passed
    over.

    Args:
        path: a comma-separated file with a header line.
        hand: whose joints the columns name.
        unit: of columns without one.

    Returns:
        Postures within the hand's limits; `n_clipped` counts the angles that were beyond.

    Raises:
        InputError: no such file.
        FileFormatError: not a CSV of postures, or a row that cannot be used; the message names the line.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"there is no file {path}")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            header = [name.strip() for name in next(reader, [])]
            type_field, joints = _type_field(header), _joint_columns(header, hand, unit)
            types, postures = [], []
            for line, row in _rows(reader, len(header)):
                types.append(_type_of(row[type_field], line))
                postures.append(_posture(row, joints, len(hand.joint_names), line))
    except FileFormatError as error:
        raise FileFormatError(f"{path}: {error}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileFormatError(f"{path}: not a CSV file ({error})") from error
    if not postures:
        raise FileFormatError(f"{path}: holds no postures")
    posture = np.array(postures)
    clipped = hand.clip(posture)
    n_clipped = int((np.abs(clipped - posture) > _ROUNDING_RAD).sum())
    return LabelledPostures(hand.joint_names, clipped, np.array(types), n_clipped)


def export_postures(path: Path | str, postures: LabelledPostures) -> None:
    """Write postures in radians so that `import_postures` reads the same numbers back.

    Raises:
        InputError: no such folder.
    """
    path = Path(path)
    if not path.parent.is_dir() or path.is_dir():
        raise InputError(f"{path} is a folder, or the folder {path.parent} does not exist")
    write_staged(path, lambda staged: _write(staged, postures))


def _write(path: Path, postures: LabelledPostures) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["grasp_type", *(f"{name}_rad" for name in postures.joint_names)])
        for kind, angles in zip(postures.grasp_type.tolist(), postures.posture.tolist(), strict=True):
            writer.writerow([kind, *map(repr, angles)])


def _type_field(header: list[str]) -> int:
    found = [field for field, name in enumerate(header) if name.lower() in TYPE_COLUMNS]
    if len(found) != 1:
        raise FileFormatError(f"needs one column grasp_type (or type), has {len(found)}; columns: {_listed(header)}")
    return found[0]


def _joint_columns(header: list[str], hand: HandModel, unit: Unit | None) -> list[_JointColumn]:
    numbers = {name.lower(): number for number, name in enumerate(hand.joint_names)}
    wrist = {name.lower() for name in hand.description.wrist_joints}
    found: list[_JointColumn] = []
    foreign: list[str] = []
    for field, name in enumerate(header):
        base, _, suffix = name.lower().rpartition("_")
        joint, given = (base, suffix) if suffix in _RADIANS and base else (name.lower(), unit)
        if joint in wrist:
            continue
        if joint not in numbers:
            if _JOINT_LIKE.search(name):
                foreign.append(name)
            continue
        if given is None:
            raise FileFormatError(f"column {name!r} has no unit; name it {name}_deg or {name}_rad, or state the unit")
        if any(column.joint == numbers[joint] for column in found):
            raise FileFormatError(f"column {name!r} gives joint {hand.joint_names[numbers[joint]]} a second time")
        found.append(_JointColumn(name, field, numbers[joint], _RADIANS[given]))
    if foreign:
        near = difflib.get_close_matches(foreign[0].upper(), [f"{j}_DEG" for j in hand.joint_names], n=1)
        hint = f" Nearest: {near[0].removesuffix('_DEG')}." if near else ""
        raise FileFormatError(
            f"this hand has no joint for {_listed(foreign)}.{hint} Joints: {_listed(hand.joint_names)}"
        )
    if not found:
        raise FileFormatError(
            f"has no joint column; name them <JOINT>_deg or <JOINT>_rad. Joints: {_listed(hand.joint_names)}; "
            f"columns: {_listed(header)}"
        )
    return found


def _rows(reader: Any, n_fields: int) -> Iterator[tuple[int, list[str]]]:
    """Give the rows of a csv reader that hold anything, with the number of the line they end on."""
    for row in reader:
        if not any(field.strip() for field in row):
            continue
        if len(row) != n_fields:
            raise FileFormatError(f"line {reader.line_num} has {len(row)} fields, the header {n_fields}")
        yield reader.line_num, row


def _type_of(text: str, line: int) -> str:
    try:
        return grasp_type(text).name
    except InputError as error:
        raise FileFormatError(f"line {line}: {error}") from error


def _posture(row: list[str], joints: list[_JointColumn], n_joints: int, line: int) -> list[float]:
    posture = [0.0] * n_joints
    for column in joints:
        try:
            angle = float(row[column.field])
        except ValueError:
            angle = math.nan
        if not math.isfinite(angle):
            raise FileFormatError(f"line {line}: {column.header} is {row[column.field].strip()!r}, not a finite number")
        posture[column.joint] = angle * column.radians_per_unit
    return posture


def _listed(names: list[str] | tuple[str, ...]) -> str:
    return ", ".join(name or "(unnamed)" for name in names) or "none"
