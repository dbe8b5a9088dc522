"""`record`: what the trial runner showed of each trial, frame by frame, with its outcome."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..grasps import Grasps
from ..poses import Pose, canonical_quat
from ..trials import Outcomes, Protocol, run

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Frame:
    """Hold one moment.

    Attributes:
        object_label: which object.
        posture: ``(J,)`` joint angles, radians.
        X_hand_object: object pose in the hand frame, ``(3,)`` and ``(4,)``.
        base_m: ``(3,)`` displacement of the hand's base, metres.
    """

    object_label: str
    posture: Array
    X_hand_object: Pose
    base_m: Array


@dataclass(frozen=True)
class Recording:
    """Hold T frames of one trial.

    Attributes:
        protocol: what was done.
        object_label: with which object.
        steps: ``(T,)`` simulation steps done; the first frame is the start.
        posture: ``(T, J)`` joint angles in the order of the grasp's joints, radians.
        X_hand_object: ``(T, 3)`` and ``(T, 4)`` object poses in the hand frame.
        outcome: what became of it, one row.
    """

    protocol: Protocol
    object_label: str
    steps: NDArray[np.int64]
    posture: Array
    X_hand_object: Pose
    outcome: Outcomes

    def __len__(self) -> int:
        """Count the frames."""
        return len(self.steps)

    @cached_property
    def time_s(self) -> Array:
        """Give the simulated time of each frame ``(T,)``."""
        return np.asarray(self.steps * self.protocol.time_step_s, dtype=np.float64)

    @cached_property
    def base_m(self) -> Array:
        """Give the base's displacement ``(T, 3)``: the motion whose acceleration the shake's gravity stands for."""
        about = self.protocol
        moved = np.zeros((len(self), 3))
        rows = np.flatnonzero((self.steps > about.closing_steps) & (self.steps < _shake_end(about)))
        since = self.steps[rows] - about.closing_steps
        turn = 2 * np.pi * about.shake_frequency_hz * since * about.time_step_s
        moved[rows, since * 3 // about.shake_steps] = about.shake_amplitude_m * np.sin(turn)
        return moved

    def frame(self, row: int) -> Frame:
        """Give one frame."""
        pose = self.X_hand_object
        at = Pose(pose.position_m[row], pose.quat_wxyz[row])
        return Frame(self.object_label, self.posture[row], at, self.base_m[row])

    def row_at(self, time_s: float) -> int:
        """Find the last frame not after a time."""
        return int(np.clip(np.searchsorted(self.time_s, time_s + 1e-9, side="right") - 1, 0, len(self) - 1))

    def phase(self, row: int) -> str:
        """Name what is being done at a frame."""
        about, step = self.protocol, int(self.steps[row])
        if step == 0:
            return "start"
        if step <= round(about.close_s / about.time_step_s):
            return "closing"
        if step <= about.closing_steps:
            return "holding still"
        if step <= _shake_end(about):
            axis = (step - about.closing_steps - 1) * 3 // about.shake_steps
            return f"shake along {'xyz'[min(axis, 2)]}"
        return "gravity"


def _shake_end(protocol: Protocol) -> int:
    return protocol.closing_steps + protocol.shake_steps


def record(grasps: Grasps, protocol: Protocol, *, n_threads: int = 1) -> list[Recording]:
    """Execute grasps in physics and keep what can be seen, one recording each."""
    seen: list[list[tuple[int, Array, Array]]] = [[] for _ in range(len(grasps))]

    def observe(rows: NDArray[Any], steps: NDArray[Any], posture: NDArray[Any], pose: NDArray[Any]) -> None:
        # The runner reuses its arrays, so what is kept must be copied.
        for row, *state in zip(rows, steps, posture.copy(), pose.copy(), strict=True):
            seen[row].append((int(state[0]), state[1], state[2]))

    outcomes = run(grasps, protocol, n_threads=n_threads, observe=observe)
    return [_recording(grasps[row], protocol, seen[row], outcomes[row]) for row in range(len(grasps))]


def _recording(grasp: Grasps, protocol: Protocol, seen: list[tuple[int, Array, Array]], outcome: Outcomes) -> Recording:
    start = grasp.X_hand_object
    pose = np.concatenate([start.position_m, start.quat_wxyz], axis=1)
    # An unstable trial may end in numbers that cannot be drawn.
    sound = [frame for frame in seen if np.isfinite(frame[1]).all() and np.isfinite(frame[2]).all()]
    pose = np.concatenate([pose, *(frame[2][None] for frame in sound)])
    return Recording(
        protocol,
        str(grasp.object_label[0]),
        np.array([0, *(frame[0] for frame in sound)], dtype=np.int64),
        np.concatenate([grasp.pregrasp, *(frame[1][None] for frame in sound)]),
        Pose(pose[:, :3], canonical_quat(pose[:, 3:])),
        outcome,
    )
