"""`SlotGroup`: simulations of trials, one a batch slot, that step side by side on one variant of the world."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from ...core.grasps import Grasps
from ...core.objects import CATALOGUE, GraspObject
from ...core.poses import Pose, rotate
from ...core.protocols import Conditions, Protocol
from ...hands import Hand
from ...worlds.pairs import digit_of_geoms
from ...worlds.world import OBJECT, OBJECT_FIELDS, World, object_fields, object_rows, shared_world
from .creep import CreepProjection, CreepSkipper
from .hasten import Hastener, Hastening

Slots = NDArray[np.int64]
_Addresses = tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]


class SlotGroup:
    """Hold simulations of trials, one a slot, and how far each is.

    A slot is free or holds a trial; the runner steps, checks and frees it. Slots never see each other.

    Args:
        varied: whether friction and gains may differ from slot to slot.
        reduced: see `worlds.world.build_world`.
        without: digits left out.
        creep: how the time under weight is abridged, None for not at all.
        check_steps: most steps between two checks during the shake and pushes.
        long_stretch: most steps between two checks while the hand closes and while the object carries its weight.

    Attributes:
        world: the world of the first catalogue object; slots with another object differ in their fields.
        trial: ``(n_slots,)`` which trial a slot holds, -1 for none.
        step: ``(n_slots,)`` steps done.
        centre: ``(n_slots, 3)`` where closing left the object's centre, NaN before; or what else it must stay near to.
        radius_m: ``(n_slots,)`` distance of the object's farthest point from its centre.
        cleared, slack_m: state when the clearance of left-out digits was last measured, and how far the object may move
            before it must be measured again.
    """

    def __init__(
        self,
        hand: Hand,
        protocol: Protocol,
        *,
        n_slots: int,
        n_threads: int,
        varied: bool = False,
        reduced: bool = True,
        without: tuple[str, ...] = (),
        creep: CreepProjection | Hastening | None = None,
        check_steps: int,
        long_stretch: int,
    ) -> None:
        self.protocol, self.schedule = protocol, protocol.schedule
        # The shared model is always that of the same object, whatever the batch holds: results must not depend on it.
        self.world = shared_world(hand, next(iter(CATALOGUE.values())), protocol.physics, reduced, without)
        self.batch = Batch(self.world.model, nsim=n_slots, nthread=n_threads)
        self._conditions = _ConditionFields(self.batch, self.world, hand, protocol, varied, reduced)
        self.qpos, self.qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        self.warmstart = self.batch.bind("qacc_warmstart")
        self.ctrl, self.sensors = self.batch.bind("ctrl"), self.batch.bind("sensordata")
        self.gravity, self._disabled = self.batch.expand("opt.gravity"), self.batch.expand("opt.disableflags")
        self._ramps = np.array([phase.ramp for phase in self.schedule.phases])
        self._ends = np.array(self.schedule.ends)
        self._pushes = self.batch.bind("xfrc_applied") if self.schedule.force.any() else None
        self._body = int(self.world.model.body(OBJECT).id)
        self._sensors_on = int(self.world.model.opt.disableflags)
        self._sensors_off = self._sensors_on | int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        self._disabled[:] = self._sensors_off
        self._check_steps, self._long_stretch = check_steps, long_stretch

        self.trial = np.full(n_slots, -1)
        self.step = np.zeros(n_slots, dtype=np.int64)
        self.centre = np.full((n_slots, 3), np.nan)
        self.radius_m = np.zeros(n_slots)
        self.cleared, self.slack_m = self.qpos.copy(), np.zeros(n_slots)
        start = self.world.object_qpos
        self.object_position, self.object_quat = slice(start, start + 3), slice(start + 3, start + 7)
        self._skipper: CreepSkipper | Hastener | None = None
        times: dict[str, Any] = {"time_step_s": protocol.physics.time_step_s, "stride": check_steps}
        times |= {"first_step": self.schedule.carry_begins, "last_step": self.schedule.total_steps}
        if isinstance(creep, Hastening):
            self._skipper = Hastener(creep, self.world, hand, self.batch.expand("dof_damping"), **times)
        elif creep is not None:
            self._skipper = CreepSkipper(creep, n_slots=n_slots, object_qpos=start, n_qpos=self.qpos.shape[1], **times)
        self._shared: tuple[SlotGroup, _Addresses] | None = None
        self._hand, self._object = hand, int(self.world.model.geom(OBJECT).id)
        self._digit = digit_of_geoms(self.world.model, hand)
        bodies = range(self.world.model.nbody)
        self._bodies = [self.world.model.body(body).name.removeprefix(hand.prefix) for body in bodies]
        self._scratch: tuple[Any, Any] | None = None
        """A model and a state to look at one slot, made when they are needed."""

    def aim(self, *ways: NDArray[np.float64], trials: TrialSetup) -> None:
        """Set pregrasp, contact and posture, ``(n, J)`` radians each, and the objects, for all trials to come."""
        self._trials = trials
        self._targets = np.stack([self.world.controls(angles) for angles in ways])

    @property
    def active(self) -> Slots:
        """Slots that hold a trial."""
        return np.flatnonzero(self.trial >= 0)

    @property
    def free(self) -> Slots:
        """Slots that hold none."""
        return np.flatnonzero(self.trial < 0)

    def take(self, slots: Slots, trials: NDArray[Any]) -> None:
        """Put new trials into free slots, at rest in the model's default state."""
        self.trial[slots] = trials
        self.batch.reset(ids=slots, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        for slot, trial in zip(slots.tolist(), trials.tolist(), strict=True):
            fields = self._trials.object_fields(trial)
            self._conditions.write(slot, fields, self._trials.conditions, trial)
            self.radius_m[slot] = fields["geom_rbound"][0]
        self.ctrl[slots] = self._targets[0, trials]
        self.gravity[slots] = 0.0
        self.centre[slots] = np.nan
        self.step[slots] = 0
        if self._skipper is not None:
            self._skipper.start(slots)

    def receive(self, slots: Slots, other: SlotGroup, theirs: Slots) -> None:
        """Take over trials in the middle of their course from a group whose world has all that this one has."""
        self.take(slots, other.trial[theirs])
        qpos, dofs, controls = self._addresses(other)
        self.qpos[slots] = other.qpos[theirs][:, qpos]
        self.qvel[slots] = other.qvel[theirs][:, dofs]
        self.warmstart[slots] = other.warmstart[theirs][:, dofs]
        self.ctrl[slots] = other.ctrl[theirs][:, controls]
        self.gravity[slots] = other.gravity[theirs]
        self.centre[slots], self.step[slots] = other.centre[theirs], other.step[theirs]
        other.trial[theirs] = -1

    def addresses_in(self, other: SlotGroup) -> NDArray[np.intp]:
        """Locate the entries of this group's states in those of a group whose world has all of them."""
        return self._addresses(other)[0]

    def _addresses(self, other: SlotGroup) -> _Addresses:
        if self._shared is None or self._shared[0] is not other:
            self._shared = other, _shared_addresses(self.world.model, other.world.model)
        return self._shared[1]

    def resume(self, slots: Slots, state: NDArray[np.float64], step: int, centre: NDArray[np.float64]) -> None:
        """Continue just taken trials from a saved state of this group's batch.

        `state` is a row, or ``(k, ...)`` rows, of the batch's state, `step` the steps done by then and `centre` where
        closing left the objects' centres.
        """
        self.batch.state[slots], self.step[slots], self.centre[slots] = state, step, centre

    def touching(self, slots: Slots) -> tuple[NDArray[np.bool_], NDArray[np.uint16]]:
        """Compute contacts of each digit and the palm with the object ``(k, D + 1)`` at the present state.

        With them come the areas of each digit that touch it (see `Hand.area_masks`), ``(k, D)``.
        """
        self._sense(slots)
        counts = [self.sensors[slots][:, list(adrs)].sum(axis=1) for adrs in self.world.touch_sensors]
        areas = np.zeros((len(slots), len(self._hand.digits)), dtype=np.uint16)
        for row, slot in enumerate(slots.tolist()):
            areas[row] = self._areas(slot)
        return np.stack(counts, axis=1) > 0, areas

    def _sense(self, slots: Slots) -> None:
        """Bring sensors up to date, which are off while stepping, where nobody reads them."""
        self._disabled[slots] = self._sensors_on
        self.batch.forward(ids=slots)
        self._disabled[slots] = self._sensors_off

    def _areas(self, slot: int) -> NDArray[np.uint16]:
        if self._scratch is None:
            self._scratch = copy.copy(self.world.model), mujoco.MjData(self.world.model)
        model, data = self._scratch
        self.batch.get_model(slot, model)
        self.batch.get_data(slot, data)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        pairs = data.contact.geom
        second = (self._digit[pairs[:, 1]] >= 0).astype(np.intp)
        mine, other = (pairs[np.arange(len(pairs)), place] for place in (second, 1 - second))
        touch = (self._digit[mine] >= 0) & (other == self._object)
        bodies = model.geom_bodyid[mine[touch]]
        # A contact's normal points from its first geom to its second.
        outward = data.contact.frame[touch, :3] * (1 - 2 * second[touch, None])
        normals = np.einsum("nij,ni->nj", data.xmat[bodies].reshape(-1, 3, 3), outward)
        return self._hand.area_masks([self._bodies[body] for body in bodies.tolist()], normals)

    def overlapping(self, slots: Slots) -> NDArray[np.bool_]:
        """Tell where hand and object overlap by more than the protocol allows."""
        self._sense(slots)
        adr = self.world.overlap_sensor
        return np.asarray((self.sensors[slots, adr] > 0) & (self.sensors[slots, adr + 1] < -self.protocol.overlap_m))

    def broken(self, slots: Slots) -> NDArray[np.bool_]:
        """Tell where the engine warned or the state is not finite."""
        warned = self.batch.warning[slots][:, :, 1].sum(axis=1) > 0
        finite = np.isfinite(self.qpos[slots]).all(axis=1) & np.isfinite(self.qvel[slots]).all(axis=1)
        return np.asarray(warned | ~finite)

    def moved(self, slots: Slots) -> NDArray[np.float64]:
        """Measure the distance of each object from where closing left it."""
        return np.asarray(np.linalg.norm(self.qpos[slots, self.object_position] - self.centre[slots], axis=1))

    def advance(self, slots: Slots) -> None:
        """Step slots until their next check."""
        step = self.step[slots]
        ramped = self._ramps[self.schedule.phase[step]] >= 0
        carrying = step >= self.schedule.carry_begins
        if self._pushes is not None:
            start = self._trials.X_hand_object.quat_wxyz[self.trial[slots]]
            self._pushes[slots, self._body, :3] = rotate(start, self.schedule.force[step])
        self._advance_ramped(slots[ramped])
        self._advance_shaken(slots[~ramped & ~carrying])
        self._advance_carrying(slots[carrying & ~ramped])

    def _advance_ramped(self, slots: Slots) -> None:
        place = self.schedule.phase[self.step[slots]]
        ahead = np.minimum(self._long_stretch, self._ends[place] - self.step[slots])
        for count in np.unique(ahead):
            some, ramp = slots[ahead == count], self._ramps[place[ahead == count]]
            trials = self.trial[some]
            fraction = self.schedule.fraction[self.step[some][:, None] + np.arange(count)][:, :, None]
            start, end = self._targets[ramp, trials][:, None], self._targets[ramp + 1, trials][:, None]
            controls = start + fraction * (end - start)
            self.batch.rollout(int(count), controls, int(mujoco.mjtState.mjSTATE_CTRL), record=(), ids=some)
        self.step[slots] += ahead

    def _advance_shaken(self, slots: Slots) -> None:
        if not slots.size:
            return
        for offset in range(self._check_steps):
            self.gravity[slots] = self.schedule.acceleration[self.step[slots] + offset]
            self.batch.step(ids=slots)
        self.step[slots] += self._check_steps

    def _advance_carrying(self, slots: Slots) -> None:
        # Here and not where the shake ends: a protocol may have none, and a trial may be taken up again after closing.
        self.gravity[slots[self.step[slots] == self.schedule.carry_begins]] = self.schedule.acceleration[-1]
        ahead = np.minimum(self._long_stretch, self.schedule.total_steps - self.step[slots])
        if self._skipper is not None:
            ahead = np.minimum(ahead, self._skipper.stretch(slots, self.step[slots]))
        for count in np.unique(ahead):
            self.batch.step(ids=slots[ahead == count], nstep=int(count))
        self.step[slots] += ahead

    def skip(self, slots: Slots) -> None:
        """Let trials under weight skip steps where that is wanted and due."""
        if self._skipper is None:
            return
        carrying = slots[self.step[slots] >= self.schedule.carry_begins]
        if carrying.size:
            self.step[carrying] += self._skipper.advance(carrying, self.step[carrying], self.qpos)


class TrialSetup:
    """Hold what each trial of a run is made with: its object, where that starts, and conditions where they differ."""

    def __init__(self, grasps: Grasps, start: Pose, protocol: Protocol, conditions: Conditions | None) -> None:
        self.X_hand_object, self.conditions = start, conditions
        self._objects: list[GraspObject] = [task.object for task in grasps.tasks.table]
        self._row = grasps.tasks.row
        self._physics = protocol.physics

    def object_fields(self, trial: int) -> Mapping[str, NDArray[Any]]:
        """Compute the fields of a trial's object (see `worlds.world.object_fields`)."""
        obj, about, mass_kg = self._objects[self._row[trial]], self.conditions, self._physics.object_mass_kg
        if about is None:
            return object_fields(obj, self._physics.density_factor, mass_kg=mass_kg)
        return object_fields(obj, float(about.density_factor[trial]), float(about.size_error_m[trial]), mass_kg)


class _ConditionFields:
    """Write a trial's object, friction and gains into a slot of the shared model."""

    def __init__(self, batch: Batch, world: World, hand: Hand, protocol: Protocol, varied: bool, reduced: bool) -> None:
        rows = object_rows(world.model)
        present = [name for name in OBJECT_FIELDS if rows[name].start < rows[name].stop]
        self._objects = [(name, batch.expand(name), rows[name]) for name in present]
        self._varied = varied
        if not varied:
            return
        # With explicit contact pairs, friction is theirs; else it is the geoms'.
        name, columns = ("pair_friction", slice(0, 2)) if reduced else ("geom_friction", slice(0, 1))
        self._friction, self._friction_columns = batch.expand(name), columns
        self._gain, self._bias = batch.expand("actuator_gainprm"), batch.expand("actuator_biasprm")
        fixed = protocol.physics.gain_nm_per_rad
        gains = {hand.prefix + each.name: fixed or each.gain_nm_per_rad for each in hand.actuators}
        self._own_gain = np.array([gains[world.model.actuator(number).name] for number in range(world.model.nu)])

    def write(self, slot: int, fields: Mapping[str, NDArray[Any]], about: Conditions | None, trial: int) -> None:
        for name, field, rows in self._objects:
            field[slot, rows] = fields[name]
        if self._varied and about is not None:
            self._friction[slot, :, self._friction_columns] = about.friction[trial]
            self._gain[slot, :, 0] = self._own_gain * about.gain_factor[trial]
            self._bias[slot, :, 1] = -self._own_gain * about.gain_factor[trial]


def _shared_addresses(model: Any, larger: Any) -> _Addresses:
    """Locate the entries of the smaller model's qpos, qvel and ctrl in those of the larger one, in its order."""
    qpos, dofs = np.empty(model.nq, dtype=np.intp), np.empty(model.nv, dtype=np.intp)
    for number in range(model.njnt):
        joint = model.joint(number)
        theirs = larger.joint(joint.name)
        free = model.jnt_type[number] == mujoco.mjtJoint.mjJNT_FREE
        angles, speeds = np.arange(7 if free else 1), np.arange(6 if free else 1)
        qpos[joint.qposadr[0] + angles] = theirs.qposadr[0] + angles
        dofs[joint.dofadr[0] + speeds] = theirs.dofadr[0] + speeds
    controls = np.array([larger.actuator(model.actuator(i).name).id for i in range(model.nu)], dtype=np.intp)
    return qpos, dofs, controls
