"""Pack grasps into the bytes of a file, in any format that `formats` can write."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ..errors import InputError
from ..formats import FORMATS_BY_NAME, ExportOptions, GraspFormat, save_grasps
from ..trials import Outcomes
from .session import Batch

_OBJECT_ROOT = "objects"
"""Where a format that names object files says they are: beside the grasps, wherever the archive is unpacked."""


@dataclass(frozen=True)
class Download:
    """Hold a file for a browser to save."""

    name: str
    content: bytes


def pack(batch: Batch, format_name: str, rows: list[int], outcomes: Mapping[int, Outcomes] | None = None) -> Download:
    """Write some rows of a batch as a file; a format of several files comes as a zip archive.

    Args:
        batch: the grasps.
        format_name: one of `FORMATS_BY_NAME`.
        rows: which of them.
        outcomes: what is known of their trials by row; formats with a place for it get it where all were tried.

    Raises:
        InputError: the format cannot hold these grasps or needs a package that is not installed.
    """
    known, grasps = FORMATS_BY_NAME[format_name], batch.grasps[rows]
    if known.missing:
        raise InputError(f"{format_name} needs a package that is not installed here: {', '.join(known.missing)}")
    tried = outcomes or {}
    complete = Outcomes.concatenate([tried[row] for row in rows]) if all(row in tried for row in rows) else None
    name = f"{batch.name}_grasp{rows[0]}" if len(rows) == 1 < len(batch.grasps) else batch.name
    with TemporaryDirectory(prefix="graspcascade-") as folder:
        target = Path(folder) / f"{name}{_suffix(known, len(np.unique(grasps.object_label)))}"
        save_grasps(
            target,
            grasps,
            metadata=batch.metadata,
            X_world_object=batch.X_world_object,
            format=format_name,
            options=ExportOptions(outcomes=complete, object_root=_OBJECT_ROOT),
        )
        if target.is_file():
            return Download(target.name, target.read_bytes())
        return Download(f"{name}_{format_name}.zip", _zipped(Path(folder)))


def _suffix(known: GraspFormat, n_objects: int) -> str:
    one_file = known.layout == "file" or (known.layout == "either" and n_objects == 1)
    return known.suffixes[0] if one_file else ""


def _zipped(folder: Path) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, path.relative_to(folder))
    return packed.getvalue()
