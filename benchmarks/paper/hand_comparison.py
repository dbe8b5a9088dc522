"""Compare our primitive-shape hand with another MJCF of the same hand on the same grasps.

Example, with MuJoCo Menagerie's mesh hand on disk (docs/own_hand.md tells where to find it)::

    python -m benchmarks.paper.hand_comparison --mjcf path/to/shadow_hand/right_hand.xml --prefix rh_ \
        --out docs/results/hand_comparison.json
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np

from benchmarks.common import command, evaluation_grasps, publish, shipped_heuristic
from graspcascade.core.grasps import Grasps
from graspcascade.core.intervals import share
from graspcascade.core.machine import versions
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.protocols import PAPER, as_protocol
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.core.yaml_files import dump_yaml
from graspcascade.engines import run_trials
from graspcascade.hands import Hand, load_hand, read_spec
from graspcascade.proposals.cascade.sampler import GraspSampler


@dataclass(frozen=True)
class Arguments:
    """Compare two hands."""

    mjcf: Path
    """The other hand's MJCF."""
    prefix: str = "rh_"
    """What it puts before names."""
    protocol: str = PAPER.name
    """Protocol of the trials."""
    per_cell: int = 50
    """Grasps for each object and type, of the heuristic (unscreened) and of the shipped cascade."""
    seed: int = 5
    """Seed of the grasps."""
    out: Path | None = None
    """JSON file to write."""


def mesh_hand(mjcf: Path, prefix: str) -> Hand:
    """Read another MJCF of the shipped hand: its hand file says the same but for the model."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "hand.yaml"
        about = {"base": "shadow", "name": "mesh hand", "mjcf": str(mjcf.resolve()), "prefix": prefix}
        dump_yaml(path, about, "The shipped hand with another model.")
        return load_hand(path)


def surface_distances(other: Hand) -> dict[str, float]:
    """Measure how far our contact places and fingertips lie from the other hand's collision surface, metres."""
    model = read_spec(other).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    far = {}
    for name, place in other.places.items():
        body = model.body(other.prefix + place.body).id
        rotation, origin = data.xmat[body].reshape(3, 3), data.xpos[body]
        point, normal = origin + rotation @ np.array(place.point_m), rotation @ np.array(place.normal)
        # A ray from outside, against the outward normal, meets the surface where the place should be.
        start = point + 0.02 * normal
        collision_shapes = np.array([0, 0, 0, 1, 0, 0], dtype=np.uint8)  # Menagerie keeps them in group 3
        hit = mujoco.mj_ray(model, data, start, -normal, collision_shapes, 1, -1, np.zeros(1, dtype=np.int32))
        far[name] = abs(hit - 0.02) if hit >= 0 else float("nan")
    return far


def compare(name: str, grasps: Grasps, ours: Outcomes, theirs: Outcomes) -> dict[str, Any]:
    """Compare the outcomes of the same grasps with both hands, trial by trial."""
    return {
        "grasps": name,
        "n": len(grasps),
        "held_primitives": share(ours.held).to_json(),
        "held_mesh": share(theirs.held).to_json(),
        "faithful_primitives": share(ours.faithful(grasps)).to_json(),
        "faithful_mesh": share(theirs.faithful(grasps)).to_json(),
        "agreement_held": share(ours.held == theirs.held).to_json(),
    }


def main(arguments: Arguments) -> None:
    """Run the comparison and print it."""
    heuristic, shipped = shipped_heuristic(), GraspSampler.pretrained()
    hand, other = heuristic.hand, mesh_hand(arguments.mjcf, arguments.prefix)
    protocol = as_protocol(arguments.protocol)
    all_grasps, types, size_differences = [], [], []
    for proposal in (heuristic, shipped):
        grasps = evaluation_grasps(proposal, arguments.per_cell, arguments.seed)
        ours, theirs = run_trials(grasps, protocol), run_trials(grasps, protocol, hand=other)
        all_grasps.append(compare(proposal.name, grasps, ours, theirs))
        for grasp_type in GRASP_TYPES:
            of_type = grasps.grasp_type == grasp_type
            compared = compare(proposal.name, grasps[of_type], ours[of_type], theirs[of_type])
            types.append({"grasp_type": grasp_type, **compared})
        size_differences.append(other.grasp_size(grasps.posture) - hand.grasp_size(grasps.posture))

    distances = surface_distances(other)
    result = {
        "title": "Primitive shapes against a mesh hand" + ("" if protocol == PAPER else f" under {protocol.name}"),
        "description": f"The same grasps under protocol {protocol.name}, executed in full with our primitive-shape "
        "hand and with the mesh hand of the same make (MuJoCo Menagerie's, convex hulls of meshes at the fingertips). "
        "Those of the heuristic are not screened; the cascade has learned from trials with the primitive-shape hand "
        "alone.",
        "protocol": protocol.name,
        "seed": arguments.seed,
        "prior": heuristic.prior.fingerprint(),
        "weights": shipped.fingerprint(),
        "mujoco": versions()["mujoco"],
        "largest_grasp_size_difference_mm": float(np.abs(np.concatenate(size_differences)).max() * 1e3),
        "largest_place_to_surface_distance_mm": max(distances.values()) * 1e3,
        "grasps": all_grasps,
        "types": types,
        "places": [{"place": name, "distance_mm": round(d * 1e3, 3)} for name, d in distances.items()],
    }
    publish(result, arguments.out)


if __name__ == "__main__":
    sys.exit(command("benchmarks.paper.hand_comparison", Arguments, main))
