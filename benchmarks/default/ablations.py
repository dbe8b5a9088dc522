"""Measure what each ingredient of the default model brings, by leaving each out in turn.

Every variant is built from nothing in a folder of its own, with a share of the default trials, and goes on where it was
cut off. Example::

    python -m benchmarks.default.ablations --runs runs/ablations --out docs/results/ablations.json
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from benchmarks.common import command, publish
from graspcascade.core.machine import versions
from graspcascade.core.protocols import HOLD, VARIED
from graspcascade.engines import as_engine
from graspcascade.hands import load_hand
from graspcascade.proposals import Proposal
from graspcascade.proposals.heuristic import CENTRED, SPREAD, Heuristic, Screened
from graspcascade.proposals.ranked import Ranked
from graspcascade.proposals.scorer import Scorer, Sight
from graspcascade.studies.build import Build, BuildSpec
from graspcascade.studies.evaluate import evaluate
from graspcascade.studies.seeds import FEIX_SEEDS


@dataclass(frozen=True)
class Arguments:
    """Build every variant and evaluate it on the same objects."""

    runs: Path
    """Folder for everything that is made."""
    trials: tuple[int, ...] = (400, 400, 400)
    """Trials for each kind of object and type in each round."""
    per_cell: int = 300
    """Trials for each kind of object and type in an evaluation."""
    only: tuple[str, ...] = ()
    """Variants to measure; all without it."""
    seed: int = 0
    """Seed of collections and evaluations."""
    threads: int = 0
    """Simulation threads, 0 for all processors."""
    out: Path | None = None
    """JSON file to write."""


def _seeing(**sight: Any) -> Callable[[BuildSpec], BuildSpec]:
    return lambda spec: replace(spec, scorer=replace(spec.scorer, sight=Sight(**sight)))


_SEEDS = replace(FEIX_SEEDS, aperture_min_m=0.010, support_reach_m=0.021, support_normal_weight=0.0, most_draws=1)
VARIANTS: Mapping[str, Callable[[BuildSpec], BuildSpec]] = {
    "all ingredients": lambda spec: spec,
    "seeds as before": lambda spec: replace(spec, seeds=_SEEDS),
    "one round": lambda spec: replace(spec, trials_per_cell=(sum(spec.trials_per_cell),)),
    "centred placements": lambda spec: replace(spec, placement=CENTRED),
    "all successes learned alike": lambda spec: replace(spec, least_chance=0.0),
    "scorer of shape parameters": _seeing(geometry="shape"),
    "scorer without gradients": _seeing(gradients=False),
    "scorer blind to conditions": _seeing(conditions=False),
}
"""What is left out; the last round's cascade without ranking, and the heuristic with ranking, need no build."""


@dataclass
class _Measure:
    """Evaluate proposals into folders, and say how far it is."""

    build: Build
    arguments: Arguments
    rows: list[dict[str, Any]] = field(default_factory=list)

    def __call__(self, name: str, proposal: Proposal, scorer: Scorer) -> None:
        for protocol in (HOLD, VARIED):
            began = time.perf_counter()
            evaluation = evaluate(
                proposal,
                protocol=protocol,
                hand=self.build.hand,
                per_cell=self.arguments.per_cell,
                cells=self.build.cells,
                seed=self.arguments.seed + 7,
                engine=self.build.engine,
                out=self.arguments.runs / "evaluations" / f"{name}-{protocol.name}".replace(" ", "_"),
                name=name,
            )
            total = evaluation.total
            rates = {event: getattr(total, f"{event}_rate").to_json() for event in ("held", "faithful")}
            judged = scorer.metadata["judged"]["faithful, uncertain"]
            self.rows.append({"variant": name, "protocol": protocol.name, "n": total.n} | rates | {"scorer": judged})
            print(self.rows[-1], f"{time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)


def main(arguments: Arguments) -> None:
    """Build and measure."""
    hand, engine = load_hand("shadow"), as_engine(n_threads=arguments.threads)
    base = BuildSpec(trials_per_cell=arguments.trials, evaluation_per_cell=1, seed=arguments.seed)
    rows: list[dict[str, Any]] = []
    for name, variant in VARIANTS.items():
        if arguments.only and name not in arguments.only:
            continue
        build = Build(hand, arguments.runs / name.replace(" ", "_"), variant(base), engine, report=_Steps(name))
        measure = _Measure(build, arguments, rows)
        cascade, scorer = build.trained()
        measure(name, Ranked(cascade, scorer), scorer)
        if name == "all ingredients":
            measure("without ranking", cascade, scorer)
            heuristic = Screened(Heuristic(hand, build.prior(), SPREAD))
            measure("the heuristic with ranking alone", Ranked(heuristic, scorer), scorer)
            measure("the heuristic alone", heuristic, scorer)
    publish(
        {
            "title": "What each ingredient brings",
            "trials_per_cell": list(arguments.trials),
            "rates": rows,
            "seed": arguments.seed,
            "versions": versions(),
        },
        arguments.out,
    )


class _Steps:
    """Say on standard error when a build begins another step."""

    def __init__(self, name: str) -> None:
        self._name, self._step = name, ""

    def __call__(self, step: str, done: int, total: int) -> None:
        if step != self._step:
            self._step = step
            print(f"{self._name}: {step}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(command("benchmarks.default.ablations", Arguments, main))
