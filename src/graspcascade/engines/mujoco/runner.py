"""The MuJoCo engine: many trials at once in batch slots that are refilled as soon as a trial is decided."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from math import gcd
from threading import Event, Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.errors import InputError
from ...core.grasps import Grasps
from ...core.machine import processors
from ...core.outcomes import Outcomes
from ...core.poses import canonical_quat, quat_multiply, rotation_angle
from ...core.protocols import Conditions, Protocol
from ...hands import Hand
from .. import Observer, Progress, check_trials, is_opposed
from .creep import FAST_FORWARD, CreepProjection
from .idle import Idle, IdleFinder, idle_sets, object_moved
from .quiet import quiet_engine
from .slots import SlotGroup, Slots, TrialSetup

CHECK_STEPS = 5
"""Most steps between two checks of the object during the shake, and always with an observer."""
LONG_STRETCH = 25
"""Most steps between two checks while the hand closes and while the object carries its weight."""


@dataclass(frozen=True)
class MujocoEngine:
    """Run trials in MuJoCo on the processors of this machine.

    Attributes:
        n_threads: simulation threads, 0 for all processors.
        n_slots: trials in flight.
        reduced: see `worlds.world.build_world`.
        creep: how the time under weight is abridged; None computes every step, as every quoted rate asks for.
    """

    n_threads: int = 0
    n_slots: int = 1024
    reduced: bool = True
    creep: CreepProjection | None = None

    @property
    def abridged(self) -> dict[str, Any] | None:  # noqa: D102 (of Engine)
        return None if self.creep is None else asdict(self.creep)

    @property
    def versions(self) -> dict[str, str]:  # noqa: D102 (of Engine)
        return {}

    def on_one_thread(self) -> MujocoEngine:  # noqa: D102 (of Engine)
        return replace(self, n_threads=1)

    def abridging(self) -> MujocoEngine:  # noqa: D102 (of Engine)
        return replace(self, creep=FAST_FORWARD)

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
        if conditions is None and protocol.variation is not None:
            raise InputError(f"protocol {protocol.name} varies: give the conditions, protocol.conditions(n)")
        check_trials(grasps, hand, conditions)
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
            mine = None if conditions is None else conditions[rows]
            try:
                _Runner(self, grasps[rows], protocol, hand, mine, threads, slots, observe, outcomes).run(report, stop)
            except BaseException:
                stop.set()
                raise
            return outcomes

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


class _Runner:
    """Run trials in slots, one group with all digits and, where digits may be left out, groups without some."""

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
    ) -> None:
        self.grasps, self.protocol, self.outcomes, self.observe = grasps, protocol, outcomes, observe
        self.hand, self.schedule = hand, protocol.schedule
        # A check must fall on the end of every phase, whatever the time step.
        check = gcd(CHECK_STEPS, *self.schedule.ends)

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
                long_stretch=check if observe is not None else max(check, LONG_STRETCH // check * check),
            )

        self.whole = group()
        # With an observer, simulate all digits.
        leave_out = engine.reduced and observe is None
        self.without = [group(*digits) for digits in idle_sets(hand)] if leave_out else []
        self.finder = IdleFinder(self.whole.world, hand) if leave_out else None
        self.idle: dict[int, tuple[Idle, NDArray[np.float64]]] = {}
        """What was left out of each trial in a group without all digits, and the whole group's state before."""
        order = hand.columns_in(grasps.joint_names)
        self.to_grasps = np.argsort(order)
        self.pregrasp = hand.clip(grasps.pregrasp[:, order])
        self.trials = TrialSetup(grasps, protocol, conditions)
        self.start_m, self.start_quat = grasps.X_hand_object.position_m, grasps.X_hand_object.quat_wxyz
        if conditions is not None:
            self.start_m = self.start_m + conditions.position_error_m
            turn = conditions.rotation_error_quat_wxyz
            self.start_quat = np.where(turn[:, :1] == 1.0, self.start_quat, quat_multiply(turn, self.start_quat))
        for each in self.groups:
            each.aim(self.pregrasp, grasps.posture[:, order], self.trials)
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
            group.skip_creep(group.active)
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
        group.qpos[slots, group.object_position] = self.start_m[trials]
        group.qpos[slots, group.object_quat] = self.start_quat[trials]
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

        missed = self._judge_closing(sound[group.step[sound] == closing]) if group is self.whole else sound[:0]
        held = sound[(group.step[sound] > closing) & (group.trial[sound] >= 0)]
        away = group.moved(held)
        gone = held[away > self.protocol.displacement_m]
        self._decide(group, gone, self.schedule.lost(group.step[gone]))

        finished = held[(group.step[held] >= total) & (away <= self.protocol.displacement_m)]
        if finished.size:
            touching = group.touching(finished)
            success = is_opposed(touching, self.outcomes.digits)
            self.outcomes.touching_end[group.trial[finished]] = touching & success[:, None]
            self._decide(group, finished, np.where(success, "held", "dropped"))
        return np.concatenate([broken, missed, gone, finished])

    def _judge_closing(self, slots: Slots) -> Slots:
        """Record the settled state of trials that just closed; return those that missed the object."""
        group = self.whole
        if not slots.size:
            return slots
        touching = group.touching(slots)
        trials = group.trial[slots]
        settled = group.qpos[slots][:, group.world.joint_qpos]
        group.centre[slots] = group.qpos[slots, group.object_position]
        self.outcomes.touching_closed[trials] = touching
        self.outcomes.settled_posture[trials] = settled[:, self.to_grasps]
        self.outcomes.object_size_m[trials] = self.hand.tip_distance(settled)
        self.outcomes.X_hand_object_settled.position_m[trials] = group.centre[slots]
        self.outcomes.X_hand_object_settled.quat_wxyz[trials] = canonical_quat(group.qpos[slots, group.object_quat])
        opposed = is_opposed(touching, self.outcomes.digits)
        missed = slots[~opposed]
        self._decide(group, missed, np.full(len(missed), "missed"))
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
        closed = group.step[slots] >= self.schedule.closing_steps
        self.outcomes.displacement_m[trials[closed]] = group.moved(slots)[closed]
        settled = self.outcomes.X_hand_object_settled.quat_wxyz[trials[closed]]
        now = canonical_quat(group.qpos[slots[closed], group.object_quat])
        self.outcomes.turn_rad[trials[closed]] = rotation_angle(settled, now)
        group.trial[slots] = -1
        for trial in trials:
            self.idle.pop(int(trial), None)
