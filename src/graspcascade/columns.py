"""Tables of plain scalars: arrays with named parts spread over columns, joints by name and poses by axis, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .poses import Pose

Columns = dict[str, NDArray[Any]]
"""Arrays ``(n,)`` by column name."""

_XYZ, _WXYZ = ("x_m", "y_m", "z_m"), ("qw", "qx", "qy", "qz")


def spread(prefix: str, names: tuple[str, ...], values: NDArray[Any]) -> Columns:
    """Give the parts of values ``(n, len(names))`` as columns ``<prefix>_<name>``."""
    return {f"{prefix}_{name}": np.ascontiguousarray(values[:, i]) for i, name in enumerate(names)}


def spread_pose(prefix: str, pose: Pose) -> Columns:
    """Give poses ``(n, 3)`` and ``(n, 4)`` as columns ``<prefix>_x_m`` to ``<prefix>_qz``, quaternions wxyz."""
    return spread(prefix, _XYZ, pose.position_m) | spread(prefix, _WXYZ, pose.quat_wxyz)


def gather(columns: Mapping[str, NDArray[Any]], prefix: str, names: tuple[str, ...]) -> NDArray[np.float64]:
    """Put columns ``<prefix>_<name>`` together, ``(n, len(names))`` in double precision.

    Raises:
        KeyError: with the name of a column that is missing.
    """
    return np.stack([np.asarray(columns[f"{prefix}_{name}"], dtype=np.float64) for name in names], axis=1)


def gather_pose(columns: Mapping[str, NDArray[Any]], prefix: str) -> Pose:
    """Put the columns of poses together, quaternions as they are stored.

    Raises:
        KeyError: with the name of a column that is missing.
    """
    return Pose(gather(columns, prefix, _XYZ), gather(columns, prefix, _WXYZ))
