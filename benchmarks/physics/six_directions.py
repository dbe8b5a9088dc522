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


FREE_JOINTS = SIX_DIRECTIONS.with_physics("six-directions, joints without dry friction", joint_friction_nm=None)
ALL = "all"
"""Stands for every type together."""
_FAILURES = ("overlap", "missed", "pushed_out", "turned", "unstable")


def counts(grasps: str, kind: str, tally: Tally) -> dict[str, Any]:
    """Count the trials of a grasp type, those that held, and the others by what ended them."""
    held = {"n": tally.n, "held": tally.held, "held rate": tally.held_rate.to_json()}
    return {"grasps": grasps, "type": kind, **held, **{name: tally.verdicts[name] for name in _FAILURES}}


def main(arguments: Arguments) -> None:
    """Evaluate every model."""
    engine, rows = as_engine(n_threads=arguments.threads), []
    models = [(name, SIX_DIRECTIONS) for name in ("heuristic", "default", *arguments.models)]
    for name, protocol in [*models, ("default", FREE_JOINTS)]:
        proposal = load_proposal(name, None)
        label = {"heuristic": "heuristic", "default": "shipped cascade"}.get(name, Path(name).name)
        label += "" if protocol is SIX_DIRECTIONS else ", joints without dry friction"
        evaluation = evaluate(
            proposal,
            per_cell=arguments.per_cell,
            seed=arguments.seed,
            protocol=protocol,
            engine=engine,
            out=arguments.runs / label.replace(",", "").replace(" ", "_"),
            name=label,
        )
        rows.append(counts(label, ALL, evaluation.total))
        print(rows[-1], file=sys.stderr, flush=True)
        rows += [counts(label, kind, tally) for kind, tally in evaluation.by_type.items()]
    publish(
        {
            "title": "Pushed in six directions",
            "description": "Grasps tried under protocol six-directions, the rule of DexGraspBench's force-closure "
            "setting: how many held in all six directions, and what ended the others: deep overlap, missed while "
            "closing, centre (pushed_out) or orientation (turned) beyond its limit. The shipped cascade's grasps also "
            "in joints without the dry friction that the benchmark's hand has.",
            "protocol": SIX_DIRECTIONS.name,
            "seed": arguments.seed,
            "mujoco": versions()["mujoco"],
            "trials": rows,
        },
        arguments.out,
    )


if __name__ == "__main__":
    sys.exit(command("benchmarks.physics.six_directions", Arguments, main))
