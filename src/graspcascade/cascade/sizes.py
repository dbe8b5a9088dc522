"""What grasp size and object size to ask for when a user names a side: offsets measured on grasps that held."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .encoding import Request

Array = NDArray[np.float64]
SizeMode = Literal["median", "drawn", "paper"]

PAPER_GRASP_OFFSET_M = -0.005
"""The paper's grasp size minus side (section V)."""
PAPER_OBJECT_OFFSET_M = 0.010
"""The paper's object size minus side (section V)."""
_KNOTS = np.linspace(0.05, 0.95, 19)
_MIN_GRASPS = 30


@dataclass(frozen=True)
class SizeRule:
    """Give sizes for requests.

    Attributes:
        grasp_offsets_m: for "type/object/axis", "type/object" and "type" the 5 to 95 % quantiles of grasp size minus
            side.
        object_offset_m: the same keys' median of object size minus side.
    """

    grasp_offsets_m: dict[str, list[float]]
    object_offset_m: dict[str, float]

    @classmethod
    def measure(cls, request: Request) -> SizeRule:
        """Measure the offsets on grasps that held, whose sizes the request carries."""
        grasp, obj = request.grasp_size_m - request.side_m, request.object_size_m - request.side_m
        quantiles: dict[str, list[float]] = {}
        medians: dict[str, float] = {}
        for level in map(np.array, _keys(request)):
            for key in np.unique(level):
                rows = level == key
                if rows.sum() >= _MIN_GRASPS or "/" not in key:
                    quantiles[str(key)] = [round(float(v), 5) for v in np.quantile(grasp[rows], _KNOTS)]
                    medians[str(key)] = round(float(np.median(obj[rows])), 5)
        return cls(quantiles, medians)

    def apply(self, request: Request, mode: SizeMode, rng: np.random.Generator) -> tuple[Array, Array]:
        """Give grasp sizes and object sizes ``(n,)`` in metres for each row's side.

        Args:
            request: its own sizes are ignored.
            mode: "median" of what held, "drawn" from what held, or the "paper" constants.
            rng: source of the draws; used in every mode, so that modes stay comparable.

        Raises:
            InputError: a type was never seen in training.
        """
        share = rng.uniform(size=len(request.side_m))
        if mode == "paper":
            return request.side_m + PAPER_GRASP_OFFSET_M, request.side_m + PAPER_OBJECT_OFFSET_M
        grasp, obj = np.empty_like(request.side_m), np.empty_like(request.side_m)
        keys, row_key = np.unique(np.array(_keys(request)[0]), return_inverse=True)
        for place, key in enumerate(map(str, keys)):
            rows = row_key == place
            levels = (key, key.rsplit("/", 1)[0], key.split("/", 1)[0])
            found = next((level for level in levels if level in self.grasp_offsets_m), None)
            if found is None:
                raise InputError(f"this model has seen no grasps of type {levels[-1]!r}")
            at = share[rows] if mode == "drawn" else np.full(int(rows.sum()), 0.5)
            grasp[rows] = request.side_m[rows] + np.interp(at, _KNOTS, self.grasp_offsets_m[found])
            obj[rows] = request.side_m[rows] + self.object_offset_m[found]
        return grasp, obj

    def to_json(self) -> dict[str, Any]:
        """Give the tables as plain JSON."""
        return {"grasp_offsets_m": self.grasp_offsets_m, "object_offset_m": self.object_offset_m}


def _keys(request: Request) -> tuple[list[str], list[str], list[str]]:
    """Name each row's "type/object/axis", "type/object" and "type"."""
    types, labels, axes = request.grasp_type.tolist(), request.object_label.tolist(), request.side_axis.tolist()
    return (
        [f"{t}/{o}/{a}" for t, o, a in zip(types, labels, axes, strict=True)],
        [f"{t}/{o}" for t, o in zip(types, labels, strict=True)],
        types,
    )
