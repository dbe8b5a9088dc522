"""Measure what each means of speeding trials up brings, and where the time of a step goes.

Example::

    python benchmarks/trial_speed.py --out docs/results/performance/trial_speed.json
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import mujoco
import numpy as np
import tyro

from graspcascade.bench.engine import RawEngine
from graspcascade.bench.environment import environment
from graspcascade.bench.trials import collection_grasps
from graspcascade.cells import CELLS
from graspcascade.files import write_json
from graspcascade.grasps import Grasps
from graspcascade.hands import SHADOW_HAND, shadow_hand
from graspcascade.machine import processors
from graspcascade.objects import grasp_object
from graspcascade.postures import PosturePrior
from graspcascade.trials import COLLECTION, PAPER, build_scene, run
from graspcascade.trials.idle import IDLE_SETS, IdleFinder

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
    """Run the reduced scene with every digit in it."""
    with patch.object(IdleFinder, "find", return_value=None):
        run(grasps)


def ladder(arguments: Arguments) -> list[dict[str, Any]]:
    """Time the same trials with one means after another."""
    hand, prior = shadow_hand(), PosturePrior.pretrained()
    grasps = collection_grasps(hand, prior, arguments.per_cell, arguments.seed)
    engine = RawEngine(hand, grasps)
    steps: dict[str, Callable[[], object]] = {
        "candidates drawn and screened": lambda: collection_grasps(hand, prior, arguments.per_cell, arguments.seed),
        "raw engine, every trial to its end": lambda: engine.measure(processors()),
        "a trial ends with its verdict, its slot is refilled": lambda: run(grasps, reduced=False),
        "wrist removed, only pairs that can touch": lambda: all_digits(grasps),
        "idle digits left out (the full protocol)": lambda: run(grasps),
        "creep projected (collection)": lambda: run(grasps, creep=COLLECTION),
    }
    for step in list(steps.values())[2:]:
        step()  # compiles scenes
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
    hand, prior = shadow_hand(), PosturePrior.pretrained()
    grasps = collection_grasps(hand, prior, 2, arguments.seed)
    states: dict[int, np.ndarray] = {}

    def look(rows: np.ndarray, steps: np.ndarray, postures: np.ndarray, poses: np.ndarray) -> None:
        for row, step, posture, pose in zip(rows, steps, postures, poses, strict=True):
            if step == PAPER.closing_steps + PAPER.shake_steps + 250:
                states[int(row)] = np.concatenate([posture, pose])

    held = run(grasps, observe=look).held
    variants = {"unreduced": (False, ()), "reduced": (True, ())} | {
        f"without {', '.join(digits)}": (True, digits) for digits in reversed(IDLE_SETS)
    }
    table = []
    for name, (reduced, without) in variants.items():
        spent = dict.fromkeys(_PARTS, 0.0)
        contacts = 0
        rows = [row for row in states if held[row]]
        # Scenes of its own: gravity and flags are set in them, and those of the runner are shared.
        scenes = {
            str(label): build_scene(SHADOW_HAND, grasp_object(str(label)), PAPER, reduced=reduced, without=without)
            for label in np.unique(grasps.object_label[rows])
        }
        for row in rows:
            scene = scenes[str(grasps.object_label[row])]
            model, data = scene.model, mujoco.MjData(scene.model)
            model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
            data.qpos[scene.joint_qpos] = states[row][: len(grasps.joint_names)][scene.joints]
            data.qpos[scene.object_qpos : scene.object_qpos + 7] = states[row][len(grasps.joint_names) :]
            low, high = model.actuator_ctrlrange.T
            data.ctrl[:] = np.clip(grasps.posture[row] @ scene.control_map, low, high)
            model.opt.gravity[:] = PAPER.gravity[-1]
            mujoco.mj_step(model, data, 25)
            contacts += data.ncon
            for part in _PARTS:
                spent[part] += _least(getattr(mujoco, f"mj_{part}"), model, data)
        mean = {f"{part}_us": round(total / len(rows), 2) for part, total in spent.items()}
        table.append({"scene": name, "dofs": model.nv, "contacts": round(contacts / len(rows), 1)} | mean)
    return table


def _least(function: Callable[[Any, Any], None], model: Any, data: Any, calls: int = 40) -> float:
    found = []
    for _ in range(3):
        begun = time.perf_counter()
        for _ in range(calls):
            function(model, data)
        found.append((time.perf_counter() - begun) / calls * 1e6)
    return min(found)


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
    print(json.dumps(result, indent=1))
    if arguments.out is not None:
        write_json(arguments.out, result)


if __name__ == "__main__":
    main(tyro.cli(Arguments))
