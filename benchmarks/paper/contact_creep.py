"""Measure how many grasps stay held over longer gravity, with contacts that creep and with contacts that hardly do.

Example::

    python -m benchmarks.paper.contact_creep --out docs/results/contact_creep.json
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.common import command, evaluation_grasps, publish
from graspcascade.core.intervals import share
from graspcascade.core.machine import versions
from graspcascade.core.protocols import PAPER, Carry
from graspcascade.engines import run_trials
from graspcascade.proposals.cascade.sampler import GraspSampler

CONTACTS: Mapping[str, Mapping[str, float]] = {
    "as in the protocol": {},
    "half the time step": {"time_step_s": PAPER.physics.time_step_s / 2},
    "impratio 100": {"impratio": 100.0},
}
"""What differs from the physics of the protocol."""


@dataclass(frozen=True)
class Arguments:
    """Execute grasps of the shipped cascade under gravity of several durations."""

    per_cell: int = 5
    """Grasps for each object and type."""
    gravity_s: tuple[float, ...] = (5.0, 20.0)
    """Seconds of gravity after the shake."""
    seed: int = 17
    """Seed of the grasps."""
    out: Path | None = None
    """JSON file to write."""


def main(arguments: Arguments) -> None:
    """Execute the same grasps under every condition."""
    shipped = GraspSampler.pretrained()
    grasps = evaluation_grasps(shipped, arguments.per_cell, arguments.seed)
    rows = []
    for name, numbers in CONTACTS.items():
        for seconds in arguments.gravity_s:
            changed = PAPER.with_physics(f"paper, {name}, {seconds:g} s", **numbers)
            protocol = replace(changed, phases=(*PAPER.phases[:-1], Carry(seconds)))
            held = run_trials(grasps, protocol).held
            rows.append(
                {
                    "contacts": name,
                    "time_step_s": protocol.physics.time_step_s,
                    "impratio": protocol.physics.impratio,
                    "gravity_s": seconds,
                    "n": len(grasps),
                    "held": int(held.sum()),
                    "held rate": share(held).to_json(),
                }
            )
            print(rows[-1], file=sys.stderr, flush=True)
    publish(
        {
            "title": "Contacts that creep",
            "description": "The same grasps of the shipped cascade under the paper protocol, with gravity for 5 s as "
            "there and for longer. `impratio` is the ratio of friction to normal stiffness in MuJoCo's soft contacts: "
            "at 10 a held object slides slowly under constant weight, at 100 hardly at all. A shorter time step "
            "leaves the sliding as it is, so that it is the contact model's and not an error of integration.",
            "seed": arguments.seed,
            "weights": shipped.fingerprint(),
            "mujoco": versions()["mujoco"],
            "conditions": rows,
        },
        arguments.out,
    )


if __name__ == "__main__":
    sys.exit(command("benchmarks.paper.contact_creep", Arguments, main))
