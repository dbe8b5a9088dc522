"""Compare our primitive-shape hand with another MJCF of the same hand on the same heuristic candidates.

Example, with MuJoCo Menagerie's mesh hand on disk::

    python benchmarks/hand_comparison.py --mjcf path/to/shadow_hand/right_hand.xml --prefix rh_ \
        --out docs/results/hand_comparison.json
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import tyro

from graspcascade.candidates import candidates, draw_sides
from graspcascade.files import write_json
from graspcascade.hands import SHADOW_HAND, HandDescription, load_hand, load_spec, shadow_hand
from graspcascade.intervals import share
from graspcascade.objects import CATALOGUE
from graspcascade.postures import PosturePrior
from graspcascade.taxonomy import GRASP_TYPES
from graspcascade.trials import PAPER, run


@dataclass(frozen=True)
class Arguments:
    """Compare two hands."""

    mjcf: Path
    """The other hand's MJCF."""
    prefix: str = "rh_"
    """What it puts before names."""
    per_cell: int = 24
    """Candidates for each object and type."""
    seed: int = 5
    """Seed of the candidates."""
    out: Path | None = None
    """JSON file to write."""


def surface_distances(other: HandDescription) -> dict[str, float]:
    """Measure how far our contact places and fingertips lie from the other hand's collision surface, metres."""
    model = load_spec(other).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    far = {}
    for name, place in SHADOW_HAND.places.items():
        body = model.body(other.prefix + place.body).id
        rotation, origin = data.xmat[body].reshape(3, 3), data.xpos[body]
        point, normal = origin + rotation @ np.array(place.point_m), rotation @ np.array(place.normal)
        # A ray from outside, against the outward normal, meets the surface where the place should be.
        start = point + 0.02 * normal
        collision_shapes = np.array([0, 0, 0, 1, 0, 0], dtype=np.uint8)  # Menagerie keeps them in group 3
        hit = mujoco.mj_ray(model, data, start, -normal, collision_shapes, 1, -1, np.zeros(1, dtype=np.int32))
        far[name] = abs(hit - 0.02) if hit >= 0 else float("nan")
    return far


def main(arguments: Arguments) -> None:
    """Run the comparison and print it."""
    hand = shadow_hand()
    other = SHADOW_HAND.with_model(arguments.mjcf, "mesh hand", arguments.prefix)
    rng = np.random.default_rng(arguments.seed)
    n = arguments.per_cell
    types = np.repeat(list(GRASP_TYPES), len(CATALOGUE) * n)
    labels = np.tile(np.repeat(list(CATALOGUE), n), len(GRASP_TYPES))
    prior = PosturePrior.pretrained()
    postures = prior.sample(types, rng)
    grasps = candidates(hand, postures, types, labels, draw_sides(labels, rng), rng)
    ours, theirs = run(grasps, PAPER), run(grasps, PAPER, hand=other)
    posture = load_hand(other).grasp_size(postures) - hand.grasp_size(postures)

    distances = surface_distances(other)
    result = {
        "title": "Primitive shapes against a mesh hand",
        "description": "The same unscreened heuristic candidates under the paper protocol, executed with our "
        "primitive-shape hand and with the mesh hand of the same make (MuJoCo Menagerie's, convex hulls of meshes at "
        "the fingertips).",
        "protocol": PAPER.name,
        "seed": arguments.seed,
        "prior": prior.fingerprint(),
        "n": len(grasps),
        "held_primitives": share(ours.held).to_json(),
        "held_mesh": share(theirs.held).to_json(),
        "faithful_primitives": share(ours.faithful(grasps)).to_json(),
        "faithful_mesh": share(theirs.faithful(grasps)).to_json(),
        "per_trial_agreement_held": share(ours.held == theirs.held).to_json(),
        "largest_grasp_size_difference_mm": float(np.abs(posture).max() * 1e3),
        "largest_place_to_surface_distance_mm": max(distances.values()) * 1e3,
        "places": [{"place": name, "distance_mm": round(d * 1e3, 3)} for name, d in distances.items()],
        "types": [
            {"grasp_type": t, "n": int((types == t).sum()), "held_primitives": int(ours.held[types == t].sum()),
             "held_mesh": int(theirs.held[types == t].sum())}
            for t in GRASP_TYPES
        ],
    }  # fmt: skip
    print(json.dumps(result, indent=1))
    if arguments.out is not None:
        write_json(arguments.out, result)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
