"""The six precision grasp types: which contact places oppose, and which digits must touch the object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .errors import unknown

DIGITS: tuple[str, ...] = ("thumb", "index", "middle", "ring", "little")
"""Order of every per-digit column in the package."""


@dataclass(frozen=True)
class GraspType:
    """Describe one grasp type of the Feix taxonomy (DOI 10.1109/THMS.2015.2470657).

    Attributes:
        name: identifier used in files and on the command line.
        feix_number: number in the taxonomy.
        opposition: the two contact places whose connecting line is the opposition axis, thumb first.
        required: digits that must touch the object in a type-faithful grasp.
        any_of: of these digits at least one must touch as well (empty: no such rule).
        support: contact places that inverse kinematics brings onto the object beside the opposing pair.
    """

    name: str
    feix_number: int
    opposition: tuple[str, str]
    required: tuple[str, ...]
    any_of: tuple[str, ...] = ()
    support: tuple[str, ...] = ()

    def is_faithful(self, touching: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Tell which grasps touch every digit the type needs.

        Args:
            touching: ``(..., 5)`` contact flags in the order of `DIGITS`.

        Returns:
            ``(...)`` flags.
        """
        touching = np.asarray(touching, dtype=bool)
        faithful = touching[..., [DIGITS.index(d) for d in self.required]].all(axis=-1)
        if self.any_of:
            faithful &= touching[..., [DIGITS.index(d) for d in self.any_of]].any(axis=-1)
        return np.asarray(faithful)


_ALL = (
    GraspType("tripod", 14, ("thumb_pad", "index_pad"), ("thumb", "index", "middle"), support=("middle_pad",)),
    GraspType("palmar_pinch", 9, ("thumb_pad", "index_phalanx"), ("thumb", "index")),
    GraspType(
        "parallel_extension",
        22,
        ("thumb_pad", "index_phalanx"),
        ("thumb", "index"),
        any_of=("middle", "ring", "little"),
        support=("middle_phalanx", "ring_phalanx", "little_phalanx"),
    ),
    GraspType("writing_tripod", 20, ("thumb_pad", "index_pad"), ("thumb", "index", "middle"), support=("middle_pad",)),
    GraspType("lateral_tripod", 25, ("thumb_pad", "index_pad"), ("thumb", "index", "middle"), support=("middle_pad",)),
    GraspType("tip_pinch", 24, ("thumb_end", "index_end"), ("thumb", "index")),
)

GRASP_TYPES: Mapping[str, GraspType] = {t.name: t for t in _ALL}
"""Every grasp type by name, in the order used for one-hot codes and tables."""


def grasp_type(name: str) -> GraspType:
    """Look up a grasp type.

    Raises:
        InputError: the name is not one of `GRASP_TYPES`; the message names the nearest.
    """
    found = GRASP_TYPES.get(str(name).strip().lower().replace("-", "_").replace(" ", "_"))
    if found is None:
        raise unknown("grasp type", name, GRASP_TYPES)
    return found
