"""Write the card of a collected dataset: seed, command, counts, success rates per cell, time taken, checksums.

Example::

    python benchmarks/data_card.py --data data --out docs/results/collection.json
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import tyro

from graspcascade.cells import cell_name
from graspcascade.dataset import CollectionSpec
from graspcascade.dataset.collect import CollectionState
from graspcascade.dataset.shards import read_metadata, shards_digest
from graspcascade.evaluation import wilson
from graspcascade.files import write_json
from graspcascade.machine import cpu_model, processors
from graspcascade.postures import PosturePrior


@dataclass(frozen=True)
class Arguments:
    """Describe a dataset."""

    data: Path
    """Folder of the dataset."""
    out: Path
    """JSON file to write."""
    title: str = "The dataset of the paper's experiment"
    """Heading of the card."""


def command(asked: dict[str, Any], about: dict[str, Any]) -> str:
    """Word the command that collects so much."""
    usual = CollectionSpec()
    flags = [
        f"--{field.name.replace('_', '-')} {asked[field.name]}"
        for field in fields(CollectionSpec)
        if asked[field.name] != getattr(usual, field.name) or field.name == "seed"
    ]
    if about["prior"] != PosturePrior.pretrained().fingerprint():
        flags.insert(0, "--prior prior.safetensors")
    if about["creep_projection"] is None:
        flags.append("--full")
    return " ".join(["graspcascade collect --out data", *flags])


def commands(about: dict[str, Any]) -> str:
    """Word what was asked, one after another; more may have been asked of a collection later."""
    asked = [before["collection"] for before in about.get("asked_before", [])] + [about["collection"]]
    return ", then ".join(command(each, about) for each in asked)


def given_up(about: dict[str, Any]) -> list[str]:
    """Name the objects and types that lack grasps."""
    state, asked = CollectionState.of(about["shards"]), CollectionSpec(**about["collection"])
    return [cell_name(cell) for cell in state.short(asked)]


def cell_card(cell: dict[str, Any]) -> dict[str, Any]:
    """Give a cell's counts with its success rate."""
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


def main(arguments: Arguments) -> None:
    """Read the metadata and write the card."""
    about = read_metadata(arguments.data)
    counts = about["counts"]
    executed = "abridged along the slow creep under weight" if about["creep_projection"] else "every step computed"
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


if __name__ == "__main__":
    main(tyro.cli(Arguments))
