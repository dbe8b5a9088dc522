"""Parquet shards in a folder with a metadata file; writing is atomic, reading is checked."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..columns import Columns
from ..errors import FileFormatError, InputError
from ..files import read_json, write_json, write_staged
from ..grasps import Grasps
from ..trials import Outcomes
from .schema import SCHEMA_VERSION, from_columns

METADATA_FILE = "metadata.json"


@dataclass(frozen=True)
class Dataset:
    """Hold a dataset in memory.

    Attributes:
        grasps: every trial's grasp; `object_size_m` is what the trial measured.
        outcomes: what became of each.
        metadata: schema version, protocol, hand, catalogue, seed, counts, versions, checksums.
    """

    grasps: Grasps
    outcomes: Outcomes
    metadata: dict[str, Any]


def shard_path(folder: Path, number: int) -> Path:
    """Name the file of a shard."""
    return folder / f"part-{number:05d}.parquet"


def shards_digest(metadata: Mapping[str, Any]) -> str:
    """Give a short digest of all shards' checksums, by which a trained model names its dataset."""
    digest = hashlib.sha256()
    for shard in metadata.get("shards", []):
        digest.update(shard["sha256"].encode())
    return digest.hexdigest()[:16]


def write_shard(path: Path, columns: Columns) -> str:
    """Write one shard atomically and return its sha256."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    arrays = {
        name: pa.array(values.astype(object), pa.string()).dictionary_encode()
        if values.dtype.kind == "U"
        else pa.array(values)
        for name, values in columns.items()
    }
    write_staged(path, lambda staged: pq.write_table(pa.table(arrays), staged, compression="zstd"))
    return hashlib.sha256(path.read_bytes()).hexdigest()


def is_intact(path: Path, sha256: str) -> bool:
    """Tell whether a shard is there with the content that its checksum is of."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest() == sha256
    except FileNotFoundError:
        return False


def write_metadata(folder: Path, metadata: dict[str, Any]) -> None:
    """Write the metadata file atomically."""
    write_json(folder / METADATA_FILE, metadata)


def read_metadata(folder: Path) -> dict[str, Any]:
    """Read and check the metadata file.

    Raises:
        FileFormatError: it is missing, not JSON or of another schema.
    """
    path = folder / METADATA_FILE
    if not path.is_file():
        raise FileFormatError(f"{folder} is not a graspcascade dataset: it has no {METADATA_FILE}")
    metadata = read_json(path)
    try:
        version = metadata["schema_version"]
        missing = [key for key in ("joint_names", "pregrasp_rad", "shards") if key not in metadata]
    except (KeyError, TypeError) as error:
        raise FileFormatError(f"{path} is not readable dataset metadata: {error}") from error
    if version != SCHEMA_VERSION:
        raise FileFormatError(f"{path} has schema version {version}; this version reads {SCHEMA_VERSION}")
    if missing:
        raise FileFormatError(f"{path} is not readable dataset metadata: it lacks {', '.join(missing)}")
    return dict(metadata)


def refuse_other_arguments(folder: Path, what: str, found: dict[str, Any], asked: dict[str, Any]) -> None:
    """Check that a folder's metadata belongs to the arguments it is to be resumed with.

    Args:
        folder: named in the message.
        what: what the folder holds, in words.
        found: its metadata.
        asked: the entries that must be there just so.

    Raises:
        InputError: an entry differs.
    """
    differing = [key for key, value in asked.items() if found.get(key) != value]
    if differing:
        raise InputError(
            f"{folder} holds {what} with another {', '.join(differing)}; "
            "give the same arguments to go on with it, or another folder"
        )


def load_dataset(folder: Path | str) -> Dataset:
    """Load a dataset whole.

    Raises:
        FileFormatError: a file is missing, truncated or foreign.
        InputError: the dataset is empty.
    """
    folder = Path(folder)
    metadata = read_metadata(folder)
    if not metadata["shards"]:
        raise InputError(f"{folder} holds no shards yet")
    parts = [_read_checked(folder / entry["file"], entry["sha256"]) for entry in metadata["shards"]]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    joint_names = tuple(metadata["joint_names"])
    grasps, outcomes = from_columns(columns, joint_names, np.array(metadata["pregrasp_rad"]))
    return Dataset(grasps, outcomes, metadata)


def _read_checked(path: Path, sha256: str) -> Columns:
    """Read a shard's columns, the file once for the table and the checksum.

    Raises:
        FileFormatError: the file is missing, truncated, not Parquet, or not of this checksum.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        content = path.read_bytes()
        with pq.ParquetFile(pa.BufferReader(content)) as file:
            table = file.read()
    except (pa.ArrowException, OSError) as error:
        raise FileFormatError(f"{path} is not a readable Parquet shard: {str(error).splitlines()[0]}") from error
    # A shard of another collection under this name is readable, yet not what the metadata speaks of.
    if hashlib.sha256(content).hexdigest() != sha256:
        raise FileFormatError(f"{path} is not the shard that {METADATA_FILE} lists: its checksum differs")
    return {name: table.column(name).to_numpy() for name in table.column_names}
