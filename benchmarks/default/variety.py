"""Measure whether a model's grasps are as varied as the heuristic's own successes of the same objects and types.

Example::

    python -m benchmarks.default.variety --model build/model-3 --prior build/prior.safetensors --out variety.json
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.common import command, publish
from graspcascade.core.families import FAMILIES
from graspcascade.core.grasps import Grasps
from graspcascade.core.machine import versions
from graspcascade.core.poses import quat_to_matrix
from graspcascade.core.protocols import HOLD
from graspcascade.core.tasks import Task, Tasks
from graspcascade.engines import as_engine
from graspcascade.hands import Hand, load_hand
from graspcascade.proposals.cascade.encoding import learning_frame, site_frames
from graspcascade.proposals.heuristic import Heuristic, Screened, opposition_points
from graspcascade.proposals.prior import PosturePrior
from graspcascade.proposals.ranked import Ranked

Array = NDArray[np.float64]
_NEIGHBOURS = 5
"""A success is covered by a sample that is nearer to it than its fifth nearest other success, as in Naeem et al.,
Reliable Fidelity and Diversity Metrics for Generative Models (2020), DOI 10.48550/arXiv.2002.09797."""
_FEWEST = 20
"""Tasks of which the heuristic holds fewer are left out."""


@dataclass(frozen=True)
class Arguments:
    """Try the heuristic on random objects, and lay a model's grasps beside its successes."""

    model: Path
    """Folder of a cascade and its scorer."""
    prior: Path
    """The heuristic's prior."""
    objects: int = 6
    """Objects of each family."""
    trials: int = 150
    """Trials of the heuristic for each object and type."""
    seed: int = 31
    """Seed of objects, sides and grasps."""
    threads: int = 0
    """Simulation threads, 0 for all processors."""
    out: Path | None = None
    """JSON file to write."""


@dataclass(frozen=True)
class Spread:
    """How far grasps of one task are spread, each a standard deviation or, of turns, 1 minus the resultant length."""

    position_m: float
    turn: float
    posture_rad: float


def turns(hand: Hand, grasps: Grasps) -> Array:
    """Measure how the site's frame is turned about the opposition axis ``(n,)``, radians."""
    frame = learning_frame(*opposition_points(hand, grasps.posture, grasps.tasks), "opposition")
    site = (frame.inverse() @ grasps.X_hand_object).quat_wxyz
    axes = quat_to_matrix(site) @ quat_to_matrix(site_frames(grasps.tasks))
    return np.asarray(np.arctan2(axes[:, 2, 2], axes[:, 1, 2]))


def spread(hand: Hand, grasps: Grasps) -> Spread:
    """Measure the spread of grasps of one task. A half turn about the axis is no difference."""
    resultant = np.abs(np.exp(2j * turns(hand, grasps)).mean())
    deviation = [np.sqrt(column.var(axis=0).sum()) for column in (grasps.X_hand_object.position_m, grasps.posture)]
    return Spread(float(deviation[0]), float(1.0 - resultant), float(deviation[1]))


def columns(hand: Hand, grasps: Grasps, turned: bool) -> Array:
    """Describe grasps of one task as points: position, turn where the object shows one, and posture."""
    angle = 2.0 * turns(hand, grasps)
    parts = [grasps.X_hand_object.position_m / 0.005, grasps.posture / 0.1]
    return np.concatenate([*parts, np.stack([np.cos(angle), np.sin(angle)], axis=1)] if turned else parts, axis=1)


def coverage(successes: Array, samples: Array) -> float:
    """Share of successes ``(n, k)`` that have a sample ``(m, k)`` within the distance of their fifth neighbour."""
    radius = cKDTree(successes).query(successes, k=_NEIGHBOURS + 1)[0][:, -1]
    return float((cKDTree(samples).query(successes)[0] <= radius).mean())


def main(arguments: Arguments) -> None:
    """Measure every task."""
    hand, prior = load_hand("shadow"), PosturePrior.load(arguments.prior)
    heuristic, ranked = Screened(Heuristic(hand, prior)), Ranked.load(arguments.model)
    rng, tasks = np.random.default_rng(arguments.seed), list[Task]()
    for family in FAMILIES.values():
        for obj in family.draw(arguments.objects, rng, hand.reach_m):
            sites = list(obj.sites(hand.reach_m).values())
            tasks += [Task(kind, obj, sites[rng.integers(len(sites))]) for kind in heuristic.grasp_types]
    engine, rows = as_engine(n_threads=arguments.threads).abridging(HOLD), []
    asked = Tasks(tuple(tasks), np.repeat(np.arange(len(tasks)), arguments.trials))
    candidates = heuristic.propose(asked, rng)
    outcomes = engine.run(hand, candidates, HOLD, progress=_Dots(len(candidates)))
    good = outcomes.faithful(candidates)
    for number, task in enumerate(tasks):
        successes = candidates[np.flatnonzero(good & (asked.row == number))]
        if len(successes) < _FEWEST:
            continue
        half = rng.permutation(len(successes)) < len(successes) // 2
        turned = task.object.shape.kind != "sphere" and not (
            task.object.shape.kind == "cylinder" and task.site.name == "z"
        )
        row: dict[str, Any] = {"type": task.grasp_type.name, "object": task.object.name, "axis": task.site.name}
        row |= {"successes": len(successes), "turned": turned}
        reference = columns(hand, successes[half], turned)
        row["coverage by other successes"] = coverage(reference, columns(hand, successes[~half], turned))
        n = int((~half).sum())
        mine = spread(hand, successes)
        for name, proposal in (("ranked", ranked), ("raw", ranked.proposal)):
            sampled = proposal.propose(Tasks.repeat(task, max(n, 200)), rng)
            other = spread(hand, sampled)
            row[name] = {
                "position": other.position_m / mine.position_m,
                "turn": other.turn / mine.turn if turned else None,
                "posture": other.posture_rad / mine.posture_rad,
                "coverage": coverage(reference, columns(hand, sampled[:n], turned)),
            }
        rows.append(row)
    publish(
        {
            "title": "Variety of a model's grasps beside the heuristic's successes",
            "n_tasks": len(rows),
            "protocol": HOLD.name,
            "median": {name: medians(rows, name) for name in ("ranked", "raw")},
            "tasks": rows,
            "seed": arguments.seed,
            "model": ranked.describe(),
            "versions": versions(),
        },
        arguments.out,
    )


def medians(rows: list[dict[str, Any]], name: str) -> dict[str, float]:
    """Compute each measure's median over tasks; coverage is relative to what other successes reach."""
    kept = {
        key: [row[name][key] for row in rows if row[name][key] is not None] for key in ("position", "turn", "posture")
    }
    kept["coverage"] = [row[name]["coverage"] / max(row["coverage by other successes"], 1e-9) for row in rows]
    return {key: round(float(np.median(values)), 4) for key, values in kept.items() if values}


class _Dots:
    """Say on standard error how far the trials are, every tenth."""

    def __init__(self, total: int) -> None:
        self._total, self._done = total, 0

    def __call__(self, decided: int) -> None:
        before, self._done = self._done, self._done + decided
        if before * 10 // self._total != self._done * 10 // self._total:
            print(f"{self._done} of {self._total} trials", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(command("benchmarks.default.variety", Arguments, main))
