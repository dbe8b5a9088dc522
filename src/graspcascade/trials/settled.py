"""When a hold may be called before its full length: for collecting data only, never for an evaluation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SettledRule:
    """Call a hold when the object rests in the hand and its drift, continued to the end, stays far inside the limit.

    The object's pose is compared at regular looks under gravity; it counts as settled when what it moved between two
    looks, continued over the rest of the trial, and where it is now are both small.
    """

    first_look_s: float = 0.2
    """Time under gravity of the first pose compared."""
    look_every_s: float = 0.2
    """Time between looks."""
    drift_m: float = 0.010
    """Largest drift of the object's centre, continued to the end of the trial."""
    drift_rad: float = 0.5
    """Largest rotation, continued to the end of the trial."""
    moved_m: float = 0.030
    """Largest distance of the object's centre from where closing left it."""

    def is_due(self, under_gravity_s: Array, check_s: float) -> NDArray[np.bool_]:
        """Tell which trials are at a look, given their time under gravity and the time between checks."""
        checks = np.round(np.asarray(under_gravity_s) / check_s).astype(int)
        first, every = round(self.first_look_s / check_s), max(round(self.look_every_s / check_s), 1)
        return (checks >= first) & ((checks - first) % every == 0)

    def is_still(self, earlier: Array, pose: Array, moved_m: Array, left_s: Array) -> NDArray[np.bool_]:
        """Tell which objects rest.

        Args:
            earlier: ``(n, 7)`` position and wxyz quaternion one look ago; not finite where there was none.
            pose: ``(n, 7)`` the same now.
            moved_m: ``(n,)`` distance from where closing left the centre.
            left_s: ``(n,)`` time left in the trial.
        """
        seen = np.isfinite(earlier).all(axis=1)
        before = np.where(seen[:, None], earlier, pose)
        looks_left = left_s / self.look_every_s
        drift = np.linalg.norm(pose[:, :3] - before[:, :3], axis=1) * looks_left
        aligned = np.minimum(np.abs((pose[:, 3:] * before[:, 3:]).sum(axis=1)), 1.0)
        turn = 2 * np.arccos(aligned) * looks_left
        return seen & (drift < self.drift_m) & (turn < self.drift_rad) & (moved_m < self.moved_m)
