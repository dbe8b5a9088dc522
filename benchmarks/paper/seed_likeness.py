"""Tabulate how human the default seed postures are, as commanded and as executed.

Example::

    python -m benchmarks.paper.seed_likeness --out docs/results/seed_likeness.json
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

from benchmarks.common import command, publish
from graspcascade.hands import load_hand
from graspcascade.studies.seeds import Likeness, SeedSpec, human_likeness, make_seeds


@dataclass(frozen=True)
class Arguments:
    """Compare seeds with recorded human grasps."""

    out: Path | None = None
    """JSON file to write."""


def outliers(one: Likeness) -> str:
    """Word the joints that are off."""
    return ", ".join(f"{name} {value:+.1f}" for name, value in one.outliers.items()) or "none"


def main(arguments: Arguments) -> None:
    """Make the seeds and print the table."""
    hand, spec = load_hand("shadow"), SeedSpec()
    seeds = make_seeds(hand, spec)
    commanded = human_likeness(seeds)
    executed = human_likeness(replace(seeds, posture=hand.executed(seeds.posture)))
    result = {
        "title": "How human the seed postures are",
        "description": "Joints of the digits that hold the object whose mean angle lies within one human standard "
        "deviation of the human mean, and those that do not (in standard deviations). Commanded angles are what a "
        "posture says; executed ones share each tendon's sum equally between its two joints.",
        "seed": spec.seed,
        "postures_per_type": spec.per_type,
        "types": [
            {
                "grasp_type": one.grasp_type,
                "human_grasps": one.n_human,
                "joints": len(one.deviation_sd),
                "within_commanded": len(one.deviation_sd) - len(one.outliers),
                "off_commanded": outliers(one),
                "within_executed": len(two.deviation_sd) - len(two.outliers),
                "off_executed": outliers(two),
            }
            for one, two in zip(commanded, executed, strict=True)
        ],
    }
    publish(result, arguments.out)


if __name__ == "__main__":
    sys.exit(command("benchmarks.paper.seed_likeness", Arguments, main))
