"""Trials per second of collection and evaluation, and their gain over stepping every trial to its end."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..candidates import draw_sides
from ..cells import CELLS
from ..dataset import CollectionSpec, collect
from ..dataset.collect import draw_round
from ..evaluation import Source, evaluate
from ..grasps import Grasps
from ..hands import HandModel
from ..machine import peak_rss_mb
from ..postures import PosturePrior
from ..trials import PAPER
from .spread import Spread

_STREAM = 0xBE7C
"""Keeps the draws of the raw engine apart from those of an evaluation with the same seed."""

Tell = Callable[[str], None]
"""Hear how far a measurement is, in words."""


@dataclass(frozen=True)
class Count:
    """Count what one run of a workload did."""

    trials: int
    held: int


Workload = Callable[[Tell], Count]


@dataclass(frozen=True)
class Repetition:
    """Hold one timed run between two measurements of the raw engine.

    Attributes:
        count: what it did.
        seconds: elapsed time.
        raw_before, raw_after: raw engine steps per second just before and just after, on grasps of the same kind.
        steps_per_trial: steps of one full-length trial.
    """

    count: Count
    seconds: float
    raw_before: float
    raw_after: float
    steps_per_trial: int = PAPER.total_steps

    @property
    def trials_per_s(self) -> float:
        """Give the trials decided per second."""
        return self.count.trials / self.seconds

    @property
    def held_per_s(self) -> float:
        """Give the held trials per second."""
        return self.count.held / self.seconds

    @property
    def gain(self) -> float:
        """Compare with the trials per second of a raw engine that steps every one to its end.

        The engine's speed is the mean of the measurements on either side, since that of a machine in use drifts.
        """
        return self.trials_per_s / ((self.raw_before + self.raw_after) / 2 / self.steps_per_trial)

    def to_json(self) -> dict[str, float]:
        """Give all numbers by name."""
        own = {name: getattr(self, name) for name in ("seconds", "trials_per_s", "held_per_s", "gain")}
        return own | {"raw_before_steps_per_s": self.raw_before, "raw_after_steps_per_s": self.raw_after}


@dataclass
class Measured:
    """Collect the repetitions of each workload.

    Attributes:
        repetitions: by the workload's name.
        peak_rss_mb: peak memory of the process when a workload had run for the first time, by its name.
    """

    repetitions: dict[str, list[Repetition]] = field(default_factory=dict)
    peak_rss_mb: dict[str, float] = field(default_factory=dict)

    def to_json(self, name: str) -> dict[str, Any]:
        """Sum up one workload."""
        found = self.repetitions[name]
        quantities = ("trials_per_s", "held_per_s", "gain")
        spreads = {q: Spread.of(getattr(one, q) for one in found).to_json() for q in quantities}
        raw = Spread.of(speed for one in found for speed in (one.raw_before, one.raw_after))
        return spreads | {
            "raw_steps_per_s": raw.to_json(),
            "trials": found[0].count.trials,
            "held": found[0].count.held,
            "values": [one.to_json() for one in found],
        }


def interleave(
    workloads: Mapping[str, tuple[Callable[[], float], Workload]],
    repetitions: int,
    begin: Callable[[str], Tell],
    clock: Callable[[], float] = time.perf_counter,
) -> Measured:
    """Run workloads in turn, each between two measurements of the raw engine.

    Args:
        workloads: by name, what measures the raw engine in steps per second, and what to run.
        repetitions: runs of each.
        begin: called with the name of what is measured next, gives what to tell how far it is.
        clock: elapsed seconds.
    """
    found = Measured(repetitions={name: [] for name in workloads})
    for _ in range(repetitions):
        for name, (raw, workload) in workloads.items():
            begin("raw engine")
            before = raw()
            tell = begin(name)
            begun = clock()
            count = workload(tell)
            seconds = clock() - begun
            found.peak_rss_mb.setdefault(name, peak_rss_mb())
            begin("raw engine")
            found.repetitions[name].append(Repetition(count, seconds, before, raw()))
    return found


def collection_round(per_cell: int) -> int:
    """Give the trials of a cell in one round: collection's own, or all there are where that is fewer."""
    return min(per_cell, CollectionSpec.round_per_cell)


def collection(hand: HandModel, prior: PosturePrior, per_cell: int, seed: int, n_threads: int) -> Workload:
    """Make the workload of a collection into a folder that is removed: drawn, screened, simulated, written."""
    spec = CollectionSpec(per_cell, round_per_cell=collection_round(per_cell), seed=seed)
    total = per_cell * len(CELLS)

    def run(tell: Tell) -> Count:
        decided = 0

        def tick(trials: int) -> None:
            nonlocal decided
            decided += trials
            tell(_of(decided, total))

        with tempfile.TemporaryDirectory(prefix="graspcascade-bench-") as folder:
            state = collect(hand, prior, spec, Path(folder) / "data", n_threads=n_threads, tick=tick)
        return Count(int(state.trials.sum()), int(state.held.sum()))

    return run


def evaluation(
    name: str, source: Source, per_cell: int, seed: int, n_threads: int, cells: Sequence[tuple[str, str]] = CELLS
) -> Workload:
    """Make the workload of an evaluation under the full protocol, which computes every step that may matter."""

    def run(tell: Tell) -> Count:
        found = evaluate(
            name,
            source,
            per_cell=per_cell,
            seed=seed,
            n_threads=n_threads,
            cells=cells,
            progress=lambda done, total: tell(_of(done, total)),
        )
        return Count(found.n, found.total.held)

    return run


def collection_grasps(hand: HandModel, prior: PosturePrior, per_cell: int, seed: int) -> Grasps:
    """Draw what a collection executes: screened candidates of every cell."""
    spec = CollectionSpec(per_cell, round_per_cell=per_cell, seed=seed)
    return draw_round(hand, prior, np.arange(len(CELLS)), 0, spec)[0]


def evaluation_grasps(source: Source, per_cell: int, seed: int, cells: Sequence[tuple[str, str]] = CELLS) -> Grasps:
    """Draw what an evaluation of a source executes."""
    rng = np.random.default_rng([seed, _STREAM])
    labels, types = (np.repeat(np.array(column, dtype=str), per_cell) for column in zip(*cells, strict=True))
    return source(types, labels, draw_sides(labels, rng), rng)


def _of(done: int, total: int) -> str:
    return f"{done} of {total} trials"
