"""From grasps to the matrices that stages are trained on, and back: quantities as columns, poses in their frame."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from ...core.errors import InputError, check_name
from ...core.objects import AXES, SHAPES, GraspObject, Shape
from ...core.poses import Pose, canonical_quat, matrix_to_quat, quat_multiply
from ...core.records import taxonomy_to_json
from ...core.tasks import Task, Tasks
from ...core.taxonomy import TAXONOMIES, as_type
from ...nets import HeadSpec, VaeSpec
from .stages import Frame, ObjectCode, Quantity, Stage, Target

Array = NDArray[np.float64]
_POSTURE_HEAD_WEIGHT = 4.0


@dataclass(frozen=True)
class Request:
    """Hold what grasps are asked for, one row each: tasks, and the two sizes in metres."""

    tasks: Tasks
    grasp_size_m: Array
    object_size_m: Array


@dataclass(frozen=True)
class Vocabulary:
    """Name what a model was taught to tell apart; the order is that of its inputs.

    Attributes:
        grasp_types: names of the types.
        objects: the objects that it knows by name, each of another shape; none where it tells them otherwise.
        shapes: kinds of shapes.
        taxonomy: whose types they are (see `core.taxonomy.TAXONOMIES`).

    Raises:
        InputError: an unknown name, or one that comes twice.
    """

    grasp_types: tuple[str, ...]
    objects: tuple[GraspObject, ...]
    shapes: tuple[str, ...] = tuple(SHAPES)
    taxonomy: str = "paper"

    def __post_init__(self) -> None:
        for names in (self.grasp_types, tuple(obj.name for obj in self.objects), self.shapes):
            if len(set(names)) < len(names):
                raise InputError(f"a vocabulary needs names, each of them once, got {', '.join(names)}")
        if not self.grasp_types or not self.shapes:
            raise InputError("a vocabulary needs grasp types and shapes")
        check_name("taxonomy", self.taxonomy, TAXONOMIES)
        for name in self.grasp_types:
            as_type(name, TAXONOMIES[self.taxonomy])
        for name in self.shapes:
            check_name("shape", name, SHAPES)
        if len({obj.shape for obj in self.objects}) < len(self.objects):
            raise InputError("a vocabulary needs objects of different shapes or sizes")

    @classmethod
    def of(cls, tasks: Tasks, code: ObjectCode = "label") -> Vocabulary:
        """Collect what tasks ask for; of objects told by label, the first of a shape lends its name."""
        asked = {task.grasp_type.name for task in tasks.distinct}
        objects: dict[Shape, GraspObject] = {}
        for task in tasks.distinct if code == "label" else ():
            objects.setdefault(task.object.shape, task.object)
        types = tuple(name for name in TAXONOMIES[tasks.taxonomy] if name in asked)
        return cls(types, tuple(objects.values()), taxonomy=tasks.taxonomy)

    def known(self, obj: GraspObject) -> GraspObject | None:
        """Look up the known object of the same shape, None where there is none."""
        return next((other for other in self.objects if other.shape == obj.shape), None)

    def renamed(self, tasks: Tasks) -> Tasks:
        """Replace objects by the known ones of the same shape."""
        table = (replace(task, object=self.known(task.object) or task.object) for task in tasks.distinct)
        return Tasks(tuple(table), np.searchsorted(tasks.used, tasks.row))

    def check(self, task: Task, code: ObjectCode) -> None:
        """Check that the model can be asked for a task.

        Raises:
            InputError: a type that it has not seen, a site that is no side, or an object that it does not know though
                it tells objects by name; the message names the types, or the nearest object.
        """
        check_side(task)
        obj = task.object
        if task.grasp_type.name not in self.grasp_types:
            known = ", ".join(self.grasp_types)
            raise InputError(f"this model has seen no grasps of type {task.grasp_type.name!r}; it knows {known}")
        if code == "label" and self.known(obj) is None:
            size = np.array(obj.extents_m)
            alike = [other for other in self.objects if other.shape.kind == obj.shape.kind] or self.objects
            nearest = min(alike, key=lambda other: float(np.abs(np.array(other.extents_m) - size).sum()))
            raise InputError(
                f"this model knows {len(self.objects)} objects by name and not {obj.name}; the nearest of these is "
                f"{nearest.name}. The heuristic takes any size (--model heuristic, or screened), and so does "
                "a cascade trained as any_size."
            )

    def to_json(self) -> dict[str, Any]:
        """Describe the vocabulary as plain data."""
        return {
            "grasp_types": list(self.grasp_types),
            "objects": [{"name": obj.name} | obj.to_json() for obj in self.objects],
            "shapes": list(self.shapes),
            **taxonomy_to_json(self.taxonomy),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Vocabulary:
        """Rebuild a vocabulary from `to_json()`; an InputError says that it is malformed."""
        try:
            named = [(about["name"], {key: about[key] for key in about if key != "name"}) for about in data["objects"]]
            types, shapes = (tuple(map(str, data[key])) for key in ("grasp_types", "shapes"))
        except (KeyError, TypeError) as error:
            raise InputError(
                f"a vocabulary lists grasp_types, objects with their names, and shapes: {error}"
            ) from error
        objects = tuple(GraspObject.from_json(name, about) for name, about in named)
        return cls(types, objects, shapes, str(data.get("taxonomy", "paper")))


def check_side(task: Task) -> None:
    """Check that a task is one a cascade can learn: a site that is no side of the object is an InputError."""
    obj, site = task.object, task.site
    if not math.isclose(obj.sides_m.get(site.name, math.nan), site.width_m, rel_tol=1e-6):
        raise InputError(
            f"this model holds objects by their sides, not by {site.name}, {site.width_m * 100:g} cm wide; sides "
            f"of {obj.name}: {obj.describe_sides()}. The heuristic takes any site (--model heuristic, or screened)."
        )


def shared_quantities(request: Request, code: ObjectCode) -> set[Quantity]:
    """Find the quantities of `encode_request` whose columns are the same in all rows."""
    distinct = request.tasks.distinct
    types = len({task.grasp_type for task in distinct}) == 1
    objects = len({task.object for task in distinct}) == 1
    sites = len({task.site for task in distinct}) == 1
    same = {
        "grasp_type": types,
        "object_type": objects and (sites or code == "label"),
        "grasp_size": bool(len(request.grasp_size_m)) and (request.grasp_size_m == request.grasp_size_m[:1]).all(),
        "object_size": objects and sites and (request.object_size_m == request.object_size_m[:1]).all(),
    }
    return {name for name in get_args(Quantity) if same.get(name, False)}


def encode_request(request: Request, vocabulary: Vocabulary, code: ObjectCode) -> dict[Quantity, Array]:
    """Encode what is asked for as columns by quantity.

    The object size comes with the true side and its axis, without which a size is ambiguous between sides.

    Args:
        request: what is asked for, all of it known (see `Vocabulary.check`).
        vocabulary: the names that the model knows.
        code: how objects are told apart: by "label", one of the known objects, or by "site": kind, whether the site
            lies along a cylinder, and extents along the axes of the site's frame.
    """
    tasks, n = request.tasks, len(request.tasks)
    known, shapes = [obj.shape for obj in vocabulary.objects], vocabulary.shapes
    width = len(known) if code == "label" else len(shapes) + 4

    def object_code(task: Task) -> Array:
        shape = task.object.shape
        if code == "label":
            return _one_hot(shape, known)
        extents = [shape.extents_m[AXES.index(axis)] for axis in site_axes(task)]
        return np.concatenate(
            [_one_hot(shape.kind, shapes), [shape.kind == "cylinder" and task.site.name == "z"], extents]
        )

    # Reshaping gives no tasks at all the right number of columns too.
    types = tasks.column(lambda task: _one_hot(task.grasp_type.name, vocabulary.grasp_types))
    axes = tasks.column(lambda task: np.eye(3)[AXES.index(task.site.name)]).reshape(n, 3)
    return {
        "grasp_type": types.reshape(n, len(vocabulary.grasp_types)),
        "object_type": tasks.column(object_code).reshape(n, width),
        "grasp_size": request.grasp_size_m[:, None],
        "object_size": np.concatenate([request.object_size_m[:, None], tasks.side_m[:, None], axes], axis=1),
    }


def _right_handed(order: Sequence[int]) -> Array:
    """Make a rotation ``(3, 3)`` whose columns are the axes of an order, the middle one turned round where need be."""
    columns = np.eye(3)[:, list(order)]
    columns[:, 1] *= np.linalg.det(columns)
    return columns


def _one_hot(value: object, known: Sequence[object]) -> Array:
    return np.asarray(np.eye(len(known))[known.index(value)])


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
    along, first, second = (other - thumb).T
    # A half-turn that lays the frame's x axis in the hand's xy plane, then a turn about the hand's x axis.
    lean = 0.5 * np.arctan2(np.hypot(first, second), along)
    turn = 0.5 * np.arctan2(second, first)
    a, b, c, s = np.cos(lean), np.sin(lean), np.cos(turn), np.sin(turn)
    return Pose((thumb + other) / 2, canonical_quat(np.stack([-s * a, c * a, c * b, s * b], axis=-1)))


def in_hand(pose: Pose, thumb: Array, other: Array, frame: Frame) -> Pose:
    """Bring poses from the learning frame into the hand frame (see `learning_frame`)."""
    return pose if frame == "hand" else learning_frame(thumb, other, frame) @ pose


_CYCLE = np.array([0.5, 0.5, 0.5, 0.5])  # takes x to y, y to z, z to x
_SIDE_TO_X = {"x": np.array([1.0, 0.0, 0.0, 0.0]), "y": _CYCLE * [1, -1, -1, -1], "z": _CYCLE}
"""For each side axis a rotation that lays it along the frame's x axis."""


def site_axes(task: Task) -> str:
    """Order the object's body axes as those of the site's frame: along the site, then the shorter of the others.

    The last is a cylinder's own axis where that is across the site.
    """
    x = AXES.index(task.site.name)
    others = [(x + 1) % 3, (x + 2) % 3]
    others.sort(key=lambda axis: (task.object.shape.kind == "cylinder" and axis == 2, task.object.extents_m[axis]))
    return "".join(AXES[axis] for axis in (x, *others))


_SITE_FRAMES = {
    "".join(AXES[axis] for axis in order): matrix_to_quat(_right_handed(order)) for order in permutations(range(3))
}


def site_frames(tasks: Tasks) -> Array:
    """Compute the rotations ``(n, 4)``, wxyz, of the sites' frames in their objects' frames (see `site_axes`)."""
    return tasks.column(lambda task: _SITE_FRAMES[site_axes(task)]).reshape(len(tasks), 4)


def fold_rotations(quat_wxyz: Array, tasks: Tasks, frame: Frame) -> Array:
    """Replace rotations by the symmetric images nearest to a fixed reference, so that equal grasps look equal.

    Args:
        quat_wxyz: ``(n, 4)`` object rotations in the learning frame.
        tasks: what each is a grasp of.
        frame: the learning frame; in the hand frame the opposition axis is taken to lie along its z.
    """
    folded = np.empty_like(quat_wxyz)
    # The symmetry is that of the kind of shape, whatever its size.
    of_kind = {task.object.shape.kind: task.object.shape for task in tasks.distinct}
    for (kind, axis), rows in tasks.groups(lambda task: (task.object.shape.kind, task.site.name)):
        to_x = _SIDE_TO_X[axis]
        # The opposing places of a Shadow Hand are roughly above one another along the fingers (hand z).
        reference = to_x if frame == "opposition" else quat_multiply(_SIDE_TO_X["y"], to_x)
        folded[rows] = of_kind[kind].fold(quat_wxyz[rows], reference)
    return folded
