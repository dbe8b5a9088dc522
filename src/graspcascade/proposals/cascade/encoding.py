"""From grasps to the matrices that stages are trained on, and back: quantities as columns, poses in their frame."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from ...core.errors import InputError
from ...core.objects import AXES, CATALOGUE, SHAPES, GraspObject
from ...core.poses import Pose, matrix_to_quat, quat_multiply
from ...core.tasks import Task, Tasks
from ...core.taxonomy import GRASP_TYPES
from ...nets import HeadSpec, VaeSpec
from .stages import Frame, ObjectCode, Quantity, Stage, Target

Array = NDArray[np.float64]
_TYPES, _OBJECTS, _KINDS = list(GRASP_TYPES), list(CATALOGUE), list(SHAPES)
_POSTURE_HEAD_WEIGHT = 4.0


@dataclass(frozen=True)
class Request:
    """Hold what grasps are asked for, one row each: tasks, and the two sizes in metres."""

    tasks: Tasks
    grasp_size_m: Array
    object_size_m: Array


def known_object(obj: GraspObject) -> GraspObject | None:
    """Look up the catalogue object of the same shape, None where there is none."""
    return next((other for other in CATALOGUE.values() if other.shape == obj.shape), None)


def check_known(task: Task, code: ObjectCode) -> None:
    """Check that a model can learn or be asked for a task.

    Raises:
        InputError: the site is no side of the object, or the model knows objects by name and not this one; the message
            names the sides, or the nearest object.
    """
    obj, site = task.object, task.site
    if not math.isclose(obj.sides_m.get(site.name, math.nan), site.width_m, rel_tol=1e-6):
        raise InputError(
            f"this model holds objects by their sides, not by {site.name}, {site.width_m * 100:g} cm wide; sides "
            f"of {obj.name}: {obj.describe_sides()}. The heuristic takes any site (--model heuristic, or screened)."
        )
    if code == "label" and known_object(obj) is None:
        shape, size = obj.shape, np.array(obj.extents_m)
        alike = [other for other in CATALOGUE.values() if other.shape.kind == shape.kind]
        nearest = min(alike, key=lambda other: float(np.abs(np.array(other.extents_m) - size).sum()))
        raise InputError(
            f"this model knows nine objects by name and not {obj.name}; the nearest of these is {nearest.name}. "
            "The heuristic takes any size (--model heuristic, or screened), and so does a model3_any_size once trained."
        )


def shared_quantities(request: Request) -> set[Quantity]:
    """Find the quantities of `encode_request` whose columns are the same in all rows."""
    distinct = request.tasks.distinct
    types = len({task.grasp_type for task in distinct}) == 1
    objects = len({task.object for task in distinct}) == 1
    same = {
        "grasp_type": types,
        "object_type": objects,
        "grasp_size": bool(len(request.grasp_size_m)) and (request.grasp_size_m == request.grasp_size_m[:1]).all(),
        "object_size": objects
        and len({task.site for task in distinct}) == 1
        and (request.object_size_m == request.object_size_m[:1]).all(),
    }
    return {name for name in get_args(Quantity) if same.get(name, False)}


def encode_request(request: Request, code: ObjectCode) -> dict[Quantity, Array]:
    """Encode what is asked for as columns by quantity.

    The object size comes with the true side and its axis, without which a size is ambiguous between sides.

    Args:
        request: what is asked for.
        code: how objects are told apart: by "label", one of the catalogue's nine, or by "shape", kind and extents.
    """
    tasks, n = request.tasks, len(request.tasks)
    width = len(_OBJECTS) if code == "label" else len(_KINDS) + 3
    # Reshaping gives no tasks at all the right number of columns too.
    types = tasks.column(lambda task: np.eye(len(_TYPES))[_TYPES.index(task.grasp_type.name)]).reshape(n, len(_TYPES))
    axes = tasks.column(lambda task: np.eye(3)[AXES.index(task.site.name)]).reshape(n, 3)
    return {
        "grasp_type": types,
        "object_type": tasks.column(lambda task: _object_code(task.object, code)).reshape(n, width),
        "grasp_size": request.grasp_size_m[:, None],
        "object_size": np.concatenate([request.object_size_m[:, None], tasks.side_m[:, None], axes], axis=1),
    }


def _object_code(obj: GraspObject, code: ObjectCode) -> Array:
    if code == "shape":
        return np.concatenate([np.eye(len(_KINDS))[_KINDS.index(obj.shape.kind)], obj.extents_m])
    known = known_object(obj)
    assert known is not None, "check_known was not called"
    return np.asarray(np.eye(len(_OBJECTS))[_OBJECTS.index(known.name)])


def encode_posture(postures: Array, thumb: Array, other: Array) -> Array:
    """Encode postures as conditions: the joint angles and, exactly known from them, the opposing places ``(n, 3)``."""
    distance = np.linalg.norm(other - thumb, axis=-1, keepdims=True)
    return np.concatenate([postures, thumb, other, distance], axis=1)


def condition_matrix(stage: Stage, quantities: Mapping[Quantity, Array]) -> NDArray[np.float32]:
    """Join the columns a stage is conditioned on, in its order."""
    return np.concatenate([quantities[name] for name in stage.given], axis=1, dtype=np.float32, casting="same_kind")


@dataclass(frozen=True)
class Condition:
    """Hold what a stage is conditioned on, the columns that all rows share apart.

    Attributes:
        shared: ``(k,)`` flags of the shared columns.
        shared_values: their values.
        by_row: ``(n, ...)`` the other columns, in order.
    """

    shared: NDArray[np.bool_]
    shared_values: NDArray[np.float32]
    by_row: NDArray[np.float32]


def condition(stage: Stage, quantities: Mapping[Quantity, Array], shared: Collection[Quantity]) -> Condition:
    """Split the columns of `condition_matrix`, those of the quantities that all rows share apart."""
    columns = {name: quantities[name] for name in stage.given}
    by_row = [column for name, column in columns.items() if name not in shared]
    once = [column[0] for name, column in columns.items() if name in shared]
    n = len(columns[stage.given[0]])
    return Condition(
        shared=np.repeat([name in shared for name in columns], [column.shape[1] for column in columns.values()]),
        shared_values=np.concatenate([np.empty(0), *once], dtype=np.float32, casting="same_kind"),
        by_row=np.concatenate([np.empty((n, 0)), *by_row], axis=1, dtype=np.float32, casting="same_kind"),
    )


def vae_spec(stage: Stage, n_joints: int, condition_dim: int, position_weight: float) -> VaeSpec:
    """Describe a stage's network; for the weight see `CascadeTraining.position_weight`."""
    heads = {
        "posture": HeadSpec("gaussian", n_joints, _POSTURE_HEAD_WEIGHT),
        "position": HeadSpec("gaussian", 3, position_weight),
        "rotation": HeadSpec(stage.rotation_head, 4),
    }
    return VaeSpec(
        condition_dim=condition_dim,
        heads=tuple(heads[target] for target in stage.targets),
        latent_dim=stage.latent_dim,
        hidden=stage.hidden,
        kl_weight=stage.kl_weight,
    )


def split_targets(stage: Stage, values: Array, n_joints: int) -> dict[Target, Array]:
    """Divide a stage's output columns into its targets."""
    widths = {"posture": n_joints, "position": 3, "rotation": 4}
    ends = np.cumsum([widths[target] for target in stage.targets])
    return dict(zip(stage.targets, np.split(values, ends[:-1], axis=1), strict=True))


# Poses


def learning_frame(thumb: Array, other: Array, frame: Frame) -> Pose:
    """Locate the frame that poses are learned in, one for each posture, in the hand frame.

    The opposition frame has its origin midway between the opposing places, x along the line from the thumb's to the
    other, and y as near the hand's x as that allows.

    Args:
        thumb: ``(n, 3)`` the thumb's opposing place in the hand frame, metres.
        other: ``(n, 3)`` the place it opposes.
        frame: which frame.
    """
    if frame == "hand":
        return Pose(np.zeros_like(thumb), np.tile([1.0, 0.0, 0.0, 0.0], (len(thumb), 1)))
    x = (other - thumb) / np.linalg.norm(other - thumb, axis=-1, keepdims=True)
    lateral = np.array([1.0, 0.0, 0.0])
    y = lateral - (x * lateral).sum(axis=-1, keepdims=True) * x
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return Pose((thumb + other) / 2, matrix_to_quat(np.stack([x, y, np.cross(x, y)], axis=-1)))


def in_hand(pose: Pose, thumb: Array, other: Array, frame: Frame) -> Pose:
    """Bring poses from the learning frame into the hand frame (see `learning_frame`)."""
    return pose if frame == "hand" else learning_frame(thumb, other, frame) @ pose


_CYCLE = np.array([0.5, 0.5, 0.5, 0.5])  # takes x to y, y to z, z to x
_SIDE_TO_X = {"x": np.array([1.0, 0.0, 0.0, 0.0]), "y": _CYCLE * [1, -1, -1, -1], "z": _CYCLE}
"""For each side axis a rotation that lays it along the frame's x axis."""


def fold_rotations(quat_wxyz: Array, tasks: Tasks, frame: Frame) -> Array:
    """Replace rotations by the symmetric images nearest to a fixed reference, so that equal grasps look equal.

    Args:
        quat_wxyz: ``(n, 4)`` object rotations in the learning frame.
        tasks: what each is a grasp of.
        frame: the learning frame; in the hand frame the opposition axis is taken to lie along its z.
    """
    folded = np.empty_like(quat_wxyz)
    for (shape, axis), rows in tasks.groups(lambda task: (task.object.shape, task.site.name)):
        to_x = _SIDE_TO_X[axis]
        # The opposing places of a Shadow Hand are roughly above one another along the fingers (hand z).
        reference = to_x if frame == "opposition" else quat_multiply(_SIDE_TO_X["y"], to_x)
        folded[rows] = shape.fold(quat_wxyz[rows], reference)
    return folded
