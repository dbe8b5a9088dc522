"""`Grasps`, the one noun that flows: heuristic and sampler return it, trials take it, formats read and write it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError
from .poses import Pose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Grasps:
    """Hold a batch of n grasps, one row each.

    Attributes:
        joint_names: names of the J columns of `posture` and `pregrasp`.
        grasp_type: ``(n,)`` names of `taxonomy.GRASP_TYPES`.
        object_label: ``(n,)`` labels of `objects.CATALOGUE`.
        side_axis: ``(n,)`` body axis of the object that lies along the opposition axis.
        side_m: ``(n,)`` extent of the object along that axis, metres.
        posture: ``(n, J)`` target joint angles, radians.
        pregrasp: ``(n, J)`` open hand before closing, radians.
        X_hand_object: object pose in the hand (palm) frame, ``(n, 3)`` and ``(n, 4)``.
        grasp_size_m: ``(n,)`` thumb-tip to index-tip distance of the posture executed without an object, metres.
        object_size_m: ``(n,)`` the same distance with the object held, metres; a sampler states its aim, NaN unknown.
        probability: ``(n,)`` chance of success, NaN where the source gives none.
    """

    joint_names: tuple[str, ...]
    grasp_type: NDArray[np.str_]
    object_label: NDArray[np.str_]
    side_axis: NDArray[np.str_]
    side_m: Array
    posture: Array
    pregrasp: Array
    X_hand_object: Pose
    grasp_size_m: Array
    object_size_m: Array
    probability: Array

    def __post_init__(self) -> None:
        """Check the shape of every column.

        Raises:
            InputError: a column has another length, or its width does not fit `joint_names` or a pose.
        """
        n, joints = len(self.grasp_type), len(self.joint_names)
        width = {"posture": (joints,), "pregrasp": (joints,), "position_m": (3,), "quat_wxyz": (4,)}
        for name, column in self.columns().items():
            expected = (n, *width.get(name, ()))
            if np.shape(column) != expected:
                raise InputError(f"column {name} has shape {np.shape(column)}, expected {expected}")

    def __len__(self) -> int:
        """Count the grasps."""
        return len(self.grasp_type)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Give every per-grasp array by name, the pose as `position_m` and `quat_wxyz`."""
        found = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("joint_names", "X_hand_object")}
        return found | {"position_m": self.X_hand_object.position_m, "quat_wxyz": self.X_hand_object.quat_wxyz}

    @classmethod
    def from_columns(cls, joint_names: Sequence[str], columns: dict[str, NDArray[Any]]) -> Grasps:
        """Rebuild a batch from `columns()`."""
        rest = {k: v for k, v in columns.items() if k not in ("position_m", "quat_wxyz")}
        return cls(
            joint_names=tuple(joint_names), X_hand_object=Pose(columns["position_m"], columns["quat_wxyz"]), **rest
        )

    def __getitem__(self, rows: ArrayLike | slice) -> Grasps:
        """Select rows by slice, index array or mask; always a batch."""
        index: Any = rows if isinstance(rows, slice) else np.atleast_1d(np.asarray(rows))
        if not isinstance(index, slice) and index.size == 0 and index.dtype != np.bool_:
            index = index.astype(np.intp)  # numpy reads an empty list as floats, which cannot index
        return Grasps.from_columns(self.joint_names, {k: v[index] for k, v in self.columns().items()})

    def __iter__(self) -> Iterator[Grasps]:
        """Walk over the grasps as batches of one."""
        return (self[i : i + 1] for i in range(len(self)))

    @classmethod
    def concatenate(cls, parts: Sequence[Grasps]) -> Grasps:
        """Join batches of one joint order.

        Raises:
            InputError: no parts, or the joint names differ.
        """
        if not parts or any(p.joint_names != parts[0].joint_names for p in parts):
            raise InputError("only grasps of the same joints can be joined, and at least one batch is needed")
        columns = [p.columns() for p in parts]
        return cls.from_columns(parts[0].joint_names, {k: np.concatenate([c[k] for c in columns]) for k in columns[0]})

    def hand_pose(self, X_world_object: Pose) -> Pose:
        """Place the hand so that each grasp's relative pose is kept.

        Args:
            X_world_object: object pose in the world, one for all (``(3,)``, ``(4,)``) or one each.

        Returns:
            Pose of the hand frame (palm, wrist straight) in the world, ``(n, 3)`` and ``(n, 4)``.
        """
        return X_world_object @ self.X_hand_object.inverse()

    def posture_by_name(self) -> dict[str, Array]:
        """Give the target angles ``(n,)`` in radians by joint name."""
        return {name: self.posture[:, i] for i, name in enumerate(self.joint_names)}
