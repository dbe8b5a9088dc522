"""Write the card of a collected dataset: seed, command, counts, success rates per cell, checksums.

Example::

    python benchmarks/data_card.py --data data --out docs/results/collection.json
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import tyro

from graspcascade.dataset.shards import read_metadata


@dataclass(frozen=True)
class Arguments:
    """Describe a dataset."""

    data: Path
    """Folder of the dataset."""
    out: Path
    """JSON file to write."""


def main(arguments: Arguments) -> None:
    """Read the metadata and write the card."""
    about = read_metadata(arguments.data)
    counts = about["counts"]
    # What was asked for may be more than is there: the card says how to get just these rows.
    per_cell = max(cell["trials"] for cell in counts["cells"])
    card = {
        "title": "The dataset the shipped cascade was trained on",
        "description": "Screened heuristic candidates under the paper protocol: candidates whose opposing places stay "
        "farther apart than the side is wide are skipped and counted, so these rates are not the heuristic's own.",
        "command": f"graspcascade collect --out data --trials-per-cell {per_cell} --seed {about['seed']}",
        "protocol": about["protocol"]["name"],
        "seed": about["seed"],
        "prior": about["prior"],
        "trials": counts["trials"],
        "held": counts["held"],
        "faithful": counts["faithful"],
        "screened_out": counts["screened_out"],
        "cells": counts["cells"],
        "shards": [{key: shard[key] for key in ("file", "rows", "sha256")} for shard in about["shards"]],
        "versions": about["versions"],
    }
    arguments.out.write_text(json.dumps(card, indent=1) + "\n")


if __name__ == "__main__":
    main(tyro.cli(Arguments))
