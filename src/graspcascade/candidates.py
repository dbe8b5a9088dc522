"""The geometric heuristic (paper, section IV): from a posture to where the object must be in the hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError, check_name
from .grasps import Grasps
from .hands import HandModel
from .objects import AXES, grasp_object
from .poses import Pose, canonical_quat, quat_multiply
from .taxonomy import grasp_type

Array = NDArray[np.float64]
FreeAngle = Literal["uniform", "minimal"]


def candidates(
    hand: HandModel,
    postures: ArrayLike,
    grasp_types: ArrayLike,
    object_labels: ArrayLike,
    side_axes: ArrayLike,
    rng: np.random.Generator,
    *,
    free_angle: FreeAngle = "uniform",
) -> Grasps:
    """Place each object between the opposing contact places of its posture.

    The centre goes to the middle of the opposition pair of the executed posture, and the body axis of the side along
    the line between the pair. The angle about that line is free.

    Args:
        hand: the hand.
        postures: ``(n, J)`` radians.
        grasp_types: ``(n,)`` names.
        object_labels: ``(n,)`` labels.
        side_axes: ``(n,)`` body axes, each with a graspable side.
        rng: draws the free angles; the same generator state gives the same candidates.
        free_angle: "uniform", or "minimal" for the smallest rotation that brings the axis into line.

    Raises:
        InputError: an unknown name, a side that cannot be held, lengths that differ, or a hand that lacks a contact
            place of a type.
    """
    check_name("free angle", free_angle, get_args(FreeAngle))
    postures = hand.executed(np.atleast_2d(np.asarray(postures, dtype=np.float64)))
    types = _spelled(grasp_types, lambda name: grasp_type(name).name)
    labels = _spelled(object_labels, lambda label: grasp_object(label).label)
    axes = np.asarray(side_axes, dtype=str)
    n = len(postures)
    if not len(types) == len(labels) == len(axes) == n:
        raise InputError(f"got {n} postures, {len(types)} types, {len(labels)} objects and {len(axes)} side axes")
    thumb, other = opposition_points(hand, postures, types)
    axes, sides = _sides(labels, axes)
    turn = rng.uniform(0.0, 2 * np.pi, n)
    if free_angle == "minimal":
        turn = np.zeros(n)
    return Grasps(
        joint_names=hand.joint_names,
        grasp_type=types,
        object_label=labels,
        side_axis=axes,
        side_m=sides,
        posture=postures,
        pregrasp=np.broadcast_to(hand.pregrasp, postures.shape).copy(),
        X_hand_object=Pose((thumb + other) / 2, _align(axes, other - thumb, turn)),
        grasp_size_m=hand.grasp_size(postures),
        object_size_m=np.full(n, np.nan),
        probability=np.full(n, np.nan),
    )


def opposition_points(hand: HandModel, postures: Array, types: NDArray[np.str_]) -> tuple[Array, Array]:
    """Locate the opposition pairs ``(n, 3)``, thumb first, of postures of mixed types, metres in the hand frame.

    Raises:
        InputError: the hand lacks a contact place of a type.
    """
    thumb, other = np.zeros((len(postures), 3)), np.zeros((len(postures), 3))
    for name in np.unique(types):
        rows = types == name
        thumb[rows], other[rows] = hand.opposition(postures[rows], grasp_type(str(name)))
    return thumb, other


def cannot_touch(hand: HandModel, grasps: Grasps) -> NDArray[np.bool_]:
    """Tell which grasps' opposing places stay farther apart than the side is wide, so that closing cannot touch.

    Collection skips these; the heuristic's own success rate counts them.
    """
    thumb, other = opposition_points(hand, grasps.posture, grasps.grasp_type)
    return np.asarray(np.linalg.norm(other - thumb, axis=-1) > grasps.side_m)


def draw_sides(object_labels: ArrayLike, rng: np.random.Generator) -> NDArray[np.str_]:
    """Draw a graspable side axis ``(n,)`` uniformly for each object."""
    labels = np.asarray(object_labels, dtype=str)
    share = rng.uniform(size=len(labels))
    axes = np.empty(len(labels), dtype="<U1")
    for label in np.unique(labels):
        rows = labels == label
        options = np.array(list(grasp_object(str(label)).graspable_sides_m))
        axes[rows] = options[(share[rows] * len(options)).astype(int)]
    return axes


def _spelled(names: ArrayLike, spell: Callable[[str], str]) -> NDArray[np.str_]:
    """Spell each name as its table does."""
    given = np.asarray(names, dtype=str)
    known = {str(name): spell(str(name)) for name in np.unique(given)}
    return np.array([known[str(name)] for name in given], dtype=str)


def _sides(labels: NDArray[np.str_], axes: NDArray[np.str_]) -> tuple[NDArray[np.str_], Array]:
    canonical, sides = axes.copy(), np.zeros(len(labels))
    for label, axis in {(str(a), str(b)) for a, b in zip(labels, axes, strict=True)}:
        obj = grasp_object(label)
        rows = (labels == label) & (axes == axis)
        canonical[rows] = obj.side_axis(axis)
        sides[rows] = obj.sides_m[obj.side_axis(axis)]
    return canonical, sides


def _align(axes: NDArray[np.str_], direction: Array, turn: Array) -> Array:
    """Rotate body axes onto directions by the smallest rotation, then turn about them."""
    body = np.eye(3)[[AXES.index(axis) for axis in axes]]
    unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    # An axis has no sign (half-turns are symmetries), so the shorter of the two ways round is taken.
    body = np.where((body * unit).sum(axis=-1, keepdims=True) < 0, -body, body)
    smallest = np.concatenate([1.0 + (body * unit).sum(axis=-1, keepdims=True), np.cross(body, unit)], axis=-1)
    about = np.concatenate([np.cos(turn / 2)[:, None], np.sin(turn / 2)[:, None] * unit], axis=-1)
    return canonical_quat(quat_multiply(about, canonical_quat(smallest)))
