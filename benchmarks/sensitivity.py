"""Measure how success depends on what the protocol fixes, the heuristic's and the shipped cascade's.

Nothing here tunes the protocol.

Example::

    python benchmarks/sensitivity.py --out docs/results --per-cell 20
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from graspcascade.cascade import GraspSampler
from graspcascade.evaluation import HEURISTIC, Source, evaluate, heuristic_metadata, heuristic_source
from graspcascade.grasps import Grasps
from graspcascade.hands import SHADOW_HAND, HandDescription, load_hand
from graspcascade.postures import PosturePrior
from graspcascade.trials import PAPER, Protocol

Names = NDArray[np.str_]


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


def conditions() -> dict[str, tuple[Protocol, HandDescription]]:
    """List protocol and hand of every condition by name."""
    flat_thumb = replace(
        SHADOW_HAND, name="shadow_hand_right, thumb flat beside the palm before closing", pregrasp_rad={}
    )
    changed = {
        # What the others are compared with: the same grasps.
        "same_grasps": PAPER,
        "friction_0.6": replace(PAPER, friction=0.6),
        "friction_1.0": replace(PAPER, friction=1.0),
        "double_density": replace(PAPER, density_factor=2.0),
        "table_gains": replace(PAPER, gain_factor=1.0),
        "time_step_1ms": replace(PAPER, time_step_s=0.001),
    }
    found = {name: (replace(p, name=f"paper, {name.replace('_', ' ')}"), SHADOW_HAND) for name, p in changed.items()}
    return found | {"flat_thumb": (replace(PAPER, name="paper, flat thumb"), flat_thumb)}


def sources(
    hand: HandDescription, prior: PosturePrior, shipped: GraspSampler
) -> dict[str, tuple[Source, dict[str, Any]]]:
    """Give by model where grasps come from, which start as the hand does, and what is recorded of the model."""

    def sample(types: Names, labels: Names, axes: Names, rng: np.random.Generator) -> Grasps:
        grasps = shipped.sample_rows(types, labels, axes, rng)
        return replace(grasps, pregrasp=np.tile(hand.pregrasp, (len(grasps), 1)))

    return {
        HEURISTIC: (heuristic_source(load_hand(hand), prior), heuristic_metadata(prior)),
        shipped.name: (sample, shipped.describe()),
    }


def main(arguments: Arguments) -> None:
    """Run the conditions one after another."""
    prior, shipped = PosturePrior.pretrained(), GraspSampler.pretrained()
    for name, (protocol, hand) in conditions().items():
        if arguments.only and name not in arguments.only:
            continue
        for model, (source, metadata) in sources(hand, prior, shipped).items():
            found = evaluate(
                model,
                source,
                per_cell=arguments.per_cell,
                seed=arguments.seed,
                protocol=protocol,
                hand=hand,
                metadata=metadata,
            )
            found.save(arguments.out / f"sensitivity_{name}_{model}.json")
            print(
                f"{model}, {name}: held {found.held.rate:.3f} [{found.held.low:.3f}, {found.held.high:.3f}] n={found.n}"
            )


if __name__ == "__main__":
    main(tyro.cli(Arguments))
