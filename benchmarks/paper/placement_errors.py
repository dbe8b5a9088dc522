r"""Measure how exactly models put the object between the opposing digits, how varied grasps are, and what errors cost.

Example, with models that `experiment.py` trained on a dataset::

    python -m benchmarks.paper.placement_errors --models runs/models/model1_seed0 runs/models/model3_seed0 --data data \
        --out docs/results/placement_errors.json
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import command, evaluation_grasps, publish
from graspcascade.core.grasps import Grasps
from graspcascade.core.intervals import share
from graspcascade.core.machine import versions
from graspcascade.core.objects import AXES, CATALOGUE
from graspcascade.core.poses import Pose, as_quat, as_rotation
from graspcascade.core.protocols import PAPER
from graspcascade.engines import run_trials
from graspcascade.hands import Hand, load_hand
from graspcascade.proposals.cascade.encoding import Request
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.heuristic import opposition_points
from graspcascade.studies.dataset import load_dataset

Array = NDArray[np.float64]
SHIFTS_MM = (0, 2, 4, 6, 8, 12)
TURNS_DEG = (5, 10, 20, 30)
OTHER_SIDE_DEG = 45.0
"""An object that is tilted by more is held across another side than the one asked for."""


@dataclass(frozen=True)
class Arguments:
    """Draw grasps of models and measure where the object is; then displace it."""

    models: tuple[Path, ...]
    """Folders of cascades."""
    out: Path
    """JSON file to write."""
    data: Path | None = None
    """Dataset whose held grasps' variety stands beside that of the models."""
    per_cell: int = 100
    """Grasps for each object and type, of each model."""
    tried_per_cell: int = 20
    """How many of the shipped cascade's are executed, for each displacement."""
    seed: int = 5
    """Seed of all draws."""


def off_centre_mm(hand: Hand, grasps: Grasps) -> Array:
    """Measure how far ``(n,)`` the object's centre is from the middle between the opposing contact points."""
    thumb, other = opposition_points(hand, grasps.posture, grasps.tasks)
    return np.asarray(1000.0 * np.linalg.norm(grasps.X_hand_object.position_m - (thumb + other) / 2, axis=1))


def tilt_deg(hand: Hand, grasps: Grasps) -> Array:
    """Measure the angle ``(n,)`` by which the side held is off the line of opposition; 0 for spheres.

    Across a cylinder every direction is a side, so that only its axis can be off the right angle to that line.
    """
    shapes, across = shapes_held(grasps)
    axes = np.where(across, "z", grasps.side_axis)
    cosine = np.abs((in_hand(grasps, axes) * opposition_lines(hand, grasps)).sum(axis=1)).clip(0.0, 1.0)
    angle = np.degrees(np.where(across, np.arcsin(cosine), np.arccos(cosine)))
    return np.asarray(np.where(shapes == "sphere", 0.0, angle))


def turn_rad(hand: Hand, grasps: Grasps) -> Array:
    """Measure the turn ``(n,)`` about the line of opposition, from the hand's z axis, up to half turns.

    It is that of a cylinder's axis, held across, or of the side that follows the one held of a box. NaN where all turns
    look alike: of spheres, and of cylinders held along their axis.
    """
    shapes, across = shapes_held(grasps)
    following = np.array([AXES[(AXES.index(name) + 1) % 3] for name in grasps.side_axis.tolist()])
    line = opposition_lines(hand, grasps)
    turned = in_hand(grasps, np.where(across, "z", following))
    start = np.array([0.0, 0.0, 1.0]) - line[:, 2:] * line
    angle = np.arctan2((np.cross(line, start) * turned).sum(axis=1), (start * turned).sum(axis=1))
    return np.asarray(np.where(across | (shapes == "box"), angle % np.pi, np.nan))


def opposition_lines(hand: Hand, grasps: Grasps) -> Array:
    """Compute the unit vectors ``(n, 3)`` from the thumb's contact point to its opposite, in the hand frame."""
    thumb, other = opposition_points(hand, grasps.posture, grasps.tasks)
    return np.asarray((other - thumb) / np.linalg.norm(other - thumb, axis=1, keepdims=True))


def shapes_held(grasps: Grasps) -> tuple[NDArray[np.str_], NDArray[np.bool_]]:
    """Look up the kinds ``(n,)`` of the objects' shapes, and which are cylinders held across."""
    shapes = grasps.tasks.column(lambda task: task.object.shape.kind, str)
    return shapes, np.asarray((shapes == "cylinder") & (grasps.side_axis != "z"))


def in_hand(grasps: Grasps, axes: NDArray[np.str_]) -> Array:
    """Compute a body axis ``(n, 3)`` of each object, by its name, in the hand frame."""
    body = np.eye(3)[[AXES.index(name) for name in axes.tolist()]]
    return np.asarray(as_rotation(grasps.X_hand_object.quat_wxyz).apply(body))


def off_size_mm(sampler: GraspSampler, grasps: Grasps) -> Array:
    """Measure how far ``(n,)`` the grasp size is from the one that the networks were asked for."""
    blank = np.full(len(grasps), np.nan)
    asked, _ = sampler.sizes.apply(Request(grasps.tasks, blank, blank), sampler.size_mode, np.random.default_rng(0))
    return np.asarray(1000.0 * np.abs(grasps.grasp_size_m - asked))


def quantiles(name: str, values: Array) -> dict[str, float]:
    """Compute the median and what 95 of 100 stay under."""
    middle, most = np.quantile(values, (0.5, 0.95))
    return {f"{name}, median": round(float(middle), 2), f"{name}, 95 % under": round(float(most), 2)}


def errors(hand: Hand, sampler: GraspSampler, name: str, grasps: Grasps) -> dict[str, Any]:
    """Measure the placements of a model."""
    tilt = tilt_deg(hand, grasps)[shapes_held(grasps)[0] != "sphere"]
    return {
        "model": name,
        "n": len(grasps),
        **quantiles("off centre mm", off_centre_mm(hand, grasps)),
        **quantiles("tilt deg", tilt),
        "another side": share(tilt > OTHER_SIDE_DEG).to_json(),
        **quantiles("grasp size off mm", off_size_mm(sampler, grasps)),
    }


def by_object(hand: Hand, name: str, grasps: Grasps) -> list[dict[str, Any]]:
    """Measure how boxes and cylinders are turned, object by object."""
    tilt, turn = tilt_deg(hand, grasps), turn_rad(hand, grasps)
    rows = []
    for label, obj in CATALOGUE.items():
        of_it = grasps.object_name == label
        if obj.shape.kind != "sphere":
            rows.append(
                {
                    "model": name,
                    "object": label,
                    "n": int(of_it.sum()),
                    **quantiles("tilt deg", tilt[of_it]),
                    "another side": share(tilt[of_it] > OTHER_SIDE_DEG).to_json(),
                    "likeness of turns": likeness(turn[of_it]),
                }
            )
    return rows


def likeness(turns: Array) -> float:
    """Measure how alike turns up to half turns are: 1 if all are the same, 0 if they are spread evenly."""
    return round(float(np.abs(np.nanmean(np.exp(2j * turns)))), 3)


def variety(hand: Hand, name: str, grasps: Grasps) -> dict[str, Any]:
    """Measure how far grasps of the same type, object and side differ: standard deviations within such groups."""
    keys = grasps.tasks.column(lambda task: "".join((*reversed(task.cell), task.site.name)), str)
    _, groups, counts = np.unique(keys, return_inverse=True, return_counts=True)
    freedom = len(grasps) - len(counts)

    def deviation(values: Array) -> float:
        means = np.stack([np.bincount(groups, column) for column in values.T], axis=1) / counts[:, None]
        squares = ((values - means[groups]) ** 2).sum(axis=0) / freedom
        return float(np.sqrt(squares.mean()))

    turns = turn_rad(hand, grasps)
    turned = [likeness(turns[groups == group]) for group in np.unique(groups[~np.isnan(turns)])]
    return {
        "grasps": name,
        "n": len(grasps),
        "grasp size sd mm": round(1000.0 * deviation(grasps.grasp_size_m[:, None]), 2),
        "joint angle sd deg": round(math.degrees(deviation(grasps.posture)), 2),
        "likeness of turns, mean": round(float(np.mean(turned)), 3),
    }


def displaced(grasps: Grasps, shift_mm: float, turn_deg: float, rng: np.random.Generator) -> Grasps:
    """Shift every object, and turn it about its centre, in directions drawn uniformly."""
    directions = rng.standard_normal((2, len(grasps), 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    pose = grasps.X_hand_object
    turned = as_rotation(pose.quat_wxyz) * as_rotation(_about(directions[1], turn_deg))
    return replace(grasps, X_hand_object=Pose(pose.position_m + shift_mm / 1000.0 * directions[0], as_quat(turned)))


def _about(axes: Array, angle_deg: float) -> Array:
    half = np.radians(angle_deg) / 2.0
    return np.concatenate([np.full((len(axes), 1), np.cos(half)), np.sin(half) * axes], axis=1)


def main(arguments: Arguments) -> None:
    """Measure placements, execute displaced grasps of the shipped cascade, and write the numbers."""
    hand, seed = load_hand("shadow"), arguments.seed
    rows, objects, varieties = [], [], []
    if arguments.data is not None:
        data = load_dataset(arguments.data)
        varieties.append(variety(hand, "dataset, held", data.grasps[data.outcomes.held]))
        print(varieties[-1], file=sys.stderr, flush=True)
    for folder in arguments.models:
        sampler = GraspSampler.load(folder)
        grasps = evaluation_grasps(sampler, arguments.per_cell, seed)
        rows.append(errors(hand, sampler, folder.name, grasps))
        objects += by_object(hand, folder.name, grasps)
        varieties.append(variety(hand, folder.name, grasps))
        print(rows[-1], varieties[-1], file=sys.stderr, flush=True)
    shipped = GraspSampler.pretrained()
    drawn = replace(shipped, size_mode="drawn")
    varieties.append(variety(hand, "shipped cascade, sizes drawn", evaluation_grasps(drawn, arguments.per_cell, seed)))
    grasps = evaluation_grasps(shipped, arguments.tried_per_cell, seed)
    tried = []
    for shift, turn in [*((shift, 0) for shift in SHIFTS_MM), *((0, turn) for turn in TURNS_DEG)]:
        outcomes = run_trials(displaced(grasps, shift, turn, np.random.default_rng(seed)))
        tried.append(
            {"shifted mm": shift, "turned deg": turn, "n": len(grasps), "held": share(outcomes.held).to_json()}
        )
        print(tried[-1], file=sys.stderr, flush=True)
    result = {
        "title": "How exactly objects are placed, and how exactly they must be",
        "description": "Off centre: from the middle between the opposing places of the posture, where the heuristic "
        "puts the object. Tilt: of the side held, off the line through these places, spheres left out; another side: "
        f"tilted by more than {OTHER_SIDE_DEG:g} degrees, so that another side is held than the one asked for. Grasp "
        "size off: from the size asked for. Displaced: grasps of the shipped cascade with the object shifted, or "
        "turned about its centre, in directions drawn uniformly; full trials under the paper protocol. Variety: "
        "standard deviations within grasps of the same type, object and side; turns about the line through the "
        "opposing places are alike by 1 if all are the same and by 0 if spread evenly, few of them never quite by 0.",
        "protocol": PAPER.name,
        "seed": seed,
        "weights": shipped.fingerprint(),
        "versions": versions(),
        "models": rows,
        "displaced": tried,
        "variety": varieties,
        "placements by object": objects,
        "file_only": ["placements by object"],
    }
    publish(result, arguments.out)


if __name__ == "__main__":
    sys.exit(command("benchmarks.paper.placement_errors", Arguments, main))
