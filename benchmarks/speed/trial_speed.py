"""Measure what each means of speeding trials up brings, and where the time of a step goes.

Example::

    python -m benchmarks.speed.trial_speed --out docs/results/performance/trial_speed.json
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import mujoco
import numpy as np

from benchmarks.common import collection_grasps, command, environment, publish, shipped_heuristic
from benchmarks.speed.trials import RawEngine
from graspcascade.core.grasps import Grasps
from graspcascade.core.machine import processors
from graspcascade.core.protocols import PAPER
from graspcascade.engines import run_trials
from graspcascade.engines.mujoco.creep import FAST_FORWARD
from graspcascade.engines.mujoco.idle import IdleFinder, idle_sets
from graspcascade.studies.rounds import CELLS
from graspcascade.worlds.world import build_world

_PARTS = ("kinematics", "collision", "makeConstraint", "fwdVelocity", "fwdConstraint", "implicit", "step")


@dataclass(frozen=True)
class Arguments:
    """Time trials."""

    per_cell: int = 10
    """Screened heuristic candidates of each object and type."""
    repetitions: int = 3
    """Repetitions, in turn."""
    seed: int = 3
    """Seed of the candidates."""
    out: Path | None = None
    """JSON file to write."""


def all_digits(grasps: Grasps) -> None:
    """Run the reduced world with every digit in it."""
    with patch.object(IdleFinder, "find", return_value=None):
        run_trials(grasps)


def ladder(arguments: Arguments) -> list[dict[str, Any]]:
    """Time the same trials with one means after another."""
    heuristic = shipped_heuristic()
    grasps = collection_grasps(heuristic, arguments.per_cell, arguments.seed)
    engine = RawEngine(heuristic.hand, grasps)
    steps: dict[str, Callable[[], object]] = {
        "candidates drawn and screened": lambda: collection_grasps(heuristic, arguments.per_cell, arguments.seed),
        "raw engine, every trial to its end": lambda: engine.measure(processors()),
        "a trial ends with its verdict, its slot is refilled": lambda: run_trials(grasps, reduced=False),
        "wrist removed, only pairs that can touch": lambda: all_digits(grasps),
        "idle digits left out (the full protocol)": lambda: run_trials(grasps),
        "creep projected (collection)": lambda: run_trials(grasps, creep=FAST_FORWARD),
    }
    for step in list(steps.values())[2:]:
        step()  # compiles worlds
    seconds: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(arguments.repetitions):
        for name, step in steps.items():
            begun = time.perf_counter()
            step()
            seconds[name].append(time.perf_counter() - begun)
    rates = {name: len(grasps) / statistics.median(values) for name, values in seconds.items()}
    return [{"means": name, "trials_per_s": round(rate, 1)} for name, rate in rates.items()]


def step_parts(arguments: Arguments) -> list[dict[str, Any]]:
    """Time the parts of one step while objects are held, microseconds on one thread, least of several."""
    heuristic = shipped_heuristic()
    hand, grasps = heuristic.hand, collection_grasps(heuristic, 2, arguments.seed)
    states: dict[int, np.ndarray] = {}

    def record(rows: np.ndarray, steps: np.ndarray, postures: np.ndarray, poses: np.ndarray) -> None:
        for row, step, posture, pose in zip(rows, steps, postures, poses, strict=True):
            if step == PAPER.schedule.carry_begins + 250:
                states[int(row)] = np.concatenate([posture, pose])

    held = run_trials(grasps, observe=record).held
    variants = {"unreduced": (False, ()), "reduced": (True, ())} | {
        f"without {', '.join(digits)}": (True, digits) for digits in reversed(idle_sets(hand))
    }
    table = []
    for name, (reduced, without) in variants.items():
        spent = dict.fromkeys(_PARTS, 0.0)
        contacts = 0
        rows = [row for row in states if held[row]]
        # Worlds of its own: gravity and flags are set in them, and those of the runner are shared.
        worlds = {
            name: build_world(hand, obj, PAPER.physics, reduced=reduced, without=without)
            for name, obj in grasps.tasks[rows].objects.items()
        }
        for row in rows:
            world = worlds[str(grasps.object_name[row])]
            model, data = world.model, mujoco.MjData(world.model)
            model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
            data.qpos[world.joint_qpos] = states[row][: len(grasps.joint_names)][world.joints]
            data.qpos[world.object_qpos : world.object_qpos + 7] = states[row][len(grasps.joint_names) :]
            data.ctrl[:] = world.controls(grasps.posture[row])
            model.opt.gravity[:] = PAPER.schedule.acceleration[-1]
            mujoco.mj_step(model, data, 25)
            contacts += data.ncon
            for part in _PARTS:
                spent[part] += _least(getattr(mujoco, f"mj_{part}"), model, data)
        mean = {f"{part}_us": round(total / len(rows), 2) for part, total in spent.items()}
        table.append({"scene": name, "dofs": model.nv, "contacts": round(contacts / len(rows), 1)} | mean)
    return table


def _least(function: Callable[[Any, Any], None], model: Any, data: Any, calls: int = 40) -> float:
    times = []
    for _ in range(3):
        begun = time.perf_counter()
        for _ in range(calls):
            function(model, data)
        times.append((time.perf_counter() - begun) / calls * 1e6)
    return min(times)


def main(arguments: Arguments) -> None:
    """Measure and print."""
    result = {
        "environment": environment(processors()),
        "seed": arguments.seed,
        "trials": arguments.per_cell * len(CELLS),
        "repetitions": arguments.repetitions,
        "ladder": ladder(arguments),
        "step": step_parts(arguments),
    }
    publish(result, arguments.out)


if __name__ == "__main__":
    sys.exit(command("benchmarks.speed.trial_speed", Arguments, main))
