"""Projective integration of the slow creep under gravity: short bursts of physics, then a skip along the drift.

Once a held object carries its weight, fast motion dies out within tenths of a second; what is left is a creep of
fingers and object over the remaining seconds that decides whether it falls. Its rate is measured over a burst of
ordinary steps and extrapolated over many more, and the next burst lets the fast motion die out again (Gear and
Kevrekidis 2003, DOI 10.1137/S1064827501388157). The length of a skip follows the error of the one before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...core.poses import as_quat, as_rotation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CreepProjection:
    """Fix how the weight's duration is abridged; SI units. The shake and closing are always computed in full."""

    begin_s: float = 0.4
    """Weight is carried for this long before the first skip."""
    settle_s: float = 0.04
    """After a skip, fast motion dies out for this long."""
    measure_s: float = 0.06
    """The rate of creep is then the mean over this long."""
    first_skip_s: float = 0.2
    """Length of the first skip."""
    longest_skip_s: float = 1.6
    """No skip is longer."""
    end_s: float = 0.1
    """The last stretch before the verdict is always computed."""
    tolerance_m: float = 0.0001
    """Error of one skip that lengths are chosen for."""
    most_movement_m: float = 0.004
    """No skip moves object or fingers by more; what is faster than that is computed."""
    object_lever_m: float = 0.04
    """Turns of the object count by this arm."""
    joint_lever_m: float = 0.06
    """Turns of a joint count by this arm."""


FAST_FORWARD = CreepProjection()
"""What collection uses unless it is told otherwise."""

_GROWTH = (0.2, 3.0)
"""Bounds of the ratio of successive skips."""
_SAFETY = 0.9


class CreepSkipper:
    """Decide, for the slots of a batch, when the state may skip, and how far.

    A slot under weight goes through cycles: a stretch of settling, a stretch of measuring, a skip. Times are counted in
    steps and every stretch is a multiple of `stride`.

    Weight sets in at `first_step` and the trial ends at `last_step`. The object's seven numbers stand at `object_qpos`
    in a state of `n_qpos`; all else are joint angles.
    """

    def __init__(
        self,
        projection: CreepProjection,
        *,
        time_step_s: float,
        stride: int,
        n_slots: int,
        first_step: int,
        last_step: int,
        object_qpos: int,
        n_qpos: int,
    ) -> None:
        self._projection, self._dt, self._stride = projection, time_step_s, stride
        self._settle, self._measure = self._steps(projection.settle_s), self._steps(projection.measure_s)
        self._begin = first_step + max(self._steps(projection.begin_s) - self._settle - self._measure, 0)
        self._last, self._end = last_step, self._steps(projection.end_s)
        self._place = slice(object_qpos, object_qpos + 3)
        self._quat = slice(object_qpos + 3, object_qpos + 7)
        self._joints = np.setdiff1d(np.arange(n_qpos), np.arange(object_qpos, object_qpos + 7))
        self._turning = np.zeros(n_slots, dtype=np.int64)
        """Step count at which the present stretch ends."""
        self._measuring = np.zeros(n_slots, dtype=bool)
        self._before = np.zeros((n_slots, n_qpos))
        self._rate = np.zeros((n_slots, 6 + len(self._joints)))
        self._skipped = np.zeros(n_slots)
        self._wanted = np.zeros(n_slots)

    def _steps(self, seconds: float) -> int:
        return max(1, round(seconds / self._dt / self._stride)) * self._stride

    def start(self, slots: NDArray[np.int64]) -> None:
        """Reset slots that take up new trials."""
        self._turning[slots] = self._begin + self._settle
        self._measuring[slots] = False
        self._skipped[slots] = 0.0
        self._wanted[slots] = self._projection.first_skip_s

    def stretch(self, slots: NDArray[np.int64], step: NDArray[np.int64]) -> NDArray[np.int64]:
        """Count the steps ``(k,)`` that are left of each slot's present stretch."""
        left: NDArray[np.int64] = np.minimum(self._turning[slots], self._last) - step
        return left

    def advance(self, slots: NDArray[np.int64], step: NDArray[np.int64], qpos: Array) -> NDArray[np.int64]:
        """Let states of slots under weight skip where their burst is complete; count the steps skipped ``(k,)``.

        Skips are written into `qpos` ``(n_slots, n_qpos)``, the states of all slots.
        """
        skipped = np.zeros(len(slots), dtype=np.int64)
        turning = (step == self._turning[slots]) & (step < self._last)
        settled = slots[turning & ~self._measuring[slots]]
        self._before[settled] = qpos[settled]
        measured = turning & self._measuring[slots]
        if measured.any():
            ready = slots[measured]
            skipped[measured] = self._project(ready, step[measured], qpos)
            self._turning[ready] = step[measured] + skipped[measured] + self._settle
            self._measuring[ready] = False
        self._turning[settled] += self._measure
        self._measuring[settled] = True
        return skipped

    def _project(self, slots: NDArray[np.int64], step: NDArray[np.int64], qpos: Array) -> NDArray[np.int64]:
        spec = self._projection
        rate = self._difference(self._before[slots], qpos[slots]) / (self._measure * self._dt)
        # Error of the last skip, assuming the rate changed linearly.
        error = self._skipped[slots] * self._movement(rate - self._rate[slots]) / 2.0
        growth = np.clip(_SAFETY * np.sqrt(spec.tolerance_m / np.maximum(error, 1e-12)), *_GROWTH)
        wanted = self._wanted[slots] * np.where(self._skipped[slots] > 0.0, growth, 1.0)
        wanted = np.clip(wanted, self._stride * self._dt, spec.longest_skip_s)
        seconds = np.minimum(wanted, spec.most_movement_m / np.maximum(self._movement(rate), 1e-12))
        self._wanted[slots] = np.maximum(seconds, self._stride * self._dt)
        steps = np.floor(seconds / self._dt + 1e-9).astype(np.int64)
        steps = np.minimum(steps, self._last - self._end - step) // self._stride * self._stride
        steps = np.maximum(steps, 0)
        going = steps > 0
        qpos[slots[going]] = self._moved(qpos[slots[going]], rate[going] * (steps[going] * self._dt)[:, None])
        self._rate[slots], self._skipped[slots] = rate, steps * self._dt
        return steps

    def _difference(self, a: Array, b: Array) -> Array:
        """Compute the movement from state a to state b: object's place, its turn (own axes), joint angles."""
        turn = (as_rotation(a[:, self._quat]).inv() * as_rotation(b[:, self._quat])).as_rotvec()
        return np.concatenate([b[:, self._place] - a[:, self._place], turn, (b - a)[:, self._joints]], axis=1)

    def _moved(self, qpos: Array, by: Array) -> Array:
        from scipy.spatial.transform import Rotation

        moved = qpos.copy()
        moved[:, self._place] += by[:, :3]
        if len(qpos):
            moved[:, self._quat] = as_quat(as_rotation(qpos[:, self._quat]) * Rotation.from_rotvec(by[:, 3:6]))
        moved[:, self._joints] += by[:, 6:]
        return moved

    def _movement(self, by: Array) -> Array:
        """Bound the distance ``(k,)`` in metres by which any part moves."""
        place, turn = np.linalg.norm(by[:, :3], axis=1), np.linalg.norm(by[:, 3:6], axis=1)
        joints = np.abs(by[:, 6:]).max(axis=1)
        arms = self._projection
        movement: Array = np.maximum(np.maximum(place, arms.object_lever_m * turn), arms.joint_lever_m * joints)
        return movement
