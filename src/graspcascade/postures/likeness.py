"""How human seed postures are: joint means against the statistics of recorded human grasps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..taxonomy import GRASP_TYPES, GraspType
from .human import human_statistics
from .labelled import LabelledPostures

_DIGIT_PREFIX = {"thumb": "TH", "index": "FF", "middle": "MF", "ring": "RF", "little": "LF"}


@dataclass(frozen=True)
class Likeness:
    """Compare one type's postures with the human ones, over the recorded joints of the digits that hold the object.

    Attributes:
        grasp_type: name of the type.
        n_postures: postures compared.
        n_human: recorded human grasps.
        deviation_sd: mean posture minus human mean in human standard deviations, by joint name.
    """

    grasp_type: str
    n_postures: int
    n_human: int
    deviation_sd: dict[str, float]

    @property
    def outliers(self) -> dict[str, float]:
        """Give the joints whose mean is more than one human standard deviation off."""
        return {name: value for name, value in self.deviation_sd.items() if abs(value) > 1.0}

    @property
    def share_within(self) -> float:
        """Give the share of joints whose mean is within one human standard deviation."""
        return 1.0 - len(self.outliers) / len(self.deviation_sd)


def human_likeness(postures: LabelledPostures) -> list[Likeness]:
    """Compare the postures of each type present; joints carry the Shadow names that the statistics use."""
    return [_of_type(kind, postures) for kind in GRASP_TYPES.values() if (postures.grasp_type == kind.name).any()]


def _of_type(kind: GraspType, postures: LabelledPostures) -> Likeness:
    rows = postures.grasp_type == kind.name
    human = human_statistics(kind.name, postures.joint_names)
    deviation = (postures.posture[rows].mean(axis=0) - human.mean) / human.sd
    prefixes = tuple(_DIGIT_PREFIX[digit] for digit in (*kind.required, *kind.any_of))
    holding = np.array([name.startswith(prefixes) for name in postures.joint_names]) & human.recorded
    names = np.array(postures.joint_names)[holding].tolist()
    found = dict(zip(names, deviation[holding].tolist(), strict=True))
    return Likeness(kind.name, int(rows.sum()), human.n_grasps, found)
