"""Where grasps put the object: relative to the opposing places of the posture, in the hand frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graspcascade.candidates import opposition_points
from graspcascade.grasps import Grasps
from graspcascade.hands import HandModel
from graspcascade.objects import AXES, CATALOGUE
from graspcascade.poses import as_rotation

Array = NDArray[np.float64]


def off_centre_mm(hand: HandModel, grasps: Grasps) -> Array:
    """Give how far ``(n,)`` the object's centre is from the middle between the opposing places."""
    thumb, other = opposition_points(hand, grasps.posture, grasps.grasp_type)
    return np.asarray(1000.0 * np.linalg.norm(grasps.X_hand_object.position_m - (thumb + other) / 2, axis=1))


def tilt_deg(hand: HandModel, grasps: Grasps) -> Array:
    """Give the angle ``(n,)`` by which the side held is off the line through the opposing places; 0 for spheres.

    Across a cylinder every direction is a side, so that only its axis can be off the right angle to that line.
    """
    shapes, across = shapes_held(grasps)
    axes = np.where(across, "z", grasps.side_axis)
    cosine = np.abs((in_hand(grasps, axes) * opposition_lines(hand, grasps)).sum(axis=1)).clip(0.0, 1.0)
    angle = np.degrees(np.where(across, np.arcsin(cosine), np.arccos(cosine)))
    return np.asarray(np.where(shapes == "sphere", 0.0, angle))


def turn_rad(hand: HandModel, grasps: Grasps) -> Array:
    """Give the turn ``(n,)`` about the line through the opposing places, from the hand's z axis, up to half turns.

    It is that of a cylinder's axis, held across, or of the side that follows the one held of a box. NaN where all turns
    look alike: of spheres, and of cylinders held along their axis.
    """
    shapes, across = shapes_held(grasps)
    following = np.array([AXES[(AXES.index(name) + 1) % 3] for name in grasps.side_axis.tolist()])
    line = opposition_lines(hand, grasps)
    turned = in_hand(grasps, np.where(across, "z", following))
    start = np.array([0.0, 0.0, 1.0]) - line[:, 2:] * line
    angle = np.arctan2((np.cross(line, start) * turned).sum(axis=1), (start * turned).sum(axis=1))
    return np.asarray(np.where(across | (shapes == "box"), angle % np.pi, np.nan))


def opposition_lines(hand: HandModel, grasps: Grasps) -> Array:
    """Give the unit vectors ``(n, 3)`` from the thumb's place to the one that opposes it, in the hand frame."""
    thumb, other = opposition_points(hand, grasps.posture, grasps.grasp_type)
    return np.asarray((other - thumb) / np.linalg.norm(other - thumb, axis=1, keepdims=True))


def shapes_held(grasps: Grasps) -> tuple[NDArray[np.str_], NDArray[np.bool_]]:
    """Give the objects' shapes ``(n,)``, and which are cylinders held across."""
    shapes = np.array([CATALOGUE[label].shape for label in grasps.object_label.tolist()])
    return shapes, np.asarray((shapes == "cylinder") & (grasps.side_axis != "z"))


def in_hand(grasps: Grasps, axes: NDArray[np.str_]) -> Array:
    """Give a body axis ``(n, 3)`` of each object, by its name, in the hand frame."""
    body = np.eye(3)[[AXES.index(name) for name in axes.tolist()]]
    return np.asarray(as_rotation(grasps.X_hand_object.quat_wxyz).apply(body))
