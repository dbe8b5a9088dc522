"""Finished rounds of an evaluation, in memory or in a folder that a later call goes on with."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..dataset.schema import SCHEMA_VERSION, to_columns
from ..dataset.shards import (
    METADATA_FILE,
    is_intact,
    read_metadata,
    refuse_other_arguments,
    shard_path,
    write_metadata,
    write_shard,
)
from ..errors import FileFormatError, InputError
from ..files import holds_nothing, sole_writer
from ..grasps import Grasps
from ..trials import VERDICTS, Outcomes

Counts = NDArray[np.int64]
"""Trials of each cell: a column for each of `trials.VERDICTS`, and the faithful in the last, ``(cells, 7)``."""

_KIND = "graspcascade evaluation rounds"
_SAME_SOURCE_TOLERANCE = 1e-5
"""Rounding of another processor stays below, another model's mean grasp does not."""


@dataclass
class RoundStore:
    """Keep the counts of finished rounds and, in a folder, their rows.

    A folder is also a dataset that `dataset.load_dataset` reads, for a look at the failures. Counts are kept beside the
    rows, so that resuming needs no pyarrow.

    Attributes:
        folder: where to keep them, None for memory only.
        metadata: contents of the folder's metadata file.
        n_cells: cells of a round.
        counts: of every finished round, lost ones too.
        lost: numbers of the finished rounds whose shard is missing or no longer what was written. They are to be kept
            once more; none where pyarrow is not installed, without which no shard can be written.
    """

    folder: Path | None
    metadata: dict[str, Any]
    n_cells: int
    counts: list[Counts] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)

    @classmethod
    @contextmanager
    def open(cls, folder: Path | str | None, identity: dict[str, Any], n_cells: int) -> Iterator[RoundStore]:
        """Open a folder, new or of an earlier call with the same arguments, and keep others out while it is open.

        Raises:
            InputError: the folder holds an evaluation with other arguments, or other files, or another process is
                writing to it.
            FileFormatError: its metadata is unreadable.
        """
        fresh = {"schema_version": SCHEMA_VERSION, "kind": _KIND} | identity
        if folder is None:
            yield cls(None, {}, n_cells)
            return
        folder = Path(folder)
        with sole_writer(folder):
            yield cls._open(folder, fresh, n_cells)

    @classmethod
    def _open(cls, folder: Path, fresh: dict[str, Any], n_cells: int) -> RoundStore:
        if (folder / METADATA_FILE).exists():
            return cls._resume(folder, fresh, n_cells)
        if not holds_nothing(folder):
            raise InputError(f"{folder} is not empty and holds no evaluation; give an empty or new folder")
        store = cls(folder, fresh | {"count_columns": [*VERDICTS, "faithful"], "rounds": [], "shards": []}, n_cells)
        write_metadata(folder, store.metadata)
        return store

    @classmethod
    def _resume(cls, folder: Path, fresh: dict[str, Any], n_cells: int) -> RoundStore:
        metadata = read_metadata(folder)
        refuse_other_arguments(folder, "something", metadata, fresh)
        try:
            counts = [np.array(found["counts"], dtype=np.int64) for found in metadata["rounds"]]
            if any(found.shape != (n_cells, len(VERDICTS) + 1) for found in counts):
                raise ValueError("a round has counts of another shape")
            sums = {shard["file"]: shard["sha256"] for shard in metadata["shards"]}
        except (KeyError, TypeError, ValueError) as error:
            raise FileFormatError(f"{folder / METADATA_FILE} is not readable evaluation metadata: {error}") from error
        # Rounds done where pyarrow was not installed have no shard to lose.
        paths = [shard_path(folder, number) for number in range(len(counts) if _keeps_rows() else 0)]
        lost = [n for n, path in enumerate(paths) if path.name in sums and not is_intact(path, sums[path.name])]
        return cls(folder, metadata, n_cells, counts, lost)

    @property
    def finished(self) -> int:
        """Count the finished rounds."""
        return len(self.counts)

    @property
    def total(self) -> Counts:
        """Add up the rounds."""
        total = np.zeros((self.n_cells, len(VERDICTS) + 1), dtype=np.int64)
        for counts in self.counts:
            total += counts
        return total

    @property
    def trials(self) -> int:
        """Count the trials of finished rounds, but for the lost ones."""
        return int(sum(found[:, :-1].sum() for number, found in enumerate(self.counts) if number not in self.lost))

    def due(self, n_rounds: int) -> list[int]:
        """List the numbers of the rounds, of so many, that are to be done: the lost ones, then those to come."""
        return [*self.lost, *range(self.finished, n_rounds)]

    def keep(self, number: int, grasps: Grasps, outcomes: Outcomes, counts: Counts) -> None:
        """Keep the round that is due first; the metadata, written last, makes it count."""
        self.counts[number : number + 1] = [counts]
        self.lost = [other for other in self.lost if other != number]
        if self.folder is None:
            return
        if number == 0:
            self.metadata.setdefault("first_round_mean", _mean(grasps).tolist())
        # pyarrow is an optional extra; without it the counts alone are kept.
        if _keeps_rows():
            path = shard_path(self.folder, number)
            digest = write_shard(path, to_columns(grasps, outcomes))
            shards = {shard["file"]: shard for shard in self.metadata["shards"]}
            shards[path.name] = {"file": path.name, "sha256": digest, "rows": len(grasps)}
            self.metadata["shards"] = list(shards.values())
        self.metadata["rounds"][number : number + 1] = [{"counts": counts.tolist()}]
        write_metadata(self.folder, self.metadata)

    def check_source(self, first_round: Grasps) -> None:
        """Check that the grasps of the first round, drawn again, are those that were executed.

        Raises:
            InputError: another source drew them; names alone do not tell a retrained model from its forerunner.
        """
        kept = np.array(self.metadata["first_round_mean"])
        if not np.allclose(kept, _mean(first_round), rtol=0.0, atol=_SAME_SOURCE_TOLERANCE):
            raise InputError(
                f"{self.folder} holds rounds of another model under the same name; "
                "give that model to go on with it, or another folder"
            )


def _keeps_rows() -> bool:
    return find_spec("pyarrow") is not None


def _mean(grasps: Grasps) -> NDArray[np.float64]:
    pose = grasps.X_hand_object
    columns = np.concatenate([grasps.posture, pose.position_m, pose.quat_wxyz], axis=1)
    return np.asarray(columns.mean(axis=0), dtype=np.float64)
