"""Measure how many grasps hold under protocol `six-directions`, and which limit the others exceed.

Rounds that are done are kept in a folder, so that the same command goes on where it was cut off. Example::

    python -m benchmarks.physics.six_directions --runs runs/six_directions --out docs/results/six_directions.json
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.common import command, publish
from graspcascade.cli.console import load_proposal
from graspcascade.core.machine import versions
from graspcascade.core.protocols import SIX_DIRECTIONS
from graspcascade.engines import as_engine
from graspcascade.studies.evaluate import evaluate
from graspcascade.studies.record import Tally


@dataclass(frozen=True)
class Arguments:
    """Try the same number of grasps of each model for every object and type."""

    runs: Path
    """Folder for the trials, one of its own for each model."""
    models: tuple[str, ...] = ()
    """Further models: names of shipped cascades, or folders; heuristic and the shipped cascade are always measured."""
    per_cell: int = 20
    """Grasps for each object and type."""
    seed: int = 17
    """Seed of the grasps."""
    threads: int = 0
    """Simulation threads, 0 for all processors."""
    out: Path | None = None
    """JSON file to write."""


def counts(tally: Tally) -> dict[str, Any]:
    """Count the trials, those that held, and the others by what ended them."""
    failed = {name: count for name, count in tally.verdicts.items() if count and name != "held"}
    return {"n": tally.n, "held": tally.held, "held rate": tally.held_rate.to_json(), "failed": failed}


def main(arguments: Arguments) -> None:
    """Evaluate every model."""
    engine, models = as_engine(n_threads=arguments.threads), {}
    for name in ("heuristic", "default", *arguments.models):
        proposal = load_proposal(name, None)
        label = {"heuristic": "heuristic", "default": "shipped cascade"}.get(name, Path(name).name)
        evaluation = evaluate(
            proposal,
            per_cell=arguments.per_cell,
            seed=arguments.seed,
            protocol=SIX_DIRECTIONS,
            engine=engine,
            out=arguments.runs / label.replace(" ", "_"),
            name=label,
        )
        by_type = {kind: counts(tally) for kind, tally in evaluation.by_type.items()}
        models[label] = {**counts(evaluation.total), "by type": by_type}
        print(label, models[label], file=sys.stderr, flush=True)
    publish(
        {
            "title": "Pushed in six directions",
            "description": "Grasps tried under protocol six-directions, the rule of DexGraspBench's force-closure "
            "setting: how many held in all six directions, and what ended the others: deep overlap, missed while "
            "closing, centre (pushed_out) or orientation (turned) beyond its limit.",
            "protocol": SIX_DIRECTIONS.name,
            "seed": arguments.seed,
            "mujoco": versions()["mujoco"],
            "models": models,
        },
        arguments.out,
    )


if __name__ == "__main__":
    sys.exit(command("benchmarks.physics.six_directions", Arguments, main))
