"""The native Parquet format: one row a grasp, joints as columns, named as in the dataset; the header rides along."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..columns import Columns, gather, gather_pose, spread, spread_pose
from ..errors import FileFormatError, InputError
from .document import LABELS, NUMBERS, GraspDocument, build, check_header, header, world_pose
from .options import Assumptions, ExportOptions

_HEADER_KEY = b"graspcascade"


def write(path: Path, document: GraspDocument, _options: ExportOptions | None = None) -> None:
    """Write a document.

    Raises:
        InputError: pyarrow is missing, or metadata that JSON cannot hold.
    """
    pa, pq = _pyarrow()
    grasps, head = document.grasps, json.dumps(header(document))
    columns: Columns = {name: getattr(grasps, name) for name in (*LABELS, *NUMBERS)}
    columns |= spread("posture", grasps.joint_names, grasps.posture)
    columns |= spread("pregrasp", grasps.joint_names, grasps.pregrasp)
    columns |= spread_pose("object", grasps.X_hand_object)
    if document.X_world_object is not None:
        columns |= spread_pose("world_hand", grasps.hand_pose(document.X_world_object))
    # from_pandas: not-a-number, which means unknown, is stored as null.
    arrays = {
        name: pa.array(values.tolist(), pa.string()) if name in LABELS else pa.array(values, from_pandas=True)
        for name, values in columns.items()
    }
    table = pa.table(arrays).replace_schema_metadata({_HEADER_KEY: head})
    pq.write_table(table, path, compression="zstd")


def read(path: Path, _assume: Assumptions | None = None) -> GraspDocument:
    """Read a document.

    Raises:
        FileFormatError: the file is truncated, foreign or of another schema.
        InputError: pyarrow is missing.
    """
    pa, pq = _pyarrow()
    try:
        with pq.ParquetFile(path) as file:
            table = file.read()
    except (pa.ArrowException, OSError) as error:
        raise FileFormatError(f"not a complete Parquet file ({str(error).splitlines()[0]})") from error
    stored = (table.schema.metadata or {}).get(_HEADER_KEY)
    try:
        found = check_header(None if stored is None else json.loads(stored))
        columns = _columns(table, tuple(found["joint_names"]))
    except KeyError as error:
        raise FileFormatError(f"lacks column {error.args[0]!r}") from error
    except FileFormatError:
        raise
    except (pa.ArrowException, ValueError, TypeError) as error:
        raise FileFormatError(f"its columns or header are damaged ({error})") from error
    return GraspDocument(build(found["joint_names"], columns), dict(found["metadata"]), world_pose(found))


def _columns(table: Any, joint_names: tuple[str, ...]) -> Columns:
    # A table is indexed by column name as a mapping is, and its columns are arrays to numpy.
    columns: Columns = {name: np.array(table[name].to_pylist(), dtype=str) for name in LABELS}
    columns |= {name: np.asarray(table[name], dtype=np.float64) for name in NUMBERS}
    columns |= {name: gather(table, name, joint_names) for name in ("posture", "pregrasp")}
    placed = gather_pose(table, "object")
    return columns | {"position_m": placed.position_m, "quat_wxyz": placed.quat_wxyz}


def _pyarrow() -> tuple[Any, Any]:
    # An optional extra, and slow to load: only this format pays for it.
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise InputError("Parquet files need pyarrow: pip install 'graspcascade[train]', or use .json") from error
    return pyarrow, pyarrow.parquet
