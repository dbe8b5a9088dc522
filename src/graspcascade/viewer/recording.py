"""`record`: what a trial looked like, frame by frame, with its outcome."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.grasps import Grasps
from ..core.objects import GraspObject
from ..core.outcomes import Outcomes
from ..core.poses import Pose, canonical_quat
from ..core.protocols import Close, Phase, Protocol, Shake
from ..engines import run_trials
from ..hands import Hand

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Frame:
    """One moment of a trial.

    Attributes:
        posture: ``(J,)`` joint angles, radians.
        X_hand_object: object pose in the hand frame, ``(3,)`` and ``(4,)``.
        base_m: ``(3,)`` displacement of the hand's base, metres.
    """

    object: GraspObject
    posture: Array
    X_hand_object: Pose
    base_m: Array


@dataclass(frozen=True)
class Recording:
    """T frames of one trial, of which `outcome` is the one row of what became of it.

    Attributes:
        steps: ``(T,)`` simulation steps done; the first frame is the start.
        posture: ``(T, J)`` joint angles in the order of the grasp's joints, radians.
        X_hand_object: ``(T, 3)`` and ``(T, 4)`` object poses in the hand frame.
    """

    protocol: Protocol
    object: GraspObject
    steps: NDArray[np.int64]
    posture: Array
    X_hand_object: Pose
    outcome: Outcomes

    def __len__(self) -> int:
        return len(self.steps)

    @cached_property
    def time_s(self) -> Array:
        """Simulated time of each frame ``(T,)``."""
        return np.asarray(self.steps * self.protocol.physics.time_step_s, dtype=np.float64)

    @cached_property
    def base_m(self) -> Array:
        """Displacement of the base ``(T, 3)``: the motion whose acceleration the field of a shake stands for."""
        step_s, moved = self.protocol.physics.time_step_s, np.zeros((len(self), 3))
        begin = 0
        for phase, end in zip(self.protocol.phases, self.protocol.schedule.ends, strict=True):
            if isinstance(phase, Shake):
                rows = np.flatnonzero((self.steps > begin) & (self.steps < end))
                since = self.steps[rows] - begin
                turn = 2 * np.pi * phase.frequency_hz * since * step_s
                moved[rows, phase.axis(since, step_s)] = phase.amplitude_m * np.sin(turn)
            begin = end
        return moved

    def frame(self, row: int) -> Frame:
        """Look up one frame; negative rows count from the end."""
        pose = Pose(self.X_hand_object.position_m[row], self.X_hand_object.quat_wxyz[row])
        return Frame(self.object, self.posture[row], pose, self.base_m[row])

    def row_at(self, time_s: float) -> int:
        """Find the last frame not after a time."""
        return int(np.clip(np.searchsorted(self.time_s, time_s + 1e-9, side="right") - 1, 0, len(self) - 1))

    @property
    def closed_row(self) -> int:
        """Row of the moment at which the hand has closed; of a trial that ended before, its last."""
        return self.row_at(self.protocol.schedule.closing_steps * self.protocol.physics.time_step_s)

    def phase(self, row: int) -> tuple[Phase, str]:
        """Find the phase that a frame belongs to, and words for what is being done."""
        schedule, step_s = self.protocol.schedule, self.protocol.physics.time_step_s
        step = int(self.steps[row])
        place = int(schedule.phase[max(step - 1, 0)])
        phase, since = schedule.phases[place], step - (schedule.ends[place - 1] if place else 0)
        if step == 0:
            return phase, "start"
        if isinstance(phase, Close):
            return phase, "closing" if since <= round(phase.ramp_s / step_s) else "holding still"
        if isinstance(phase, Shake):
            return phase, f"shake along {'xyz'[int(phase.axis(since - 1, step_s))]}"
        return phase, phase.kind


def record(grasps: Grasps, hand: Hand, protocol: Protocol) -> list[Recording]:
    """Execute grasps in physics and keep what can be seen, one recording each."""
    start = np.concatenate([grasps.X_hand_object.position_m, grasps.X_hand_object.quat_wxyz], axis=1)
    seen: list[list[tuple[int, Array, Array]]] = [[(0, *state)] for state in zip(grasps.pregrasp, start, strict=True)]

    def observe(rows: NDArray[Any], steps: NDArray[Any], posture: NDArray[Any], pose: NDArray[Any]) -> None:
        # The runner reuses its arrays, so what is kept must be copied. An unstable trial may end in numbers that cannot
        # be drawn.
        sound = np.isfinite(posture).all(axis=1) & np.isfinite(pose).all(axis=1)
        for row, ok, *state in zip(rows, sound, steps, posture.copy(), pose.copy(), strict=True):
            if ok:
                seen[row].append((int(state[0]), state[1], state[2]))

    outcomes = run_trials(grasps, protocol, hand=hand, n_threads=1, observe=observe)

    def recording(row: int) -> Recording:
        steps, postures, poses = zip(*seen[row], strict=True)
        pose, obj = np.stack(poses), grasps.tasks[[row]].distinct[0].object
        X_hand_object = Pose(pose[:, :3], canonical_quat(pose[:, 3:]))
        return Recording(protocol, obj, np.array(steps), np.stack(postures), X_hand_object, outcomes[row])

    return [recording(row) for row in range(len(grasps))]
