"""Postures with the grasp type each belongs to, and their CSV: joint columns by name, in degrees or radians."""

from __future__ import annotations

import csv
import difflib
import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..core.errors import FileFormatError, InputError
from ..core.files import write_staged
from ..core.taxonomy import as_type
from ..hands import Hand, is_left

Unit = Literal["deg", "rad"]
TYPE_COLUMNS = ("grasp_type", "type")
_RADIANS = {"deg": math.radians(1.0), "rad": 1.0}
_UNIT_NAMES = {"deg": "degrees", "rad": "radians"}
_JOINT_LIKE = re.compile(r"(^|[^a-z])[a-z]{2}j\d+$|_(deg|rad)$", re.IGNORECASE)
_ROUNDING_RAD = 1e-6
"""An angle this little beyond a limit was at the limit before it was written with a few digits."""
_OVERSHOOT_RAD = 0.1
"""How far recorded angles may often be beyond a limit: a glove is not calibrated better."""


@dataclass(frozen=True)
class LabelledPostures:
    r"""Hold n labelled postures.

    Attributes:
        joint_names: names of the J columns.
        posture: ``(n, J)`` radians.
        grasp_type: ``(n,)`` type names.
        clipped: by joint, how many angles were brought to its limits; joints without any left out.
        taxonomy: whose types they are (see `core.taxonomy.TAXONOMIES`); a CSV of postures does not say.

    Examples:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> from graspcascade import load_hand
        >>> with TemporaryDirectory() as folder:
        ...     file = Path(folder, "recorded.csv")
        ...     _ = file.write_text("grasp_type,FFJ3_deg,THJ4_deg\ntripod,40,60\ntip pinch,35,95\n")
        ...     recorded = import_postures(file, load_hand("shadow"))
        >>> recorded.grasp_type.tolist(), recorded.n_clipped
        (['tripod', 'tip_pinch'], 1)
    """

    joint_names: tuple[str, ...]
    posture: NDArray[np.float64]
    grasp_type: NDArray[np.str_]
    clipped: Mapping[str, int] = field(default_factory=dict)
    taxonomy: str = "paper"

    def __len__(self) -> int:
        """Count the postures."""
        return len(self.posture)

    @property
    def n_clipped(self) -> int:
        """Count the angles that were beyond the joint limits."""
        return sum(self.clipped.values())


@dataclass(frozen=True)
class _JointColumn:
    """Say what a column of the file holds: the angle of a joint, or the sum of two coupled ones."""

    header: str
    field: int
    joints: tuple[int, ...]
    unit: Unit


def import_postures(path: Path | str, hand: Hand, *, unit: Unit | None = None) -> LabelledPostures:
    """Read recorded postures.

    Columns are ``grasp_type`` (or ``type``) and ``<JOINT>_deg`` or ``<JOINT>_rad``; a bare ``<JOINT>`` needs `unit`. A
    prefix that all joints share (``rh_FFJ3``) is dropped. A column of a coupled actuator (``FFJ0``) holds the sum of
    its two joints, and each gets half. Joints without a column are 0. Wrist joints, which grasps hold straight, and
    columns that are no joints are passed over.

    Args:
        path: a comma-separated file with a header line.
        hand: whose joints the columns name.
        unit: of columns without one.

    Returns:
        Postures within the hand's limits; `clipped` counts the angles that were beyond.

    Raises:
        InputError: no such file.
        FileFormatError: not a CSV of postures of a right hand, angles that look like the other unit, or a row that
            cannot be used; the message names the line.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"there is no file {path}")
    try:
        types, posture = _read(path, hand, unit)
    except FileFormatError as error:
        raise FileFormatError(f"{path}: {error}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileFormatError(f"{path}: not a CSV file ({error})") from error
    within = hand.clip(posture)
    beyond = (np.abs(within - posture) > _ROUNDING_RAD).sum(axis=0).tolist()
    clipped = {name: count for name, count in zip(hand.joint_names, beyond, strict=True) if count}
    return LabelledPostures(hand.joint_names, within, np.array(types), clipped)


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


def _read(path: Path, hand: Hand, unit: Unit | None) -> tuple[list[str], NDArray[np.float64]]:
    """Read type names, and angles ``(n, J)`` in radians that may be beyond limits."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.reader(file)
        header = [name.strip() for name in next(reader, [])]
        fields = [field for field, name in enumerate(header) if name.lower() in TYPE_COLUMNS]
        if len(fields) != 1:
            raise FileFormatError(f"needs one column grasp_type (or type), has {len(fields)}: {_listed(header)}")
        columns = _joint_columns(header, hand, unit)
        types, rows = [], []
        for row in reader:
            if not any(field.strip() for field in row):
                continue
            try:
                if len(row) != len(header):
                    raise InputError(f"{len(row)} fields, the header has {len(header)}")
                types.append(as_type(row[fields[0]]).name)
                rows.append([_angle(row[column.field], column.header) for column in columns])
            except InputError as error:
                raise FileFormatError(f"line {reader.line_num}: {error}") from error
    if not rows:
        raise FileFormatError("holds no postures")
    # A sum of coupled angles is shared equally, as the tendon shares it.
    angles = np.array(rows) / [len(column.joints) for column in columns]
    for known in _RADIANS:
        _check_unit(known, angles, columns, hand)
    posture = np.zeros((len(rows), len(hand.joint_names)))
    for column, values in zip(columns, angles.T, strict=True):
        posture[:, column.joints] = (values * _RADIANS[column.unit])[:, None]
    return types, posture


def _joint_columns(header: list[str], hand: Hand, unit: Unit | None) -> list[_JointColumn]:
    numbers = {name: number for number, name in enumerate(hand.joint_names)}
    known: dict[str, tuple[int, ...]] = {name.lower(): (number,) for name, number in numbers.items()}
    tendons = {c.name: c.joints for c in hand.couplings if c.kind == "tendon"}
    known |= {name.lower(): tuple(numbers[joint] for joint in joints) for name, joints in tendons.items()}
    wrist = [name.lower() for name in hand.wrist_joints]
    columns: list[_JointColumn] = []
    foreign: list[str] = []
    shared = ""
    for place, name in enumerate(header):
        base, given = _split_unit(name.lower(), unit)
        prefix, joint = _split_prefix(base, [*known, *wrist])
        if joint in wrist:
            continue
        if joint not in known:
            foreign += [name] if _JOINT_LIKE.search(name) else []
            continue
        if is_left(prefix):
            raise FileFormatError(f"column {name!r} is of a left hand; recordings of a right hand are needed")
        if columns and prefix != shared:
            raise FileFormatError(f"columns {columns[0].header!r} and {name!r} must have the same prefix, or none")
        shared = prefix
        if given is None:
            raise FileFormatError(f"column {name!r} has no unit; name it {name}_deg or {name}_rad, or state --unit deg")
        twice = [number for column in columns for number in column.joints if number in known[joint]]
        if twice:
            raise FileFormatError(f"column {name!r} gives joint {hand.joint_names[twice[0]]} a second time")
        columns.append(_JointColumn(name, place, known[joint], given))
    if foreign:
        raise FileFormatError(_foreign_words(foreign, [*hand.joint_names, *tendons]))
    if not columns:
        raise FileFormatError(
            f"has no joint column; name them <JOINT>_deg or <JOINT>_rad. Joints: {_listed(hand.joint_names)}; "
            f"columns: {_listed(header)}"
        )
    return columns


def _split_unit(name: str, unit: Unit | None) -> tuple[str, Unit | None]:
    for suffix in get_args(Unit):
        if name.endswith(f"_{suffix}"):
            return name.removesuffix(f"_{suffix}"), suffix
    return name, unit


def _split_prefix(name: str, joints: list[str]) -> tuple[str, str]:
    """Split ``rh_ffj3`` into ``rh_`` and ``ffj3``; a name that ends with no joint has no prefix."""
    for joint in joints:
        prefix = name.removesuffix(joint)
        if prefix != name and not prefix[-1:].isalnum():
            return prefix, joint
    return "", name


def _foreign_words(foreign: list[str], joints: list[str]) -> str:
    by_lower = {name.lower(): name for name in joints}
    base, _ = _split_unit(foreign[0].lower(), None)
    # What stands before the last sign that is no letter or digit may be a prefix, or part of the name.
    candidates = [re.split(r"[^a-z0-9]", base)[-1], base]
    near = [match for name in candidates for match in difflib.get_close_matches(name, by_lower, n=1)]
    hint = f" Nearest: {by_lower[near[0]]}." if near else ""
    return f"this hand has no joint for {_listed(foreign)}.{hint} Joints: {_listed(joints)}"


def _check_unit(unit: str, angles: NDArray[np.float64], columns: list[_JointColumn], hand: Hand) -> None:
    """Check that the angles ``(n, columns)`` under one unit do not look like the other one.

    Degrees are refused as radians beyond a full turn, or when most would be beyond the joints' limits; radians as
    degrees when nearly all are below 2 and most would be within the limits.
    """
    chosen = [number for number, column in enumerate(columns) if column.unit == unit]
    if not chosen:
        return
    values = angles[:, chosen]
    lower, upper = (
        np.array([limit[list(columns[number].joints)].mean() for number in chosen])
        for limit in (hand.lower_rad - _OVERSHOOT_RAD, hand.upper_rad + _OVERSHOOT_RAD)
    )
    most_within = ((lower <= values) & (values <= upper)).mean() >= 0.5
    row, place = np.unravel_index(np.abs(values).argmax(), values.shape)
    worst = columns[chosen[place]]
    largest = values[row, place]
    if unit == "rad":
        wrong, other = abs(largest) > 2 * math.pi or not most_within, "deg"
    else:
        wrong, other = largest != 0 and np.quantile(np.abs(values), 0.95) < 2 and most_within, "rad"
    if wrong:
        raise FileFormatError(
            f"the angles in {_UNIT_NAMES[unit]} look like {_UNIT_NAMES[other]}, the largest is "
            f"{largest * len(worst.joints):g} under {worst.header}; name such columns <JOINT>_{other}, or state "
            f"--unit {other} for those without a unit"
        )


def _angle(text: str, header: str) -> float:
    with suppress(ValueError):
        if math.isfinite(angle := float(text)):
            return angle
    raise InputError(f"{header} is {text.strip()!r}, not a finite number")


def _listed(names: list[str] | tuple[str, ...]) -> str:
    return ", ".join(name or "(unnamed)" for name in names) or "none"
