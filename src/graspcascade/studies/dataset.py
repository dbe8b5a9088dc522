"""Datasets: Parquet shards in a folder with a metadata file; writing is atomic, reading is checked.

Every column is a plain scalar, joints by name, so that pyarrow, pandas and Hugging Face `datasets` read shards as they
are. SI units; frames as in `Grasps` and `Outcomes`. Real numbers are stored in single precision.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from itertools import product
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from ..core.errors import FileFormatError, InputError
from ..core.files import holds_nothing, read_json, sole_writer, write_json, write_staged
from ..core.grasps import Grasps
from ..core.objects import AXES
from ..core.outcomes import PALM, VERDICTS, Outcomes
from ..core.poses import Pose, canonical_quat
from ..core.protocols import Conditions
from ..core.records import Columns, check_widths, gather, gather_pose, read_tasks, spread, spread_pose
from ..core.taxonomy import AREAS, DIGITS

METADATA_FILE = "metadata.json"
SCHEMA_VERSION = 1

_GRASP_NUMBERS = ("side_m", "grasp_size_m")
_OUTCOME_NUMBERS = ("object_size_m", "displacement_m", "turn_rad", "duration_s")
_FARTHEST_M, _UNIT_TOLERANCE = 1.0, 1e-3
"""An object farther from the hand, or a quaternion whose length differs more from 1, is of no grasp."""
_UNUSUAL = ("cells", "families", "placement", "taxonomy")
"""Entries that metadata has only where they are not as usual."""
_WORDS = {"model_metadata": "training of the model", "hand_fingerprint": "hand file", "pregrasp_rad": "open hand"}
"""What entries of the metadata are called in messages, where not by their keys."""

Record = TypeVar("Record")
Whole = Annotated[int, msgspec.Meta(ge=0)]


class Shard(msgspec.Struct):
    """What the metadata lists of a shard."""

    file: Annotated[str, msgspec.Meta(pattern=r"^part-[0-9]+\.parquet$")]
    sha256: str


class _Named(msgspec.Struct):
    name: str


class _Metadata(msgspec.Struct):
    """What every dataset's metadata must say; studies add entries of their own."""

    schema_version: int
    hand: str
    joint_names: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    pregrasp_rad: tuple[float, ...]
    protocol: _Named
    shards: list[Shard]
    digits: tuple[str, ...] = DIGITS
    objects: dict[str, Any] = {}
    hand_fingerprint: str | None = None

    def __post_init__(self) -> None:
        for what, names in (("joint_names", self.joint_names), ("shards", [shard.file for shard in self.shards])):
            if twice := [name for name, count in Counter(names).items() if count > 1]:
                raise ValueError(f"{twice[0]} is twice in {what}")
        if len(self.pregrasp_rad) != len(self.joint_names) or not np.isfinite(self.pregrasp_rad).all():
            raise ValueError(f"pregrasp_rad must be an angle for each of {len(self.joint_names)} joint_names")


@dataclass(frozen=True)
class Dataset:
    """Hold a dataset in memory.

    Attributes:
        grasps: every trial's grasp; `object_size_m` is what the trial measured.
        outcomes: what became of each.
        metadata: schema version, protocol, hand, objects, seed, counts, versions, checksums.
        conditions: those of each trial, None where all are as in the protocol's physics.

    Examples:
        >>> from tempfile import TemporaryDirectory
        >>> from graspcascade.proposals.heuristic import Heuristic
        >>> from graspcascade.studies.collect import CollectionSpec, collect
        >>> spec = CollectionSpec(trials_per_cell=4, round_per_cell=4)
        >>> with TemporaryDirectory() as folder:
        ...     state = collect(Heuristic.pretrained(), spec, folder, cells=[("box:32x41x60mm", "tripod")])
        ...     dataset = load_dataset(folder)
        >>> len(dataset.grasps), int(dataset.outcomes.held.sum()) == int(state.held.sum())
        (4, True)
    """

    grasps: Grasps
    outcomes: Outcomes
    metadata: dict[str, Any]
    conditions: Conditions | None = None


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
    parts = [_read_shard(folder / entry["file"], entry["sha256"]) for entry in metadata["shards"]]
    # A column that some shard lacks is missed below, unless it need not be there.
    shared = [name for name in parts[0] if all(name in part for part in parts)]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in shared}
    grasps, outcomes, conditions = from_columns(columns, metadata)
    return Dataset(grasps, outcomes, metadata, conditions)


def join(datasets: Sequence[Dataset]) -> Dataset:
    """Join datasets of one hand; the metadata is that of the first, with all shards' checksums.

    Raises:
        InputError: no datasets, or they differ in hand, its file or taxonomy.
    """
    if not datasets:
        raise InputError("there are no datasets to join")
    first, *others = datasets
    for key in ("hand", "joint_names", "hand_fingerprint", "taxonomy"):
        if any(each.metadata.get(key) != first.metadata.get(key) for each in others):
            raise InputError(f"datasets of another {_WORDS.get(key, key.replace('_', ' '))} cannot be joined")
    conditions = [each.conditions for each in datasets if each.conditions is not None]
    columns = {part.name: [getattr(about, part.name) for about in conditions] for part in fields(Conditions)}
    joined = {name: np.concatenate(parts) for name, parts in columns.items()} if conditions else {}
    return Dataset(
        Grasps.concatenate([each.grasps for each in datasets]),
        Outcomes.concatenate([each.outcomes for each in datasets]),
        first.metadata | {"shards": [shard for each in datasets for shard in each.metadata["shards"]]},
        Conditions(**joined) if len(conditions) == len(datasets) else None,
    )


def _read_shard(path: Path, sha256: str) -> Columns:
    """Read a shard's columns, the file once for the table and the checksum."""
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


# Columns


def to_columns(grasps: Grasps, outcomes: Outcomes, conditions: Conditions | None = None) -> Columns:
    """Spread grasps, their outcomes and, where they differ, the conditions over named scalar columns."""
    columns: Columns = {"grasp_type": grasps.grasp_type, "object_label": grasps.object_name}
    columns |= {"side_axis": grasps.side_axis, "verdict": outcomes.verdict}
    columns |= {"held": outcomes.held, "faithful": outcomes.faithful(grasps)}
    columns |= {name: getattr(grasps, name) for name in _GRASP_NUMBERS}
    columns |= {name: getattr(outcomes, name) for name in _OUTCOME_NUMBERS}
    columns |= spread("posture", grasps.joint_names, grasps.posture)
    columns |= spread("settled", grasps.joint_names, outcomes.settled_posture)
    columns |= spread_pose("object", grasps.X_hand_object)
    columns |= spread_pose("settled_object", outcomes.X_hand_object_settled)
    columns |= spread("touch_closed", outcomes.touch_columns, outcomes.touching_closed)
    columns |= spread("touch_end", outcomes.touch_columns, outcomes.touching_end)
    columns |= spread("areas_closed", outcomes.digits, outcomes.areas_closed)
    columns |= spread("areas_end", outcomes.digits, outcomes.areas_end)
    if conditions is not None:
        for name, values in vars(conditions).items():
            columns |= {name: values} if values.ndim == 1 else spread(name, AXES, values)
    return {name: v.astype(np.float32) if v.dtype == np.float64 else v for name, v in columns.items()}


def from_columns(
    columns: Mapping[str, NDArray[Any]], about: Mapping[str, Any]
) -> tuple[Grasps, Outcomes, Conditions | None]:
    """Rebuild grasps, outcomes and conditions from shard columns.

    Args:
        columns: of one or more shards.
        about: the dataset's metadata: hand, joint names, pregrasp, digits, taxonomy of the types, and objects that are
            not spelled by size.

    Raises:
        FileFormatError: a column is missing or holds a value that cannot be, or a row names a task that cannot be.
    """
    joint_names, digits = tuple(about["joint_names"]), tuple(about.get("digits", DIGITS))
    touch = (*digits, PALM)
    # Earlier versions did not record turns.
    columns = {"turn_rad": np.full(len(columns["side_m"]), np.nan), **columns} if "side_m" in columns else columns
    try:
        _check_values(columns, joint_names, digits)
        types, objects, axes = (columns[name] for name in ("grasp_type", "object_label", "side_axis"))
        numbers = {name: np.asarray(columns[name], dtype=np.float64) for name in (*_GRASP_NUMBERS, *_OUTCOME_NUMBERS)}
        posture = gather(columns, "posture", joint_names)
        tasks = read_tasks(types, objects, axes, about)
        check_widths(tasks, numbers["side_m"])
        grasps = Grasps(
            hand=str(about.get("hand", "")),
            joint_names=joint_names,
            tasks=tasks,
            posture=posture,
            pregrasp=np.broadcast_to(np.asarray(about["pregrasp_rad"]), posture.shape).copy(),
            X_hand_object=_unit_pose(columns, "object"),
            grasp_size_m=numbers["grasp_size_m"],
            object_size_m=numbers["object_size_m"],
            probability=np.full(len(posture), np.nan),
        )
        outcomes = Outcomes(
            digits=digits,
            verdict=np.asarray(columns["verdict"], dtype=str),
            touching_closed=gather(columns, "touch_closed", touch).astype(bool),
            touching_end=gather(columns, "touch_end", touch).astype(bool),
            areas_closed=_areas(columns, "areas_closed", digits),
            areas_end=_areas(columns, "areas_end", digits),
            settled_posture=gather(columns, "settled", joint_names),
            X_hand_object_settled=_unit_pose(columns, "settled_object"),
            **{name: numbers[name] for name in _OUTCOME_NUMBERS},
        )
        conditions = _conditions(columns) if "friction" in columns else None
    except KeyError as error:
        raise FileFormatError(f"the dataset lacks column {error.args[0]!r}") from error
    return grasps, outcomes, conditions


def _areas(columns: Mapping[str, NDArray[Any]], prefix: str, digits: tuple[str, ...]) -> NDArray[np.uint16]:
    """Join the columns of areas touched ``(n, D)``, zeros where there are none: earlier versions did not record any."""
    if not any(name.startswith(prefix) for name in columns):
        return np.zeros((len(columns["verdict"]), len(digits)), dtype=np.uint16)
    return gather(columns, prefix, digits).astype(np.uint16)


def _check_values(columns: Mapping[str, NDArray[Any]], joint_names: tuple[str, ...], digits: tuple[str, ...]) -> None:
    is_held = columns["verdict"] == "held"
    right = {"verdict": np.isin(columns["verdict"].astype(str), VERDICTS), "held": columns["held"] == is_held}
    right |= {f"posture_{name}": np.isfinite(columns[f"posture_{name}"]) for name in joint_names}
    for when, digit in product(("closed", "end"), digits):
        if (name := f"areas_{when}_{digit}") in columns:
            known = (columns[name] >= 0) & (columns[name] < 1 << len(AREAS))
            right[name] = known & ((columns[name] == 0) | columns[f"touch_{when}_{digit}"])
    pose = gather_pose(columns, "object")
    within = np.abs(pose.position_m) < _FARTHEST_M
    right |= {f"object_{axis}_m": within[:, place] for place, axis in enumerate(AXES)}
    right["object_qw"] = np.abs(np.linalg.norm(pose.quat_wxyz, axis=1) - 1.0) < _UNIT_TOLERANCE
    for name, rows in right.items():
        if not rows.all():
            row = int(np.argmin(rows))
            raise FileFormatError(f"column {name!r} of the dataset cannot be {columns[name][row]} (row {row})")


def _conditions(columns: Mapping[str, NDArray[Any]]) -> Conditions:
    names = [part.name for part in fields(Conditions)]
    made = {name: gather(columns, name, AXES) if f"{name}_x" in columns else columns[name] for name in names}
    return Conditions(**{name: np.asarray(values, dtype=np.float64) for name, values in made.items()})


def _unit_pose(columns: Mapping[str, NDArray[Any]], prefix: str) -> Pose:
    # Single precision shortens quaternions a little; they are made unit again.
    stored = gather_pose(columns, prefix)
    return Pose(stored.position_m, canonical_quat(stored.quat_wxyz))


# Folders


@contextmanager
def open_folder(
    folder: Path, what: str, identity: Mapping[str, Any], empty: Mapping[str, Any]
) -> Iterator[dict[str, Any]]:
    """Open a folder of rounds, new or of an earlier call with the same arguments, and keep others out meanwhile.

    Args:
        folder: made if needed.
        what: what it is to hold, for a message.
        identity: entries of the metadata that say what its rows rest on; the schema version is added.
        empty: further entries of the metadata of a new folder.

    Yields:
        The metadata, to be changed in place and written with `write_metadata`.

    Raises:
        InputError: the folder holds rounds with other arguments, or something else, or another process writes to it.
        FileFormatError: its metadata cannot be read.
    """
    identity = {"schema_version": SCHEMA_VERSION} | dict(identity)
    with sole_writer(folder):
        path = folder / METADATA_FILE
        is_new = not path.exists()
        if not is_new:
            metadata = read_metadata(folder)
            said = dict.fromkeys([*identity, *_UNUSUAL])
            if differing := [key for key in said if metadata.get(key) != identity.get(key)]:
                words = ", ".join(_WORDS.get(key, key.replace("_", " ")) for key in differing)
                raise InputError(
                    f"{folder} holds rounds with another {words}; "
                    "give the same arguments to go on with it, or another folder"
                )
        elif not holds_nothing(folder):
            raise InputError(f"{folder} is not empty and holds no {what}; give an empty or new folder")
        else:
            metadata = identity | dict(empty)
            write_metadata(folder, metadata)
        try:
            yield metadata
        except InputError:
            # What is refused before its first round must not bind the folder to the arguments that were wrong.
            if is_new and not metadata["shards"] and not metadata.get("rounds"):
                path.unlink(missing_ok=True)
            raise


def read_metadata(folder: Path) -> dict[str, Any]:
    """Read and check the metadata file.

    Raises:
        FileFormatError: it is missing, not JSON or of another schema, or lacks or garbles what every dataset says.
    """
    path = folder / METADATA_FILE
    if not path.is_file():
        raise FileFormatError(f"{folder} is not a graspcascade dataset: it has no {METADATA_FILE}")
    read = read_json(path)
    metadata: dict[str, Any] = read if isinstance(read, dict) else {}
    if (version := metadata.get("schema_version", SCHEMA_VERSION)) != SCHEMA_VERSION:
        raise FileFormatError(f"{path} has schema version {version!r}; this version reads {SCHEMA_VERSION}")
    check_record(metadata, _Metadata, path)
    return metadata


def check_record(data: Any, kind: type[Record], path: Path) -> Record:
    """Read a part of the metadata in `path` as a record; a FileFormatError says what of it does not fit."""
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        raise FileFormatError(f"{path} is not readable metadata: {error}") from error


def write_metadata(folder: Path, metadata: dict[str, Any]) -> None:
    """Write the metadata file atomically."""
    write_json(folder / METADATA_FILE, metadata)


def shard_path(folder: Path, number: int) -> Path:
    """Name the file of a round's shard."""
    return folder / f"part-{number:05d}.parquet"


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


def write_round(
    folder: Path, number: int, grasps: Grasps, outcomes: Outcomes, conditions: Conditions | None = None
) -> dict[str, Any]:
    """Write the rows of a round as a shard, and return what the metadata lists of it: file, sha256 and rows."""
    path = shard_path(folder, number)
    digest = write_shard(path, to_columns(grasps, outcomes, conditions))
    return {"file": path.name, "sha256": digest, "rows": len(grasps)}


def is_intact(folder: Path, entry: Mapping[str, Any]) -> bool:
    """Tell whether a shard that the metadata lists is there with the content that its checksum is of."""
    path = folder / entry["file"]
    return path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == str(entry["sha256"])


def shards_digest(metadata: Mapping[str, Any]) -> str:
    """Compute a short digest of all shards' checksums, by which a trained model names its dataset."""
    sums = "".join(shard["sha256"] for shard in metadata.get("shards", []))
    return hashlib.sha256(sums.encode()).hexdigest()[:16]
