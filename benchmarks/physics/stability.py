"""Measure whether verdicts depend on how long an object's weight acts, or on the time step.

Example::

    python -m benchmarks.physics.stability --out docs/results/stability.json
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.common import command, evaluation_grasps, publish, shipped_heuristic
from graspcascade.core.intervals import newcombe, share
from graspcascade.core.machine import versions
from graspcascade.core.protocols import HOLD, PAPER, Carry, Protocol
from graspcascade.engines import run_trials
from graspcascade.proposals.cascade.sampler import GraspSampler


@dataclass(frozen=True)
class Arguments:
    """Execute the same grasps under longer weight and under shorter time steps."""

    per_cell: int = 20
    """Grasps for each object and type, of the heuristic (unscreened) and of the shipped cascade."""
    seed: int = 17
    """Seed of the grasps."""
    out: Path | None = None
    """JSON file to write."""


def variants(base: Protocol) -> Iterator[tuple[float, Protocol]]:
    """List a protocol as it is, with weight for 20 s, and with half the time step; with the seconds of weight."""
    carry = base.phases[-1]
    assert isinstance(carry, Carry)
    yield carry.duration_s, base
    longer = replace(carry, duration_s=4 * carry.duration_s)
    yield longer.duration_s, replace(base, name=f"{base.name}, weight for 20 s", phases=(*base.phases[:-1], longer))
    half = base.physics.time_step_s / 2
    yield carry.duration_s, base.with_physics(f"{base.name}, half the time step", time_step_s=half)


def main(arguments: Arguments) -> None:
    """Execute the same grasps under every variant of both protocols."""
    rows = []
    for proposal in (shipped_heuristic(), GraspSampler.pretrained()):
        grasps = evaluation_grasps(proposal, arguments.per_cell, arguments.seed)
        for base in (PAPER, HOLD):
            usual = np.zeros(len(grasps), dtype=bool)
            for seconds, protocol in variants(base):
                outcomes = run_trials(grasps, protocol)
                held = outcomes.held
                usual = held if protocol is base else usual
                rows.append(
                    {
                        "grasps": proposal.name,
                        "protocol": base.name,
                        "gravity_s": seconds,
                        "time_step_s": protocol.physics.time_step_s,
                        "n": len(grasps),
                        "held": int(held.sum()),
                        "held rate": share(held).to_json(),
                        "faithful rate": share(outcomes.faithful(grasps)).to_json(),
                        "steady rate": share(outcomes.steady).to_json(),
                        "held, points over the protocol": 100
                        * newcombe(int(held.sum()), len(grasps), int(usual.sum()), len(grasps)).difference,
                        "same verdict": share(held == usual).to_json(),
                    }
                )
                print(rows[-1], file=sys.stderr, flush=True)
    publish(
        {
            "title": "Whether verdicts depend on the clock",
            "description": "The same grasps under the protocols paper and hold, with weight for 5 s as there and for "
            "20 s, and with half the time step. Every step is computed. *Steady* is held and turned in the hand by "
            "less than 15 degrees; *same verdict* compares each trial with that of the protocol as it is.",
            "seed": arguments.seed,
            "mujoco": versions()["mujoco"],
            "conditions": rows,
        },
        arguments.out,
    )


if __name__ == "__main__":
    sys.exit(command("benchmarks.physics.stability", Arguments, main))
