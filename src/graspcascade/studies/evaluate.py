"""Resumable evaluation: every cell gets the same number of full-length trials, in rounds that depend on seeds alone."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ..core.errors import MAX_SEED, FileFormatError, InputError, check_whole
from ..core.families import ObjectFamily
from ..core.grasps import Grasps
from ..core.machine import versions
from ..core.objects import GraspObject
from ..core.outcomes import VERDICTS, Outcomes
from ..core.protocols import PAPER, Protocol, as_protocol
from ..core.tasks import draw_tasks
from ..core.taxonomy import GraspType, taxonomy_of
from ..engines import Engine, as_engine
from ..hands import Hand, executing_hand
from ..proposals import Proposal
from ..proposals.cascade.sampler import EVALUATION_FILE
from .dataset import METADATA_FILE, Whole, check_record, is_intact, open_folder, shard_path, write_metadata, write_round
from .record import Cell, Evaluation
from .rounds import CELLS, Pair, as_cells, setting_of, try_round

ROUND_PER_CELL = 20
"""Trials of a cell in one round; a round is all that an interruption can lose."""

_COUNTED = ("faithful", "steady")
"""What is counted of each cell beside the verdicts."""
_SAME_SOURCE_TOLERANCE = 1e-5
"""Rounding of another processor stays below, another model's mean grasp does not."""
_STREAM = 0xE7A1
"""Keeps the draws of an evaluation apart from those of a collection with the same seed."""


def evaluate(
    proposal: Proposal,
    *,
    per_cell: int,
    seed: int,
    protocol: Protocol | str = PAPER,
    hand: Hand | Path | str | None = None,
    engine: Engine | str = "mujoco",
    workers: int = 1,
    out: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
    cells: Sequence[tuple[GraspObject | ObjectFamily | str, GraspType | str]] = CELLS,
    name: str | None = None,
    metadata: Mapping[str, Any] | None = None,
) -> Evaluation:
    """Execute grasps of a proposal for every object and type, and count what becomes of them.

    The side of each grasp is drawn uniformly from the object's graspable sides. Every trial runs to its end. The
    numbers depend on the arguments and versions alone, not on threads, processes or interruptions.

    Args:
        proposal: draws the grasps.
        per_cell: trials for each object and type.
        seed: of every draw.
        protocol: what is done and what counts, or its name.
        hand: the hand to execute with, its name or file; by default the proposal's.
        engine: what tries them, or its name.
        workers: processes to try in, 0 for as many as processors; 1 stays in this one.
        out: folder that keeps finished rounds (rows as Parquet where pyarrow is installed) and the final
            `evaluation.json`; the same call goes on where an earlier one was cut off, and executes rounds whose rows
            were lost since again. None keeps nothing.
        progress: called with trials done and trials in all.
        cells: pairs of object or family and grasp type, or of their names; of a family every trial draws an object.
        name: what the numbers are quoted under; by default the proposal's name.
        metadata: JSON-able facts of the model, recorded with the numbers; by default the proposal's.

    Raises:
        InputError: nothing to do, an abridging engine, a proposal that answers something else than it was asked, or a
            folder that holds an evaluation with other arguments or that another process is writing to.
        FileFormatError: the folder holds something else.

    Examples:
        >>> from graspcascade import GRASP_TYPES, GraspSampler, as_object
        >>> cells = [(as_object("box_medium"), GRASP_TYPES["tripod"])]
        >>> result = evaluate(GraspSampler.pretrained(), per_cell=2, seed=0, cells=cells)
        >>> result.protocol.name, result.n
        ('paper', 2)
    """
    engine, cells = as_engine(engine), as_cells(cells, proposal.as_type)
    protocol = as_protocol(protocol)
    if engine.abridged is not None:
        raise InputError("an evaluation computes every step; give an engine with creep=None")
    hand = executing_hand(proposal.hand, hand)
    name = proposal.name if name is None else name
    check_whole("per_cell", per_cell, 1)
    check_whole("seed", seed, most=MAX_SEED)
    identity: dict[str, Any] = {
        "kind": "graspcascade evaluation rounds",
        "model": name,
        "model_metadata": _plain(proposal.describe() if metadata is None else metadata),
        **setting_of(hand, protocol, engine, cells),
        "cells": [[obj.name, kind.name] for obj, kind in cells],
        "seed": seed,
        "per_cell": per_cell,
        "round_per_cell": ROUND_PER_CELL,
        "versions": versions() | engine.versions,
    }
    rounds = [min(ROUND_PER_CELL, per_cell - start) for start in range(0, per_cell, ROUND_PER_CELL)]
    draws = [EvaluationRound(proposal, cells, n, seed, number) for number, n in enumerate(rounds)]
    with _open(out, identity, rounds) as (metadata, lost):
        kept = metadata["rounds"]
        # Names do not tell a model from a retrained one; the first round, drawn again, does.
        if kept and not np.allclose(
            metadata["first_round_mean"], _mean(draws[0]()), rtol=0.0, atol=_SAME_SOURCE_TOLERANCE
        ):
            raise InputError(
                f"{out} holds rounds of another model under the same name; "
                "give that model to go on with it, or another folder"
            )
        done = sum(n for number, n in enumerate(rounds[: len(kept)]) if number not in lost) * len(cells)

        def tell(decided: int) -> None:
            nonlocal done
            done += decided
            if progress is not None:
                progress(done, per_cell * len(cells))

        tell(0)
        for number in [*lost, *range(len(kept), len(rounds))]:
            grasps = draws[number]()
            conditions = protocol.conditions(len(grasps), (seed, number, _STREAM, 1))
            outcomes = try_round(
                grasps, draws[number], hand, protocol, engine, conditions, workers=workers, progress=tell
            )
            if number == 0:
                metadata.setdefault("first_round_mean", _mean(grasps))
            if out is not None and _keeps_rows():
                entry = write_round(Path(out), number, grasps, outcomes, conditions)
                shards = {shard["file"]: shard for shard in metadata["shards"]} | {entry["file"]: entry}
                metadata["shards"] = list(shards.values())
            kept[number : number + 1] = [{"counts": _count(len(cells), rounds[number], grasps, outcomes)}]
            if out is not None:
                write_metadata(Path(out), metadata)
        counted = np.sum([one["counts"] for one in kept], axis=0).tolist()
        tallies = tuple(
            Cell(dict(zip(VERDICTS, verdicts, strict=True)), faithful, kind.name, obj.name, steady=steady)
            for (obj, kind), (*verdicts, faithful, steady) in zip(cells, counted, strict=True)
        )
        about = {key: identity[key] for key in ("seed", "per_cell", "versions", "model_metadata")}
        about["taxonomy"] = taxonomy_of(kind for _, kind in cells)
        evaluation = Evaluation(protocol, name, hand.name, tallies, engine=engine.name, **about)
        if out is not None:
            evaluation.save(Path(out) / EVALUATION_FILE)
    return evaluation


@dataclass(frozen=True)
class EvaluationRound:
    """Draw one round of an evaluation: `per_cell` rows of each cell together, and cells in order."""

    proposal: Proposal
    cells: tuple[Pair, ...]
    per_cell: int
    seed: int
    number: int

    def __call__(self) -> Grasps:
        """Draw the grasps.

        Raises:
            InputError: the proposal answered something else than it was asked.
        """
        rng = np.random.default_rng([self.seed, self.number, _STREAM])
        tasks = draw_tasks(self.cells, self.per_cell, self.proposal.hand.reach_m, rng)
        grasps = self.proposal.propose(tasks, rng)
        # A proposal that drops or trades rows would change the question and so the rate.
        if not grasps.tasks.same_as(tasks):
            raise InputError("the proposal answered with other tasks than it was asked for")
        hand, joints = self.proposal.hand, ", ".join(grasps.joint_names)
        if grasps.joint_names != hand.joint_names:
            raise InputError(f"the proposal's joints are {joints}, not those of {hand.name} in order")
        return grasps


@contextmanager
def _open(
    out: Path | None, identity: dict[str, Any], sizes: Sequence[int]
) -> Iterator[tuple[dict[str, Any], list[int]]]:
    """Open the metadata of finished rounds of certain sizes, and list the rounds whose rows were lost.

    A folder is also a dataset that `load_dataset` reads. Counts are kept beside the rows, so that resuming needs no
    pyarrow.
    """
    empty: dict[str, Any] = {"count_columns": [*VERDICTS, *_COUNTED], "rounds": [], "shards": []}
    if out is None:
        yield empty, []
        return
    with open_folder(folder := Path(out), "evaluation", identity, empty) as metadata:
        _check(metadata, folder / METADATA_FILE, identity, sizes)
        shards = {shard["file"]: shard for shard in metadata["shards"]}
        # Rounds done where pyarrow was not installed have no shard to lose, and without it none can be written.
        names = [shard_path(folder, number).name for number in range(len(metadata["rounds"]) if _keeps_rows() else 0)]
        yield metadata, [n for n, name in enumerate(names) if name in shards and not is_intact(folder, shards[name])]


class _Round(msgspec.Struct):
    counts: list[list[Whole]]


class _Rounds(msgspec.Struct):
    rounds: list[_Round]
    first_round_mean: list[float] | None = None


def _check(metadata: dict[str, Any], path: Path, identity: Mapping[str, Any], sizes: Sequence[int]) -> None:
    read = check_record(metadata, _Rounds, path)
    n_cells, n_columns = len(identity["cells"]), len(VERDICTS) + len(_COUNTED)
    n_means = len(identity["joint_names"]) + 7
    if len(read.rounds) > len(sizes) or (read.rounds and len(read.first_round_mean or ()) != n_means):
        raise FileFormatError(f"{path} needs at most {len(sizes)} rounds and, with one, {n_means} first_round_mean")
    for number, (kept, size) in enumerate(zip(read.rounds, sizes, strict=False)):
        # The verdicts of a cell are those of its trials; of the held ones some are faithful, and some steady.
        fits = [
            len(row) == n_columns and sum(row[: len(VERDICTS)]) == size and max(row[len(VERDICTS) :]) <= row[0]
            for row in kept.counts
        ]
        if len(fits) != n_cells or not all(fits):
            raise FileFormatError(f"{path}: the counts of round {number} are not of {size} trials in {n_cells} cells")


def _keeps_rows() -> bool:
    return find_spec("pyarrow") is not None


def _mean(grasps: Grasps) -> list[float]:
    pose = grasps.X_hand_object
    return [float(v) for v in np.concatenate([grasps.posture, pose.position_m, pose.quat_wxyz], axis=1).mean(axis=0)]


def _plain(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Bring metadata into the form that JSON gives back."""
    try:
        return dict(json.loads(json.dumps(dict(metadata), allow_nan=False)))
    except (TypeError, ValueError) as error:
        raise InputError(f"model metadata must be plain JSON: {error}") from error


def _count(n_cells: int, per_cell: int, grasps: Grasps, outcomes: Outcomes) -> list[list[int]]:
    """Count each verdict, the faithful and the steady of every cell: ``(cells, verdicts + 2)``."""
    columns = [outcomes.verdict == verdict for verdict in VERDICTS] + [outcomes.faithful(grasps), outcomes.steady]
    counts: list[list[int]] = np.array(columns).reshape(len(columns), n_cells, per_cell).sum(axis=2).T.tolist()
    return counts
