r"""Measure how exactly models put the object between the opposing digits, and how much error a grasp bears.

Example, with models that `paper_experiment.py` trained::

    python benchmarks/placement_errors.py --models runs/models/model1_seed0 runs/models/model3_seed0 \
        --out docs/results/placement_errors.json
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from graspcascade.bench.trials import evaluation_grasps
from graspcascade.candidates import opposition_points
from graspcascade.cascade import GraspSampler
from graspcascade.cascade.encoding import Request
from graspcascade.dataset.collect import versions
from graspcascade.evaluation import model_source
from graspcascade.files import write_json
from graspcascade.grasps import Grasps
from graspcascade.hands import HandModel, shadow_hand
from graspcascade.intervals import share
from graspcascade.objects import AXES, CATALOGUE
from graspcascade.poses import Pose, as_quat, as_rotation
from graspcascade.trials import PAPER, run

Array = NDArray[np.float64]
SHIFTS_MM = (0, 2, 4, 6, 8, 12)
TURNS_DEG = (5, 10, 20, 30)


@dataclass(frozen=True)
class Arguments:
    """Draw grasps of models and measure where the object is; then displace it."""

    models: tuple[Path, ...]
    """Folders of cascades."""
    out: Path
    """JSON file to write."""
    per_cell: int = 100
    """Grasps for each object and type, of each model."""
    tried_per_cell: int = 20
    """How many of the shipped cascade's are executed, for each displacement."""
    seed: int = 5
    """Seed of all draws."""


def off_centre_mm(hand: HandModel, grasps: Grasps) -> Array:
    """Give how far ``(n,)`` the object's centre is from the middle between the opposing places."""
    thumb, other = opposition_points(hand, grasps.posture, grasps.grasp_type)
    return np.asarray(1000.0 * np.linalg.norm(grasps.X_hand_object.position_m - (thumb + other) / 2, axis=1))


def tilt_deg(hand: HandModel, grasps: Grasps) -> Array:
    """Give the angle ``(n,)`` by which the side held is off the line through the opposing places; 0 for spheres.

    Across a cylinder every direction is a side, so that only its axis can be off the right angle to that line.
    """
    thumb, other = opposition_points(hand, grasps.posture, grasps.grasp_type)
    line = (other - thumb) / np.linalg.norm(other - thumb, axis=1, keepdims=True)
    shapes = np.array([CATALOGUE[label].shape for label in grasps.object_label.tolist()])
    across = (shapes == "cylinder") & (grasps.side_axis != "z")
    axes = np.where(across, "z", grasps.side_axis)
    body = np.eye(3)[[AXES.index(name) for name in axes.tolist()]]
    cosine = np.abs((as_rotation(grasps.X_hand_object.quat_wxyz).apply(body) * line).sum(axis=1)).clip(0.0, 1.0)
    angle = np.degrees(np.where(across, np.arcsin(cosine), np.arccos(cosine)))
    return np.asarray(np.where(shapes == "sphere", 0.0, angle))


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
        **quantiles("grasp size off mm", off_size_mm(sampler, grasps)),
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
    rows = []
    for folder in arguments.models:
        sampler = GraspSampler.load(folder)
        grasps = evaluation_grasps(model_source(sampler), arguments.per_cell, seed)
        rows.append(errors(hand, sampler, folder.name, grasps))
        print(rows[-1], flush=True)
    shipped = GraspSampler.pretrained()
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
        "puts the object. Tilt: of the side held, off the line through these places, spheres left out. Grasp size off: "
        "from the size asked for. Below, grasps of the shipped cascade with the object shifted, or turned about its "
        "centre, in directions drawn uniformly: full trials under the paper protocol.",
        "protocol": PAPER.name,
        "seed": seed,
        "weights": shipped.fingerprint(),
        "versions": versions(),
        "models": rows,
        "displaced": tried,
    }
    write_json(arguments.out, result)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
