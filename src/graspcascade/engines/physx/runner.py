"""The PhysX engine: one trial after the other, each in a scene of its own."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from importlib.metadata import version
from math import gcd
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...core.errors import InputError
from ...core.grasps import Grasps
from ...core.objects import CATALOGUE
from ...core.outcomes import Outcomes
from ...core.poses import canonical_quat, quat_multiply, rotation_angle
from ...core.protocols import Conditions, Protocol
from ...hands import Hand
from ...worlds.world import object_fields, object_rows, shared_world
from .. import Engine, Observer, Progress, check_trials, is_opposed
from .scene import Scene, load_sapien

CHECK_STEPS = 5
"""Most steps between two checks of the object."""


@dataclass(frozen=True)
class PhysxEngine(Engine):
    """Run trials in PhysX on one processor.

    Of a protocol's physics it has no use for the numbers of MuJoCo's contacts: `contact_time_constant_s`, `impratio`
    and `noslip_iterations`.

    Attributes:
        n_threads: 0 or 1: trials run one at a time, and only processes run side by side.

    Raises:
        InputError: PhysX is not installed, or more threads are asked for.
    """

    name: ClassVar[str] = "physx"
    n_threads: int = 1

    def __post_init__(self) -> None:
        if self.n_threads not in (0, 1):
            raise InputError(f"engine physx has one thread, got {self.n_threads}; several processes run side by side")
        load_sapien()

    @property
    def versions(self) -> dict[str, str]:  # noqa: D102 (of Engine)
        return {"sapien": version("sapien")}

    def run(
        self,
        hand: Hand,
        grasps: Grasps,
        protocol: Protocol,
        conditions: Conditions | None = None,
        *,
        observe: Observer | None = None,
        progress: Progress | None = None,
    ) -> Outcomes:
        """Execute every grasp (see `Engine.run`).

        Raises:
            InputError: grasps or conditions that cannot be tried (see `check_trials`), a hand that cannot be converted
                (see `Scene`), or a protocol that pushes, limits turns or has joints with dry friction.
        """
        parts = {
            "pushes": protocol.schedule.force.any(),
            "a squeeze or a contact found before": protocol.contact_by is not None
            or any(phase.ramp > 0 for phase in protocol.phases),
            "limits of turns": protocol.turn_rad is not None,
            "dry friction of joints": protocol.physics.joint_friction_nm,
        }
        if lacking := [name for name, there in parts.items() if there]:
            asked = f"what protocol {protocol.name} asks for: {', '.join(lacking)}"
            raise InputError(f"engine physx cannot do {asked}; try it with engine mujoco")
        check_trials(grasps, hand, protocol, conditions)
        runner = _Runner(hand, grasps, protocol, conditions, observe)
        for trial in range(len(grasps)):
            runner.run(trial)
            if progress is not None:
                progress(1)
        return runner.outcomes


class _Runner:
    """Run the trials of a batch in any order."""

    def __init__(
        self,
        hand: Hand,
        grasps: Grasps,
        protocol: Protocol,
        conditions: Conditions | None,
        observe: Observer | None,
    ) -> None:
        self.hand, self.protocol, self.observe = hand, protocol, observe
        self.outcomes = Outcomes.blank(len(grasps), len(hand.joint_names), tuple(hand.digits))
        self.world = shared_world(hand, next(iter(CATALOGUE.values())), protocol.physics, True)
        self.conditions = Conditions.of(protocol.physics, len(grasps)) if conditions is None else conditions
        self.objects = [task.object for task in grasps.tasks]
        order = hand.columns_in(grasps.joint_names)
        self.to_grasps = np.argsort(order)
        self.pregrasp = hand.clip(grasps.pregrasp[:, order])
        self.control_from = self.world.controls(self.pregrasp)
        self.control_to = self.world.controls(grasps.posture[:, order])
        pose, turn = grasps.X_hand_object, self.conditions.rotation_error_quat_wxyz
        self.start_m = pose.position_m + self.conditions.position_error_m
        self.start_quat = quat_multiply(turn, pose.quat_wxyz)
        self.check = gcd(CHECK_STEPS, *protocol.schedule.ends)
        # Overlap is a matter of geometry: MuJoCo's measure of it is exact and the same for both engines.
        self.measured = copy.copy(self.world.model)
        self.measuring = mujoco.MjData(self.measured)

    def run(self, trial: int) -> None:
        """Run a trial and write down its outcome."""
        outcomes, schedule, about = self.outcomes, self.protocol.schedule, self.conditions
        density, size = float(about.density_factor[trial]), float(about.size_error_m[trial])
        fields = object_fields(self.objects[trial], density, size, self.protocol.physics.object_mass_kg)
        if self._overlap_m(trial, fields) > self.protocol.overlap_m:
            outcomes.verdict[trial] = "overlap"
            return
        physics = self.protocol.physics
        scene = Scene(
            self.world,
            self.hand,
            physics,
            fields,
            friction=float(about.friction[trial]),
            gain_factor=float(about.gain_factor[trial]) / physics.gain_factor,
            gravity=schedule.acceleration[-1],
        )
        scene.place(self.pregrasp[trial], self.start_m[trial], self.start_quat[trial])
        start, end = self.control_from[trial], self.control_to[trial]
        verdict = settled = None
        for step, acceleration in enumerate(schedule.acceleration, 1):
            closing = step <= schedule.closing_steps
            scene.step(start + schedule.fraction[step - 1] * (end - start) if closing else end, acceleration)
            if step % self.check:
                continue
            pose = scene.object_pose
            if self.observe is not None:
                self._show(self.observe, scene, trial, step, pose)
            if not (np.isfinite(pose).all() and np.isfinite(scene.angles).all()):
                verdict = "unstable"
            elif step == schedule.closing_steps:
                settled, verdict = pose, self._judge_closing(scene, trial, pose)
            elif settled is not None and np.linalg.norm(pose[:3] - settled[:3]) > self.protocol.displacement_m:
                verdict = str(schedule.lost(np.array([step]))[0])
            elif step == schedule.total_steps:
                touching, areas = scene.touching()
                verdict = "held" if is_opposed(touching[None], outcomes.digits)[0] else "dropped"
                if verdict == "held":
                    outcomes.touching_end[trial], outcomes.areas_end[trial] = touching, areas
            if verdict is not None:
                break
        outcomes.verdict[trial] = verdict
        outcomes.duration_s[trial] = step * physics.time_step_s
        if settled is not None:
            outcomes.displacement_m[trial] = np.linalg.norm(pose[:3] - settled[:3])
            outcomes.turn_rad[trial] = rotation_angle(settled[3:], pose[3:])

    def _judge_closing(self, scene: Scene, trial: int, pose: NDArray[np.float64]) -> str | None:
        """Record the settled state; name the verdict if the trial ends here."""
        outcomes, angles, (touching, areas) = self.outcomes, scene.angles, scene.touching()
        outcomes.touching_closed[trial], outcomes.areas_closed[trial] = touching, areas
        outcomes.settled_posture[trial] = angles[self.to_grasps]
        outcomes.object_size_m[trial] = self.hand.tip_distance(angles)[0]
        outcomes.X_hand_object_settled.position_m[trial] = pose[:3]
        outcomes.X_hand_object_settled.quat_wxyz[trial] = canonical_quat(pose[3:])
        return None if is_opposed(touching[None], outcomes.digits)[0] else "missed"

    def _overlap_m(self, trial: int, fields: Any) -> float:
        model, data = self.measured, self.measuring
        for name, rows in object_rows(model).items():
            if rows.start < rows.stop:
                getattr(model, name)[rows] = fields[name]
        start, sensor = self.world.object_qpos, self.world.overlap_sensor
        data.qpos[self.world.joint_qpos] = self.pregrasp[trial]
        data.qpos[start : start + 7] = [*self.start_m[trial], *self.start_quat[trial]]
        mujoco.mj_forward(model, data)
        return -float(data.sensordata[sensor + 1]) if data.sensordata[sensor] > 0 else 0.0

    def _show(self, observe: Observer, scene: Scene, trial: int, step: int, pose: NDArray[np.float64]) -> None:
        observe(np.array([trial]), np.array([step]), scene.angles[None, self.to_grasps], pose[None])
