"""From named quantities of grasps to the matrices that stages are trained on, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..nets import HeadSpec, VaeSpec
from ..objects import AXES, CATALOGUE
from ..taxonomy import GRASP_TYPES
from .stages import Quantity, Stage, Target

Array = NDArray[np.float64]
_TYPES, _OBJECTS = list(GRASP_TYPES), list(CATALOGUE)
_POSTURE_HEAD_WEIGHT = 4.0
_POSITION_HEAD_WEIGHT = 4.0


@dataclass(frozen=True)
class Request:
    """Hold what grasps are asked for, one row each: names, side, and the two sizes in metres."""

    grasp_type: NDArray[np.str_]
    object_label: NDArray[np.str_]
    side_axis: NDArray[np.str_]
    side_m: Array
    grasp_size_m: Array
    object_size_m: Array


def target_dim(target: Target, n_joints: int) -> int:
    """Count a target's columns."""
    return {"posture": n_joints, "position": 3, "rotation": 4}[target]


def encode_request(request: Request) -> dict[Quantity, Array]:
    """Encode what is asked for as columns by quantity.

    The object size comes with the true side and its axis, without which a size is ambiguous between sides.
    """
    axes = _one_hot(request.side_axis, list(AXES))
    return {
        "grasp_type": _one_hot(request.grasp_type, _TYPES),
        "object_type": _one_hot(request.object_label, _OBJECTS),
        "grasp_size": request.grasp_size_m[:, None],
        "object_size": np.concatenate([request.object_size_m[:, None], request.side_m[:, None], axes], axis=1),
    }


def _one_hot(names: NDArray[np.str_], order: list[str]) -> Array:
    values, places = np.unique(names, return_inverse=True)
    return np.eye(len(order))[[order.index(str(value)) for value in values]][places]


def encode_posture(postures: Array, thumb: Array, other: Array) -> Array:
    """Encode postures as conditions: the joint angles and, exactly known from them, the opposing places ``(n, 3)``."""
    distance = np.linalg.norm(other - thumb, axis=-1, keepdims=True)
    return np.concatenate([postures, thumb, other, distance], axis=1)


def condition_matrix(stage: Stage, quantities: Mapping[Quantity, Array]) -> NDArray[np.float32]:
    """Join the columns a stage is conditioned on, in its order."""
    return np.concatenate([quantities[name] for name in stage.given], axis=1).astype(np.float32)


def vae_spec(stage: Stage, n_joints: int, condition_dim: int) -> VaeSpec:
    """Describe a stage's network."""
    heads = {
        "posture": HeadSpec("gaussian", n_joints, _POSTURE_HEAD_WEIGHT),
        "position": HeadSpec("gaussian", 3, _POSITION_HEAD_WEIGHT),
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
    ends = np.cumsum([target_dim(target, n_joints) for target in stage.targets])[:-1]
    return dict(zip(stage.targets, np.split(values, ends, axis=1), strict=True))
