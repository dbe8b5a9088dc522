"""What a change of joint angles does to the contact places: the measure by which posture errors matter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..hands import HandModel
from ..taxonomy import GRASP_TYPES, GraspType, grasp_type

Array = NDArray[np.float64]
N_ROWS = 3 + 3 * max(len(kind.support) for kind in GRASP_TYPES.values())
"""Rows of a contact metric: the opposition vector, then an offset for each supporting place."""


def contact_metric(hand: HandModel, postures: Array, grasp_types: NDArray[np.str_]) -> NDArray[np.float32]:
    """Differentiate the contact geometry of each posture with respect to its joints.

    Args:
        hand: the hand.
        postures: ``(n, J)`` radians.
        grasp_types: ``(n,)`` names.

    Returns:
        ``(n, N_ROWS, J)`` metres per radian; rows without a supporting place are zero.
    """
    found = np.zeros((len(postures), N_ROWS, postures.shape[1]), dtype=np.float32)
    for name in np.unique(grasp_types):
        rows = np.flatnonzero(grasp_types == name)
        kind = grasp_type(str(name))
        for chunk in np.array_split(rows, max(1, len(rows) // 2000)):
            size = 3 + 3 * len(kind.support)
            found[chunk, :size] = _jacobian(hand, postures[chunk], kind)
    return found


def _jacobian(hand: HandModel, postures: Array, kind: GraspType) -> Array:
    step = 1e-5
    n_joints = postures.shape[1]
    columns = []
    for joint in range(n_joints):
        change = step * np.eye(n_joints)[joint]
        columns.append(
            (_geometry(hand, postures + change, kind) - _geometry(hand, postures - change, kind)) / (2 * step)
        )
    return np.stack(columns, axis=-1)


def _geometry(hand: HandModel, postures: Array, kind: GraspType) -> Array:
    thumb, other = kind.opposition
    # Averaged by hand instead of `executed`, whose clipping at the limits would hide the slope there.
    places = hand.places(hand.share(postures), [thumb, other, *kind.support])
    vectors = [places[other].point_m - places[thumb].point_m]
    vectors += [places[name].point_m - places[other].point_m for name in kind.support]
    return np.concatenate(vectors, axis=-1)
