"""Measure how many grasps of each model hold under each protocol, side by side.

Rounds that are done are kept in a folder, so that the same command goes on where it was cut off. Example::

    python -m benchmarks.physics.protocols --runs runs/protocols --models runs/model1 runs/model2 --out protocols.json
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.common import command, publish
from graspcascade.cli.console import load_proposal
from graspcascade.core.machine import versions
from graspcascade.core.protocols import PROTOCOLS
from graspcascade.engines import as_engine
from graspcascade.studies.evaluate import evaluate


@dataclass(frozen=True)
class Arguments:
    """Try the same number of grasps of each model for every object and type under every protocol."""

    runs: Path
    """Folder for the trials, one of its own for each model and protocol."""
    models: tuple[str, ...] = ("heuristic", "paper")
    """Names of shipped models, or folders."""
    names: tuple[str, ...] = ()
    """What the models are called in the results; by default as given."""
    protocols: tuple[str, ...] = ("paper", "hold", "six-directions")
    """Protocols, by name."""
    per_cell: int = 50
    """Grasps for each object and type."""
    seed: int = 19
    """Seed of the grasps."""
    threads: int = 0
    """Simulation threads, 0 for all processors."""
    out: Path | None = None
    """JSON file to write."""


def main(arguments: Arguments) -> None:
    """Evaluate every model under every protocol."""
    engine, rows, models = as_engine(n_threads=arguments.threads), [], list[dict[str, Any]]()
    for model, label in zip(arguments.models, arguments.names or arguments.models, strict=True):
        proposal = load_proposal(model, None)
        models.append({"model": label} | proposal.describe())
        for protocol in arguments.protocols:
            evaluation = evaluate(
                proposal,
                per_cell=arguments.per_cell,
                seed=arguments.seed,
                protocol=protocol,
                engine=engine,
                out=arguments.runs / f"{label}-{protocol}",
                name=label,
            )
            total = evaluation.total
            rates = {name: getattr(total, f"{name}_rate").to_json() for name in ("held", "faithful", "steady")}
            rows.append({"model": label, "protocol": protocol, "n": total.n} | rates)
            print(rows[-1], file=sys.stderr, flush=True)
    publish(
        {
            "title": "Models under three protocols",
            "description": "The same number of grasps of every model for each object and type: how many held, how many "
            "of these also touched as their type asks, and in how many the object turned by less than 15 degrees "
            "between closing and the end. Grasps of one model are the same under every protocol.",
            "protocols": {name: PROTOCOLS[name].to_json() for name in arguments.protocols},
            "rates": rows,
            "models": models,
            "per_cell": arguments.per_cell,
            "seed": arguments.seed,
            "versions": versions() | engine.versions,
        },
        arguments.out,
    )


if __name__ == "__main__":
    sys.exit(command("benchmarks.physics.protocols", Arguments, main))
