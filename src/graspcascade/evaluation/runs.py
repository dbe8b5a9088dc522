"""Resumable evaluation: every cell gets the same number of full-length trials, in rounds that depend on seeds alone."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..candidates import draw_sides
from ..cascade.sampler import EVALUATION_FILE
from ..cells import CELLS
from ..errors import InputError
from ..grasps import Grasps
from ..hands import SHADOW_HAND, HandDescription
from ..machine import versions
from ..objects import CATALOGUE, grasp_object
from ..taxonomy import grasp_type
from ..trials import PAPER, VERDICTS, Outcomes, Protocol, run
from .record import Cell, Evaluation
from .sources import Source
from .store import Counts, RoundStore

ROUND_PER_CELL = 20
"""Trials of a cell in one round; a round is all that an interruption can lose."""

_STREAM = 0xE7A1
"""Keeps the draws of an evaluation apart from those of a collection with the same seed."""


def evaluate(
    name: str,
    source: Source,
    *,
    per_cell: int,
    seed: int,
    protocol: Protocol = PAPER,
    hand: HandDescription = SHADOW_HAND,
    out: Path | None = None,
    n_threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
    cells: Sequence[tuple[str, str]] = CELLS,
    metadata: Mapping[str, Any] | None = None,
) -> Evaluation:
    """Execute grasps of a source for every object and type, and count what becomes of them.

    The side of each grasp is drawn uniformly from the object's graspable sides. Every trial runs to its end. The
    numbers depend on the arguments and versions alone, not on threads or interruptions.

    Args:
        name: what the numbers are quoted under.
        source: draws the grasps.
        per_cell: trials for each object and type.
        seed: seed of every draw.
        protocol: what is done and what counts.
        hand: the hand to execute with.
        out: folder that keeps finished rounds (rows as Parquet where pyarrow is installed) and the final
            `evaluation.json`; the same call goes on where an earlier one was cut off, and executes rounds whose rows
            were lost since again. None keeps nothing.
        n_threads: simulation threads, 0 for all processors.
        progress: called with trials done and trials in all.
        cells: (object label, grasp type) pairs.
        metadata: JSON-able facts of the model, recorded with the numbers.

    Raises:
        InputError: nothing to do, an unknown name, a source that answers something else than it was asked, or a
            folder that holds an evaluation with other arguments or that another process is writing to.
        FileFormatError: the folder holds something else.
    """
    cells = tuple((grasp_object(label).label, grasp_type(kind).name) for label, kind in cells)
    _check(cells, per_cell, seed)
    identity: dict[str, Any] = {
        "model": name,
        "model_metadata": _plain(metadata or {}),
        "protocol": protocol.to_json(),
        "hand": hand.name,
        "hand_fingerprint": hand.fingerprint(),
        "joint_names": list(hand.joint_names),
        "pregrasp_rad": list(hand.pregrasp),
        "objects": {label: obj.to_json() for label, obj in CATALOGUE.items()},
        "cells": [list(cell) for cell in cells],
        "seed": seed,
        "per_cell": per_cell,
        "round_per_cell": ROUND_PER_CELL,
        "versions": versions(),
    }
    rounds = [min(ROUND_PER_CELL, per_cell - start) for start in range(0, per_cell, ROUND_PER_CELL)]
    with RoundStore.open(out, identity, len(cells)) as store:
        if store.finished:
            store.check_source(_draw(source, cells, rounds[0], seed, 0, hand))
        done = _Progress(progress, store.trials, per_cell * len(cells))
        for number in store.due(len(rounds)):
            grasps = _draw(source, cells, rounds[number], seed, number, hand)
            outcomes = run(grasps, protocol, hand=hand, n_threads=n_threads, progress=done)
            store.keep(number, grasps, outcomes, _count(len(cells), rounds[number], grasps, outcomes))
        evaluation = Evaluation(
            protocol=protocol,
            model=name,
            hand=hand.name,
            cells=_cells(cells, store.total),
            seed=seed,
            per_cell=per_cell,
            versions=identity["versions"],
            model_metadata=identity["model_metadata"],
        )
        if out is not None:
            evaluation.save(Path(out) / EVALUATION_FILE)
    return evaluation


class _Progress:
    """Add up the trials that the runner reports."""

    def __init__(self, report: Callable[[int, int], None] | None, done: int, total: int) -> None:
        self._report, self._done, self._total = report, done, total
        self(0)

    def __call__(self, decided: int) -> None:
        self._done += decided
        if self._report is not None:
            self._report(self._done, self._total)


def _check(cells: Sequence[tuple[str, str]], per_cell: int, seed: int) -> None:
    if per_cell < 1:
        raise InputError(f"an evaluation needs at least 1 trial per cell, got {per_cell}")
    if seed < 0:
        raise InputError(f"a seed must not be negative, got {seed}")
    if not cells or len(set(cells)) < len(cells):
        raise InputError("an evaluation needs at least one cell, and each object and type once")


def _plain(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Bring metadata into the form that JSON gives back."""
    try:
        return dict(json.loads(json.dumps(dict(metadata), allow_nan=False)))
    except (TypeError, ValueError) as error:
        raise InputError(f"model metadata must be plain JSON: {error}") from error


def _draw(
    source: Source, cells: Sequence[tuple[str, str]], per_cell: int, seed: int, number: int, hand: HandDescription
) -> Grasps:
    """Draw one round, the rows of a cell together and cells in order."""
    rng = np.random.default_rng([seed, number, _STREAM])
    labels, types = (np.repeat(np.array(column, dtype=str), per_cell) for column in zip(*cells, strict=True))
    axes = draw_sides(labels, rng)
    grasps = source(types, labels, axes, rng)
    asked = {"grasp_type": types, "object_label": labels, "side_axis": axes}
    # A source that drops or trades rows would change the question and so the rate.
    differing = [key for key, column in asked.items() if not np.array_equal(getattr(grasps, key), column)]
    if differing:
        raise InputError(f"the source answered with another {', '.join(differing)} than it was asked for")
    if grasps.joint_names != hand.joint_names:
        raise InputError(f"the source's joints are {', '.join(grasps.joint_names)}, not those of {hand.name} in order")
    return grasps


def _count(n_cells: int, per_cell: int, grasps: Grasps, outcomes: Outcomes) -> Counts:
    """Count each verdict, and the faithful, of every cell: ``(cells, verdicts + 1)``."""
    columns = [outcomes.verdict == verdict for verdict in VERDICTS] + [outcomes.faithful(grasps)]
    return np.stack([column.reshape(n_cells, per_cell).sum(axis=1) for column in columns], axis=1).astype(np.int64)


def _cells(cells: Sequence[tuple[str, str]], counts: NDArray[np.int64]) -> tuple[Cell, ...]:
    return tuple(
        Cell(dict(zip(VERDICTS, row[:-1], strict=True)), row[-1], kind, label)
        for (label, kind), row in zip(cells, counts.tolist(), strict=True)
    )
