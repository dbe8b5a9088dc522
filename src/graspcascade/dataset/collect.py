"""Resumable collection: rounds of screened candidates through the trials, one shard a round."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..candidates import candidates, cannot_touch, draw_sides
from ..cells import CELLS
from ..errors import InputError
from ..files import holds_nothing, sole_writer
from ..grasps import Grasps
from ..hands import HandModel
from ..machine import peak_rss_mb, versions
from ..objects import CATALOGUE
from ..postures import PosturePrior
from ..trials import COLLECTION, PAPER, CreepProjection, Protocol, run
from .schema import SCHEMA_VERSION, to_columns
from .shards import (
    METADATA_FILE,
    is_intact,
    read_metadata,
    refuse_other_arguments,
    shard_path,
    write_metadata,
    write_shard,
)

MOST_DRAWS_PER_TRIAL = 1000
"""Candidates drawn of a cell for each trial of a round before it is called hopeless; the shipped prior needs three."""
RARE_RATE, RARE_AFTER_TRIALS = 0.05, 1000
"""An object and type of which less than this share holds, after so many trials, is hardly worth waiting for."""


@dataclass(frozen=True)
class CollectionSpec:
    """Say how much to collect; collection ends when every cell has enough of both."""

    trials_per_cell: int = 1200
    """Trials for each object and type, rounded up to whole rounds; 0 asks for none."""
    successes_per_cell: int = 0
    """Held grasps for each object and type; 0 asks for none."""
    most_trials_per_cell: int = 0
    """A cell is given up after the round that reaches so many trials, whatever it lacks; 0 for never. Some cells hardly
    ever hold."""
    round_per_cell: int = 200
    """Trials of an unfinished cell in one round; a round is one shard and all that an interruption can lose."""
    seed: int = 0
    """Seed of every draw; the same seed gives the same rows whatever the threads or interruptions."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InputError: one is negative, a round is empty or nothing is asked for.
        """
        for name in ("trials_per_cell", "successes_per_cell", "most_trials_per_cell", "seed"):
            if not getattr(self, name) >= 0:
                raise InputError(f"{name} must not be negative, got {getattr(self, name)}")
        if not self.round_per_cell >= 1:
            raise InputError(f"round_per_cell must be at least 1, got {self.round_per_cell}")
        if self.trials_per_cell == 0 and self.successes_per_cell == 0:
            raise InputError("nothing to collect: give trials_per_cell or successes_per_cell")


@dataclass(frozen=True)
class CollectionState:
    """Report how far a collection is: rounds written, trials and held grasps of each cell ``(54,)``.

    `lost` names the shards that are missing or no longer what was written; they are collected again before anything
    else, and count for nothing until then.
    """

    rounds: int
    trials: NDArray[np.int64]
    held: NDArray[np.int64]
    faithful: NDArray[np.int64]
    lost: tuple[str, ...] = ()

    @classmethod
    def of(cls, shards: Sequence[Mapping[str, Any]], lost: Collection[int] = ()) -> CollectionState:
        """Count the shards that a collection's metadata lists, but for the lost ones, given by their numbers."""
        found = [shard for number, shard in enumerate(shards) if number not in lost]

        def total(key: str) -> NDArray[np.int64]:
            counts: NDArray[np.int64] = np.array([s[key] for s in found], dtype=np.int64).reshape(-1, len(CELLS))
            return np.asarray(counts.sum(axis=0))

        files = tuple(str(shards[number]["file"]) for number in lost)
        return cls(len(found), total("trials"), total("held"), total("faithful"), files)

    def short(self, spec: CollectionSpec) -> NDArray[np.int64]:
        """Give the indices in `CELLS` of those that lack trials or successes."""
        return np.flatnonzero((self.trials < spec.trials_per_cell) | (self.held < spec.successes_per_cell))

    def rare(self, spec: CollectionSpec) -> NDArray[np.int64]:
        """Give the indices in `CELLS` of unfinished ones that hold too rarely to be waited for (see `RARE_RATE`).

        None where such cells will be given up anyway.
        """
        if spec.most_trials_per_cell:
            return np.empty(0, dtype=np.int64)
        cells = self.unfinished(spec)
        trials, held = self.trials[cells], self.held[cells]
        rare = (held < spec.successes_per_cell) & (trials >= RARE_AFTER_TRIALS) & (held < RARE_RATE * trials)
        return cells[rare]

    def unfinished(self, spec: CollectionSpec) -> NDArray[np.int64]:
        """Give the indices in `CELLS` of those that still get trials: short of something, and not given up."""
        short, most = self.short(spec), spec.most_trials_per_cell
        return short[self.trials[short] < most] if most else short


def collect(
    hand: HandModel,
    prior: PosturePrior,
    spec: CollectionSpec,
    folder: Path | str,
    *,
    protocol: Protocol = PAPER,
    creep: CreepProjection | None = COLLECTION,
    n_threads: int = 0,
    progress: Callable[[CollectionState], None] | None = None,
    tick: Callable[[int], None] | None = None,
) -> CollectionState:
    """Collect trials into a folder, going on where an earlier call with the same arguments was cut off.

    Shards that were lost since are collected again, with the same rows.

    Args:
        hand: the hand.
        prior: where postures come from.
        spec: how much.
        folder: made if needed.
        protocol: the trial.
        creep: how trials are abridged under weight; None computes every step.
        n_threads: simulation threads, 0 for all.
        progress: called at the start and after each round.
        tick: called within a round with the number of trials decided since the last call.

    Raises:
        InputError: the folder holds a collection with other arguments, or something else, or another process is
            collecting into it; or the prior is of another hand, or its postures can hardly touch an object.
        FileFormatError: the metadata of its collection cannot be read.
    """
    folder = Path(folder)
    prior.check_hand(hand)
    with sole_writer(folder):
        metadata = _open(folder, hand, prior, spec, protocol, creep)
        shards = metadata["shards"]
        lost = [n for n, shard in enumerate(shards) if not is_intact(folder / shard["file"], shard["sha256"])]
        while True:
            state = CollectionState.of(shards, lost)
            if progress is not None:
                progress(state)
            # A lost shard gets the cells that it had, as its counts tell, whatever is asked for by now.
            number = lost[0] if lost else len(shards)
            cells = np.flatnonzero(shards[number]["trials"]) if lost else state.unfinished(spec)
            if not cells.size:
                return state
            begun = time.perf_counter()
            grasps, skipped = draw_round(hand, prior, cells, number, spec)
            outcomes = run(grasps, protocol, hand=hand.description, n_threads=n_threads, creep=creep, progress=tick)
            path = shard_path(folder, number)
            digest = write_shard(path, to_columns(grasps, outcomes))
            counts = _count(grasps, outcomes.held, outcomes.faithful(grasps))
            shard = {"file": path.name, "sha256": digest, "rows": len(grasps), "screened_out": skipped} | counts
            shards[number : number + 1] = [shard]
            del lost[:1]
            # Kept apart from what the same seed gives again.
            spent = {"seconds": round(time.perf_counter() - begun, 3), "peak_rss_mb": round(peak_rss_mb(), 1)}
            metadata.setdefault("effort", {})[path.name] = spent
            metadata["counts"] = _totals(shards)
            write_metadata(folder, metadata)


def draw_round(
    hand: HandModel, prior: PosturePrior, cells: NDArray[np.int64], number: int, spec: CollectionSpec
) -> tuple[Grasps, int]:
    """Draw one round's candidates, skipping those that cannot touch.

    Returns:
        The candidates, `round_per_cell` for each cell, and how many were skipped.

    Raises:
        InputError: hardly any candidate of a cell can touch (see `MOST_DRAWS_PER_TRIAL`).
    """
    parts, skipped = [], 0
    most = MOST_DRAWS_PER_TRIAL * spec.round_per_cell
    for cell in cells:
        label, kind = CELLS[cell]
        rng = np.random.default_rng([spec.seed, number, int(cell)])
        kept: list[Grasps] = []
        missing, n_drawn = spec.round_per_cell, 0
        while missing > 0:
            if n_drawn >= most:
                raise InputError(
                    f"only {spec.round_per_cell - missing} of {n_drawn} {kind} candidates for {label} can touch it, as "
                    "their opposing places are farther apart than its sides are wide; "
                    f"give a prior whose {kind} postures are narrower"
                )
            labels, kinds = np.full(2 * missing, label), np.full(2 * missing, kind)
            drawn = candidates(hand, prior.sample(kinds, rng), kinds, labels, draw_sides(labels, rng), rng)
            n_drawn += len(drawn)
            hopeless = cannot_touch(hand, drawn)
            useful = np.flatnonzero(~hopeless)[:missing]
            # Draws beyond the last one taken were not looked at and do not count as skipped.
            seen = len(drawn) if len(useful) < missing else int(useful[-1]) + 1
            skipped += int(hopeless[:seen].sum())
            kept.append(drawn[useful])
            missing -= len(useful)
        parts.extend(kept)
    return Grasps.concatenate(parts), skipped


def _open(
    folder: Path,
    hand: HandModel,
    prior: PosturePrior,
    spec: CollectionSpec,
    protocol: Protocol,
    creep: CreepProjection | None,
) -> dict[str, Any]:
    identity = {
        "schema_version": SCHEMA_VERSION,
        "hand": hand.description.name,
        "hand_fingerprint": hand.description.fingerprint(),
        "joint_names": list(hand.joint_names),
        "pregrasp_rad": hand.pregrasp.tolist(),
        "prior": prior.fingerprint(),
        "protocol": protocol.to_json(),
        "creep_projection": None if creep is None else asdict(creep),
        "objects": {label: obj.to_json() for label, obj in CATALOGUE.items()},
        "screening": "candidates whose opposing places stay farther apart than the side is wide are skipped",
        "seed": spec.seed,
        "round_per_cell": spec.round_per_cell,
        # The shards' bytes are pyarrow's.
        "versions": versions() | {"pyarrow": version("pyarrow")},
    }
    if (folder / METADATA_FILE).exists():
        found = read_metadata(folder)
        refuse_other_arguments(folder, "a collection", found, identity)
        # More may be asked of a finished collection: rows so far stay what they are.
        if found["collection"] != asdict(spec):
            before = {"rounds": len(found["shards"]), "collection": found["collection"]}
            found["asked_before"] = [*found.get("asked_before", []), before]
        return found | {"collection": asdict(spec)}
    if not holds_nothing(folder):
        raise InputError(f"{folder} is not empty and holds no collection; give an empty or new folder")
    metadata = identity | {"collection": asdict(spec), "counts": {}, "shards": []}
    write_metadata(folder, metadata)
    return metadata


def _count(grasps: Grasps, held: NDArray[np.bool_], faithful: NDArray[np.bool_]) -> dict[str, list[int]]:
    cell = np.array(
        [CELLS.index((str(o), str(t))) for o, t in zip(grasps.object_label, grasps.grasp_type, strict=True)]
    )

    def per_cell(rows: NDArray[np.bool_]) -> list[int]:
        return [int(count) for count in np.bincount(cell[rows], minlength=len(CELLS))]

    return {"trials": per_cell(np.ones_like(held)), "held": per_cell(held), "faithful": per_cell(faithful)}


def _totals(shards: Sequence[dict[str, Any]]) -> dict[str, Any]:
    state = CollectionState.of(shards)
    return {
        "trials": int(state.trials.sum()),
        "held": int(state.held.sum()),
        "faithful": int(state.faithful.sum()),
        "screened_out": sum(s["screened_out"] for s in shards),
        "cells": [
            {"object": o, "grasp_type": t, "trials": int(n), "held": int(h), "faithful": int(f)}
            for (o, t), n, h, f in zip(CELLS, state.trials, state.held, state.faithful, strict=True)
        ],
    }
