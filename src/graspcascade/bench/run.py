"""All measurements of one bench, in one run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError, check_name

if TYPE_CHECKING:
    from ..grasps import Grasps

TRIAL_PARTS = ("collection", "evaluation", "evaluation_heuristic")
PARTS = ("raw", *TRIAL_PARTS, "sampling", "cold_start", "training")
"""What can be measured. The raw engine by itself steps the heuristic's candidates as they come; each part that is
compared with it is compared on grasps of its own kind."""

Report = Callable[[int, int, str], None]
"""Hear measurements done, measurements in all, and what is under way."""


@dataclass(frozen=True)
class BenchSpec:
    """Say how much to measure."""

    collection_per_cell: int = 200
    """Trials for each object and type in one repetition of collection; 200 are one round of `graspcascade collect`."""
    evaluation_per_cell: int = 40
    """Trials for each object and type in one repetition of evaluation; 20 are one round of `graspcascade evaluate`."""
    raw_per_cell: int = 2
    """Full-length trials for each object and type in one measurement of the raw engine."""
    repetitions: int = 3
    """Repetitions of collection and of evaluation, in turn, each between two measurements of the raw engine."""
    threads: int = 0
    """Simulation threads and training processes, 0 for all processors."""
    seed: int = 0
    """Seed of every draw; repetitions do the same work."""
    sample_calls: int = 216
    """Timed calls for 1,000 grasps."""
    cold_starts: int = 7
    """Timed starts of the command line."""
    training_rows: int = 270_000
    """Grasps to train on."""
    training_epochs: int = 3
    """Epochs that are timed before training is extrapolated to all of them."""
    train_full: bool = False
    """Train to the end instead of extrapolating."""

    def __post_init__(self) -> None:
        """Check the counts.

        Raises:
            InputError: a count is too small.
        """
        least = {"threads": 0, "seed": 0, "training_epochs": 2, "training_rows": 100}
        for name, value in asdict(self).items():
            if name != "train_full" and value < least.get(name, 1):
                raise InputError(f"{name.replace('_', '-')} must be at least {least.get(name, 1)}, got {value}")


def check_parts(only: Collection[str]) -> tuple[str, ...]:
    """Give the parts that are asked for, all where none is named.

    Raises:
        InputError: an unknown part.
    """
    for name in only:
        check_name("part", name, PARTS)
    return tuple(name for name in PARTS if name in only or not only)


def run_bench(
    spec: BenchSpec | None = None,
    only: Collection[str] = (),
    *,
    data: Path | None = None,
    report: Report = lambda done, total, what: None,
    cells: Sequence[tuple[str, str]] | None = None,
) -> dict[str, Any]:
    """Measure and give every number as JSON data. Nothing is kept on disk.

    Args:
        spec: how much.
        only: some of `PARTS`, all without it.
        data: dataset whose successes are trained on; without it, samples of the shipped cascade are.
        report: hears how far it is.
        cells: (object label, grasp type) pairs of the raw engine and of evaluations, all without it; collections
            always go through all.

    Raises:
        InputError: an unknown part, or a dataset with nothing to learn from.
        FileFormatError: the dataset cannot be read.
    """
    spec, parts = spec or BenchSpec(), check_parts(only)
    # Whoever asks for help or names a wrong part should not wait for physics to load.
    from ..machine import processors
    from .environment import environment

    threads = spec.threads or processors()
    watch = _Watch(parts, spec.repetitions, report)
    found: dict[str, Any] = {
        "environment": environment(threads),
        "settings": asdict(spec) | {"threads": threads},
        "repetitions": spec.repetitions,
    }
    if {"raw", *TRIAL_PARTS} & set(parts):
        found |= _trials(spec, parts, threads, cells, watch)
    if "sampling" in parts:
        from .sampling import sampling

        watch.begin("sampling")
        found["sampling"] = sampling(spec.sample_calls, spec.seed)
    if "cold_start" in parts:
        from .cold_start import cold_start

        watch.begin("cold_start")
        found["cold_start"] = cold_start(spec.cold_starts)
    if "training" in parts:
        found["training"] = _training(spec, threads, data, watch)
    watch.end()
    return found


class _Watch:
    """Count the measurements and pass on what they tell."""

    def __init__(self, parts: Sequence[str], repetitions: int, report: Report) -> None:
        compared, rest = set(parts) & set(TRIAL_PARTS), set(parts) - {"raw", *TRIAL_PARTS}
        raw = repetitions * (2 * len(compared) + ("raw" in parts))
        self._total, self._begun, self._report = raw + repetitions * len(compared) + len(rest), 0, report

    def begin(self, name: str) -> Callable[[str], None]:
        done = self._begun
        self._begun += 1
        what = name.replace("_", " ")
        self._report(done, self._total, what)
        return lambda words: self._report(done, self._total, f"{what}: {words}")

    def end(self) -> None:
        self._report(self._total, self._total, "done")


def _trials(
    spec: BenchSpec, parts: Sequence[str], threads: int, cells: Sequence[tuple[str, str]] | None, watch: _Watch
) -> dict[str, Any]:
    from ..cascade import GraspSampler
    from ..cells import CELLS
    from ..evaluation import ROUND_PER_CELL, heuristic_source, model_source
    from ..hands import shadow_hand
    from ..postures import PosturePrior
    from ..trials import PAPER
    from .engine import STEPPING, RawEngine
    from .spread import Spread
    from .trials import collection, collection_grasps, collection_round, evaluation, evaluation_grasps, interleave

    hand, prior = shadow_hand(), PosturePrior.pretrained()
    cells = CELLS if cells is None else cells
    per_cell = dict.fromkeys(TRIAL_PARTS, spec.evaluation_per_cell) | {"collection": spec.collection_per_cell}
    heuristic = heuristic_source(hand, prior)
    sources = {"evaluation_heuristic": heuristic}
    if "evaluation" in parts:
        sources["evaluation"] = model_source(GraspSampler.pretrained())

    def engine(grasps: Grasps) -> Callable[[], float]:
        own = RawEngine(hand, grasps)
        return lambda: own.measure(threads)

    workloads = {}
    if "collection" in parts:
        drawn = collection_grasps(hand, prior, spec.raw_per_cell, spec.seed)
        workloads["collection"] = engine(drawn), collection(hand, prior, per_cell["collection"], spec.seed, threads)
    for name, source in sources.items():
        if name in parts:
            drawn = evaluation_grasps(source, spec.raw_per_cell, spec.seed, cells)
            workloads[name] = engine(drawn), evaluation(name, source, per_cell[name], spec.seed, threads, cells)
    found: dict[str, Any] = {}
    if "raw" in parts:
        measure, values = engine(evaluation_grasps(heuristic, spec.raw_per_cell, spec.seed, cells)), []
        for _ in range(spec.repetitions):
            watch.begin("raw engine")
            values.append(measure())
        found["raw"] = {"steps_per_s": Spread.of(values).to_json(), "values": values, "stepping": STEPPING}
    measured = interleave(workloads, spec.repetitions, watch.begin)
    for name in workloads:
        rounds = collection_round(per_cell[name]) if name == "collection" else ROUND_PER_CELL
        found[name] = measured.to_json(name) | {
            "round_per_cell": min(rounds, per_cell[name]),
            "raw_trials": spec.raw_per_cell * len(CELLS if name == "collection" else cells),
            "steps_per_trial": PAPER.total_steps,
        }
    if "collection" in workloads:
        found["collection"]["peak_rss_mb"] = measured.peak_rss_mb["collection"]
    return found


def _training(spec: BenchSpec, threads: int, data: Path | None, watch: _Watch) -> dict[str, Any]:
    from ..hands import shadow_hand
    from .training import training, training_rows

    tell = watch.begin("training")
    tell("rows")
    dataset, source = training_rows(data, spec.training_rows, spec.seed)
    found = training(
        shadow_hand(),
        dataset,
        epochs_measured=spec.training_epochs,
        full=spec.train_full,
        workers=threads,
        tell=tell,
    )
    return {"rows_from": source} | found
