"""`Outcomes`: what became of each grasp in its trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..grasps import Grasps
from ..poses import Pose
from ..taxonomy import DIGITS, grasp_type

VERDICTS: tuple[str, ...] = ("held", "overlap", "missed", "shaken_out", "dropped", "unstable")
"""Every verdict; all but the first are failures.

`overlap`: hand and object intersect at the start. `missed`: after closing the thumb and a finger do not both touch the
object. `shaken_out`, `dropped`: the object left during the shake, or under gravity or without contact at its end.
`unstable`: the engine reported a warning or a non-finite state.
"""
TOUCH_COLUMNS: tuple[str, ...] = (*DIGITS, "palm")


@dataclass(frozen=True)
class Outcomes:
    """Hold the results of n trials, one row each, in the order of the grasps.

    Attributes:
        verdict: ``(n,)`` one of `VERDICTS`.
        touching_closed: ``(n, 6)`` contacts with the object after closing, columns `TOUCH_COLUMNS`.
        touching_end: ``(n, 6)`` the same at the end of a held trial, False for failures.
        settled_posture: ``(n, J)`` joint angles after closing, radians; NaN where closing was not reached.
        X_hand_object_settled: object pose after closing; NaN likewise.
        object_size_m: ``(n,)`` thumb-tip to index-tip distance after closing, metres; NaN likewise.
        displacement_m: ``(n,)`` distance of the object's centre from its settled place when the trial ended; NaN
            likewise.
        duration_s: ``(n,)`` simulated time.
    """

    verdict: NDArray[np.str_]
    touching_closed: NDArray[np.bool_]
    touching_end: NDArray[np.bool_]
    settled_posture: NDArray[np.float64]
    X_hand_object_settled: Pose
    object_size_m: NDArray[np.float64]
    displacement_m: NDArray[np.float64]
    duration_s: NDArray[np.float64]

    @property
    def held(self) -> NDArray[np.bool_]:
        """Tell which grasps held."""
        return np.asarray(self.verdict == "held")

    def faithful(self, grasps: Grasps) -> NDArray[np.bool_]:
        """Tell which grasps held and touch every digit their type needs."""
        found = self.held.copy()
        for name in np.unique(grasps.grasp_type):
            rows = grasps.grasp_type == name
            found[rows] &= grasp_type(str(name)).is_faithful(self.touching_end[rows, : len(DIGITS)])
        return found

    def __len__(self) -> int:
        """Count the trials."""
        return len(self.verdict)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Give every per-trial array by name, the settled pose as position and quaternion."""
        found = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "X_hand_object_settled"}
        settled = self.X_hand_object_settled
        return found | {"settled_position_m": settled.position_m, "settled_quat_wxyz": settled.quat_wxyz}

    @classmethod
    def from_columns(cls, columns: dict[str, NDArray[Any]]) -> Outcomes:
        """Rebuild from `columns()`."""
        rest = {k: v for k, v in columns.items() if not k.startswith("settled_") or k == "settled_posture"}
        return cls(X_hand_object_settled=Pose(columns["settled_position_m"], columns["settled_quat_wxyz"]), **rest)

    def __getitem__(self, rows: Any) -> Outcomes:
        """Select rows by slice, index array or mask; always a batch."""
        index = rows if isinstance(rows, slice) else np.atleast_1d(np.asarray(rows))
        if not isinstance(index, slice) and index.size == 0 and index.dtype != np.bool_:
            index = index.astype(np.intp)  # numpy reads an empty list as floats, which cannot index
        return Outcomes.from_columns({k: v[index] for k, v in self.columns().items()})

    @classmethod
    def concatenate(cls, parts: Sequence[Outcomes]) -> Outcomes:
        """Join batches."""
        columns = [part.columns() for part in parts]
        return cls.from_columns({k: np.concatenate([c[k] for c in columns]) for k in columns[0]})

    @classmethod
    def blank(cls, n: int, n_joints: int) -> Outcomes:
        """Make n rows to be filled in by an engine."""
        return cls(
            verdict=np.full(n, "unstable", dtype="<U10"),
            touching_closed=np.zeros((n, len(TOUCH_COLUMNS)), dtype=bool),
            touching_end=np.zeros((n, len(TOUCH_COLUMNS)), dtype=bool),
            settled_posture=np.full((n, n_joints), np.nan),
            X_hand_object_settled=Pose(np.full((n, 3), np.nan), np.full((n, 4), np.nan)),
            object_size_m=np.full(n, np.nan),
            displacement_m=np.full(n, np.nan),
            duration_s=np.zeros(n),
        )
