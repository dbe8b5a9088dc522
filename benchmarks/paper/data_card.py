"""Describe a collected dataset: command, counts, rates per cell, checksums; and how its time and memory grew.

Example, with a collection made in one go::

    python -m benchmarks.paper.data_card --data data --out docs/results/collection.json \
        --scaling docs/results/performance/collection_scaling.json
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, fields
from itertools import accumulate
from pathlib import Path
from typing import Any

from benchmarks.common import command, environment, shipped_heuristic
from graspcascade.core.files import write_json
from graspcascade.core.intervals import wilson
from graspcascade.core.machine import cpu_model, processors
from graspcascade.studies.collect import CollectionSpec, CollectionState
from graspcascade.studies.dataset import read_metadata, shards_digest
from graspcascade.studies.rounds import CELLS, cell_name


@dataclass(frozen=True)
class Arguments:
    """Describe a dataset."""

    data: Path
    """Folder of the dataset."""
    out: Path
    """JSON file to write."""
    scaling: Path | None = None
    """JSON file to write time and memory to, as they stood after so many trials."""
    trials: tuple[int, ...] = (10_000, 50_000, 100_000)
    """Counts of trials to show there, each at the end of the round that reached it; the whole comes last."""
    title: str = "The dataset of the paper's experiment"
    """Heading of the card."""


def words(asked: dict[str, Any], about: dict[str, Any]) -> str:
    """Word the command that collects so much."""
    usual = CollectionSpec()
    flags = [
        f"--{field.name.replace('_', '-')} {asked[field.name]}"
        for field in fields(CollectionSpec)
        if asked[field.name] != getattr(usual, field.name) or field.name == "seed"
    ]
    if about["prior"] != shipped_heuristic().prior.fingerprint():
        flags.insert(0, "--prior prior.safetensors")
    if about["creep_projection"] is None:
        flags.append("--full")
    return " ".join(["graspcascade collect --out data", *flags])


def commands(about: dict[str, Any]) -> str:
    """Word what was asked, one after another; more may have been asked of a collection later."""
    asked = [before["collection"] for before in about.get("asked_before", [])] + [about["collection"]]
    return ", then ".join(words(each, about) for each in asked)


def given_up(about: dict[str, Any]) -> list[str]:
    """Name the objects and types that lack grasps."""
    state, asked = CollectionState.of(about["shards"]), CollectionSpec(**about["collection"])
    return [cell_name(CELLS[cell]) for cell in state.short(asked)]


def cell_card(cell: dict[str, Any]) -> dict[str, Any]:
    """Add a cell's success rate to its counts."""
    return cell | {"held rate": wilson(cell["held"], cell["trials"]).to_json()}


def effort(about: dict[str, Any]) -> dict[str, Any]:
    """Sum up what the collection took, on the machine the card is written on."""
    spent = about["effort"].values()
    seconds = sum(each["seconds"] for each in spent)
    return {
        "hours": round(seconds / 3600, 2),
        "trials_per_s": round(about["counts"]["trials"] / seconds, 1),
        "held_per_s": round(about["counts"]["held"] / seconds, 1),
        "peak_rss_mb": max(each["peak_rss_mb"] for each in spent),
        "cpu": cpu_model(),
        "threads": processors(),
    }


def growth(about: dict[str, Any], asked: tuple[int, ...]) -> list[dict[str, Any]]:
    """List trials, held trials, seconds and peak memory when each count was reached, and at the end."""
    shards = about["shards"]
    effort = [about["effort"][shard["file"]] for shard in shards]
    trials = list(accumulate(shard["rows"] for shard in shards))
    held = list(accumulate(sum(shard["held"]) for shard in shards))
    seconds = list(accumulate(spent["seconds"] for spent in effort))
    ends = [next((i for i, done in enumerate(trials) if done >= count), None) for count in asked]
    shown = sorted({end for end in ends if end is not None} | {len(shards) - 1})
    return [
        {
            "trials": trials[i],
            "held": held[i],
            "seconds": seconds[i],
            "trials_per_s": trials[i] / seconds[i],
            "peak_rss_mb": max(spent["peak_rss_mb"] for spent in effort[: i + 1]),
        }
        for i in shown
    ]


def main(arguments: Arguments) -> None:
    """Read the metadata and write the card, and how the collection grew."""
    about = read_metadata(arguments.data)
    counts = about["counts"]
    full = about["creep_projection"] is None
    executed = "every step computed" if full else "abridged: slow sliding under weight is extrapolated"
    card = {
        "title": arguments.title,
        "description": f"Screened heuristic candidates under the paper protocol, {executed}: candidates whose opposing "
        "places stay farther apart than the side is wide are skipped and counted, so these rates are not the "
        "heuristic's own. A cell of object and type that hardly ever holds is given up after the most trials named in "
        "the command.",
        "command": commands(about),
        "protocol": about["protocol"]["name"],
        "hand": about["hand"],
        "seed": about["seed"],
        "prior": about["prior"],
        "trials": counts["trials"],
        "held": counts["held"],
        "faithful": counts["faithful"],
        "screened_out": counts["screened_out"],
        "given_up": given_up(about),
        "took": effort(about),
        "digest of the shards": shards_digest(about),
        "versions": about["versions"],
        "cells": [cell_card(cell) for cell in counts["cells"]],
        "shards": [{key: shard[key] for key in ("file", "rows", "sha256")} for shard in about["shards"]],
        "file_only": ["shards"],
    }
    write_json(arguments.out, card)
    if arguments.scaling is not None:
        scaling = {
            "title": "Time and memory of a collection",
            "description": "One `graspcascade collect` from nothing, as it stood after so many trials.",
            "environment": environment(processors()),
            "seed": about["seed"],
            "round_per_cell": about["round_per_cell"],
            "runs": growth(about, arguments.trials),
        }
        write_json(arguments.scaling, scaling)


if __name__ == "__main__":
    sys.exit(command("benchmarks.paper.data_card", Arguments, main))
