"""Where a grasp is in contact: the settled joints and object pose of its trial, else what was commanded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..grasps import Grasps
from ..poses import Pose
from .options import ExportOptions


@dataclass(frozen=True)
class Contact:
    """Hold joints and object poses in contact.

    Attributes:
        posture: ``(n, J)`` radians, in the order of the grasps' joints.
        X_hand_object: ``(n, 3)`` and ``(n, 4)``.
        measured: ``(n,)`` whether they come from a trial; else they are the target and the object as placed.
    """

    posture: NDArray[np.float64]
    X_hand_object: Pose
    measured: NDArray[np.bool_]


def contact_of(grasps: Grasps, options: ExportOptions) -> Contact:
    """Take each grasp's contact from its outcome where there is one and closing was reached."""
    placed, outcomes = grasps.X_hand_object, options.outcomes
    if outcomes is None:
        return Contact(grasps.posture, placed, np.zeros(len(grasps), dtype=bool))
    settled = outcomes.X_hand_object_settled
    reached = np.isfinite(np.concatenate([outcomes.settled_posture, settled.position_m], axis=1)).all(axis=1)
    rows = reached[:, None]
    return Contact(
        np.where(rows, outcomes.settled_posture, grasps.posture),
        Pose(
            np.where(rows, settled.position_m, placed.position_m), np.where(rows, settled.quat_wxyz, placed.quat_wxyz)
        ),
        reached,
    )
