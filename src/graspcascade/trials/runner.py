"""The MuJoCo runner: many trials at once in slots that are refilled as soon as a trial is decided."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache
from math import gcd
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch
from numpy.typing import NDArray

from ..errors import InputError
from ..grasps import Grasps
from ..hands import SHADOW_HAND, HandDescription, load_hand
from ..objects import CATALOGUE, grasp_object
from ..poses import canonical_quat
from ..taxonomy import DIGITS
from .outcomes import Outcomes
from .protocol import PAPER, Protocol
from .scene import Scene, build_scene

_THUMB = DIGITS.index("thumb")
CHECK_STEPS = 5
"""Most steps between two looks at the object; a trial is decided within this many steps of what decides it."""

Progress = Callable[[int], None]
Observer = Callable[[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]], None]


def run(
    grasps: Grasps,
    protocol: Protocol = PAPER,
    *,
    hand: HandDescription = SHADOW_HAND,
    n_threads: int = 0,
    n_slots: int = 256,
    reduced: bool = True,
    observe: Observer | None = None,
    progress: Progress | None = None,
) -> Outcomes:
    """Execute every grasp in physics.

    Each trial is independent of the others, so outcomes do not depend on threads, slots or order.

    Args:
        grasps: what to execute; joints are matched by name.
        protocol: what is done and what counts.
        hand: the hand to execute with.
        n_threads: simulation threads, 0 for all processors.
        n_slots: trials in flight.
        reduced: see `build_scene`.
        observe: called every `CHECK_STEPS` steps with the rows being simulated ``(k,)``, their step counts ``(k,)``,
            joint angles ``(k, J)`` in the order of the grasps' joints, and object poses ``(k, 7)`` (position, wxyz).
        progress: called with the number of trials decided since the last call.

    Returns:
        Outcomes in the order of the grasps.
    """
    outcomes = Outcomes.blank(len(grasps), len(hand.joint_names))
    if len(grasps):
        runner = _Runner(grasps, protocol, hand, n_threads, min(n_slots, len(grasps)), reduced, observe, outcomes)
        runner.run(progress)
    return outcomes


@lru_cache(maxsize=64)
def _scene(hand_key: _ByName, label: str, protocol: Protocol, reduced: bool) -> Scene:
    return build_scene(hand_key.hand, grasp_object(label), protocol, reduced=reduced)


class _ByName:
    """Make a hand description, which holds dictionaries, usable as a cache key."""

    def __init__(self, hand: HandDescription) -> None:
        self.hand = hand

    def __hash__(self) -> int:
        return hash((self.hand.name, self.hand.mjcf, self.hand.prefix))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ByName) and self.hand == other.hand


class _ObjectFields:
    """Write an object's shape, mass and inertia into a slot of the shared model.

    All scenes differ in the object alone, so the fields in which their compiled models differ are exactly what a slot
    must take over when it gets a new object.
    """

    def __init__(self, batch: Batch, scenes: dict[str, Scene], base: Scene) -> None:
        names = [
            name
            for name in sorted(MODEL_FIELDS)
            if "." not in name
            and any(
                not np.array_equal(getattr(scene.model, name), getattr(base.model, name)) for scene in scenes.values()
            )
        ]
        self._fields = [batch.expand(name) for name in names]
        self._values = {label: [getattr(scene.model, name).copy() for name in names] for label, scene in scenes.items()}

    def write(self, slot: int, label: str) -> None:
        for field, value in zip(self._fields, self._values[label], strict=True):
            # Of a hand with meshes the batch keeps only the bodies' bounding volumes, which come first.
            field[slot] = value.reshape(-1)[: field[slot].size].reshape(field[slot].shape)


def _opposed(touching: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell where the thumb and at least one finger touch the object."""
    fingers = [place for place in range(len(DIGITS)) if place != _THUMB]
    return touching[:, _THUMB] & touching[:, fingers].any(axis=1)


class _Runner:
    def __init__(
        self,
        grasps: Grasps,
        protocol: Protocol,
        hand: HandDescription,
        n_threads: int,
        n_slots: int,
        reduced: bool,
        observe: Observer | None,
        outcomes: Outcomes,
    ) -> None:
        self.observe = observe
        self.grasps, self.protocol, self.outcomes = grasps, protocol, outcomes
        self.hand_model = load_hand(hand)
        key = _ByName(hand)
        labels = sorted(set(grasps.object_label.tolist()))
        scenes = {label: _scene(key, label, protocol, reduced) for label in labels}
        # The shared model is always that of the same object, whatever the batch holds: results must not depend on it.
        self.scene = _scene(key, next(iter(CATALOGUE)), protocol, reduced)
        self.batch = Batch(self.scene.model, nsim=n_slots, nthread=n_threads)
        self.objects = _ObjectFields(self.batch, scenes, self.scene)
        self.qpos, self.qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        self.ctrl, self.sensors = self.batch.bind("ctrl"), self.batch.bind("sensordata")
        self.gravity, self.disabled = self.batch.expand("opt.gravity"), self.batch.expand("opt.disableflags")
        self._sensors_off = int(self.scene.model.opt.disableflags) | int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        self._sensors_on = int(self.scene.model.opt.disableflags)
        self.disabled[:] = self._sensors_off

        # A look must fall on the end of every phase, whatever the time step.
        self.check_steps = gcd(CHECK_STEPS, protocol.closing_steps, protocol.shake_steps, protocol.total_steps)
        absent = [name for name in hand.joint_names if name not in grasps.joint_names]
        if absent:
            raise InputError(f"the grasps lack joints of {hand.name}: {', '.join(absent)}")
        foreign = [name for name in grasps.joint_names if name not in hand.joint_names]
        if foreign:
            raise InputError(f"{hand.name} has no joints {', '.join(foreign)}")
        order = [list(grasps.joint_names).index(name) for name in hand.joint_names]
        self.to_grasps = np.argsort(order)
        self.pregrasp = self.hand_model.clip(grasps.pregrasp[:, order])
        limits = self.scene.model.actuator_ctrlrange
        self.control_from = np.clip(self.pregrasp @ self.scene.control_map, limits[:, 0], limits[:, 1])
        target = grasps.posture[:, order] @ self.scene.control_map
        self.control_to = np.clip(target, limits[:, 0], limits[:, 1])

        self.trial = np.full(n_slots, -1)
        self.step = np.zeros(n_slots, dtype=np.int64)
        self.centre = np.zeros((n_slots, 3))
        self.object_slice = slice(self.scene.object_qpos, self.scene.object_qpos + 3)

    def run(self, progress: Progress | None) -> None:
        queue = iter(range(len(self.grasps)))
        self._fill(np.arange(len(self.trial)), queue, progress)
        while (active := np.flatnonzero(self.trial >= 0)).size:
            self._advance(active)
            if self.observe is not None:
                self._show(self.observe, active)
            decided = self._judge(active)
            if decided.size:
                if progress is not None:
                    progress(len(decided))
                self._fill(decided, queue, progress)

    def _fill(self, slots: NDArray[Any], queue: Iterable[int], progress: Progress | None) -> None:
        """Load the next trials into free slots; those that start in overlap are decided at once and replaced."""
        free = slots
        while free.size:
            loaded = []
            for slot, trial in zip(free, queue, strict=False):
                self.trial[slot] = trial
                loaded.append(slot)
            # zip takes a slot before it finds the queue empty, so the rest is found by counting.
            self.trial[free[len(loaded) :]] = -1
            if not loaded:
                return
            free = self._load(np.array(loaded))
            if free.size and progress is not None:
                progress(len(free))

    def _load(self, slots: NDArray[Any]) -> NDArray[Any]:
        """Place hand and object at the start; return the slots whose trial failed by overlap."""
        trials = self.trial[slots]
        self.batch.reset(ids=slots, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        for slot, trial in zip(slots, trials, strict=True):
            self.objects.write(slot, str(self.grasps.object_label[trial]))
        self.gravity[slots] = 0.0
        self.centre[slots] = np.nan
        self.step[slots] = 0
        rows = slots[:, None]
        self.qpos[rows, self.scene.joint_qpos] = self.pregrasp[trials]
        pose = self.grasps.X_hand_object
        start = self.scene.object_qpos
        self.qpos[rows, np.arange(start, start + 3)] = pose.position_m[trials]
        self.qpos[rows, np.arange(start + 3, start + 7)] = pose.quat_wxyz[trials]
        self.ctrl[slots] = self.control_from[trials]
        self._read_contacts(slots)
        adr = self.scene.overlap_sensor
        overlap = (self.sensors[slots, adr] > 0) & (self.sensors[slots, adr + 1] < -self.protocol.overlap_m)
        failed = np.asarray(slots[overlap])
        self._decide(failed, np.full(len(failed), "overlap"))
        return failed

    def _read_contacts(self, slots: NDArray[Any]) -> NDArray[np.bool_]:
        """Compute contacts at the present state; contact sensors are off while stepping, where nobody reads them."""
        self.disabled[slots] = self._sensors_on
        self.batch.forward(ids=slots)
        self.disabled[slots] = self._sensors_off
        counts = [self.sensors[slots][:, list(adrs)].sum(axis=1) for adrs in self.scene.touch_sensors]
        return np.stack(counts, axis=1) > 0

    def _advance(self, active: NDArray[Any]) -> None:
        """Step every active slot `check_steps` times, with per-step inputs only where they change."""
        first_constant = self.protocol.closing_steps + self.protocol.shake_steps
        steady = self.step[active] >= first_constant
        if steady.any():
            self.batch.step(ids=active[steady], nstep=self.check_steps)
        moving = active[~steady]
        if moving.size:
            trials = self.trial[moving]
            start, change = self.control_from[trials], self.control_to[trials] - self.control_from[trials]
            for offset in range(self.check_steps):
                step = self.step[moving] + offset
                self.ctrl[moving] = start + self.protocol.closing_fraction[step][:, None] * change
                self.gravity[moving] = self.protocol.gravity[step]
                self.batch.step(ids=moving)
        self.step[active] += self.check_steps
        entering = active[self.step[active] == first_constant]
        if entering.size:
            self.gravity[entering] = self.protocol.gravity[-1]

    def _show(self, observe: Observer, active: NDArray[Any]) -> None:
        start = self.scene.object_qpos
        posture = self.qpos[active][:, self.scene.joint_qpos][:, self.to_grasps]
        observe(self.trial[active], self.step[active], posture, self.qpos[active, start : start + 7])

    def _judge(self, active: NDArray[Any]) -> NDArray[Any]:
        """Decide what can be decided; return the slots that became free."""
        closing, total = self.protocol.closing_steps, self.protocol.total_steps
        warned = self.batch.warning[active][:, :, 1].sum(axis=1) > 0
        broken = warned | ~(np.isfinite(self.qpos[active]).all(axis=1) & np.isfinite(self.qvel[active]).all(axis=1))
        self._decide(active[broken], np.full(int(broken.sum()), "unstable"))
        sound = active[~broken]

        missed = self._judge_closing(sound[self.step[sound] == closing])
        held = sound[self.step[sound] > closing]
        away = np.linalg.norm(self.qpos[held, self.object_slice] - self.centre[held], axis=1)
        gone = held[away > self.protocol.displacement_m]
        shaking = self.step[gone] <= closing + self.protocol.shake_steps
        self._decide(gone, np.where(shaking, "shaken_out", "dropped"))

        finished = held[(self.step[held] >= total) & (away <= self.protocol.displacement_m)]
        if finished.size:
            touching = self._read_contacts(finished)
            success = _opposed(touching)
            self.outcomes.touching_end[self.trial[finished]] = touching & success[:, None]
            self._decide(finished, np.where(success, "held", "dropped"))
        return np.sort(np.concatenate([active[broken], missed, gone, finished]))

    def _judge_closing(self, slots: NDArray[Any]) -> NDArray[Any]:
        """Record the settled state of trials that just closed; return those that missed the object."""
        if not slots.size:
            return slots
        touching = self._read_contacts(slots)
        trials = self.trial[slots]
        settled = self.qpos[slots][:, self.scene.joint_qpos]
        self.centre[slots] = self.qpos[slots, self.object_slice]
        self.outcomes.touching_closed[trials] = touching
        self.outcomes.settled_posture[trials] = settled[:, self.to_grasps]
        self.outcomes.object_size_m[trials] = self.hand_model.tip_distance(settled)
        self.outcomes.X_hand_object_settled.position_m[trials] = self.centre[slots]
        start = self.scene.object_qpos
        quat = self.qpos[slots][:, start + 3 : start + 7]
        self.outcomes.X_hand_object_settled.quat_wxyz[trials] = canonical_quat(quat)
        missed = slots[~_opposed(touching)]
        self._decide(missed, np.full(len(missed), "missed"))
        return missed

    def _decide(self, slots: NDArray[Any], verdicts: NDArray[Any]) -> None:
        """Write the verdicts of slots whose trial is over and free them."""
        trials = self.trial[slots]
        self.outcomes.verdict[trials] = verdicts
        self.outcomes.duration_s[trials] = self.step[slots] * self.protocol.time_step_s
        closed = self.step[slots] >= self.protocol.closing_steps
        moved = np.linalg.norm(self.qpos[slots, self.object_slice] - self.centre[slots], axis=1)
        self.outcomes.displacement_m[trials[closed]] = moved[closed]
        self.trial[slots] = -1
