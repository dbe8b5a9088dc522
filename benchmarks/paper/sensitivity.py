"""Measure how success depends on what the protocol fixes, the heuristic's and the shipped cascade's.

Nothing here tunes the protocol.

Example::

    python -m benchmarks.paper.sensitivity --out docs/results --per-cell 20
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.common import command, shipped_heuristic
from graspcascade.core.protocols import PAPER, Protocol
from graspcascade.hands import Hand, load_hand
from graspcascade.proposals import Proposal
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.studies.evaluate import evaluate


@dataclass(frozen=True)
class Arguments:
    """Evaluate the heuristic and the shipped cascade under changed conditions."""

    out: Path = Path("docs/results")
    """Folder of the JSON files."""
    per_cell: int = 20
    """Trials for each object and type."""
    seed: int = 0
    """Seed of the grasps."""
    only: tuple[str, ...] = ()
    """Names of conditions to run, all without it."""


def conditions() -> dict[str, tuple[Protocol, Hand]]:
    """List protocol and hand of every condition by name."""
    hand = load_hand("shadow")
    flat_thumb = replace(hand, name=f"{hand.name}, thumb flat beside the palm before closing", pregrasp_rad={})
    changed = {
        # What the others are compared with: the same grasps.
        "same_grasps": {},
        "friction_0.6": {"friction": 0.6},
        "friction_1.0": {"friction": 1.0},
        "double_density": {"density_factor": 2.0},
        "table_gains": {"gain_factor": 1.0},
        "time_step_1ms": {"time_step_s": 0.001},
    }
    named = {
        name: (PAPER.with_physics(f"paper, {name.replace('_', ' ')}", **numbers), hand)
        for name, numbers in changed.items()
    }
    return named | {"flat_thumb": (PAPER.with_physics("paper, flat thumb"), flat_thumb)}


def proposals(hand: Hand) -> list[Proposal]:
    """List where grasps come from; all close from the hand as it opens."""
    shipped = GraspSampler.pretrained()
    opened = replace(shipped.hand, pregrasp_rad=hand.pregrasp_rad)
    return [replace(shipped_heuristic(), hand=hand), replace(shipped, hand=opened)]


def main(arguments: Arguments) -> None:
    """Run the conditions one after another."""
    for name, (protocol, hand) in conditions().items():
        if arguments.only and name not in arguments.only:
            continue
        for proposal in proposals(hand):
            result = evaluate(proposal, per_cell=arguments.per_cell, seed=arguments.seed, protocol=protocol, hand=hand)
            result.save(arguments.out / f"sensitivity_{name}_{proposal.name}.json")
            rate = result.held
            print(f"{proposal.name}, {name}: held {rate.rate:.3f} [{rate.low:.3f}, {rate.high:.3f}] n={result.n}")


if __name__ == "__main__":
    sys.exit(command("benchmarks.paper.sensitivity", Arguments, main))
