"""The native JSON format: one object per grasp, joints by name, exact to the last bit."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import FileFormatError
from ..grasps import Grasps
from .document import LABELS, NUMBERS, UNKNOWABLE, GraspDocument, build, check_header, header, world_pose
from .options import Assumptions, ExportOptions


def write(path: Path, document: GraspDocument, _options: ExportOptions | None = None) -> None:
    """Write a document.

    Raises:
        InputError: a value that is not finite where a number is needed, or metadata that JSON cannot hold.
    """
    path.write_text(json.dumps(document_to_json(document), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read(path: Path, _assume: Assumptions | None = None) -> GraspDocument:
    """Read a document.

    Raises:
        FileFormatError: the file is truncated, foreign or of another schema.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"not complete JSON ({str(error) or 'nested too deep'})") from error
    found = check_header(found)
    return GraspDocument(_grasps(found), dict(found["metadata"]), world_pose(found))


def document_to_json(document: GraspDocument) -> dict[str, Any]:
    """Give a document as plain lists, numbers and null, the header first.

    Raises:
        InputError: a value that is not finite where a number is needed, or metadata that JSON cannot hold.
    """
    grasps = document.grasps
    found, rows = header(document), _rows(grasps)
    if document.X_world_object is not None:
        hand = grasps.hand_pose(document.X_world_object)
        for row, position, quat in zip(rows, hand.position_m.tolist(), hand.quat_wxyz.tolist(), strict=True):
            row["X_world_hand"] = {"position_m": position, "quat_wxyz": quat}
    return found | {"grasps": rows}


def _rows(grasps: Grasps) -> list[dict[str, Any]]:
    columns = {name: column.tolist() for name, column in grasps.columns().items()}
    return [
        {name: columns[name][i] for name in LABELS}
        | {name: _or_null(columns[name][i]) for name in NUMBERS}
        | {name: dict(zip(grasps.joint_names, columns[name][i], strict=True)) for name in ("posture", "pregrasp")}
        | {"X_hand_object": {name: columns[name][i] for name in ("position_m", "quat_wxyz")}}
        for i in range(len(grasps))
    ]


def _or_null(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _grasps(found: dict[str, Any]) -> Grasps:
    rows, names = found.get("grasps"), found["joint_names"]
    if not isinstance(rows, list):
        raise FileFormatError("grasps is not a list")
    read_rows = []
    for number, row in enumerate(rows):
        try:
            read_rows.append(_row(row, names))
        except KeyError as error:
            raise FileFormatError(f"grasp {number}: lacks {error.args[0]!r}") from error
        except (TypeError, ValueError, OverflowError) as error:
            raise FileFormatError(f"grasp {number}: {error}") from error
    widths = {"posture": len(names), "pregrasp": len(names), "position_m": 3, "quat_wxyz": 4}
    columns: dict[str, NDArray[Any]] = {name: np.array([r[name] for r in read_rows], dtype=str) for name in LABELS}
    for name in (*NUMBERS, *widths):
        shape = (len(rows), widths[name]) if name in widths else (len(rows),)
        columns[name] = np.array([r[name] for r in read_rows], dtype=np.float64).reshape(shape)
    return build(names, columns)


def _row(row: dict[str, Any], joint_names: list[str]) -> dict[str, Any]:
    if not isinstance(row, dict):
        raise TypeError("is not an object")
    found: dict[str, Any] = {name: _text(row[name], name) for name in LABELS}
    for name in NUMBERS:
        unknown = name in UNKNOWABLE and row[name] is None
        found[name] = math.nan if unknown else _number(row[name], name)
    for name in ("posture", "pregrasp"):
        foreign = sorted(set(row[name]) - set(joint_names))
        if foreign:
            raise ValueError(f"{name} has joints that joint_names lacks: {', '.join(foreign)}")
        found[name] = [_number(row[name][joint], joint) for joint in joint_names]
    for name, length in (("position_m", 3), ("quat_wxyz", 4)):
        values = row["X_hand_object"][name]
        if not isinstance(values, list) or len(values) != length:
            raise ValueError(f"{name} is not a list of {length} numbers")
        found[name] = [_number(value, name) for value in values]
    return found


def _text(value: object, name: str) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{name} is {value!r}, not a name")
    return value


def _number(value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{name} is {value!r}, not a finite number")
    return float(value)


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a JSON number")
