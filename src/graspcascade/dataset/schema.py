"""Which columns a shard has, and the way between them and `Grasps` with `Outcomes`.

Every column is a plain scalar, joints by name, so that pyarrow, pandas and Hugging Face `datasets` read shards as they
are. SI units; frames as in `Grasps` and `Outcomes`. Real numbers are stored in single precision.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..columns import Columns, gather, gather_pose, spread, spread_pose
from ..errors import FileFormatError
from ..grasps import Grasps
from ..poses import Pose, canonical_quat
from ..trials import TOUCH_COLUMNS, Outcomes

SCHEMA_VERSION = 1

_LABELS = ("grasp_type", "object_label", "side_axis")
_GRASP_NUMBERS = ("side_m", "grasp_size_m")
_OUTCOME_NUMBERS = ("object_size_m", "displacement_m", "duration_s")


def to_columns(grasps: Grasps, outcomes: Outcomes) -> Columns:
    """Spread grasps and their outcomes over named scalar columns."""
    columns: Columns = {name: getattr(grasps, name) for name in _LABELS}
    columns["verdict"] = outcomes.verdict
    columns["held"] = outcomes.held
    columns["faithful"] = outcomes.faithful(grasps)
    columns |= {name: getattr(grasps, name) for name in _GRASP_NUMBERS}
    columns |= {name: getattr(outcomes, name) for name in _OUTCOME_NUMBERS}
    columns |= spread("posture", grasps.joint_names, grasps.posture)
    columns |= spread("settled", grasps.joint_names, outcomes.settled_posture)
    columns |= spread_pose("object", grasps.X_hand_object)
    columns |= spread_pose("settled_object", outcomes.X_hand_object_settled)
    columns |= spread("touch_closed", TOUCH_COLUMNS, outcomes.touching_closed)
    columns |= spread("touch_end", TOUCH_COLUMNS, outcomes.touching_end)
    return {name: v.astype(np.float32) if v.dtype == np.float64 else v for name, v in columns.items()}


def from_columns(
    columns: Mapping[str, NDArray[Any]], joint_names: tuple[str, ...], pregrasp: NDArray[np.float64]
) -> tuple[Grasps, Outcomes]:
    """Rebuild grasps and outcomes from shard columns.

    Raises:
        FileFormatError: a column is missing.
    """
    try:
        n = len(columns["verdict"])
        numbers = {name: np.asarray(columns[name], dtype=np.float64) for name in (*_GRASP_NUMBERS, *_OUTCOME_NUMBERS)}
        grasps = Grasps(
            joint_names=joint_names,
            **{name: np.asarray(columns[name], dtype=str) for name in _LABELS},
            side_m=numbers["side_m"],
            posture=gather(columns, "posture", joint_names),
            pregrasp=np.broadcast_to(pregrasp, (n, len(joint_names))).copy(),
            X_hand_object=_unit_pose(columns, "object"),
            grasp_size_m=numbers["grasp_size_m"],
            object_size_m=numbers["object_size_m"],
            probability=np.full(n, np.nan),
        )
        outcomes = Outcomes(
            verdict=np.asarray(columns["verdict"], dtype=str),
            touching_closed=gather(columns, "touch_closed", TOUCH_COLUMNS).astype(bool),
            touching_end=gather(columns, "touch_end", TOUCH_COLUMNS).astype(bool),
            settled_posture=gather(columns, "settled", joint_names),
            X_hand_object_settled=_unit_pose(columns, "settled_object"),
            object_size_m=numbers["object_size_m"],
            displacement_m=numbers["displacement_m"],
            duration_s=numbers["duration_s"],
        )
    except KeyError as error:
        raise FileFormatError(f"the dataset lacks column {error.args[0]!r}") from error
    return grasps, outcomes


def _unit_pose(columns: Mapping[str, NDArray[Any]], prefix: str) -> Pose:
    # Single precision shortens quaternions a little; they are made unit again.
    stored = gather_pose(columns, prefix)
    return Pose(stored.position_m, canonical_quat(stored.quat_wxyz))
