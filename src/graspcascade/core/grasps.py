"""`Grasps`, the value that flows: proposals return it, engines try it, formats read and write it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError, as_numbers
from .poses import Pose, canonical_quat, quat_multiply
from .tasks import Tasks

Array = NDArray[np.float64]
_FURTHEST_M, _NONE = 1.0, np.zeros(0)


class Commanded(Protocol):
    """What can be commanded: a `hands.Hand`."""

    def controls(self, angles: Mapping[str, ArrayLike]) -> dict[str, Array]:
        """Compute the actuators' targets ``(n,)`` by name for joint angles ``(n,)`` by name."""


@dataclass(frozen=True, eq=False)
class Grasps:
    """A batch of n grasps for a hand, by its name, one row each.

    Attributes:
        joint_names: names of the J columns of `posture` and `pregrasp`.
        tasks: type, object and site of each grasp.
        posture: ``(n, J)`` target joint angles, radians.
        pregrasp: ``(n, J)`` open hand before closing, radians.
        X_hand_object: object pose in the hand frame, ``(n, 3)`` and ``(n, 4)``.
        grasp_size_m: ``(n,)`` thumb-tip to index-tip distance of the posture executed without an object, metres.
        object_size_m: ``(n,)`` the same distance with the object held, metres; a sampler states its aim, NaN unknown.
        probability: ``(n,)`` chance of success, NaN where the source gives none.

    Raises:
        InputError: a column has another length than the tasks, or its width does not fit `joint_names` or a pose.

    Example:
        >>> from graspcascade import GraspSampler, Pose
        >>> grasps = GraspSampler.pretrained().sample("tripod", "box_medium", "x", n=3)
        >>> grasps
        <Grasps: 3 tripod of box_medium, 22 joints of shadow_hand_right>
        >>> hand = grasps.hand_pose(Pose.of([0.4, 0.0, 0.1], [1, 0, 0, 0]))  # of the hand frame in the world
        >>> hand.position_m.shape, sorted(grasps.posture_by_name())[0]
        ((3, 3), 'FFJ1')
    """

    hand: str
    joint_names: tuple[str, ...]
    tasks: Tasks
    posture: Array
    pregrasp: Array
    X_hand_object: Pose
    grasp_size_m: Array
    object_size_m: Array
    probability: Array

    def __post_init__(self) -> None:
        joints = (len(self.joint_names),)
        width = {"posture": joints, "pregrasp": joints, "position_m": (3,), "quat_wxyz": (4,)}
        columns = {name: as_numbers(f"column {name}", column) for name, column in self.columns().items()}
        for name, column in columns.items():
            expected = (len(self), *width.get(name, ()))
            if column.shape != expected:
                raise InputError(f"column {name} has shape {column.shape}, expected {expected}")
        pose = Pose(columns.pop("position_m"), columns.pop("quat_wxyz"))
        for name, value in [*columns.items(), ("X_hand_object", pose)]:
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        """Count the grasps."""
        return len(self.tasks)

    def __repr__(self) -> str:
        """Describe the batch in one line."""
        hand, types = self.hand or "a hand without a name", _named(self.grasp_type, "types")
        what = f" {types} of {_named(self.object_name, 'objects')}" if len(self) else ""
        return f"<Grasps: {len(self)}{what}, {len(self.joint_names)} joints of {hand}>"

    @property
    def grasp_type(self) -> NDArray[np.str_]:
        """Names of the grasp types ``(n,)``."""
        return self.tasks.grasp_type

    @property
    def object_name(self) -> NDArray[np.str_]:
        """Names of the objects ``(n,)``."""
        return self.tasks.object_name

    @property
    def side_axis(self) -> NDArray[np.str_]:
        """Names of the sites held ``(n,)``, for a primitive the body axis of the side."""
        return self.tasks.side_axis

    @property
    def side_m(self) -> Array:
        """Widths of the sites held ``(n,)``, metres."""
        return self.tasks.side_m

    def columns(self) -> dict[str, Array]:
        """Collect every array of numbers by name, the pose as `position_m` and `quat_wxyz`."""
        sizes = {name: getattr(self, name) for name in ("grasp_size_m", "object_size_m", "probability")}
        return {"posture": self.posture, "pregrasp": self.pregrasp} | vars(self.X_hand_object) | sizes

    @classmethod
    def from_columns(cls, hand: str, joint_names: Sequence[str], tasks: Tasks, columns: Mapping[str, Array]) -> Grasps:
        """Rebuild a batch from its tasks and `columns()`."""
        rest = {name: column for name, column in columns.items() if name not in ("position_m", "quat_wxyz")}
        pose = Pose(columns["position_m"], columns["quat_wxyz"])
        return cls(hand=hand, joint_names=tuple(joint_names), tasks=tasks, X_hand_object=pose, **rest)

    def __getitem__(self, rows: ArrayLike | slice) -> Grasps:
        """Select rows by slice, index array or mask; always a batch."""
        index = batch_index(rows)
        columns = {name: column[index] for name, column in self.columns().items()}
        return Grasps.from_columns(self.hand, self.joint_names, self.tasks[index], columns)

    def __iter__(self) -> Iterator[Grasps]:
        """Iterate over the grasps as batches of one."""
        return (self[i : i + 1] for i in range(len(self)))

    @classmethod
    def concatenate(cls, parts: Sequence[Grasps]) -> Grasps:
        """Join batches of one hand and joint order.

        Raises:
            InputError: no parts, or hands or joint names differ.
        """
        if not parts or any((p.hand, p.joint_names) != (parts[0].hand, parts[0].joint_names) for p in parts):
            raise InputError("only grasps of the same hand and joints can be joined, and at least one batch is needed")
        columns = [part.columns() for part in parts]
        joined = {name: np.concatenate([column[name] for column in columns]) for name in columns[0]}
        tasks = Tasks.concatenate([part.tasks for part in parts])
        return cls.from_columns(parts[0].hand, parts[0].joint_names, tasks, joined)

    def hand_pose(self, X_world_object: Pose) -> Pose:
        """Compute the poses in the world of the hand frame (wrist straight), for one pose of the object or one each."""
        return X_world_object @ self.X_hand_object.inverse()

    def posture_by_name(self) -> dict[str, Array]:
        """Collect the target angles ``(n,)`` in radians by joint name."""
        return {name: self.posture[:, i] for i, name in enumerate(self.joint_names)}

    def controls(self, hand: Commanded, *, opened: bool = False) -> dict[str, Array]:
        """Compute what to command the hand's actuators.

        Args:
            hand: the hand to command, such as another model of the same hand; joints are matched by name.
            opened: command the open hand before closing instead of the posture.

        Returns:
            Targets ``(n,)`` by the MJCF's actuator names: an angle in radians or a tendon's sum of angles, 0 for the
            wrist, all within the control range.

        Raises:
            InputError: the grasps lack joints of the hand, or angles are no radians (see `check_numbers`).
        """
        name, angles = ("pregrasp", self.pregrasp) if opened else ("posture", self.posture)
        check_numbers({name: angles})
        return hand.controls(dict(zip(self.joint_names, angles.T, strict=True)))

    def symmetric_copies(self, turns: int = 8) -> Grasps:
        """Repeat each grasp with its object turned onto itself: the same grasp, approached from another side.

        The copies are equally good as far as hand and object alone are concerned; use them to find one that a table or
        an arm allows. A box has 4, a cylinder two times `turns`, a sphere 24; each grasp comes first of its copies.
        """
        parts, order = [], []
        for shape, rows in self.tasks.groups(lambda task: task.object.shape):
            group, places = shape.symmetries(turns), np.flatnonzero(rows)
            copies = self[np.repeat(places, len(group))]
            quat = quat_multiply(copies.X_hand_object.quat_wxyz, np.tile(group, (len(places), 1)))
            columns = copies.columns() | {"quat_wxyz": canonical_quat(quat)}
            parts.append(Grasps.from_columns(self.hand, self.joint_names, copies.tasks, columns))
            order.append(np.repeat(places, len(group)))
        return Grasps.concatenate(parts)[np.argsort(np.concatenate(order), kind="stable")] if parts else self


def check_numbers(columns: Mapping[str, Array]) -> None:
    """Check columns of grasps, named as in `Grasps.columns` or ``side_m``, whatever the hand.

    Raises:
        InputError: the first grasp whose number is not finite, no length, no chance, or of another unit.
    """

    def refuse(rows: NDArray[np.bool_], what: str, values: Array = _NONE) -> None:
        for row in np.flatnonzero(rows)[:1].tolist():
            raise InputError(f"grasp {row}: {what.format(*values[row : row + 1])}")

    unknowable = ("grasp_size_m", "object_size_m", "probability")  # not-a-number is unknown there
    for name in ("posture", "pregrasp", "position_m", "quat_wxyz", "side_m", *unknowable):
        if name not in columns:
            continue
        column = columns[name]
        rows = column.reshape(len(column), int(np.prod(column.shape[1:])))
        with np.errstate(over="ignore"):  # what is too large for a float is refused like anything else
            largest, norm = np.abs(rows).max(axis=1, initial=0.0), np.linalg.norm(rows, axis=1)
        if name in unknowable:
            refuse(np.isinf(column) | (column < 0), f"{name} is not a length or chance")
        else:
            refuse(np.asarray(~np.isfinite(rows).all(axis=1)), f"{name} is not finite")
        if name in ("posture", "pregrasp"):
            what = f"{name} has an angle of {{:g}}, but angles are radians; this looks like degrees"
            refuse(largest > 2 * np.pi, what, largest)
        elif name == "position_m":
            what = "the object's centre is {:g} m from the palm, but lengths are metres; these look like millimetres"
            refuse(norm > _FURTHEST_M, what, norm)
        elif name == "quat_wxyz":
            refuse(np.abs(norm - 1.0) > 1e-3, "the quaternion (qw qx qy qz) must have norm 1, got norm {:.4g}", norm)
        elif name == "probability":
            refuse(column > 1, "probability is above 1")
        else:
            what = f"{name} is {{:g}}, but lengths are metres; this looks like centimetres or millimetres"
            refuse(column > _FURTHEST_M, what, column)
            if name == "side_m":
                refuse(column <= 0, f"{name} is not a positive length")


def batch_index(rows: Any) -> Any:
    """Turn a slice, index array, mask or single number into an index that selects a batch."""
    if isinstance(rows, slice):
        return rows
    index = np.atleast_1d(np.asarray(rows))
    # numpy reads an empty list as floats, which cannot index.
    return index if index.size or index.dtype == np.bool_ else index.astype(np.intp)


def _named(names: NDArray[np.str_], plural: str) -> str:
    distinct = sorted(set(names.tolist()))
    return distinct[0] if len(distinct) == 1 else f"{len(distinct)} {plural}"
