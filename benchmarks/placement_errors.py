r"""Measure how exactly models put the object between the opposing digits, how varied grasps are, and what errors cost.

Example, with models that `paper_experiment.py` trained on a dataset::

    python benchmarks/placement_errors.py --models runs/models/model1_seed0 runs/models/model3_seed0 --data data \
        --out docs/results/placement_errors.json
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from placement import off_centre_mm, tilt_deg, turn_rad

from graspcascade.bench.trials import evaluation_grasps
from graspcascade.cascade import GraspSampler
from graspcascade.cascade.encoding import Request
from graspcascade.dataset import load_dataset
from graspcascade.evaluation import model_source
from graspcascade.files import write_json
from graspcascade.grasps import Grasps
from graspcascade.hands import HandModel, shadow_hand
from graspcascade.intervals import share
from graspcascade.machine import versions
from graspcascade.objects import CATALOGUE
from graspcascade.poses import Pose, as_quat, as_rotation
from graspcascade.trials import PAPER, run

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


def off_size_mm(sampler: GraspSampler, grasps: Grasps) -> Array:
    """Give how far ``(n,)`` the grasp size is from the one that the networks were asked for."""
    request = Request(
        grasps.grasp_type,
        grasps.object_label,
        grasps.side_axis,
        grasps.side_m,
        np.empty(len(grasps)),
        np.empty(len(grasps)),
    )
    asked, _ = sampler.sizes.apply(request, sampler.size_mode, np.random.default_rng(0))
    return np.asarray(1000.0 * np.abs(grasps.grasp_size_m - asked))


def quantiles(name: str, values: Array) -> dict[str, float]:
    """Give the median and what 95 of 100 stay under."""
    middle, most = np.quantile(values, (0.5, 0.95))
    return {f"{name}, median": round(float(middle), 2), f"{name}, 95 % under": round(float(most), 2)}


def errors(hand: HandModel, sampler: GraspSampler, name: str, grasps: Grasps) -> dict[str, Any]:
    """Measure the placements of a model."""
    tilt = tilt_deg(hand, grasps)[~np.char.startswith(grasps.object_label, "sphere")]
    return {
        "model": name,
        "n": len(grasps),
        **quantiles("off centre mm", off_centre_mm(hand, grasps)),
        **quantiles("tilt deg", tilt),
        "another side": share(tilt > OTHER_SIDE_DEG).to_json(),
        **quantiles("grasp size off mm", off_size_mm(sampler, grasps)),
    }


def by_object(hand: HandModel, name: str, grasps: Grasps) -> list[dict[str, Any]]:
    """Measure how boxes and cylinders are turned, object by object."""
    tilt, turn = tilt_deg(hand, grasps), turn_rad(hand, grasps)
    rows = []
    for label, thing in CATALOGUE.items():
        of_it = grasps.object_label == label
        if thing.shape != "sphere":
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
    """Give how alike turns up to half turns are: 1 if all are the same, 0 if they are spread evenly."""
    return round(float(np.abs(np.nanmean(np.exp(2j * turns)))), 3)


def variety(hand: HandModel, name: str, grasps: Grasps) -> dict[str, Any]:
    """Measure how far grasps of the same type, object and side differ: standard deviations within such groups."""
    keys = np.char.add(np.char.add(grasps.grasp_type, grasps.object_label), grasps.side_axis)
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
    hand, seed = shadow_hand(), arguments.seed
    rows, objects, varieties = [], [], []
    if arguments.data is not None:
        data = load_dataset(arguments.data)
        varieties.append(variety(hand, "dataset, held", data.grasps[data.outcomes.held]))
        print(varieties[-1], flush=True)
    for folder in arguments.models:
        sampler = GraspSampler.load(folder)
        grasps = evaluation_grasps(model_source(sampler), arguments.per_cell, seed)
        rows.append(errors(hand, sampler, folder.name, grasps))
        objects += by_object(hand, folder.name, grasps)
        varieties.append(variety(hand, folder.name, grasps))
        print(rows[-1], varieties[-1], flush=True)
    shipped = GraspSampler.pretrained()
    drawn = model_source(replace(shipped, size_mode="drawn"))
    varieties.append(variety(hand, "shipped cascade, sizes drawn", evaluation_grasps(drawn, arguments.per_cell, seed)))
    grasps = evaluation_grasps(model_source(shipped), arguments.tried_per_cell, seed)
    tried = []
    for shift, turn in [*((shift, 0) for shift in SHIFTS_MM), *((0, turn) for turn in TURNS_DEG)]:
        outcomes = run(displaced(grasps, shift, turn, np.random.default_rng(seed)))
        tried.append(
            {"shifted mm": shift, "turned deg": turn, "n": len(grasps), "held": share(outcomes.held).to_json()}
        )
        print(tried[-1], flush=True)
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
    write_json(arguments.out, result)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
