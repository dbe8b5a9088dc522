"""How fast everything is on this machine, against stated yardsticks, in one run.

Examples::

    python -m benchmarks.speed.bench
    python -m benchmarks.speed.bench --only collection --json
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.common import (
    Spread,
    collection_grasps,
    command,
    environment,
    evaluation_grasps,
    shipped_heuristic,
)
from graspcascade.cli.console import bar, need, plain, print_json, print_table
from graspcascade.core.errors import InputError, check_name
from graspcascade.core.files import write_json

if TYPE_CHECKING:
    from graspcascade.core.grasps import Grasps
    from graspcascade.studies.rounds import Pair

MODULE = "benchmarks.speed.bench"
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
    protocol: str = "paper"
    """Protocol of all trials."""
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
            if name not in ("train_full", "protocol") and value < least.get(name, 1):
                raise InputError(f"{name.replace('_', '-')} must be at least {least.get(name, 1)}, got {value}")


def check_parts(only: Collection[str]) -> tuple[str, ...]:
    """Check which parts are asked for, all where none is named.

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
    model: Path | None = None,
    report: Report = lambda done, total, what: None,
    cells: Sequence[Pair] = (),
) -> dict[str, Any]:
    """Measure and return every number as JSON data. Nothing is kept on disk.

    Args:
        spec: how much.
        only: some of `PARTS`, all without it.
        data: dataset whose successes are trained on; without it, samples of the shipped cascade are.
        model: folder of a cascade and a scorer to sample from as well.
        report: hears how far it is.
        cells: pairs of object and grasp type of the raw engine and of evaluations, all without it; collections always
            go through all.

    Raises:
        InputError: an unknown part, or a dataset with nothing to learn from.
        FileFormatError: the dataset cannot be read.
    """
    spec, parts = spec or BenchSpec(), check_parts(only)
    # Whoever asks for help or names a wrong part should not wait for physics to load.
    from graspcascade.core.machine import processors

    threads = spec.threads or processors()
    watch = _Watch(parts, spec.repetitions, report)
    measured: dict[str, Any] = {
        "environment": environment(threads),
        "settings": asdict(spec) | {"threads": threads},
        "repetitions": spec.repetitions,
    }
    if {"raw", *TRIAL_PARTS} & set(parts):
        measured |= _trials(spec, parts, threads, cells, watch)
    if "sampling" in parts:
        from .sampling import sampling

        watch.begin("sampling")
        measured |= sampling(spec.sample_calls, spec.seed, model)
    if "cold_start" in parts:
        from .sampling import cold_start

        watch.begin("cold_start")
        measured["cold_start"] = cold_start(spec.cold_starts)
    if "training" in parts:
        measured["training"] = _training(spec, threads, data, watch)
    watch.end()
    return measured


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
    spec: BenchSpec, parts: Sequence[str], threads: int, cells: Sequence[Pair], watch: _Watch
) -> dict[str, Any]:
    from graspcascade.core.protocols import as_protocol
    from graspcascade.proposals import Proposal
    from graspcascade.proposals.cascade.sampler import GraspSampler
    from graspcascade.studies.evaluate import ROUND_PER_CELL
    from graspcascade.studies.rounds import CELLS

    from .trials import STEPPING, RawEngine, collection, collection_round, evaluation, interleave

    heuristic, cells, protocol = shipped_heuristic(), cells or CELLS, as_protocol(spec.protocol)
    per_cell = dict.fromkeys(TRIAL_PARTS, spec.evaluation_per_cell) | {"collection": spec.collection_per_cell}
    proposals: dict[str, Proposal] = {"evaluation_heuristic": heuristic}
    if "evaluation" in parts:
        proposals["evaluation"] = GraspSampler.pretrained()

    def engine(grasps: Grasps) -> Callable[[], float]:
        own = RawEngine(heuristic.hand, grasps, protocol)
        return lambda: own.measure(threads)

    workloads = {}
    if "collection" in parts:
        drawn = collection_grasps(heuristic, spec.raw_per_cell, spec.seed)
        collected = collection(heuristic, per_cell["collection"], spec.seed, threads, protocol)
        workloads["collection"] = engine(drawn), collected
    for name, proposal in proposals.items():
        if name in parts:
            drawn = evaluation_grasps(proposal, spec.raw_per_cell, spec.seed, cells)
            workloads[name] = engine(drawn), evaluation(proposal, per_cell[name], spec.seed, threads, cells, protocol)
    measured: dict[str, Any] = {}
    if "raw" in parts:
        measure, values = engine(evaluation_grasps(heuristic, spec.raw_per_cell, spec.seed, cells)), []
        for _ in range(spec.repetitions):
            watch.begin("raw engine")
            values.append(measure())
        measured["raw"] = {"steps_per_s": Spread.of(values).to_json(), "values": values, "stepping": STEPPING}
    repeated = interleave(workloads, spec.repetitions, watch.begin)
    for name in workloads:
        rounds = collection_round(per_cell[name]) if name == "collection" else ROUND_PER_CELL
        measured[name] = repeated.to_json(name) | {
            "round_per_cell": min(rounds, per_cell[name]),
            "raw_trials": spec.raw_per_cell * len(CELLS if name == "collection" else cells),
            "steps_per_trial": protocol.schedule.total_steps,
        }
    if "collection" in workloads:
        measured["collection"]["peak_rss_mb"] = repeated.peak_rss_mb["collection"]
    return measured


def _training(spec: BenchSpec, threads: int, data: Path | None, watch: _Watch) -> dict[str, Any]:
    from graspcascade.hands import load_hand

    from .training import training, training_rows

    tell = watch.begin("training")
    tell("rows")
    dataset, source = training_rows(data, spec.training_rows, spec.seed)
    measured = training(
        load_hand("shadow"),
        dataset,
        epochs_measured=spec.training_epochs,
        full=spec.train_full,
        workers=threads,
        tell=tell,
    )
    return {"rows_from": source} | measured


@dataclass(frozen=True)
class Bench:
    """Measure trials, sampling and training on this machine, each against a yardstick measured beside it.

    The gain of collection and evaluation is their trials per second over those of the bare engine that steps every
    trial of the full hand to its end.
    """

    only: tuple[str, ...] = ()
    """What to measure: raw, collection, evaluation, evaluation_heuristic, sampling, cold_start, training; all without
    it."""
    spec: BenchSpec = field(default_factory=BenchSpec)
    """How much."""
    data: Path | None = None
    """Folder of a dataset whose successes to train on; samples of the shipped cascade without it."""
    model: Path | None = None
    """Folder of a cascade and a scorer that are sampled from, as drawn and ranked, beside the paper's cascade."""
    out: Path | None = None
    """Also write the numbers to this .json file."""
    json: bool = False
    """Print JSON."""


def main(bench: Bench) -> None:
    """Measure, then print and write."""
    parts = check_parts(bench.only)
    if "collection" in parts or "training" in parts:
        need("pyarrow")
    if "training" in parts:
        need("torch")
    if bench.out is not None and (bench.out.suffix.lower() != ".json" or bench.out.is_dir()):
        raise InputError(f"the numbers are written to a .json file, got {bench.out.name!r}")
    with bar("bench") as progress:
        measured = run_bench(
            bench.spec,
            bench.only,
            data=bench.data,
            model=bench.model,
            report=lambda done, total, what: progress.show(done, total, note=what),
        )
    measured = plain(measured)
    if bench.out is not None:
        write_json(bench.out, measured, allow_nan=False)
    if bench.json:
        print_json(measured)
    else:
        _print(measured)


def _print(measured: dict[str, Any]) -> None:
    about = measured["environment"]
    print(f"{about['cpu']}, {about['logical_cores']} logical cores, {about['threads']} threads")
    shown = [part for part in dict.fromkeys((*PARTS, *_ROWS)) if part in measured]
    rows = [row for part in shown for row in _ROWS.get(part, _trial_rows)(part, measured[part])]
    print_table(["measured", "unit", "median", "min", "max"], rows, left=(0, 1))
    if measured.get("training", {}).get("extrapolated"):
        epochs, measured = measured["training"]["epochs"], measured["training"]["epochs_measured"]
        print(f"training is extrapolated from {measured} to {epochs} epochs")


def _trial_rows(part: str, measured: dict[str, Any]) -> list[list[str]]:
    name = part.replace("_", " ")
    rows = [
        [name, "trials/s", *_spread(measured["trials_per_s"], "1f")],
        [name, "held/s", *_spread(measured["held_per_s"], "1f")],
        [name, "gain", *_spread(measured["gain"], "2f")],
    ]
    if "peak_rss_mb" in measured:
        rows.append([name, "peak MB", f"{measured['peak_rss_mb']:.0f}", "", ""])
    return rows


def _raw_rows(_: str, measured: dict[str, Any]) -> list[list[str]]:
    return [["raw engine", "steps/s", *_spread(measured["steps_per_s"], "0f")]]


def _sampling_rows(part: str, measured: dict[str, Any]) -> list[list[str]]:
    name = f"{part.replace('_', ' ')}, {measured['grasps']} grasps"
    return [
        [name, "ms", *_spread(measured["ms"], "2f")],
        ["its matrix products", "ms", *_spread(measured["yardstick_ms"], "2f")],
        [name, "ratio", f"{measured['ratio']:.2f}", "", ""],
    ]


def _cold_start_rows(_: str, measured: dict[str, Any]) -> list[list[str]]:
    return [
        ["cold start of sample", "s", *_spread(measured["s"], "3f")],
        [measured["yardstick"], "s", *_spread(measured["yardstick_s"], "3f")],
        ["cold start of sample", "ratio", f"{measured['ratio']:.2f}", "", ""],
    ]


def _training_rows(_: str, measured: dict[str, Any]) -> list[list[str]]:
    name = f"training on {measured['rows']} grasps"
    return [
        [name, "s", f"{measured['s']:.1f}", "", ""],
        ["its matrix products", "s", f"{measured['yardstick_s']:.1f}", "", ""],
        [name, "ratio", f"{measured['ratio']:.2f}", "", ""],
    ]


_ROWS = {
    "raw": _raw_rows,
    **dict.fromkeys(("sampling", "sampling_raw", "sampling_ranked"), _sampling_rows),
    "cold_start": _cold_start_rows,
    "training": _training_rows,
}


def _spread(measured: dict[str, float], form: str) -> list[str]:
    return [format(measured[name], f".{form}") for name in ("median", "min", "max")]


def run(argv: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit status."""
    return command(MODULE, Bench, main, argv)


if __name__ == "__main__":
    sys.exit(run())
