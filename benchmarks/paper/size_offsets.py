r"""Measure how grasp size and object size differ from the side that is held, for what to ask of a model.

Example, with the cascade that is evaluated::

    python -m benchmarks.paper.size_offsets --data data --model runs/models/model3_seed0 \
        --out docs/results/size_offsets.json
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import command, publish
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.cascade.sizes import PAPER_GRASP_OFFSET_M, PAPER_OBJECT_OFFSET_M
from graspcascade.studies.dataset import load_dataset, shards_digest


@dataclass(frozen=True)
class Arguments:
    """Measure sizes."""

    data: Path
    """Folder of the dataset."""
    model: Path
    """Folder of the cascade whose offsets are used."""
    out: Path
    """JSON file to write."""


def quantiles(offset_m: NDArray[np.float64]) -> dict[str, float]:
    """Compute the median and the range of the middle nine tenths, millimetres."""
    low, middle, high = (round(1000.0 * float(value), 1) for value in np.quantile(offset_m, (0.05, 0.5, 0.95)))
    return {"median mm": middle, "5 % mm": low, "95 % mm": high}


def main(arguments: Arguments) -> None:
    """Read the type-faithful successes and write their offsets."""
    data, sampler = load_dataset(arguments.data), GraspSampler.load(arguments.model)
    good = data.outcomes.faithful(data.grasps)
    grasps, outcomes = data.grasps[good], data.outcomes[good]
    grasp = grasps.grasp_size_m - grasps.side_m
    obj = outcomes.object_size_m - grasps.side_m

    def row(name: str, rows: NDArray[np.bool_], used: list[float]) -> dict[str, Any]:
        return {
            "type": name,
            "grasps": int(rows.sum()),
            "grasp size minus side": quantiles(grasp[rows]),
            "object size minus side": quantiles(obj[rows]),
            "grasp offset used": {"from mm": round(1000 * min(used), 1), "to mm": round(1000 * max(used), 1)},
        }

    def used(kind: str) -> list[float]:
        return [
            value
            for key, value in sampler.sizes.best_offset_m.items()
            if key.startswith(f"{kind}/") and key.count("/") == 2
        ]

    result = {
        "title": "Sizes to ask for",
        "description": "A user names a side, the networks take a grasp size and an object size. The paper adds "
        "constants to the side. Here successes differ from the side by what the table says. Used are the offsets "
        "where trials held most often and type-faithfully, one for each type, object and side (the table gives their "
        "range), and the median of the object sizes there. The experiments compare this with the paper's constants.",
        "weights": sampler.fingerprint(),
        "shards": shards_digest(data.metadata),
        "paper": {
            "grasp size minus side mm": 1000.0 * PAPER_GRASP_OFFSET_M,
            "object size minus side mm": 1000.0 * PAPER_OBJECT_OFFSET_M,
        },
        "measured": [
            row("all", np.ones(len(grasp), dtype=bool), [value for kind in GRASP_TYPES for value in used(kind)]),
            *(row(kind, grasps.grasp_type == kind, used(kind)) for kind in GRASP_TYPES),
        ],
    }
    publish(result, arguments.out)


if __name__ == "__main__":
    sys.exit(command("benchmarks.paper.size_offsets", Arguments, main))
