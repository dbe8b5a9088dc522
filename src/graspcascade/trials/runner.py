"""The MuJoCo runner: many trials at once in slots that are refilled as soon as a trial is decided."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from math import gcd
from threading import Event, Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..grasps import Grasps
from ..hands import SHADOW_HAND, HandDescription, load_hand
from ..machine import processors
from ..poses import canonical_quat
from ..taxonomy import DIGITS
from .creep import CreepProjection
from .idle import IDLE_SETS, Idle, IdleFinder, object_moved
from .lane import Lane, Slots
from .outcomes import Outcomes
from .protocol import PAPER, Protocol
from .quiet import quiet_engine

_THUMB = DIGITS.index("thumb")
CHECK_STEPS = 5
"""Most steps between two looks at the object during the shake, and always when somebody observes."""
LONG_STRETCH = 25
"""Most steps between two looks while the hand closes and while the object carries its weight."""

Progress = Callable[[int], None]
Observer = Callable[[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]], None]


def run(
    grasps: Grasps,
    protocol: Protocol = PAPER,
    *,
    hand: HandDescription = SHADOW_HAND,
    n_threads: int = 0,
    n_slots: int = 1024,
    reduced: bool = True,
    creep: CreepProjection | None = None,
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
        creep: how the time under weight is abridged; None computes every step, as every quoted rate asks for.
        observe: called every `CHECK_STEPS` steps with the rows being simulated ``(k,)``, their step counts ``(k,)``,
            joint angles ``(k, J)`` in the order of the grasps' joints, and object poses ``(k, 7)`` (position, wxyz).
        progress: called with the number of trials decided since the last call.

    Returns:
        Outcomes in the order of the grasps.

    Raises:
        InputError: the grasps' joints are not the hand's, or an abridged trial is to be observed.
    """
    if creep is not None and observe is not None:
        raise InputError("an abridged trial cannot be observed; give creep=None")
    _check_joints(grasps, hand)
    # One runner a thread: what each does between steps goes on while the others step. Whoever observes has one.
    n_runners = 1 if observe is not None else max(1, min(n_threads or processors(), len(grasps)))
    shares = [np.arange(first, len(grasps), n_runners) for first in range(n_runners)]
    report = None if progress is None else _Counter(progress)
    stop = Event()

    def execute(rows: NDArray[np.int64]) -> Outcomes:
        found = Outcomes.blank(len(rows), len(hand.joint_names))
        if not len(rows):
            return found
        threads, slots = n_threads if n_runners == 1 else 1, min(-(-n_slots // n_runners), len(rows))
        try:
            _Runner(grasps[rows], protocol, hand, threads, slots, reduced, creep, observe, found).run(report, stop)
        except BaseException:
            stop.set()
            raise
        return found

    with quiet_engine(), ThreadPoolExecutor(n_runners) as pool:
        try:
            parts = list(pool.map(execute, shares))
        finally:
            # An interrupt ends the runners at their next look.
            stop.set()
    return Outcomes.concatenate(parts)[np.argsort(np.concatenate(shares))]


def _check_joints(grasps: Grasps, hand: HandDescription) -> None:
    absent = [name for name in hand.joint_names if name not in grasps.joint_names]
    if absent:
        raise InputError(f"the grasps lack joints of {hand.name}: {', '.join(absent)}")
    foreign = [name for name in grasps.joint_names if name not in hand.joint_names]
    if foreign:
        raise InputError(f"{hand.name} has no joints {', '.join(foreign)}")


class _Counter:
    """Pass on the progress of several threads, one at a time."""

    def __init__(self, progress: Progress) -> None:
        self._progress, self._lock = progress, Lock()

    def __call__(self, decided: int) -> None:
        with self._lock:
            self._progress(decided)


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
        creep: CreepProjection | None,
        observe: Observer | None,
        outcomes: Outcomes,
    ) -> None:
        self.grasps, self.protocol, self.outcomes, self.observe = grasps, protocol, outcomes, observe
        self.hand_model = load_hand(hand)
        labels = sorted(set(grasps.object_label.tolist()))
        # A look must fall on the end of every phase, whatever the time step.
        check = gcd(CHECK_STEPS, protocol.closing_steps, protocol.shake_steps, protocol.total_steps)

        def lane(*without: str) -> Lane:
            return Lane(
                hand,
                protocol,
                labels,
                n_slots=n_slots,
                n_threads=n_threads,
                reduced=reduced,
                without=without,
                creep=creep,
                check_steps=check,
                long_stretch=check if observe is not None else max(check, LONG_STRETCH // check * check),
            )

        self.whole = lane()
        # Whoever observes wants to see all digits.
        leave_out = reduced and observe is None
        self.without = [lane(*digits) for digits in IDLE_SETS] if leave_out else []
        self.finders = {x: IdleFinder(scene, hand) for x, scene in self.whole.scenes.items()} if leave_out else {}
        self.idle: dict[int, tuple[Idle, NDArray[np.float64]]] = {}
        """What was left out of each trial in a lane without all digits, and the whole lane's state before."""
        order = [list(grasps.joint_names).index(name) for name in hand.joint_names]
        self.to_grasps = np.argsort(order)
        self.pregrasp = self.hand_model.clip(grasps.pregrasp[:, order])
        for each in self.lanes:
            each.aim(self.pregrasp, grasps.posture[:, order], grasps.object_label)
        self.n_slots = n_slots

    @property
    def lanes(self) -> list[Lane]:
        return [self.whole, *self.without]

    def run(self, progress: Progress | None, stop: Event) -> None:
        queue = iter(range(len(self.grasps)))
        self._fill(queue, progress)
        in_flight = 1
        while in_flight and not stop.is_set():
            in_flight = sum(self._look(lane, progress) for lane in self.lanes)
            self._fill(queue, progress)

    def _look(self, lane: Lane, progress: Progress | None) -> int:
        """Step a lane until its next look and decide what can be decided; return how many trials it held."""
        active = lane.active
        if active.size:
            lane.advance(active)
            if self.observe is not None:
                self._show(self.observe, active)
            decided = self._judge(lane, active)
            if decided.size and progress is not None:
                progress(len(decided))
            if lane is not self.whole:
                self._bring_back(lane)
            lane.leap(lane.active)
        return len(active)

    def _fill(self, queue: Iterator[int], progress: Progress | None) -> None:
        """Take up trials until enough are in flight; those that start in overlap are decided at once and replaced."""
        while room := self.n_slots - sum(len(lane.active) for lane in self.lanes):
            trials = np.array([trial for _, trial in zip(range(room), queue, strict=False)], dtype=np.int64)
            if not trials.size:
                return
            failed = self._load(self.whole.free[: len(trials)], trials)
            if failed and progress is not None:
                progress(failed)

    def _load(self, slots: Slots, trials: NDArray[Any]) -> int:
        """Place hand and object at the start; return how many trials failed by overlap."""
        lane = self.whole
        lane.take(slots, trials)
        lane.qpos[slots[:, None], lane.scene.joint_qpos] = self.pregrasp[trials]
        lane.qpos[slots, lane.object_position] = self.grasps.X_hand_object.position_m[trials]
        lane.qpos[slots, lane.object_quat] = self.grasps.X_hand_object.quat_wxyz[trials]
        failed = slots[lane.overlapping(slots)]
        self._decide(lane, failed, np.full(len(failed), "overlap"))
        return len(failed)

    def _show(self, observe: Observer, active: Slots) -> None:
        lane = self.whole
        posture = lane.qpos[active][:, lane.scene.joint_qpos][:, self.to_grasps]
        start = lane.scene.object_qpos
        observe(lane.trial[active], lane.step[active], posture, lane.qpos[active, start : start + 7])

    def _judge(self, lane: Lane, active: Slots) -> Slots:
        """Decide what can be decided; return the slots that became free so."""
        closing, total = self.protocol.closing_steps, self.protocol.total_steps
        is_broken = lane.broken(active)
        broken, sound = active[is_broken], active[~is_broken]
        self._decide(lane, broken, np.full(len(broken), "unstable"))

        missed = self._judge_closing(sound[lane.step[sound] == closing]) if lane is self.whole else sound[:0]
        held = sound[(lane.step[sound] > closing) & (lane.trial[sound] >= 0)]
        away = lane.moved(held)
        gone = held[away > self.protocol.displacement_m]
        shaking = lane.step[gone] <= closing + self.protocol.shake_steps
        self._decide(lane, gone, np.where(shaking, "shaken_out", "dropped"))

        finished = held[(lane.step[held] >= total) & (away <= self.protocol.displacement_m)]
        if finished.size:
            touching = lane.touching(finished)
            success = _opposed(touching)
            self.outcomes.touching_end[lane.trial[finished]] = touching & success[:, None]
            self._decide(lane, finished, np.where(success, "held", "dropped"))
        return np.concatenate([broken, missed, gone, finished])

    def _judge_closing(self, slots: Slots) -> Slots:
        """Record the settled state of trials that just closed; return those that missed the object."""
        lane = self.whole
        if not slots.size:
            return slots
        touching = lane.touching(slots)
        trials = lane.trial[slots]
        settled = lane.qpos[slots][:, lane.scene.joint_qpos]
        lane.centre[slots] = lane.qpos[slots, lane.object_position]
        self.outcomes.touching_closed[trials] = touching
        self.outcomes.settled_posture[trials] = settled[:, self.to_grasps]
        self.outcomes.object_size_m[trials] = self.hand_model.tip_distance(settled)
        self.outcomes.X_hand_object_settled.position_m[trials] = lane.centre[slots]
        self.outcomes.X_hand_object_settled.quat_wxyz[trials] = canonical_quat(lane.qpos[slots, lane.object_quat])
        opposed = _opposed(touching)
        missed = slots[~opposed]
        self._decide(lane, missed, np.full(len(missed), "missed"))
        self._leave_out_idle_digits(slots[opposed])
        return missed

    def _leave_out_idle_digits(self, slots: Slots) -> None:
        """Move trials in which some digits are clear of everything to lanes without these digits."""
        if not self.without:
            return
        leaving: list[list[int]] = [[] for _ in self.without]
        for slot in slots:
            trial = int(self.whole.trial[slot])
            idle = self._finder(trial).find(self.whole.qpos[slot])
            if idle is not None:
                self.idle[trial] = idle, self.whole.batch.state[slot].copy()
                leaving[idle.place].append(slot)
        for lane, chosen in zip(self.without, leaving, strict=True):
            if chosen:
                theirs, free = np.array(chosen), lane.free[: len(chosen)]
                lane.receive(free, self.whole, theirs)
                lane.seen[free] = lane.qpos[free]
                lane.slack_m[free] = [self.idle[trial][0].slack_m for trial in lane.trial[free].tolist()]

    def _bring_back(self, lane: Lane) -> None:
        """Return trials to the whole scene, as they were after closing, if the object came near a digit left out."""
        active = lane.active
        stirred = active[~(object_moved(lane.scene, lane.seen[active], lane.qpos[active]) < lane.slack_m[active])]
        for slot in stirred:
            trial = int(lane.trial[slot])
            idle, state = self.idle[trial]
            lane.seen[slot] = lane.qpos[slot]
            lane.slack_m[slot] = self._finder(trial).slack(idle, lane.qpos[slot], lane.addresses_in(self.whole))
            if lane.slack_m[slot] <= 0.0:
                back = self.whole.free[:1]
                self.whole.take(back, np.array([trial]))
                self.whole.resume(back, state, self.protocol.closing_steps, lane.centre[slot])
                del self.idle[trial]
                lane.trial[slot] = -1

    def _finder(self, trial: int) -> IdleFinder:
        return self.finders[str(self.grasps.object_label[trial])]

    def _decide(self, lane: Lane, slots: Slots, verdicts: NDArray[Any]) -> None:
        """Write the verdicts of slots whose trial is over and free them."""
        trials = lane.trial[slots]
        self.outcomes.verdict[trials] = verdicts
        self.outcomes.duration_s[trials] = lane.step[slots] * self.protocol.time_step_s
        closed = lane.step[slots] >= self.protocol.closing_steps
        self.outcomes.displacement_m[trials[closed]] = lane.moved(slots)[closed]
        lane.trial[slots] = -1
        for trial in trials:
            self.idle.pop(int(trial), None)
