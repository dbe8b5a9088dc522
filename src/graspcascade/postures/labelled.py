"""`LabelledPostures`: postures with the grasp type each belongs to, made or imported."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class LabelledPostures:
    """Hold n labelled postures.

    Attributes:
        joint_names: names of the J columns.
        posture: ``(n, J)`` radians.
        grasp_type: ``(n,)`` type names.
        n_clipped: angles that were beyond the joint limits and were brought inside.
    """

    joint_names: tuple[str, ...]
    posture: NDArray[np.float64]
    grasp_type: NDArray[np.str_]
    n_clipped: int = 0

    def __len__(self) -> int:
        """Count the postures."""
        return len(self.posture)
