"""The MuJoCo engine: many trials at once in batch slots that are refilled as soon as a trial is decided."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from math import gcd
from threading import Event, Lock
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ...core.errors import InputError
from ...core.grasps import Grasps
from ...core.machine import processors
from ...core.outcomes import Outcomes
from ...core.poses import Pose, canonical_quat, quat_multiply, rotation_angle
from ...core.protocols import Conditions, Protocol
from ...hands import Hand
from .. import Engine, Observer, Progress, check_trials, is_opposed
from .creep import FAST_FORWARD, CreepProjection
from .hasten import HASTENED, Hastening
from .idle import Idle, IdleFinder, idle_sets, object_moved
from .quiet import quiet_engine
from .slots import SlotGroup, Slots, TrialSetup

CHECK_STEPS = 5
"""Most steps between two checks of the object during shake and pushes, and always with an observer or limited turns."""
LONG_STRETCH = 25
"""Most steps between two checks while the hand closes and while the object carries its weight."""


@dataclass(frozen=True)
class MujocoEngine(Engine):
    """Run trials in MuJoCo on the processors of this machine.

    Attributes:
        n_threads: simulation threads, 0 for all processors.
        n_slots: trials in flight.
        reduced: see `worlds.world.build_world`.
        creep: how the time under weight is abridged; None computes every step, as every quoted rate asks for.
    """

    name: ClassVar[str] = "mujoco"
    n_threads: int = 0
    n_slots: int = 1024
    reduced: bool = True
    creep: CreepProjection | Hastening | None = None

    @property
    def abridged(self) -> dict[str, Any] | None:  # noqa: D102 (of Engine)
        return None if self.creep is None else asdict(self.creep)

    def on_one_thread(self) -> MujocoEngine:  # noqa: D102 (of Engine)
        return replace(self, n_threads=1)

    def abridging(self, protocol: Protocol) -> MujocoEngine:  # noqa: D102 (of Engine)
        if not protocol.phases[-1].steady:
            return self
        return replace(self, creep=HASTENED if protocol.physics.noslip_iterations else FAST_FORWARD)

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

        Each trial is independent of the others, so outcomes do not depend on threads, slots or order.

        Raises:
            InputError: grasps or conditions that cannot be tried (see `check_trials`), or an abridged trial is to be
                observed.
        """
        if self.creep is not None and observe is not None:
            raise InputError("an abridged trial cannot be observed; give creep=None")
        if self.n_threads < 0 or self.n_slots < 1:
            raise InputError(f"threads must be at least 0 and slots at least 1, got {self.n_threads}, {self.n_slots}")
        check_trials(grasps, hand, protocol, conditions)
        # One runner a thread: what each does between steps goes on while the others step. An observer has one.
        n_runners = 1 if observe is not None else max(1, min(self.n_threads or processors(), len(grasps)))
        shares = [np.arange(first, len(grasps), n_runners) for first in range(n_runners)]
        report = None if progress is None else _Counter(progress)
        stop = Event()

        def execute(rows: NDArray[np.int64]) -> Outcomes:
            outcomes = Outcomes.blank(len(rows), len(hand.joint_names), tuple(hand.digits))
            if not len(rows):
                return outcomes
            threads = self.n_threads if n_runners == 1 else 1
            slots = min(-(-self.n_slots // n_runners), len(rows))
            mine, some = None if conditions is None else conditions[rows], grasps[rows]
            try:
                if protocol.contact_by is None:
                    _Runner(self, some, protocol, hand, mine, threads, slots, observe, outcomes).run(report, stop)
                    return outcomes
                first = replace(protocol.contact_by, overlap_m=protocol.overlap_m)
                about = None if mine is None else _errors_alone(mine, first)
                _Runner(self, some, first, hand, about, threads, slots, None, outcomes, True).run(None, stop)
                outcomes.duration_s[:] = 0.0
                failed, closed = np.flatnonzero(~outcomes.held), np.flatnonzero(outcomes.held)
                if report is not None and failed.size:
                    report(len(failed))
                tried = outcomes[closed]
                about = None if mine is None else mine[closed]
                see = None if observe is None else _renumbered(observe, closed)
                if closed.size:
                    _Runner(self, some[closed], protocol, hand, about, threads, slots, see, tried).run(report, stop)
                return Outcomes.concatenate([outcomes[failed], tried])[np.argsort(np.concatenate([failed, closed]))]
            except BaseException:
                stop.set()
                raise

        with quiet_engine(), ThreadPoolExecutor(n_runners) as pool:
            try:
                parts = list(pool.map(execute, shares))
            finally:
                # An interrupt ends the runners at their next check.
                stop.set()
        return Outcomes.concatenate(parts)[np.argsort(np.concatenate(shares))]


class _Counter:
    """Pass on the progress of several threads, one at a time."""

    def __init__(self, progress: Progress) -> None:
        self._progress, self._lock = progress, Lock()

    def __call__(self, decided: int) -> None:
        with self._lock:
            self._progress(decided)


def _errors_alone(conditions: Conditions, protocol: Protocol) -> Conditions:
    """Keep the errors of pose and size, and take the rest from another protocol's physics."""
    errors = {part.name: getattr(conditions, part.name) for part in fields(conditions) if "_error_" in part.name}
    return Conditions.of(protocol.physics, len(conditions), **errors)


def _renumbered(observe: Observer, rows: NDArray[np.int64]) -> Observer:
    """Let an observer see the trials of a part under their rows in the whole."""
    return lambda trials, *seen: observe(rows[trials], *seen)


class _Runner:
    """Run trials in slots, one group with all digits and, where digits may be left out, groups without some.

    With `until_closed`, trials end when the hand has closed, and are held unless they missed. Otherwise, if the
    protocol has its contact found by another, `outcomes` says what that found.
    """

    def __init__(
        self,
        engine: MujocoEngine,
        grasps: Grasps,
        protocol: Protocol,
        hand: Hand,
        conditions: Conditions | None,
        n_threads: int,
        n_slots: int,
        observe: Observer | None,
        outcomes: Outcomes,
        until_closed: bool = False,
    ) -> None:
        self.until_closed, self.by_pose = until_closed, protocol.turn_rad is not None
        self.grasps, self.protocol, self.outcomes, self.observe = grasps, protocol, outcomes, observe
        self.hand, self.schedule = hand, protocol.schedule
        # A check must fall on the end of every phase, whatever the time step.
        check = gcd(CHECK_STEPS, *self.schedule.ends)
        often = observe is not None or self.by_pose

        def group(*without: str) -> SlotGroup:
            return SlotGroup(
                hand,
                protocol,
                n_slots=n_slots,
                n_threads=n_threads,
                varied=conditions is not None,
                reduced=engine.reduced,
                without=without,
                creep=engine.creep,
                check_steps=check,
                long_stretch=check if often else max(check, LONG_STRETCH // check * check),
            )

        self.whole = group()
        # With an observer, simulate all digits; attempts that start again have no use for what closing saved.
        leave_out = engine.reduced and not often and not until_closed
        self.without = [group(*digits) for digits in idle_sets(hand)] if leave_out else []
        self.finder = IdleFinder(self.whole.world, hand) if leave_out else None
        self.idle: dict[int, tuple[Idle, NDArray[np.float64]]] = {}
        """What was left out of each trial in a group without all digits, and the whole group's state before."""
        order = hand.columns_in(grasps.joint_names)
        self.to_grasps = np.argsort(order)
        self.pregrasp = hand.clip(grasps.pregrasp[:, order])
        start, posture = grasps.X_hand_object, grasps.posture[:, order]
        contact = posture
        if protocol.contact_by is not None:
            contact, settled = outcomes.settled_posture[:, order], outcomes.X_hand_object_settled
            start = Pose(settled.position_m.copy(), settled.quat_wxyz.copy())
        elif conditions is not None:
            turn = conditions.rotation_error_quat_wxyz
            quat = np.where(turn[:, :1] == 1.0, start.quat_wxyz, quat_multiply(turn, start.quat_wxyz))
            start = Pose(start.position_m + conditions.position_error_m, quat)
        self.trials = TrialSetup(grasps, start, protocol, conditions)
        for each in self.groups:
            each.aim(self.pregrasp, contact, posture, trials=self.trials)
        self.n_slots = n_slots

    @property
    def groups(self) -> list[SlotGroup]:
        return [self.whole, *self.without]

    def run(self, progress: Progress | None, stop: Event) -> None:
        queue = iter(range(len(self.grasps)))
        self._fill(queue, progress)
        in_flight = 1
        while in_flight and not stop.is_set():
            in_flight = sum(self._advance(group, progress) for group in self.groups)
            self._fill(queue, progress)

    def _advance(self, group: SlotGroup, progress: Progress | None) -> int:
        """Step a group until its next check and decide what can be decided; return how many trials it held."""
        active = group.active
        if active.size:
            group.advance(active)
            if self.observe is not None:
                self._show(self.observe, active)
            decided = self._judge(group, active)
            if decided.size and progress is not None:
                progress(len(decided))
            if group is not self.whole:
                self._bring_back(group)
            group.skip(group.active)
        return len(active)

    def _fill(self, queue: Iterator[int], progress: Progress | None) -> None:
        """Take up trials until enough are in flight; those that start in overlap are decided at once and replaced."""
        while room := self.n_slots - sum(len(group.active) for group in self.groups):
            trials = np.array([trial for _, trial in zip(range(room), queue, strict=False)], dtype=np.int64)
            if not trials.size:
                return
            failed = self._load(self.whole.free[: len(trials)], trials)
            if failed and progress is not None:
                progress(failed)

    def _load(self, slots: Slots, trials: NDArray[Any]) -> int:
        """Place hand and object at the start; return how many trials failed by overlap."""
        group = self.whole
        group.take(slots, trials)
        group.qpos[slots[:, None], group.world.joint_qpos] = self.pregrasp[trials]
        start = self.trials.X_hand_object
        group.qpos[slots, group.object_position] = start.position_m[trials]
        group.qpos[slots, group.object_quat] = start.quat_wxyz[trials]
        if self.by_pose:
            group.centre[slots] = start.position_m[trials]
        failed = slots[group.overlapping(slots)]
        self._decide(group, failed, np.full(len(failed), "overlap"))
        return len(failed)

    def _show(self, observe: Observer, active: Slots) -> None:
        group = self.whole
        posture = group.qpos[active][:, group.world.joint_qpos][:, self.to_grasps]
        start = group.world.object_qpos
        observe(group.trial[active], group.step[active], posture, group.qpos[active, start : start + 7])

    def _judge(self, group: SlotGroup, active: Slots) -> Slots:
        """Decide what can be decided; return the slots that became free so."""
        closing, total = self.schedule.closing_steps, self.schedule.total_steps
        broken = active[group.broken(active)]
        sound = np.setdiff1d(active, broken)
        self._decide(group, broken, np.full(len(broken), "unstable"))
        if self.by_pose:
            return np.concatenate([broken, self._judge_pose(sound)])

        missed = self._judge_closing(sound[group.step[sound] == closing]) if group is self.whole else sound[:0]
        held = sound[(group.step[sound] > closing) & (group.trial[sound] >= 0)]
        away = group.moved(held)
        gone = held[away > self.protocol.displacement_m]
        self._decide(group, gone, self.schedule.lost(group.step[gone]))

        finished = held[(group.step[held] >= total) & (away <= self.protocol.displacement_m)]
        if finished.size:
            touching, areas = group.touching(finished)
            success = is_opposed(touching, self.outcomes.digits)
            ended = group.trial[finished[success]]
            self.outcomes.touching_end[ended], self.outcomes.areas_end[ended] = touching[success], areas[success]
            self._decide(group, finished, np.where(success, "held", "dropped"))
        return np.concatenate([broken, missed, gone, finished])

    def _judge_pose(self, slots: Slots) -> Slots:
        """Decide by how far objects are from where they started, and begin the next attempt where one has ended."""
        group, outcomes = self.whole, self.outcomes
        trials, limit = group.trial[slots], self.protocol.turn_rad
        away = group.moved(slots)
        start = self.trials.X_hand_object.quat_wxyz[trials]
        turned = rotation_angle(start, canonical_quat(group.qpos[slots, group.object_quat]))
        outcomes.displacement_m[trials] = np.fmax(outcomes.displacement_m[trials], away)
        outcomes.turn_rad[trials] = np.fmax(outcomes.turn_rad[trials], turned)
        out = away > self.protocol.displacement_m
        assert limit is not None
        failed = out | (turned > limit)
        self._decide(group, slots[failed], np.where(out[failed], "pushed_out", "turned"))
        kept = slots[~failed]
        finished = kept[group.step[kept] >= self.schedule.total_steps]
        if finished.size:
            ended = group.trial[finished]
            outcomes.touching_end[ended], outcomes.areas_end[ended] = group.touching(finished)
            self._decide(group, finished, np.full(len(finished), "held"))
        again = kept[np.isin(group.step[kept], self.schedule.restarts)]
        if again.size:
            step = group.step[again]
            self._load(again, group.trial[again])
            group.step[again] = step
        return np.concatenate([slots[failed], finished])

    def _judge_closing(self, slots: Slots) -> Slots:
        """Record the settled state of trials that just closed; return those that missed the object."""
        group = self.whole
        if not slots.size:
            return slots
        touching, areas = group.touching(slots)
        trials = group.trial[slots]
        settled = group.qpos[slots][:, group.world.joint_qpos]
        group.centre[slots] = group.qpos[slots, group.object_position]
        self.outcomes.touching_closed[trials], self.outcomes.areas_closed[trials] = touching, areas
        self.outcomes.settled_posture[trials] = settled[:, self.to_grasps]
        self.outcomes.object_size_m[trials] = self.hand.tip_distance(settled)
        self.outcomes.X_hand_object_settled.position_m[trials] = group.centre[slots]
        self.outcomes.X_hand_object_settled.quat_wxyz[trials] = canonical_quat(group.qpos[slots, group.object_quat])
        opposed = is_opposed(touching, self.outcomes.digits)
        missed = slots[~opposed]
        self._decide(group, missed, np.full(len(missed), "missed"))
        if self.until_closed:
            self._decide(group, slots[opposed], np.full(opposed.sum(), "held"))
            return slots
        self._leave_out_idle_digits(slots[opposed])
        return missed

    def _leave_out_idle_digits(self, slots: Slots) -> None:
        """Move trials in which some digits are clear of everything to groups without these digits."""
        if self.finder is None or not self.without:
            return
        leaving: list[list[int]] = [[] for _ in self.without]
        for slot in slots:
            trial = int(self.whole.trial[slot])
            self.finder.use(self.trials.object_fields(trial))
            idle = self.finder.find(self.whole.qpos[slot])
            if idle is not None:
                self.idle[trial] = idle, self.whole.batch.state[slot].copy()
                leaving[idle.place].append(slot)
        for group, chosen in zip(self.without, leaving, strict=True):
            if chosen:
                theirs, free = np.array(chosen), group.free[: len(chosen)]
                group.receive(free, self.whole, theirs)
                group.cleared[free] = group.qpos[free]
                group.slack_m[free] = [self.idle[trial][0].slack_m for trial in group.trial[free].tolist()]

    def _bring_back(self, group: SlotGroup) -> None:
        """Return trials to the whole world, as they were after closing, if the object came near a digit left out."""
        active = group.active
        moved = object_moved(group.world, group.cleared[active], group.qpos[active], group.radius_m[active])
        for slot in active[~(moved < group.slack_m[active])]:
            trial = int(group.trial[slot])
            idle, state = self.idle[trial]
            group.cleared[slot] = group.qpos[slot]
            assert self.finder is not None
            self.finder.use(self.trials.object_fields(trial))
            group.slack_m[slot] = self.finder.slack(idle, group.qpos[slot], group.addresses_in(self.whole))
            if group.slack_m[slot] <= 0.0:
                back = self.whole.free[:1]
                self.whole.take(back, np.array([trial]))
                self.whole.resume(back, state, self.schedule.closing_steps, group.centre[slot])
                del self.idle[trial]
                group.trial[slot] = -1

    def _decide(self, group: SlotGroup, slots: Slots, verdicts: NDArray[Any]) -> None:
        """Write the verdicts of slots whose trial is over and free them."""
        trials = group.trial[slots]
        self.outcomes.verdict[trials] = verdicts
        self.outcomes.duration_s[trials] = group.step[slots] * self.protocol.physics.time_step_s
        group.trial[slots] = -1
        for trial in trials:
            self.idle.pop(int(trial), None)
        if self.by_pose:
            return
        closed = group.step[slots] >= self.schedule.closing_steps
        self.outcomes.displacement_m[trials[closed]] = group.moved(slots)[closed]
        settled = self.outcomes.X_hand_object_settled.quat_wxyz[trials[closed]]
        now = canonical_quat(group.qpos[slots[closed], group.object_quat])
        self.outcomes.turn_rad[trials[closed]] = rotation_angle(settled, now)
