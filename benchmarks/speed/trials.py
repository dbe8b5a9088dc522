"""Trials per second of collection and evaluation, and their gain over an engine that steps every trial to its end."""

from __future__ import annotations

import copy
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.common import Spread
from graspcascade.core.grasps import Grasps
from graspcascade.core.machine import peak_rss_mb
from graspcascade.core.protocols import PAPER, Protocol
from graspcascade.engines.mujoco.runner import MujocoEngine
from graspcascade.hands import Hand
from graspcascade.proposals import Proposal
from graspcascade.proposals.heuristic import Heuristic
from graspcascade.studies.collect import CollectionSpec, collect
from graspcascade.studies.evaluate import evaluate
from graspcascade.studies.rounds import CELLS, Pair
from graspcascade.worlds.world import build_world

Tell = Callable[[str], None]
"""Hear how far a measurement is, in words."""


STEPPING = "mj_step in a plain loop, one trial at a time on each thread"
"""How the yardstick steps; a few per cent faster than `mujoco.batch` on the same trials and threads."""


class RawEngine:
    """Step grasps through full-length trials of the unreduced world: all joints, all default pairs.

    No trial ends early, no contact is looked at, and contact sensors are off: nothing is measured but the engine under
    the protocol's controls and gravity.

    Args:
        hand: the hand.
        grasps: what to execute.
        protocol: the trial.
    """

    def __init__(self, hand: Hand, grasps: Grasps, protocol: Protocol = PAPER) -> None:
        self.protocol, self.grasps = protocol, grasps
        self._worlds = {
            name: build_world(hand, obj, protocol.physics, reduced=False) for name, obj in grasps.tasks.objects.items()
        }
        for world in self._worlds.values():
            world.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        self._pregrasp = hand.clip(grasps.pregrasp)
        schedule = protocol.schedule
        self._fraction = schedule.fraction[: schedule.carry_begins, None]
        self._own = threading.local()

    @property
    def steps(self) -> int:
        """Count the steps of one measurement."""
        return len(self.grasps) * self.protocol.schedule.total_steps

    def measure(self, n_threads: int) -> float:
        """Execute every trial and return steps per second of elapsed time."""
        pool = ThreadPoolExecutor(n_threads)
        try:
            begun = time.perf_counter()
            for _ in pool.map(self.execute, range(len(self.grasps))):
                pass
            return self.steps / (time.perf_counter() - begun)
        finally:
            # After an interrupt, trials that have not begun are not waited for.
            pool.shutdown(cancel_futures=True)

    def execute(self, row: int) -> NDArray[np.float64]:
        """Step one trial to its end.

        Returns:
            ``(7,)`` the object's pose at the end, position in metres and quaternion wxyz, in the hand frame.
        """
        name, schedule = str(self.grasps.object_name[row]), self.protocol.schedule
        world, model = self._worlds[name], self._model(name)
        data = mujoco.MjData(model)
        place = slice(world.object_qpos, world.object_qpos + 7)
        pose = self.grasps.X_hand_object
        data.qpos[world.joint_qpos] = self._pregrasp[row]
        data.qpos[place] = np.concatenate([pose.position_m[row], pose.quat_wxyz[row]])
        begin, end = (world.controls(posture[row]) for posture in (self._pregrasp, self.grasps.posture))
        controls = begin + self._fraction * (end - begin)
        control, gravity = data.ctrl, model.opt.gravity
        for step in range(schedule.carry_begins):
            control[:] = controls[step]
            gravity[:] = schedule.acceleration[step]
            mujoco.mj_step(model, data)
        gravity[:] = schedule.acceleration[-1]
        mujoco.mj_step(model, data, schedule.total_steps - schedule.carry_begins)
        return np.array(data.qpos[place])

    def _model(self, name: str) -> Any:
        """Copy a world's model once for this thread: gravity is a field of it and changes as trials go on."""
        models = self._own.__dict__
        if name not in models:
            models[name] = copy.copy(self._worlds[name].model)
        return models[name]


@dataclass(frozen=True)
class Count:
    """Count what one run of a workload did."""

    trials: int
    held: int


Workload = Callable[[Tell], Count]


@dataclass(frozen=True)
class Repetition:
    """Hold one timed run between two measurements of the raw engine.

    Attributes:
        count: what it did.
        seconds: elapsed time.
        raw_before, raw_after: raw engine steps per second just before and just after, on grasps of the same kind.
        steps_per_trial: steps of one full-length trial.
    """

    count: Count
    seconds: float
    raw_before: float
    raw_after: float
    steps_per_trial: int = PAPER.schedule.total_steps

    @property
    def trials_per_s(self) -> float:
        """Trials decided per second."""
        return self.count.trials / self.seconds

    @property
    def held_per_s(self) -> float:
        """Held trials per second."""
        return self.count.held / self.seconds

    @property
    def gain(self) -> float:
        """Compare with the trials per second of a raw engine that steps every one to its end.

        The engine's speed is the mean of the measurements on either side, since that of a machine in use drifts.
        """
        return self.trials_per_s / ((self.raw_before + self.raw_after) / 2 / self.steps_per_trial)

    def to_json(self) -> dict[str, float]:
        """Name all numbers."""
        own = {name: getattr(self, name) for name in ("seconds", "trials_per_s", "held_per_s", "gain")}
        return own | {"raw_before_steps_per_s": self.raw_before, "raw_after_steps_per_s": self.raw_after}


@dataclass
class Measured:
    """Collect the repetitions of each workload.

    Attributes:
        repetitions: by the workload's name.
        peak_rss_mb: peak memory of the process when a workload had run for the first time, by its name.
    """

    repetitions: dict[str, list[Repetition]] = field(default_factory=dict)
    peak_rss_mb: dict[str, float] = field(default_factory=dict)

    def to_json(self, name: str) -> dict[str, Any]:
        """Sum up one workload."""
        repetitions = self.repetitions[name]
        quantities = ("trials_per_s", "held_per_s", "gain")
        spreads = {q: Spread.of(getattr(one, q) for one in repetitions).to_json() for q in quantities}
        raw = Spread.of(speed for one in repetitions for speed in (one.raw_before, one.raw_after))
        return spreads | {
            "raw_steps_per_s": raw.to_json(),
            "trials": repetitions[0].count.trials,
            "held": repetitions[0].count.held,
            "values": [one.to_json() for one in repetitions],
        }


def interleave(
    workloads: Mapping[str, tuple[Callable[[], float], Workload]],
    repetitions: int,
    begin: Callable[[str], Tell],
    clock: Callable[[], float] = time.perf_counter,
) -> Measured:
    """Run workloads in turn, each between two measurements of the raw engine.

    Args:
        workloads: by name, what measures the raw engine in steps per second, and what to run.
        repetitions: runs of each.
        begin: called with the name of what is measured next, returns what to tell how far it is.
        clock: elapsed seconds.
    """
    measured = Measured(repetitions={name: [] for name in workloads})
    for _ in range(repetitions):
        for name, (raw, workload) in workloads.items():
            begin("raw engine")
            before = raw()
            tell = begin(name)
            begun = clock()
            count = workload(tell)
            seconds = clock() - begun
            measured.peak_rss_mb.setdefault(name, peak_rss_mb())
            begin("raw engine")
            measured.repetitions[name].append(Repetition(count, seconds, before, raw()))
    return measured


def collection_round(per_cell: int) -> int:
    """Limit collection's trials of a cell in one round to all there are."""
    return min(per_cell, CollectionSpec.round_per_cell)


def collection(heuristic: Heuristic, per_cell: int, seed: int, n_threads: int, protocol: Protocol = PAPER) -> Workload:
    """Make the workload of a collection into a folder that is removed: drawn, screened, simulated, written."""
    spec = CollectionSpec(per_cell, round_per_cell=collection_round(per_cell), seed=seed)
    engine = MujocoEngine(n_threads).abridging(protocol)
    total = per_cell * len(CELLS)

    def run(tell: Tell) -> Count:
        decided = 0

        def tick(trials: int) -> None:
            nonlocal decided
            decided += trials
            tell(_of(decided, total))

        with tempfile.TemporaryDirectory(prefix="graspcascade-bench-") as folder:
            state = collect(heuristic, spec, Path(folder) / "data", protocol=protocol, engine=engine, tick=tick)
        return Count(int(state.trials.sum()), int(state.held.sum()))

    return run


def evaluation(
    proposal: Proposal,
    per_cell: int,
    seed: int,
    n_threads: int,
    cells: Sequence[Pair] = CELLS,
    protocol: Protocol = PAPER,
) -> Workload:
    """Make the workload of an evaluation under the full protocol, which computes every step that may matter."""

    def run(tell: Tell) -> Count:
        result = evaluate(
            proposal,
            per_cell=per_cell,
            seed=seed,
            protocol=protocol,
            engine=MujocoEngine(n_threads),
            cells=cells,
            progress=lambda done, total: tell(_of(done, total)),
        )
        return Count(result.n, result.total.held)

    return run


def _of(done: int, total: int) -> str:
    return f"{done} of {total} trials"
