"""Resumable collection: rounds of screened candidates through the trials, one shard a round."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from ..core.errors import MAX_SEED, FileFormatError, InputError, check_whole
from ..core.families import ObjectFamily
from ..core.grasps import Grasps
from ..core.machine import peak_rss_mb, versions
from ..core.objects import GraspObject
from ..core.outcomes import Outcomes
from ..core.protocols import PAPER, Protocol, as_protocol
from ..core.tasks import draw_tasks
from ..core.taxonomy import GraspType
from ..engines import Engine, as_engine
from ..hands import Hand, executing_hand
from ..proposals import Proposal
from .dataset import METADATA_FILE, Shard, Whole, check_record, is_intact, open_folder, write_metadata, write_round
from .rounds import CELLS, Pair, as_cells, setting_of, try_round

MOST_DRAWS_PER_TRIAL = 1000
"""Candidates drawn of a cell for each trial of a round before it is called hopeless; the shipped prior needs three."""
_STREAM = 0xC011
"""Keeps draws of conditions apart from those of grasps."""
RARE_RATE, RARE_AFTER_TRIALS = 0.05, 1000
"""An object and type of which less than this share holds, after so many trials, is hardly worth waiting for."""


@dataclass(frozen=True)
class CollectionSpec:
    """Say how much to collect; collection ends when every cell has enough of both.

    Raises:
        InputError: a number is negative, a round is empty or nothing is asked for.

    Examples:
        >>> CollectionSpec(trials_per_cell=0, successes_per_cell=50, most_trials_per_cell=1000).round_per_cell
        200
    """

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
        for name in ("trials_per_cell", "successes_per_cell", "most_trials_per_cell"):
            check_whole(name, getattr(self, name), most=10**9)
        check_whole("round_per_cell", self.round_per_cell, 1, 10_000)
        check_whole("seed", self.seed, most=MAX_SEED)
        if self.trials_per_cell == 0 and self.successes_per_cell == 0:
            raise InputError("nothing to collect: give trials_per_cell or successes_per_cell")


@dataclass(frozen=True)
class CollectionState:
    """Report how far a collection is: rounds written, and trials and held grasps of each cell ``(cells,)``."""

    rounds: int
    trials: NDArray[np.int64]
    held: NDArray[np.int64]
    faithful: NDArray[np.int64]
    lost: tuple[str, ...] = ()
    """Shards that are missing or no longer what was written; they are collected again before anything else."""

    @classmethod
    def of(
        cls, shards: Sequence[Mapping[str, Any]], lost: Collection[int] = (), n_cells: int = len(CELLS)
    ) -> CollectionState:
        """Count the shards that a collection's metadata lists, but for the lost ones, given by their numbers."""
        present = [shard for number, shard in enumerate(shards) if number not in lost]

        trials, held, faithful = (
            np.array([shard[key] for shard in present], dtype=np.int64).reshape(-1, n_cells).sum(axis=0)
            for key in ("trials", "held", "faithful")
        )
        return cls(len(present), trials, held, faithful, tuple(str(shards[number]["file"]) for number in lost))

    def short(self, spec: CollectionSpec) -> NDArray[np.int64]:
        """List the indices of the cells that lack trials or successes."""
        return np.flatnonzero((self.trials < spec.trials_per_cell) | (self.held < spec.successes_per_cell))

    def rare(self, spec: CollectionSpec) -> NDArray[np.int64]:
        """List the indices of unfinished cells that hold too rarely to be waited for (see `RARE_RATE`).

        None where such cells will be given up anyway.
        """
        trials, held = self.trials, self.held
        rare = (held < spec.successes_per_cell) & (trials >= RARE_AFTER_TRIALS) & (held < RARE_RATE * trials)
        return np.flatnonzero(rare & (spec.most_trials_per_cell == 0))

    def unfinished(self, spec: CollectionSpec) -> NDArray[np.int64]:
        """List the indices of the cells that still get trials: short of something, and not given up."""
        short, most = self.short(spec), spec.most_trials_per_cell
        return short[self.trials[short] < most] if most else short


def collect(
    proposal: Proposal,
    spec: CollectionSpec,
    folder: Path | str,
    *,
    protocol: Protocol | str = PAPER,
    hand: Hand | str | None = None,
    engine: Engine | str = "mujoco",
    cells: Sequence[tuple[GraspObject | ObjectFamily | str, GraspType | str]] = CELLS,
    workers: int = 1,
    progress: Callable[[CollectionState], None] | None = None,
    tick: Callable[[int], None] | None = None,
) -> CollectionState:
    """Collect trials into a folder, going on where an earlier call with the same arguments was cut off.

    Shards that were lost since are collected again, with the same rows.

    Args:
        proposal: where candidates come from, and for which hand.
        spec: how much.
        folder: made if needed.
        protocol: the trial, or its name.
        hand: to execute with (see `hands.executing_hand`); by default the proposal's.
        engine: what tries them, or the name of one that abridges the time under weight.
        cells: pairs of object or family and type, or of their names; of a family every trial draws an object. Those
            of types that the proposal cannot make (see `Proposal.grasp_types`) get no trials.
        workers: processes to try in, 0 for as many as processors; 1 stays in this one.
        progress: called at the start and after each round.
        tick: called within a round with the number of trials decided since the last call.

    Raises:
        InputError: the folder holds a collection with other arguments, or something else, or another process is
            collecting into it; or none of the types can be made, or hardly any candidate is worth a trial.
        FileFormatError: the metadata of its collection cannot be read.
    """
    folder, cells, protocol = Path(folder), as_cells(cells), as_protocol(protocol)
    hand = executing_hand(proposal.hand, hand)
    if cells and not any(kind in proposal.grasp_types for _, kind in cells):
        possible = ", ".join(kind.name for kind in proposal.grasp_types) or "none"
        raise InputError(f"{hand.name} and the prior can make none of the types asked for. Possible types: {possible}.")
    engine = as_engine(engine).abridging(protocol) if isinstance(engine, str) else engine
    identity = setting_of(hand, protocol, engine, cells) | {
        **proposal.describe(),
        "creep_projection": engine.abridged,
        "screening": proposal.screening,
        "seed": spec.seed,
        "round_per_cell": spec.round_per_cell,
        # The shards' bytes are pyarrow's.
        "versions": versions() | engine.versions | {"pyarrow": version("pyarrow")},
    }
    if cells != CELLS:
        identity["cells"] = [[obj.name, kind.name] for obj, kind in cells]
    empty = {"collection": asdict(spec), "counts": {}, "shards": []}
    with open_folder(folder, "collection", identity, empty) as metadata:
        shards = metadata["shards"]
        _check(metadata, folder / METADATA_FILE, len(cells))
        # More may be asked of a finished collection: rows so far stay what they are.
        if metadata["collection"] != asdict(spec):
            before = {"rounds": len(shards), "collection": metadata["collection"]}
            metadata["asked_before"] = [*metadata.get("asked_before", []), before]
            metadata["collection"] = asdict(spec)
        lost = [number for number, shard in enumerate(shards) if not is_intact(folder, shard)]
        while True:
            state = CollectionState.of(shards, lost, len(cells))
            if progress is not None:
                progress(state)
            # A lost shard gets the cells that it had, as its counts tell, whatever is asked for by now.
            number = lost[0] if lost else len(shards)
            wanting = np.flatnonzero(shards[number]["trials"]) if lost else state.unfinished(spec)
            asked = [cell for cell in wanting.tolist() if cells[cell][1] in proposal.grasp_types]
            if not asked:
                return state
            begun = time.perf_counter()
            draw = CollectionRound(proposal, tuple(asked), number, spec, cells)
            grasps, n_skipped = draw.screened()
            conditions = protocol.conditions(len(grasps), (spec.seed, number, _STREAM))
            outcomes = try_round(grasps, draw, hand, protocol, engine, conditions, workers=workers, progress=tick)
            entry = write_round(folder, number, grasps, outcomes, conditions) | {"screened_out": n_skipped}
            cell = np.repeat(asked, spec.round_per_cell)
            shards[number : number + 1] = [entry | _count(cell, grasps, outcomes, len(cells))]
            del lost[:1]
            # Kept apart from what the same seed gives again.
            spent = {"seconds": round(time.perf_counter() - begun, 3), "peak_rss_mb": round(peak_rss_mb(), 1)}
            metadata.setdefault("effort", {})[entry["file"]] = spent
            metadata["counts"] = _totals(cells, shards)
            write_metadata(folder, metadata)


class _Round(Shard):
    trials: list[Whole]
    held: list[Whole]
    faithful: list[Whole]
    screened_out: Whole


class _Collected(msgspec.Struct):
    collection: dict[str, Any]
    shards: list[_Round]
    asked_before: list[Any] = []
    effort: dict[str, Any] = {}


def _check(metadata: Mapping[str, Any], path: Path, n_cells: int) -> None:
    for shard in check_record(metadata, _Collected, path).shards:
        counts = (shard.trials, shard.held, shard.faithful)
        # No cell holds more often than it is tried, or more type-faithfully than at all.
        if {len(column) for column in counts} != {n_cells} or not all(t >= h >= f for t, h, f in zip(*counts)):  # noqa: B905
            raise FileFormatError(f"{path}: the counts of {shard.file} are not those of {n_cells} cells")


@dataclass(frozen=True)
class CollectionRound:
    """Draw one round of a collection (see `draw_round`)."""

    proposal: Proposal
    asked: tuple[int, ...]
    number: int
    spec: CollectionSpec
    cells: tuple[Pair, ...] = CELLS

    def __call__(self) -> Grasps:
        """Draw it."""
        return self.screened()[0]

    def screened(self) -> tuple[Grasps, int]:
        """Draw it, and count the candidates skipped."""
        return draw_round(self.proposal, self.asked, self.number, self.spec, self.cells)


def draw_round(
    proposal: Proposal, asked: Sequence[int], number: int, spec: CollectionSpec, cells: Sequence[Pair] = CELLS
) -> tuple[Grasps, int]:
    """Draw one round's candidates, skipping those that are not worth a trial (see `Proposal.hopeless`).

    Args:
        proposal: where candidates come from.
        asked: indices of the `cells` to draw for.
        number: the round's.
        spec: rows of each cell, and the seed.
        cells: pairs of object or family and type.

    Returns:
        The candidates, `round_per_cell` for each cell and those of a cell together, and how many were skipped. Of a
        family, objects and sides are drawn first, and then grasps for each until one is worth a trial.

    Raises:
        InputError: hardly any candidate of a cell is worth a trial (see `MOST_DRAWS_PER_TRIAL`).
    """
    drawn = []
    for cell in asked:
        obj, kind = cells[cell]
        n, rng = spec.round_per_cell, np.random.default_rng([spec.seed, number, int(cell)])
        if isinstance(obj, ObjectFamily):
            drawn.append(_of_family(proposal, obj, kind, n, rng))
        else:
            drawn.append(_of_object(proposal, obj, kind, n, rng))
    return Grasps.concatenate([grasps for grasps, _ in drawn]), sum(skipped for _, skipped in drawn)


def _of_object(
    proposal: Proposal, obj: GraspObject, kind: GraspType, n: int, rng: np.random.Generator
) -> tuple[Grasps, int]:
    parts, skipped, missing, n_drawn = [], 0, n, 0
    while missing > 0:
        _check_hope(proposal, (obj, kind), n, missing, n_drawn)
        drawn = proposal.propose_any_side(obj, kind, 2 * missing, rng)
        n_drawn += len(drawn)
        hopeless = proposal.hopeless(drawn)
        useful = np.flatnonzero(~hopeless)[:missing]
        # Draws beyond the last one taken were not looked at and do not count as skipped.
        seen = len(drawn) if len(useful) < missing else int(useful[-1]) + 1
        skipped += int(hopeless[:seen].sum())
        parts.append(drawn[useful])
        missing -= len(useful)
    return Grasps.concatenate(parts), skipped


def _of_family(
    proposal: Proposal, family: ObjectFamily, kind: GraspType, n: int, rng: np.random.Generator
) -> tuple[Grasps, int]:
    # Were objects drawn again too, those that are easily held would be tried more often.
    tasks = draw_tasks([(family, kind)], n, proposal.hand.reach_m, rng)
    parts, rows, skipped, missing, n_drawn = [], [], 0, np.arange(n), 0
    while missing.size:
        _check_hope(proposal, (family, kind), n, len(missing), n_drawn)
        tries = -(-n // len(missing))
        drawn = proposal.propose(tasks[np.repeat(missing, tries)], rng)
        n_drawn += len(drawn)
        useful = ~proposal.hopeless(drawn).reshape(-1, tries)
        first, done = useful.argmax(axis=1), useful.any(axis=1)
        skipped += int(np.where(done, first, tries).sum())
        parts.append(drawn[np.flatnonzero(done) * tries + first[done]])
        rows.append(missing[done])
        missing = missing[~done]
    return Grasps.concatenate(parts)[np.argsort(np.concatenate(rows))], skipped


def _check_hope(proposal: Proposal, pair: Pair, n: int, missing: int, n_drawn: int) -> None:
    if n_drawn >= MOST_DRAWS_PER_TRIAL * n:
        obj, kind = pair
        raise InputError(
            f"only {n - missing} of {n_drawn} {kind.name} candidates for {obj.name} are worth a trial "
            f"({proposal.screening}); give a prior or a model whose {kind.name} grasps fit it"
        )


def _count(cell: NDArray[np.int64], grasps: Grasps, outcomes: Outcomes, n_cells: int) -> dict[str, list[int]]:
    """Count, for each cell, rows of which `cell` ``(n,)`` has the numbers."""
    rows = {"trials": np.full(len(grasps), True), "held": outcomes.held, "faithful": outcomes.faithful(grasps)}
    return {name: np.bincount(cell[chosen], minlength=n_cells).tolist() for name, chosen in rows.items()}


def _totals(cells: Sequence[Pair], shards: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    state = CollectionState.of(shards, n_cells=len(cells))
    counts = {name: getattr(state, name).tolist() for name in ("trials", "held", "faithful")}
    by_cell = [
        {"object": obj.name, "grasp_type": kind.name} | {name: counts[name][place] for name in counts}
        for place, (obj, kind) in enumerate(cells)
    ]
    skipped = sum(shard["screened_out"] for shard in shards)
    return {name: sum(counts[name]) for name in counts} | {"screened_out": skipped, "cells": by_cell}
