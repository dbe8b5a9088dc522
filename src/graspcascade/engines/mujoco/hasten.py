"""Trials whose contacts do not creep, abridged: the slow tipping of coupled joints under weight is hastened.

Where contacts hold still, what goes on moving are joints that share a tendon. Only damping resists a change of their
difference, so that a digit tips slowly, at a rate inverse to the damping: with a fifteenth of it, a second's tipping
takes a fifteenth of a second.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from ...hands import Hand
from ...worlds.world import World

Steps = NDArray[np.int64]


@dataclass(frozen=True)
class Hastening:
    """Fix how the weight's duration is abridged; SI units. Closing and shake are always computed in full."""

    begin_s: float = 0.2
    """Weight is carried for this long before anything is hastened."""
    factor: float = 15.0
    """The rest of the duration is divided by this, and so is the damping of coupled joints meanwhile."""
    measure_s: float = 0.16
    """Then, with full damping again, the object's speed is its mean over this long, over and over."""
    still_m_s: float = 0.0004
    """An object slower than this is taken to stay where it is; all others are computed until they are."""


HASTENED = Hastening()
"""What collection uses where contacts do not creep, unless it is told otherwise."""


class Hastener:
    """Set the damping of the slots of a batch, and decide which trials are over before their time.

    Weight sets in at `first_step` and the trial ends at `last_step`; every stretch is a multiple of `stride` steps.
    `damping` ``(n_slots, n_dofs)`` is written to.
    """

    def __init__(
        self,
        spec: Hastening,
        world: World,
        hand: Hand,
        damping: NDArray[np.float64],
        *,
        time_step_s: float,
        stride: int,
        first_step: int,
        last_step: int,
    ) -> None:
        def steps(seconds: float) -> int:
            return max(1, ceil(seconds / time_step_s / stride)) * stride

        model, coupled = world.model, {hand.prefix + name for c in hand.couplings for name in c.joints}
        self._coupled = np.array([model.joint(int(joint)).name in coupled for joint in model.dof_jntid])
        self._damping, self._own, self._factor = damping, np.array(model.dof_damping), spec.factor
        self._begin, self._last, self._stride = first_step + steps(spec.begin_s), last_step, stride
        self._end = self._begin + steps(max(last_step - self._begin, 0) * time_step_s / spec.factor)
        self._measure = steps(spec.measure_s)
        self._still_m = spec.still_m_s * self._measure * time_step_s
        self._place = slice(world.object_qpos, world.object_qpos + 3)
        self._before = np.zeros((len(damping), 3))

    def start(self, slots: Steps) -> None:
        """Reset slots that take up new trials."""
        self._damping[slots] = self._own

    def stretch(self, slots: Steps, step: Steps) -> Steps:
        """Count the steps ``(k,)`` that are left of each slot's present stretch, and set their damping."""
        hastened = (step >= self._begin) & (step < self._end)
        self._damping[slots] = np.where(self._coupled & hastened[:, None], self._own / self._factor, self._own)
        ends = np.where(step < self._begin, self._begin, self._end)
        measured = step - self._end
        left = np.where(measured < 0, ends - step, self._measure - measured % self._measure)
        return np.minimum(left, self._last - step)

    def advance(self, slots: Steps, step: Steps, qpos: NDArray[np.float64]) -> Steps:
        """Count the steps ``(k,)`` that slots under weight skip: all but the last few, once their objects are still."""
        skipped, since, last = np.zeros_like(step), step - self._end, self._last - self._stride
        measured = (since >= 0) & (since % self._measure == 0) & (step < last)
        chosen = slots[measured]
        moved = np.linalg.norm(qpos[chosen, self._place] - self._before[chosen], axis=1)
        self._before[chosen] = qpos[chosen, self._place]
        still = (moved < self._still_m) & (since[measured] > 0)
        skipped[measured] = np.where(still, last - step[measured], 0)
        return skipped
