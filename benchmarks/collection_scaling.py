"""Show how time and memory grow with a collection, from what it noted of itself round by round.

Example, with a collection made in one go::

    python benchmarks/collection_scaling.py --data data --out docs/results/performance/collection_scaling.json
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

import tyro

from graspcascade.bench.environment import environment
from graspcascade.dataset.shards import read_metadata
from graspcascade.files import write_json
from graspcascade.machine import processors


@dataclass(frozen=True)
class Arguments:
    """Sum up a collection."""

    data: Path
    """Folder of the dataset."""
    trials: tuple[int, ...] = (10_000, 50_000, 100_000)
    """Counts to show, each at the end of the round that reached it; the whole collection comes last."""
    out: Path | None = None
    """JSON file to write."""


def rows(metadata: dict[str, Any], asked: tuple[int, ...]) -> list[dict[str, Any]]:
    """Give trials, held trials, seconds and peak memory when each count was reached, and at the end."""
    shards = metadata["shards"]
    effort = [metadata["effort"][shard["file"]] for shard in shards]
    trials = list(accumulate(shard["rows"] for shard in shards))
    held = list(accumulate(sum(shard["held"]) for shard in shards))
    seconds = list(accumulate(spent["seconds"] for spent in effort))
    ends = [next((i for i, done in enumerate(trials) if done >= count), None) for count in asked]
    found = sorted({end for end in ends if end is not None} | {len(shards) - 1})
    return [
        {
            "trials": trials[i],
            "held": held[i],
            "seconds": seconds[i],
            "trials_per_s": trials[i] / seconds[i],
            "peak_rss_mb": max(spent["peak_rss_mb"] for spent in effort[: i + 1]),
        }
        for i in found
    ]


def main(arguments: Arguments) -> None:
    """Print the rows."""
    metadata = read_metadata(arguments.data)
    result = {
        "title": "Time and memory of a collection",
        "description": "One `graspcascade collect` from nothing, as it stood after so many trials.",
        "environment": environment(processors()),
        "seed": metadata["seed"],
        "round_per_cell": metadata["round_per_cell"],
        "runs": rows(metadata, arguments.trials),
    }
    print(json.dumps(result, indent=1))
    if arguments.out is not None:
        write_json(arguments.out, result)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
