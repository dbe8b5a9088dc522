"""`Outcomes`: what became of each grasp in its trial."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .grasps import Grasps, batch_index
from .poses import Pose
from .taxonomy import DIGITS

VERDICTS: tuple[str, ...] = (
    *("held", "overlap", "missed", "shaken_out", "dropped"),
    *("pushed_out", "turned", "unstable"),
)
"""Every verdict; all but the first are failures.

`overlap`: hand and object intersect at the start. `missed`: after closing the thumb and a finger do not both touch the
object. `shaken_out`, `dropped`: the object left during the shake, or under gravity or without contact at its end.
`pushed_out`, `turned`: under a protocol that limits turns, the object's centre, or else its orientation, went farther
from its start than allowed. `unstable`: the engine reported a warning or a non-finite state.
"""
PALM = "palm"
STEADY_RAD = math.radians(15.0)
"""An object that turned by less between closing and the end of the trial was held steadily."""


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Results of n trials, one row each, in the order of the grasps.

    Attributes:
        digits: names of the hand's D digits.
        verdict: ``(n,)`` one of `VERDICTS`.
        touching_closed: ``(n, D + 1)`` contacts with the object after closing, columns `touch_columns`.
        touching_end: ``(n, D + 1)`` the same at the end of a held trial, False for failures.
        areas_closed: ``(n, D)`` where each digit touched the object after closing: masks of `taxonomy.AREAS`, 0 where
            it did not, or where nobody recorded it.
        areas_end: ``(n, D)`` the same at the end of a held trial, 0 for failures.
        settled_posture: ``(n, J)`` joint angles after closing, radians; NaN where closing was not reached.
        X_hand_object_settled: object pose after closing; NaN likewise.
        object_size_m: ``(n,)`` thumb-tip to index-tip distance after closing, metres; NaN likewise.
        displacement_m: ``(n,)`` distance of the object's centre from its settled place at the end; NaN likewise. Under
            a protocol that limits turns, the greatest distance from where it started.
        turn_rad: ``(n,)`` angle between its settled orientation and that at the end, or the greatest, likewise.
        duration_s: ``(n,)`` simulated time; a closing that only finds the contact (`Protocol.contact_by`) is left out.
    """

    digits: tuple[str, ...]
    verdict: NDArray[np.str_]
    touching_closed: NDArray[np.bool_]
    touching_end: NDArray[np.bool_]
    areas_closed: NDArray[np.uint16]
    areas_end: NDArray[np.uint16]
    settled_posture: NDArray[np.float64]
    X_hand_object_settled: Pose
    object_size_m: NDArray[np.float64]
    displacement_m: NDArray[np.float64]
    turn_rad: NDArray[np.float64]
    duration_s: NDArray[np.float64]

    @property
    def touch_columns(self) -> tuple[str, ...]:
        """Names of the columns of contacts: the digits, then the palm."""
        return (*self.digits, PALM)

    @property
    def held(self) -> NDArray[np.bool_]:
        """Flags ``(n,)`` of the grasps that held."""
        return np.asarray(self.verdict == "held")

    @property
    def steady(self) -> NDArray[np.bool_]:
        """Flags ``(n,)`` of the grasps that held and in which the object turned by less than `STEADY_RAD`."""
        return np.asarray(self.held & (self.turn_rad < STEADY_RAD))

    def faithful(self, grasps: Grasps) -> NDArray[np.bool_]:
        """Tell which grasps ``(n,)`` held and touch with every digit, and where on it, that their type needs."""
        faithful, length_m = self.held.copy(), grasps.tasks.column(lambda task: task.length_m, np.float64)
        for kind, rows in grasps.tasks.groups(lambda task: task.grasp_type):
            touches = self.touching_end[rows], self.digits, self.areas_end[rows]
            faithful[rows] &= kind.is_faithful(*touches, length_m[rows])
        return faithful

    def __len__(self) -> int:
        """Count the trials."""
        return len(self.verdict)

    def __repr__(self) -> str:
        """Count the verdicts in one line."""
        counts = [
            f"{int((self.verdict == verdict).sum())} {verdict}" for verdict in VERDICTS if verdict in self.verdict
        ]
        return f"<Outcomes: {len(self)} trials, {', '.join(counts) or 'none'}>"

    def columns(self) -> dict[str, NDArray[Any]]:
        """Collect every per-trial array by name, the settled pose as position and quaternion."""
        own = {k: v for k, v in vars(self).items() if k not in ("digits", "X_hand_object_settled")}
        settled = self.X_hand_object_settled
        return own | {"settled_position_m": settled.position_m, "settled_quat_wxyz": settled.quat_wxyz}

    @classmethod
    def from_columns(cls, digits: Sequence[str], columns: Mapping[str, NDArray[Any]]) -> Outcomes:
        """Rebuild from `columns()`."""
        rest = dict(columns)
        pose = Pose(rest.pop("settled_position_m"), rest.pop("settled_quat_wxyz"))
        return cls(digits=tuple(digits), X_hand_object_settled=pose, **rest)

    def __getitem__(self, rows: Any) -> Outcomes:
        """Select rows by slice, index array or mask; always a batch."""
        index = batch_index(rows)
        return Outcomes.from_columns(self.digits, {k: v[index] for k, v in self.columns().items()})

    @classmethod
    def concatenate(cls, parts: Sequence[Outcomes]) -> Outcomes:
        """Join batches of one hand."""
        columns = [part.columns() for part in parts]
        return cls.from_columns(parts[0].digits, {k: np.concatenate([c[k] for c in columns]) for k in columns[0]})

    @classmethod
    def blank(cls, n: int, n_joints: int, digits: Sequence[str] = DIGITS) -> Outcomes:
        """Make n rows to be filled in by an engine."""
        closed, end = np.zeros((2, n, len(digits) + 1), dtype=bool)
        areas_closed, areas_end = np.zeros((2, n, len(digits)), dtype=np.uint16)
        posture, position, quat = (np.full((n, width), np.nan) for width in (n_joints, 3, 4))
        size, displacement, turn = np.full((3, n), np.nan)
        verdict = np.full(n, "unstable", dtype="<U10")
        settled = Pose(position, quat)
        touches = closed, end, areas_closed, areas_end
        return cls(tuple(digits), verdict, *touches, posture, settled, size, displacement, turn, np.zeros(n))
