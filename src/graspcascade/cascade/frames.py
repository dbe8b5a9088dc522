"""The frame in which object poses are learned, and the folding of rotations by the object's symmetry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..objects import AXES, grasp_object
from ..poses import Pose, matrix_to_quat, quat_multiply
from .stages import Frame

Array = NDArray[np.float64]


def learning_frame(thumb: Array, other: Array, frame: Frame) -> Pose:
    """Locate the frame that poses are learned in, one for each posture, in the hand frame.

    The opposition frame has its origin midway between the opposing places, x along the line from the thumb's to the
    other, and y as near the hand's x as that allows.

    Args:
        thumb: ``(n, 3)`` the thumb's opposing place, metres (see `candidates.opposition_points`).
        other: ``(n, 3)`` the place it opposes.
        frame: which frame.
    """
    if frame == "hand":
        return Pose(np.zeros_like(thumb), np.tile([1.0, 0.0, 0.0, 0.0], (len(thumb), 1)))
    return Pose((thumb + other) / 2, _frame_quat(other - thumb))


def in_hand(pose: Pose, thumb: Array, other: Array, frame: Frame) -> Pose:
    """Bring poses from the learning frame into the hand frame (see `learning_frame`)."""
    return pose if frame == "hand" else learning_frame(thumb, other, frame) @ pose


def _frame_quat(x_axis: Array) -> Array:
    x = x_axis / np.linalg.norm(x_axis, axis=-1, keepdims=True)
    lateral = np.array([1.0, 0.0, 0.0])
    y = lateral - (x * lateral).sum(axis=-1, keepdims=True) * x
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return matrix_to_quat(np.stack([x, y, np.cross(x, y)], axis=-1))


_CYCLE = np.array([0.5, 0.5, 0.5, 0.5])  # takes x to y, y to z, z to x
_SIDE_TO_X = {"x": np.array([1.0, 0.0, 0.0, 0.0]), "y": _CYCLE * [1, -1, -1, -1], "z": _CYCLE}
"""For each side axis a rotation that lays it along the frame's x axis."""


def fold_rotations(
    quat_wxyz: Array, object_labels: NDArray[np.str_], side_axes: NDArray[np.str_], frame: Frame
) -> Array:
    """Replace rotations by the symmetric images nearest to a fixed reference, so that equal grasps look equal.

    Args:
        quat_wxyz: ``(n, 4)`` object rotations in the learning frame.
        object_labels: ``(n,)`` labels.
        side_axes: ``(n,)`` axes of the sides held.
        frame: the learning frame; in the hand frame the opposition axis is taken to lie along its z.
    """
    folded = np.empty_like(quat_wxyz)
    for label in np.unique(object_labels):
        for axis in AXES:
            rows = (object_labels == label) & (side_axes == axis)
            if rows.any():
                folded[rows] = grasp_object(str(label)).fold(quat_wxyz[rows], _reference(axis, frame))
    return folded


def _reference(axis: str, frame: Frame) -> Array:
    to_x = _SIDE_TO_X[axis]
    # The opposing places of a Shadow Hand are roughly above one another along the fingers (hand z).
    return to_x if frame == "opposition" else quat_multiply(_CYCLE * [1, -1, -1, -1], to_x)
