"""Choose the contact settings of the `hold` protocol by experiments whose right answer is known.

No grasp's success is looked at. Every experiment has a limit, fixed here; `hold` has the cheapest settings that keep
all of them. Example::

    python -m benchmarks.physics.contacts --out docs/results/contacts.json
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from benchmarks.common import command, environment, publish
from graspcascade.core.objects import as_object
from graspcascade.core.protocols import PAPER
from graspcascade.hands import load_hand
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.worlds.world import build_world

GRAVITY_M_S2, MASS_KG, LONG_S = 9.81, 0.1, 20.0
FRICTION, TORSION_M = PAPER.physics.friction, PAPER.physics.torsional_friction_m
_PAD_RADIUS_M, _UPRIGHT_M, _FLAT_M = 0.0075, (0.015, 0.02, 0.03), (0.03, 0.02, 0.015)
"""Radius of a fingertip, and half the block's extents as it is gripped and as it lies."""
_NEEDED_N = MASS_KG * GRAVITY_M_S2 / (2 * FRICTION)
"""Force of each of two pads that just carries the object."""

LIMITS: Mapping[str, float] = {
    "gripped_mm": 0.1,
    "three_pads_mm": 0.1,
    "resting_mm": 0.1,
    "sliding_error": 0.02,
    "turned_deg": 0.1,
    "slipping_error": 0.1,
    "energy_gain": 1e-3,
}
"""Most error of each experiment, by its name in the table."""


@dataclass(frozen=True)
class Settings:
    """What MuJoCo computes contacts with."""

    impratio: float = 10.0
    """Ratio of friction to normal impedance."""
    noslip_iterations: int = 0
    """Passes after the solver that remove the slip which soft friction leaves."""
    cone: str = "elliptic"
    solver: str = "newton"
    integrator: str = "implicitfast"
    time_step_s: float = 0.004

    def apply(self, option: Any) -> None:
        """Write them into the options of a model or of a spec."""
        option.impratio, option.noslip_iterations = self.impratio, self.noslip_iterations
        option.timestep = self.time_step_s
        option.cone = getattr(mujoco.mjtCone, f"mjCONE_{self.cone.upper()}")
        option.solver = getattr(mujoco.mjtSolver, f"mjSOL_{self.solver.upper()}")
        option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{self.integrator.upper()}")


def variants() -> Iterator[Settings]:
    """List the settings of the table."""
    for impratio in (10.0, 30.0, 100.0, 300.0, 1000.0):
        for passes in (0, 1, 3, 5, 10):
            yield Settings(impratio, passes)
    for base in (Settings(), Settings(30.0, 3)):
        yield replace(base, cone="pyramidal")
        yield replace(base, solver="cg")
        yield replace(base, solver="pgs")
        yield replace(base, integrator="euler")
        yield replace(base, integrator="implicit")
        for step_s in (0.001, 0.002, 0.005):
            yield replace(base, time_step_s=step_s)


@dataclass(frozen=True)
class Scene:
    """Hold a scene of one free block, whose joint comes first."""

    model: Any
    data: Any

    def run(self, seconds: float) -> None:
        """Step on."""
        for _ in range(round(seconds / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)

    def pull(self, direction: tuple[float, float, float]) -> None:
        """Let weight act along a direction."""
        self.model.opt.gravity[:] = GRAVITY_M_S2 * np.array(direction)

    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """Copy the block's position and quaternion."""
        return self.data.qpos[:3].copy(), self.data.qpos[3:7].copy()

    def moved_m(self, before: tuple[np.ndarray, np.ndarray]) -> float:
        """Measure how far the block's centre is from where it was."""
        return float(np.linalg.norm(self.data.qpos[:3] - before[0]))

    def turned_rad(self, before: tuple[np.ndarray, np.ndarray]) -> float:
        """Measure how far the block is turned from how it was, at most half a turn."""
        return float(2 * np.arccos(min(1.0, abs(self.data.qpos[3:7] @ before[1]))))


def _block(settings: Settings, half_m: tuple[float, float, float], height_m: float = 0.0) -> Any:
    spec = mujoco.MjSpec()
    settings.apply(spec.option)
    body = spec.worldbody.add_body(name="block", pos=[0.0, 0.0, height_m])
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half_m, mass=MASS_KG)
    return spec


def _compiled(spec: Any) -> Scene:
    physics = PAPER.physics
    for geom in spec.geoms:
        geom.condim, geom.friction = 4, [physics.friction, physics.torsional_friction_m, 0.0001]
        geom.solref = [physics.contact_time_constant_s, 1.0]
    spec.option.gravity = [0.0, 0.0, 0.0]
    model = spec.compile()
    return Scene(model, mujoco.MjData(model))


def gripped(settings: Settings, force_n: float, pads: int = 2) -> Scene:
    """Grip a floating block between round pads, one on the left and the others on the right, and let it settle."""
    spec = _block(settings, _UPRIGHT_M)
    right = [(0.0, 0.0)] if pads == 2 else [(0.0, -0.01), (0.0, 0.01)]
    for number, (side, (y, z)) in enumerate([(-1.0, (0.0, 0.0)), *((1.0, place) for place in right)]):
        name = f"pad_{number}"
        body = spec.worldbody.add_body(name=name, pos=[side * (_UPRIGHT_M[0] + _PAD_RADIUS_M), y, z])
        body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[-side, 0.0, 0.0]).damping[0] = 5.0
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[_PAD_RADIUS_M, 0.0, 0.0], mass=0.02)
        actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.gear[0] = force_n / (len(right) if side > 0 else 1)
    scene = _compiled(spec)
    scene.data.ctrl[:] = 1.0
    scene.run(0.5)
    return scene


def on_floor(settings: Settings, height_m: float = _FLAT_M[2]) -> Scene:
    """Put a block above a floor."""
    spec = _block(settings, _FLAT_M, height_m)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 1.0])
    return _compiled(spec)


def gripped_mm(settings: Settings, pads: int = 2) -> float:
    """Measure how far a block sinks in 20 s that is gripped at twice the force that friction needs, millimetres."""
    scene = gripped(settings, 2 * _NEEDED_N, pads)
    scene.pull((0.0, 0.0, -1.0))
    before = scene.pose()
    scene.run(LONG_S)
    return scene.moved_m(before) * 1e3


def resting_mm(settings: Settings) -> float:
    """Measure how far a block slides in 20 s on a slope at 95 % of the friction angle, millimetres."""
    scene = on_floor(settings)
    scene.pull((0.0, 0.0, -1.0))
    scene.run(0.5)
    angle, before = 0.95 * np.arctan(FRICTION), scene.pose()
    scene.pull((np.sin(angle), 0.0, -np.cos(angle)))
    scene.run(LONG_S)
    return scene.moved_m(before) * 1e3


def sliding_error(settings: Settings) -> float:
    """Compare a block's way in 0.5 s on a slope at 120 % of the friction angle with theory: relative error."""
    scene, seconds = on_floor(settings), 0.5
    scene.pull((0.0, 0.0, -1.0))
    scene.run(0.5)
    angle, before = 1.2 * np.arctan(FRICTION), scene.pose()
    scene.pull((np.sin(angle), 0.0, -np.cos(angle)))
    scene.run(seconds)
    expected = 0.5 * GRAVITY_M_S2 * (np.sin(angle) - FRICTION * np.cos(angle)) * seconds**2
    return float(abs(scene.moved_m(before) / expected - 1.0))


def turned_deg(settings: Settings, share: float = 0.8, seconds: float = LONG_S) -> float:
    """Measure how far a gripped block turns under a share of the torque that makes it slip, degrees."""
    force = 4 * _NEEDED_N
    scene = gripped(settings, force)
    before = scene.pose()
    scene.data.xfrc_applied[1, 3] = share * 2 * TORSION_M * force
    scene.run(seconds)
    return float(np.degrees(scene.turned_rad(before)))


def slipping_error(settings: Settings) -> float:
    """Compare a gripped block's turn in 0.1 s under twice the slipping torque with theory: relative error."""
    seconds, force = 0.1, 4 * _NEEDED_N
    inertia = MASS_KG / 3 * (_UPRIGHT_M[1] ** 2 + _UPRIGHT_M[2] ** 2)
    expected = 0.5 * (2 * TORSION_M * force / inertia) * seconds**2
    return float(abs(np.radians(turned_deg(settings, 2.0, seconds)) / expected - 1.0))


def energy_gain(settings: Settings) -> float:
    """Throw a spinning block onto a floor; measure the most energy gained from one flight to a later one.

    Energy is compared while nothing touches, as that stored in a pressed contact is not counted by the engine; motion
    that is left after 5 s counts as gained too. All is relative to the first energy.
    """
    scene = on_floor(settings, 0.08)
    model, data = scene.model, scene.data
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    scene.pull((0.0, 0.0, -1.0))
    data.qvel[:] = 0.3, 0.0, 0.0, 3.0, 1.0, 2.0
    mujoco.mj_forward(model, data)
    first = lowest = float(data.energy.sum())
    gained = 0.0
    for _ in range(round(5.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
        if data.ncon == 0:
            gained = max(gained, float(data.energy.sum()) - lowest)
            lowest = min(lowest, float(data.energy.sum()))
    return max(gained, float(data.energy[1])) / first


def measure(settings: Settings) -> dict[str, float]:
    """Make every experiment of `LIMITS`."""
    return {
        "gripped_mm": gripped_mm(settings),
        "three_pads_mm": gripped_mm(settings, pads=3),
        "resting_mm": resting_mm(settings),
        "sliding_error": sliding_error(settings),
        "turned_deg": turned_deg(settings),
        "slipping_error": slipping_error(settings),
        "energy_gain": energy_gain(settings),
    }


HELD = (
    ("tripod", "box_medium"),
    ("palmar_pinch", "sphere_medium"),
    ("writing_tripod", "cylinder_medium"),
    ("parallel_extension", "box_large"),
    ("tip_pinch", "box_small"),
    ("lateral_tripod", "cylinder_large"),
)
"""What the hand holds while the cost of a step is measured."""


class StepCost:
    """Measure what one second of a held object takes, all digits simulated, on one thread."""

    def __init__(self) -> None:
        hand, sampler, step_s = load_hand("shadow"), GraspSampler.pretrained(), PAPER.physics.time_step_s
        self._whole = int(mujoco.mjtState.mjSTATE_INTEGRATION)
        self._held = []
        for kind, name in HELD:
            grasps = sampler.sample(kind, name, None, n=1, seed=1)
            world = build_world(hand, as_object(name), PAPER.physics)
            model, data = world.model, mujoco.MjData(world.model)
            order = hand.columns_in(grasps.joint_names)
            opened, closed = (world.controls(angles[0, order]) for angles in (grasps.pregrasp, grasps.posture))
            data.qpos[world.joint_qpos] = grasps.pregrasp[0, order][world.joints]
            pose, start = grasps.X_hand_object, world.object_qpos
            data.qpos[start : start + 7] = np.concatenate([pose.position_m[0], pose.quat_wxyz[0]])
            for fraction in PAPER.closing.fraction(step_s):
                data.ctrl[:] = opened + fraction * (closed - opened)
                mujoco.mj_step(model, data)
            model.opt.gravity[2] = -GRAVITY_M_S2
            state = np.empty(mujoco.mj_stateSize(model, self._whole))
            mujoco.mj_getState(model, data, state, self._whole)
            self._held.append((model, data, state))

    def measure(self, settings: Settings) -> float:
        """Measure the processor time of one step, averaged over the grasps, microseconds."""
        steps, spent = round(1.0 / settings.time_step_s), 0.0
        for model, data, state in self._held:
            settings.apply(model.opt)
            mujoco.mj_setState(model, data, state, self._whole)
            begun = time.process_time()
            for _ in range(steps):
                mujoco.mj_step(model, data)
            spent += time.process_time() - begun
        return spent / steps / len(self._held) * 1e6


@dataclass(frozen=True)
class Arguments:
    """Make the experiments with every variant of the settings."""

    repetitions: int = 5
    """Measurements of a step's cost, in turns; the fastest counts."""
    out: Path | None = None
    """JSON file to write."""


def main(arguments: Arguments) -> None:
    """Make the table."""
    cost, rows = StepCost(), list(dict.fromkeys(variants()))
    spent = [[cost.measure(settings) for settings in rows] for _ in range(arguments.repetitions)]
    fastest = np.min(spent, axis=0)
    table = []
    for settings, microseconds in zip(rows, fastest.tolist(), strict=True):
        errors = measure(settings)
        failed = [name for name, limit in LIMITS.items() if not errors[name] <= limit]
        table.append(asdict(settings) | errors | {"step_us": round(microseconds, 2), "failed": failed})
        print(table[-1], file=sys.stderr, flush=True)
    passed = [row for row in table if not row["failed"] and row["time_step_s"] == PAPER.physics.time_step_s]
    publish(
        {
            "title": "Contact settings",
            "description": "Experiments whose right answer is known, with a block of 100 g: gripped at twice the force "
            "that friction needs, by two pads and by three, for 20 s; on a slope at 95 % of the friction angle for "
            "20 s and at 120 % for 0.5 s; under 80 % of the torque that makes it slip for 20 s and under twice that "
            "torque for 0.1 s; thrown onto a floor. `step_us` is the processor time of one step of a held object with "
            "all digits, averaged over six grasps.",
            "limits": dict(LIMITS),
            "rows": table,
            "cheapest_that_passes": min(passed, key=lambda row: row["step_us"]) if passed else None,
            **environment(1),
        },
        arguments.out,
    )


if __name__ == "__main__":
    sys.exit(command("benchmarks.physics.contacts", Arguments, main))
