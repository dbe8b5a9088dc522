"""Try the same grasps in MuJoCo and in PhysX, and count how often both come to the same verdict.

Example::

    python -m benchmarks.physics.engines --work runs/engines --out docs/results/engines.json
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import command, publish, shipped_heuristic
from graspcascade.core.grasps import Grasps
from graspcascade.core.intervals import newcombe, share
from graspcascade.core.machine import versions
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.protocols import HOLD, VARIED, Protocol
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.engines import Engine, as_engine
from graspcascade.proposals import Proposal
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.studies.dataset import Dataset, load_dataset
from graspcascade.studies.evaluate import evaluate

_PER_ROUND = 5
"""Grasps of a cell in one evaluation, which is all that an interruption can lose."""


@dataclass(frozen=True)
class Arguments:
    """Execute the same grasps in both engines."""

    work: Path
    """Folder for finished trials; the same command goes on where an earlier one stopped."""
    per_cell: int = 25
    """Grasps for each object and type, of the heuristic (unscreened) and of the shipped cascade; a multiple of 5."""
    workers: int = 1
    """Processes."""
    out: Path | None = None
    """JSON file to write."""


def main(arguments: Arguments) -> None:
    """Execute what is not yet done, and compare."""
    engines: dict[str, Engine] = {"mujoco": as_engine("mujoco", n_threads=1), "physx": as_engine("physx")}
    rounds = [
        (proposal, protocol, seed)
        for seed in range(arguments.per_cell // _PER_ROUND)
        for protocol in (HOLD, VARIED)
        for proposal in (shipped_heuristic(), GraspSampler.pretrained())
    ]
    tried: dict[tuple[str, str], list[tuple[Dataset, Dataset]]] = {}
    for proposal, protocol, seed in rounds:
        folder = arguments.work / proposal.name / protocol.name / str(seed)
        both = [_tried(proposal, protocol, seed, engine, folder / name, arguments) for name, engine in engines.items()]
        tried.setdefault((proposal.name, protocol.name), []).append((both[0], both[1]))
    publish(
        {
            "title": "The same grasps in MuJoCo and PhysX",
            "description": "The same grasps, with the same draws of what a protocol varies, in both engines. Agreement "
            "is the share of trials with the same answer to whether the grasp held; differences are in points, PhysX "
            "over MuJoCo, with 95 % intervals.",
            "versions": versions() | engines["physx"].versions,
            "comparisons": [row for (name, protocol), parts in tried.items() for row in compare(name, protocol, parts)],
        },
        arguments.out,
    )


def _tried(
    proposal: Proposal, protocol: Protocol, seed: int, engine: Engine, folder: Path, arguments: Arguments
) -> Dataset:
    def show(done: int, of: int) -> None:
        print(f"\r{folder}: {done} of {of} trials ", end="", file=sys.stderr, flush=True)

    settings: Mapping[str, Any] = {"engine": engine, "workers": arguments.workers, "out": folder, "progress": show}
    evaluate(proposal, per_cell=_PER_ROUND, seed=seed, protocol=protocol, **settings)
    print(file=sys.stderr)
    return load_dataset(folder)


def compare(name: str, protocol: str, parts: list[tuple[Dataset, Dataset]]) -> Iterator[dict[str, Any]]:
    """Compare the outcomes of the same grasps, of all types together and of each.

    Raises:
        ValueError: the grasps are not the same.
    """
    for mine, theirs in parts:
        if not np.array_equal(mine.grasps.posture, theirs.grasps.posture):
            raise ValueError(f"the grasps of {name} under {protocol} are not the same in both engines")
    grasps = Grasps.concatenate([mine.grasps for mine, _ in parts])
    first, other = (Outcomes.concatenate([pair[k].outcomes for pair in parts]) for k in (0, 1))
    yield _row(name, protocol, "all", grasps, first, other, np.ones(len(grasps), dtype=bool))
    for kind in GRASP_TYPES:
        yield _row(name, protocol, kind, grasps, first, other, grasps.grasp_type == kind)


def _row(
    name: str, protocol: str, kind: str, grasps: Grasps, first: Outcomes, other: Outcomes, rows: NDArray[np.bool_]
) -> dict[str, Any]:
    n, held, also = int(rows.sum()), first.held[rows], other.held[rows]
    more = newcombe(int(also.sum()), n, int(held.sum()), n)
    pairs, counts = np.unique(np.stack([first.verdict[rows], other.verdict[rows]], axis=1), axis=0, return_counts=True)
    return {
        "grasps": name,
        "protocol": protocol,
        "type": kind,
        "n": n,
        "held": {"mujoco": share(held).to_json(), "physx": share(also).to_json()},
        "faithful": {
            "mujoco": share(first.faithful(grasps)[rows]).to_json(),
            "physx": share(other.faithful(grasps)[rows]).to_json(),
        },
        "steady": {"mujoco": share(first.steady[rows]).to_json(), "physx": share(other.steady[rows]).to_json()},
        "held, points": [100 * value for value in (more.difference, more.low, more.high)],
        "agreement": share(held == also).to_json(),
        "differing verdicts": {
            f"{mine}, {theirs}": count
            for (mine, theirs), count in zip(pairs.tolist(), counts.tolist(), strict=True)
            if mine != theirs
        },
    }


if __name__ == "__main__":
    sys.exit(command("benchmarks.physics.engines", Arguments, main))
