"""From named quantities of grasps to the matrices that stages are trained on, and back."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from ..nets import HeadSpec, VaeSpec
from ..objects import AXES, CATALOGUE
from ..taxonomy import GRASP_TYPES
from .stages import Quantity, Stage, Target

Array = NDArray[np.float64]
_TYPES, _OBJECTS = list(GRASP_TYPES), list(CATALOGUE)
_POSTURE_HEAD_WEIGHT = 4.0


@dataclass(frozen=True)
class Cells:
    """Hold the distinct combinations of type, object and side axis of a request.

    Attributes:
        names: ``(m, 3)`` type, object label and side axis of each.
        of_row: ``(n,)`` which of them each row asks for.
    """

    names: NDArray[np.str_]
    of_row: NDArray[np.intp]

    @classmethod
    def find(cls, *columns: NDArray[np.str_]) -> Cells:
        """Find them among columns of names ``(n,)``."""
        of_row = np.zeros(len(columns[0]), dtype=np.intp)
        first = of_row[:1]
        for names in columns:
            # Sorting names is slow, and most requests ask for one thing.
            if (names != names[:1]).any():
                _, place = np.unique(names, return_inverse=True)
                _, first, of_row = np.unique(of_row * len(names) + place, return_index=True, return_inverse=True)
        return cls(np.array([names[first] for names in columns]).T, of_row)


@dataclass(frozen=True)
class Request:
    """Hold what grasps are asked for, one row each: names, side, and the two sizes in metres."""

    grasp_type: NDArray[np.str_]
    object_label: NDArray[np.str_]
    side_axis: NDArray[np.str_]
    side_m: Array
    grasp_size_m: Array
    object_size_m: Array

    @cached_property
    def cells(self) -> Cells:
        """Find what is asked for, each combination once."""
        return Cells.find(self.grasp_type, self.object_label, self.side_axis)


def shared_quantities(request: Request) -> set[Quantity]:
    """Find the quantities of `encode_request` whose columns are the same in all rows."""
    types, labels, axes = (len(set(names)) == 1 for names in request.cells.names.T.tolist())
    same = {
        "grasp_type": types,
        "object_type": labels,
        "grasp_size": bool(len(request.grasp_size_m)) and (request.grasp_size_m == request.grasp_size_m[:1]).all(),
        "object_size": labels and axes and (request.object_size_m == request.object_size_m[:1]).all(),
    }
    return {name for name in get_args(Quantity) if same.get(name, False)}


def target_dim(target: Target, n_joints: int) -> int:
    """Count a target's columns."""
    return {"posture": n_joints, "position": 3, "rotation": 4}[target]


def encode_request(request: Request) -> dict[Quantity, Array]:
    """Encode what is asked for as columns by quantity.

    The object size comes with the true side and its axis, without which a size is ambiguous between sides.
    """
    cells = request.cells
    types, labels, axes = (
        _one_hot(names, order)[cells.of_row]
        for names, order in zip(cells.names.T, (_TYPES, _OBJECTS, list(AXES)), strict=True)
    )
    return {
        "grasp_type": types,
        "object_type": labels,
        "grasp_size": request.grasp_size_m[:, None],
        "object_size": np.concatenate([request.object_size_m[:, None], request.side_m[:, None], axes], axis=1),
    }


def _one_hot(names: NDArray[np.str_], order: list[str]) -> Array:
    return np.eye(len(order))[[order.index(name) for name in names.tolist()]]


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
    """Give the columns of `condition_matrix`, those of the quantities that all rows share apart."""
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
    found, start = {}, 0
    for target in stage.targets:
        end = start + target_dim(target, n_joints)
        found[target] = values[:, start:end]
        start = end
    return found
