"""Pack grasps into the bytes of a file, in any format that `formats` knows."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from ..errors import InputError
from ..formats import FORMATS, save_grasps
from .session import Batch


@dataclass(frozen=True)
class Download:
    """Hold a file for a browser to save."""

    name: str
    content: bytes


def format_choices() -> dict[str, str]:
    """Give the suffix of each format by the words that a person chooses it by."""
    return {f"{suffix} - {known.description}": suffix for suffix, known in FORMATS.items()}


def pack(batch: Batch, suffix: str, row: int | None = None) -> Download:
    """Write all grasps, or one row of them, as a file; a format of several files comes as a zip archive.

    Raises:
        InputError: the format cannot hold these grasps or needs a package that is not installed.
    """
    name = batch.name if row is None else f"{batch.name}_grasp{row}"
    grasps = batch.grasps if row is None else batch.grasps[row]
    with TemporaryDirectory(prefix="graspcascade-") as folder:
        target = Path(folder) / f"{name}{suffix}"
        try:
            save_grasps(target, grasps, metadata=batch.metadata, X_world_object=batch.X_world_object)
        except ModuleNotFoundError as error:
            raise InputError(f"{suffix} files need the package {error.name}, which is not installed here") from error
        made = [path for path in sorted(Path(folder).rglob("*")) if path.is_file()]
        if made == [target]:
            return Download(target.name, target.read_bytes())
        return Download(f"{target.stem}.zip", _zipped(Path(folder), made))


def _zipped(folder: Path, files: list[Path]) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for path in files:
            archive.write(path, path.relative_to(folder))
    return packed.getvalue()
