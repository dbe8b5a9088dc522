"""Our own formats, exact to the last bit: JSON, an object a grasp with joints by name, and Parquet, a row a grasp."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.errors import FileFormatError, InputError
from ..core.files import parse_json
from ..core.records import Columns, gather, gather_pose, read_tasks, spread, spread_pose
from . import document as doc
from .document import ANGLES, LABELS, NUMBERS, POSE_PARTS, UNKNOWABLE, Assumptions, ExportOptions, GraspDocument

_HEADER_KEY = b"graspcascade"


def write_json(path: Path, document: GraspDocument, _options: ExportOptions) -> None:
    """Write a document as JSON."""
    path.write_text(json.dumps(document_to_json(document), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def document_to_json(document: GraspDocument) -> dict[str, Any]:
    """Write a document as plain lists, numbers and null, the header first.

    Raises:
        InputError: a value that no reader would take, or metadata that JSON cannot hold.
    """
    grasps, head, rows = document.grasps, doc.header(document), doc.fact_rows(document.grasps)
    placed = None if document.X_world_object is None else grasps.hand_pose(document.X_world_object)
    for i, row in enumerate(rows):
        row |= {name: doc.by_name(grasps.joint_names, getattr(grasps, name)[i]) for name in ANGLES}
        row["X_hand_object"] = doc.pose_to_json(grasps.X_hand_object, i)
        if placed is not None:
            row["X_world_hand"] = doc.pose_to_json(placed, i)
    return head | {"grasps": rows}


def read_json(path: Path, assume: Assumptions) -> GraspDocument:
    """Read a document."""
    head = parse_json(path.read_bytes(), allow_nan=False)
    names, rows = doc.check_header(head)["joint_names"], head.get("grasps")
    if not isinstance(rows, list):
        raise FileFormatError("grasps is not a list")
    read = []
    for i, row in enumerate(rows):
        with doc.place(f"grasp {i}"):
            try:
                read.append(_row(row, names))
            except KeyError as error:
                raise FileFormatError(f"lacks {error.args[0]!r}") from error
    types, objects, axes = ([row[label] for row in read] for label in LABELS)
    tasks = read_tasks(types, objects, axes, head)
    return doc.to_document(head, names, doc.stack(read, names), tasks, assume.hand)


def _row(row: object, joint_names: Sequence[str]) -> dict[str, Any]:
    if not isinstance(row, dict):
        raise FileFormatError("is not an object")
    for name in LABELS:
        if not isinstance(row[name], str):
            raise FileFormatError(f"{name} is {doc.shown(row[name])}, not a name")
    read: dict[str, Any] = {name: row[name] for name in LABELS}
    for name in NUMBERS:
        unknown = name in UNKNOWABLE and row[name] is None
        read[name] = math.nan if unknown else doc.number(row[name], name)
    for name in ANGLES:
        angles = doc.mapping(row[name])
        foreign = sorted(set(angles) - set(joint_names))
        if foreign:
            raise FileFormatError(f"{name} has joints that joint_names lacks: {', '.join(foreign)}")
        read[name] = {joint: doc.number(angles[joint], joint) for joint in joint_names}
    pose = doc.mapping(row["X_hand_object"])
    return read | {name: doc.numbers(pose[name], width, name) for name, width in POSE_PARTS.items()}


def write_parquet(path: Path, document: GraspDocument, _options: ExportOptions) -> None:
    """Write a document as Parquet, joints as columns named as in the dataset; the header rides along."""
    pa, pq = _pyarrow()
    grasps, head = document.grasps, json.dumps(doc.header(document))
    columns = doc.facts(grasps)
    for name in ANGLES:
        columns |= spread(name, grasps.joint_names, getattr(grasps, name))
    columns |= spread_pose("object", grasps.X_hand_object)
    if document.X_world_object is not None:
        columns |= spread_pose("world_hand", grasps.hand_pose(document.X_world_object))
    # from_pandas: not-a-number, which means unknown, is stored as null.
    arrays = {
        name: pa.array(values.tolist(), pa.string()) if name in LABELS else pa.array(values, from_pandas=True)
        for name, values in columns.items()
    }
    pq.write_table(pa.table(arrays).replace_schema_metadata({_HEADER_KEY: head}), path, compression="zstd")


def read_parquet(path: Path, assume: Assumptions) -> GraspDocument:
    """Read a document."""
    pa, pq = _pyarrow()
    try:
        with pq.ParquetFile(path) as file:
            table = file.read()
    except (pa.ArrowException, OSError) as error:
        raise FileFormatError(f"not a complete Parquet file ({str(error).splitlines()[0]})") from error
    stored = (table.schema.metadata or {}).get(_HEADER_KEY)
    head = doc.check_header(None if stored is None else parse_json(stored, allow_nan=False))
    names, read = tuple(head["joint_names"]), _Columns(table)
    columns: Columns = {name: read[name] for name in NUMBERS}
    columns |= {name: gather(read, name, names) for name in ANGLES}
    columns |= vars(gather_pose(read, "object"))
    types, objects, axes = (read[label] for label in LABELS)
    tasks = read_tasks(types, objects, axes, head)
    return doc.to_document(head, names, columns, tasks, assume.hand)


class _Columns(dict[str, NDArray[Any]]):
    """The columns of a table, checked and made arrays when they are asked for."""

    def __init__(self, table: Any) -> None:
        self.table = table

    def __missing__(self, name: str) -> NDArray[Any]:
        places = self.table.schema.get_all_field_indices(name)
        if len(places) != 1:
            raise FileFormatError(f"has column {name!r} {len(places)} times" if places else f"lacks column {name!r}")
        column = self.table.column(places[0])
        kind, what = ("string|large_string|dict", "text") if name in LABELS else ("u?int|float|double|null", "numbers")
        if not re.match(kind, str(column.type)):
            raise FileFormatError(f"column {name!r} is of type {column.type}, not of {what}")
        return np.array(column.to_pylist(), dtype=str) if name in LABELS else np.asarray(column, dtype=np.float64)


def _pyarrow() -> tuple[Any, Any]:
    try:  # an optional extra, and slow to load: only this format pays for it
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        how = "install the extra 'train' (in a checkout: pip install '.[train]'), or use .json"
        raise InputError(f"Parquet files need pyarrow: {how}") from error
    return pyarrow, pyarrow.parquet
