"""Compare grasps and verdicts with those recorded before, bit by bit.

Three sets of 1,080 grasps: one round of an evaluation of the heuristic, one of the shipped cascade, both tried to
their end, and one round of a collection, tried as collections are. What is recorded of each column is a digest of its
bytes, so that a difference says which column changed. Other versions of numpy or MuJoCo, or another processor, round
differently and are named where they differ.

Example::

    python -m benchmarks.paper.digest           # compares everything; the exit status is 1 if anything differs
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspcascade.core.grasps import Grasps
from graspcascade.core.machine import cpu_model, versions
from graspcascade.core.outcomes import VERDICTS, Outcomes
from graspcascade.engines import run_trials
from graspcascade.engines.mujoco.creep import FAST_FORWARD
from graspcascade.hands import load_hand
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.heuristic import Heuristic
from graspcascade.proposals.prior import PosturePrior
from graspcascade.studies.collect import CollectionSpec, draw_round
from graspcascade.studies.evaluate import EvaluationRound
from graspcascade.studies.rounds import CELLS

RECORD = Path(__file__).parents[2] / "tests" / "data" / "digest.json"
SETS = ("heuristic", "cascade", "collection")
PER_CELL, SEED = 20, 20261125


def recorded() -> dict[str, Any]:
    """Read what was recorded."""
    return dict(json.loads(RECORD.read_text(encoding="utf-8")))


def draw(name: str) -> tuple[Grasps, int | None]:
    """Draw the grasps of a set, and count how many candidates a collection skipped."""
    hand = load_hand("shadow")
    if name == "cascade":
        return EvaluationRound(GraspSampler.pretrained(), CELLS, PER_CELL, SEED, 0)(), None
    heuristic = Heuristic(hand, PosturePrior.pretrained())
    if name == "heuristic":
        return EvaluationRound(heuristic, CELLS, PER_CELL, SEED, 0)(), None
    return draw_round(heuristic, range(len(CELLS)), 0, CollectionSpec(round_per_cell=PER_CELL, seed=SEED))


def try_grasps(name: str, grasps: Grasps) -> Outcomes:
    """Try grasps as those of a set were tried."""
    if name == "collection":
        return run_trials(grasps, "paper", hand="shadow", creep=FAST_FORWARD)
    return run_trials(grasps, "paper", hand="shadow")


def letters(outcomes: Outcomes) -> str:
    """Spell verdicts as a string, the first letter of each."""
    assert len({verdict[0] for verdict in VERDICTS}) == len(VERDICTS)
    return "".join(verdict[0] for verdict in outcomes.verdict.tolist())


def grasp_columns(grasps: Grasps) -> dict[str, NDArray[Any]]:
    """List the columns that are recorded of grasps."""
    names = {"grasp_type": grasps.grasp_type, "object": grasps.object_name, "side_axis": grasps.side_axis}
    numbers = {name: column for name, column in grasps.columns().items() if name != "probability"}
    return names | {"side_m": grasps.side_m} | numbers


def digests(columns: Mapping[str, NDArray[Any]]) -> dict[str, str]:
    """Compute a short digest of each column's bytes."""

    def digest(column: NDArray[Any]) -> str:
        values = np.ascontiguousarray(column)
        data = "\n".join(values.reshape(-1).tolist()).encode() if values.dtype.kind == "U" else values.tobytes()
        return hashlib.sha256(data).hexdigest()[:16]

    return {name: digest(column) for name, column in columns.items()}


def differing(columns: Mapping[str, NDArray[Any]], record: Mapping[str, str]) -> list[str]:
    """Name the columns whose bytes are not those recorded, or that are missing; later additions are not compared."""
    ours = digests(columns)
    return sorted(name for name in record if ours.get(name) != record[name])


def machine() -> dict[str, str]:
    """Describe what rounding depends on: versions, processor, and what the processor can do."""
    about = Path("/proc/cpuinfo")
    lines = about.read_text(encoding="utf-8").splitlines() if about.exists() else []
    flags = next((line.partition(":")[2].split() for line in lines if line.startswith("flags")), [])
    features = hashlib.sha256(" ".join(sorted(flags)).encode()).hexdigest()[:16]
    return versions() | {"cpu": cpu_model(), "cpu_features": features}


def other_machine(record: Mapping[str, Any]) -> list[str]:
    """Name what of versions and processor differs from the record; the package's own version does not matter."""
    theirs = record["versions"] | {name: record[name] for name in ("cpu", "cpu_features")}
    return [
        f"{name} was {theirs[name]}, is {ours}"
        for name, ours in machine().items()
        if _matters(name, ours, theirs[name])
    ]


def _matters(name: str, ours: str, theirs: str) -> bool:
    return name not in ("graspcascade", "python") and ours != theirs


def compare(name: str, record: Mapping[str, Any]) -> list[str]:
    """Recompute a set and word, a line each, what differs from its record."""
    grasps, skipped = draw(name)
    outcomes = try_grasps(name, grasps)
    lines = []
    if columns := differing(grasp_columns(grasps), record["grasps"]):
        lines.append(f"columns of the grasps: {', '.join(columns)}")
    if columns := differing(outcomes.columns(), record["outcomes"]):
        lines.append(f"columns of the outcomes: {', '.join(columns)}")
    changed = sum(ours != theirs for ours, theirs in zip(letters(outcomes), record["verdicts"], strict=True))
    if changed:
        lines.append(f"{changed} of {len(grasps)} verdicts")
    counts = {"held": int(outcomes.held.sum()), "faithful": int(outcomes.faithful(grasps).sum())}
    counts |= {} if skipped is None else {"skipped": skipped}
    return lines + [f"{key}: {n}, was {record[key]}" for key, n in counts.items() if n != record[key]]


def main() -> int:
    """Compare everything and print what differs; return the exit status."""
    record, status = recorded(), 0
    for difference in other_machine(record):
        print(f"recorded elsewhere: {difference}")
    for name in SETS:
        differences = compare(name, record[name])
        status |= bool(differences)
        print(f"{name}: {'; '.join(differences) or 'the same to the last bit'}", flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main())
