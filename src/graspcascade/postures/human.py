"""Statistics of recorded human precision grasps: mean, spread and percentiles of joint angles by grasp type."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_UNRECORDED_SD_RAD = np.radians(5.0)
"""Spread given to joints without recordings (LFJ5), which humans kept near zero."""


@dataclass(frozen=True)
class HumanStatistics:
    """Hold one type's figures, ``(J,)`` radians in the order asked for.

    Attributes:
        n_grasps: recorded grasps behind the figures.
        recorded: which joints were recorded.
        mean: mean angle.
        sd: standard deviation.
        p10: tenth percentile.
        p90: ninetieth percentile.
    """

    n_grasps: int
    recorded: NDArray[np.bool_]
    mean: Array
    sd: Array
    p10: Array
    p90: Array


@lru_cache(maxsize=1)
def _rows() -> Mapping[tuple[str, str], Mapping[str, str]]:
    text = (files("graspcascade.postures") / "human_statistics.csv").read_text()
    return {(row["grasp_type"], row["statistic"]): row for row in csv.DictReader(text.splitlines())}


def human_statistics(grasp_type: str, joint_names: tuple[str, ...]) -> HumanStatistics:
    """Look up the figures of a grasp type; a joint without recordings has mean 0 and a spread of 5 degrees."""
    rows = _rows()
    recorded = np.array([f"{name}_deg" in rows[grasp_type, "mean"] for name in joint_names])

    def figures(statistic: str, default: float) -> Array:
        row = rows[grasp_type, statistic]
        return np.array([np.radians(float(row[f"{n}_deg"])) if f"{n}_deg" in row else default for n in joint_names])

    return HumanStatistics(
        n_grasps=int(rows[grasp_type, "mean"]["n_grasps"]),
        recorded=recorded,
        mean=figures("mean", 0.0),
        sd=figures("sd", _UNRECORDED_SD_RAD),
        p10=figures("p10", -1.28 * _UNRECORDED_SD_RAD),
        p90=figures("p90", 1.28 * _UNRECORDED_SD_RAD),
    )
