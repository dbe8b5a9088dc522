"""Compare verdicts of the same grasps, executed in full, as in a collection, with all digits, and in finer steps.

Example::

    python -m benchmarks.paper.verdict_agreement --out docs/results/verdict_agreement.json
    python -m benchmarks.paper.verdict_agreement --protocol hold --out docs/results/verdict_agreement_hold.json
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import collection_grasps, command, evaluation_grasps, publish, shipped_heuristic
from graspcascade.core.grasps import Grasps
from graspcascade.core.intervals import share
from graspcascade.core.machine import versions
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.protocols import PAPER, as_protocol
from graspcascade.engines import as_engine, run_trials
from graspcascade.proposals.cascade.sampler import GraspSampler


@dataclass(frozen=True)
class Arguments:
    """Execute grasps several times."""

    protocol: str = PAPER.name
    """Protocol of the trials."""
    per_cell: int = 200
    """Grasps for each object and type, of the heuristic (as collected) and of the shipped cascade."""
    fine_per_cell: int = 20
    """How many of these are executed in steps of 1 ms and with all digits."""
    seed: int = 11
    """Seed of the grasps."""
    out: Path | None = None
    """JSON file to write."""


def compare(name: str, way: str, grasps: Grasps, reference: Outcomes, other: Outcomes) -> dict[str, Any]:
    """Compare outcomes with those of the full protocol, trial by trial."""
    held, faithful = reference.held, reference.faithful(grasps)
    return {
        "grasps": name,
        "executed": way,
        "n": len(grasps),
        "held_full": share(held).to_json(),
        "held": share(other.held).to_json(),
        "agreement": share(held == other.held).to_json(),
        "false_successes": share(other.held & ~held).to_json(),
        "false_failures": share(held & ~other.held).to_json(),
        "agreement_faithful": share(faithful == other.faithful(grasps)).to_json(),
    }


def main(arguments: Arguments) -> None:
    """Run the comparisons and print them."""
    heuristic, shipped = shipped_heuristic(), GraspSampler.pretrained()
    n, seed, protocol = arguments.per_cell, arguments.seed, as_protocol(arguments.protocol)
    fine = protocol.with_physics(f"{protocol.name}, 1 ms", time_step_s=0.001)
    sources: dict[str, Callable[[], Grasps]] = {
        "heuristic, screened": lambda: collection_grasps(heuristic, n, seed),
        shipped.name: lambda: evaluation_grasps(shipped, n, seed),
    }
    rows = []
    for name, draw in sources.items():
        grasps = draw()
        full = run_trials(grasps, protocol)
        abridged = run_trials(grasps, protocol, engine=as_engine().abridging(protocol))
        rows.append(compare(name, "abridged as in a collection", grasps, full, abridged))
        print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
        some = np.flatnonzero(np.arange(len(grasps)) % n < arguments.fine_per_cell)
        part, outcomes = grasps[some], full[some]
        ways = {
            "all digits, joints and pairs": partial(run_trials, part, protocol, reduced=False),
            "steps of 1 ms": partial(run_trials, part, fine),
        }
        for way, execute in ways.items():
            rows.append(compare(name, way, part, outcomes, execute()))
            print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    result = {
        "title": "Agreement of verdicts" if protocol == PAPER else f"Agreement of verdicts under {protocol.name}",
        "description": f"The same grasps under protocol {protocol.name}: in full as an evaluation executes them, and "
        "in another way. Agreement is the share of trials with the same verdict on held; false successes held only in "
        "the other way.",
        "protocol": protocol.name,
        "seed": seed,
        "prior": heuristic.prior.fingerprint(),
        "weights": shipped.fingerprint(),
        "mujoco": versions()["mujoco"],
        "comparisons": rows,
    }
    publish(result, arguments.out)


if __name__ == "__main__":
    sys.exit(command("benchmarks.paper.verdict_agreement", Arguments, main))
