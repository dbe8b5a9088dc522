"""A lane: the slots that step side by side on one variant of the scene."""

from __future__ import annotations

from functools import lru_cache
from threading import Lock
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch
from numpy.typing import NDArray

from ..hands import HandDescription
from ..objects import CATALOGUE, grasp_object
from .creep import CreepProjection, Leaper
from .protocol import Protocol
from .scene import OBJECT, Scene, build_scene

Slots = NDArray[np.int64]
_Addresses = tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]


class Lane:
    """Hold simulations of trials, one a slot, and what each is at.

    A slot is free or holds a trial; it is stepped, looked at and freed by the runner. Slots never see each other.

    Attributes:
        scene: the scene of the first catalogue object; slots with another object differ in their fields.
        trial: ``(n_slots,)`` which trial a slot holds, -1 for none.
        step: ``(n_slots,)`` steps done.
        centre: ``(n_slots, 3)`` where closing left the object's centre, NaN before.
        seen, slack_m: state when the clearance of left-out digits was last measured, and how far the object may move
            before it must be measured again.
    """

    def __init__(
        self,
        hand: HandDescription,
        protocol: Protocol,
        labels: list[str],
        *,
        n_slots: int,
        n_threads: int,
        reduced: bool = True,
        without: tuple[str, ...] = (),
        creep: CreepProjection | None = None,
        check_steps: int,
        long_stretch: int,
    ) -> None:
        self.protocol = protocol
        self.scenes = {label: trial_scene(hand, label, protocol, reduced, without) for label in labels}
        # The shared model is always that of the same object, whatever the batch holds: results must not depend on it.
        self.scene = trial_scene(hand, next(iter(CATALOGUE)), protocol, reduced, without)
        self.batch = Batch(self.scene.model, nsim=n_slots, nthread=n_threads)
        self._objects = _ObjectFields(self.batch, self.scenes, self.scene)
        self.qpos, self.qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        self.warmstart = self.batch.bind("qacc_warmstart")
        self.ctrl, self.sensors = self.batch.bind("ctrl"), self.batch.bind("sensordata")
        self.gravity, self._disabled = self.batch.expand("opt.gravity"), self.batch.expand("opt.disableflags")
        self._sensors_on = int(self.scene.model.opt.disableflags)
        self._sensors_off = self._sensors_on | int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        self._disabled[:] = self._sensors_off
        self._check_steps, self._long_stretch = check_steps, long_stretch
        self._weight_begins = protocol.closing_steps + protocol.shake_steps

        self.trial = np.full(n_slots, -1)
        self.step = np.zeros(n_slots, dtype=np.int64)
        self.centre = np.full((n_slots, 3), np.nan)
        self.seen, self.slack_m = self.qpos.copy(), np.zeros(n_slots)
        start = self.scene.object_qpos
        self.object_position, self.object_quat = slice(start, start + 3), slice(start + 3, start + 7)
        self._leaper = None if creep is None else self._make_leaper(creep)
        self._shared: tuple[Lane, _Addresses] | None = None

    def _make_leaper(self, creep: CreepProjection) -> Leaper:
        return Leaper(
            creep,
            time_step_s=self.protocol.time_step_s,
            stride=self._check_steps,
            n_slots=len(self.trial),
            first_step=self._weight_begins,
            last_step=self.protocol.total_steps,
            object_qpos=self.scene.object_qpos,
            n_qpos=self.qpos.shape[1],
        )

    def aim(self, pregrasp: NDArray[np.float64], posture: NDArray[np.float64], labels: NDArray[Any]) -> None:
        """Set what the hand closes from and to, ``(n, J)`` radians, and on which objects, for all trials to come."""
        self._labels = labels
        low, high = self.scene.model.actuator_ctrlrange.T
        self._control_from, self._control_to = (
            np.clip(angles @ self.scene.control_map, low, high) for angles in (pregrasp, posture)
        )

    @property
    def active(self) -> Slots:
        """List the slots that hold a trial."""
        return np.flatnonzero(self.trial >= 0)

    @property
    def free(self) -> Slots:
        """List the slots that hold none."""
        return np.flatnonzero(self.trial < 0)

    def take(self, slots: Slots, trials: NDArray[Any]) -> None:
        """Give free slots new trials, at rest in the model's default state."""
        self.trial[slots] = trials
        self.batch.reset(ids=slots, stage=int(mujoco.mjtStage.mjSTAGE_NONE))
        for slot, label in zip(slots, self._labels[trials], strict=True):
            self._objects.write(slot, str(label))
        self.ctrl[slots] = self._control_from[trials]
        self.gravity[slots] = 0.0
        self.centre[slots] = np.nan
        self.step[slots] = 0
        if self._leaper is not None:
            self._leaper.start(slots)

    def receive(self, slots: Slots, other: Lane, theirs: Slots) -> None:
        """Take over trials in the middle of their course from a lane whose scene has all that this one has."""
        self.take(slots, other.trial[theirs])
        qpos, dofs, controls = self._addresses(other)
        self.qpos[slots] = other.qpos[theirs][:, qpos]
        self.qvel[slots] = other.qvel[theirs][:, dofs]
        self.warmstart[slots] = other.warmstart[theirs][:, dofs]
        self.ctrl[slots] = other.ctrl[theirs][:, controls]
        self.gravity[slots] = other.gravity[theirs]
        self.centre[slots], self.step[slots] = other.centre[theirs], other.step[theirs]
        other.trial[theirs] = -1

    def addresses_in(self, other: Lane) -> NDArray[np.intp]:
        """Give where the entries of this lane's states stand in those of a lane whose scene has all of them."""
        return self._addresses(other)[0]

    def _addresses(self, other: Lane) -> _Addresses:
        if self._shared is None or self._shared[0] is not other:
            self._shared = other, _shared_addresses(self.scene.model, other.scene.model)
        return self._shared[1]

    def resume(self, slots: Slots, state: NDArray[np.float64], step: int, centre: NDArray[np.float64]) -> None:
        """Continue just taken trials from a saved state of this lane's batch.

        Args:
            slots: ``(k,)``.
            state: a row, or ``(k, ...)`` rows, of the batch's state.
            step: steps done by then.
            centre: where closing left the objects' centres.
        """
        self.batch.state[slots], self.step[slots], self.centre[slots] = state, step, centre

    def touching(self, slots: Slots) -> NDArray[np.bool_]:
        """Compute contacts ``(k, 6)`` with the object at the present state.

        Contact sensors are off while stepping, where nobody reads them.
        """
        self._disabled[slots] = self._sensors_on
        self.batch.forward(ids=slots)
        self._disabled[slots] = self._sensors_off
        counts = [self.sensors[slots][:, list(adrs)].sum(axis=1) for adrs in self.scene.touch_sensors]
        return np.stack(counts, axis=1) > 0

    def overlapping(self, slots: Slots) -> NDArray[np.bool_]:
        """Tell where hand and object overlap by more than the protocol allows."""
        self.touching(slots)
        adr = self.scene.overlap_sensor
        return np.asarray((self.sensors[slots, adr] > 0) & (self.sensors[slots, adr + 1] < -self.protocol.overlap_m))

    def broken(self, slots: Slots) -> NDArray[np.bool_]:
        """Tell where the engine warned or the state is not finite."""
        warned = self.batch.warning[slots][:, :, 1].sum(axis=1) > 0
        finite = np.isfinite(self.qpos[slots]).all(axis=1) & np.isfinite(self.qvel[slots]).all(axis=1)
        return np.asarray(warned | ~finite)

    def moved(self, slots: Slots) -> NDArray[np.float64]:
        """Give the distance of each object from where closing left it."""
        return np.asarray(np.linalg.norm(self.qpos[slots, self.object_position] - self.centre[slots], axis=1))

    def advance(self, slots: Slots) -> None:
        """Step slots until their next look."""
        step = self.step[slots]
        closing = step < self.protocol.closing_steps
        weighted = step >= self._weight_begins
        self._advance_closing(slots[closing])
        self._advance_shaken(slots[~closing & ~weighted])
        self._advance_weighted(slots[weighted])

    def _advance_closing(self, slots: Slots) -> None:
        ahead = np.minimum(self._long_stretch, self.protocol.closing_steps - self.step[slots])
        for count in np.unique(ahead):
            some = slots[ahead == count]
            trials = self.trial[some]
            fraction = self.protocol.closing_fraction[self.step[some][:, None] + np.arange(count)][:, :, None]
            start, end = self._control_from[trials][:, None], self._control_to[trials][:, None]
            controls = start + fraction * (end - start)
            self.batch.rollout(int(count), controls, int(mujoco.mjtState.mjSTATE_CTRL), record=(), ids=some)
        self.step[slots] += ahead

    def _advance_shaken(self, slots: Slots) -> None:
        if not slots.size:
            return
        for offset in range(self._check_steps):
            self.gravity[slots] = self.protocol.gravity[self.step[slots] + offset]
            self.batch.step(ids=slots)
        self.step[slots] += self._check_steps

    def _advance_weighted(self, slots: Slots) -> None:
        # Here and not where the shake ends: a protocol may have none, and a trial may be taken up again after closing.
        self.gravity[slots[self.step[slots] == self._weight_begins]] = self.protocol.gravity[-1]
        ahead = np.minimum(self._long_stretch, self.protocol.total_steps - self.step[slots])
        if self._leaper is not None:
            ahead = np.minimum(ahead, self._leaper.stretch(slots, self.step[slots]))
        for count in np.unique(ahead):
            self.batch.step(ids=slots[ahead == count], nstep=int(count))
        self.step[slots] += ahead

    def leap(self, slots: Slots) -> None:
        """Let states under weight leap along their creep where that is wanted and due."""
        if self._leaper is None:
            return
        weighted = slots[self.step[slots] >= self._weight_begins]
        if weighted.size:
            self.step[weighted] += self._leaper.advance(weighted, self.step[weighted], self.qpos)


class _ObjectFields:
    """Write an object's shape, mass and inertia into a slot of the shared model.

    All scenes of a lane differ in the object alone, so the fields in which their compiled models differ are exactly
    what a slot must take over when it gets a new object.
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


def _shared_addresses(model: Any, larger: Any) -> _Addresses:
    """Give where in the larger model's qpos, qvel and ctrl the entries of the smaller one stand, in its order."""
    qpos, dofs = np.empty(model.nq, dtype=np.intp), np.empty(model.nv, dtype=np.intp)
    for number in range(model.njnt):
        joint = model.joint(number)
        theirs = larger.joint(joint.name)
        free = joint.name == OBJECT
        widths = (7, 6) if free else (1, 1)
        for found, at, there, width in zip(
            (qpos, dofs),
            (joint.qposadr[0], joint.dofadr[0]),
            (theirs.qposadr[0], theirs.dofadr[0]),
            widths,
            strict=True,
        ):
            found[at : at + width] = np.arange(there, there + width)
    controls = np.array([larger.actuator(model.actuator(i).name).id for i in range(model.nu)], dtype=np.intp)
    return qpos, dofs, controls


_compiling = Lock()


def trial_scene(
    hand: HandDescription, label: str, protocol: Protocol, reduced: bool, without: tuple[str, ...] = ()
) -> Scene:
    """Build a scene, or give the one built before from the same arguments."""
    # Threads start together and need the same scenes: the second waits for what the first compiles.
    with _compiling:
        return _scene(hand, label, protocol, reduced, without)


@lru_cache(maxsize=128)
def _scene(hand: HandDescription, label: str, protocol: Protocol, reduced: bool, without: tuple[str, ...]) -> Scene:
    return build_scene(hand, grasp_object(label), protocol, reduced=reduced, without=without)
