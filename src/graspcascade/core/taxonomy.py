"""The six precision grasp types: which contact places oppose, and which digits must touch the object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .errors import unknown

DIGITS: tuple[str, ...] = ("thumb", "index", "middle", "ring", "little")
"""Names that a hand's digits may have, in anatomical order."""


@dataclass(frozen=True)
class GraspType:
    """One grasp type of the Feix taxonomy (DOI 10.1109/THMS.2015.2470657).

    Attributes:
        opposition: the two contact places whose connecting line is the opposition axis, thumb first.
        required: digits that must touch the object in a type-faithful grasp.
        any_of: of these digits, those that the hand has, at least one must touch as well (empty: no such rule).
        support: contact places that inverse kinematics brings onto the object beside the opposing pair.
    """

    name: str
    feix_number: int
    opposition: tuple[str, str]
    required: tuple[str, ...]
    any_of: tuple[str, ...] = ()
    support: tuple[str, ...] = ()

    def is_faithful(self, touching: NDArray[np.bool_], digits: Sequence[str] = DIGITS) -> NDArray[np.bool_]:
        """Tell which grasps ``(...)`` touch with every digit the type needs.

        Args:
            touching: ``(..., D)`` contact flags of the hand's digits; columns beyond those are ignored.
            digits: names of the D columns. A hand that lacks a required digit is never faithful.
        """
        touching, names = np.asarray(touching, dtype=bool), list(digits)
        if not set(self.required) <= set(names):
            return np.zeros(touching.shape[:-1], dtype=bool)
        faithful = touching[..., [names.index(digit) for digit in self.required]].all(axis=-1)
        if self.any_of:
            present = [names.index(digit) for digit in self.any_of if digit in names]
            faithful &= touching[..., present].any(axis=-1)
        return np.asarray(faithful)


_TRIPOD = (("thumb_pad", "index_pad"), ("thumb", "index", "middle"), (), ("middle_pad",))
_EXTENDED = (("middle", "ring", "little"), ("middle_phalanx", "ring_phalanx", "little_phalanx"))
_ALL = (
    GraspType("tripod", 14, *_TRIPOD),
    GraspType("palmar_pinch", 9, ("thumb_pad", "index_phalanx"), ("thumb", "index")),
    GraspType("parallel_extension", 22, ("thumb_pad", "index_phalanx"), ("thumb", "index"), *_EXTENDED),
    GraspType("writing_tripod", 20, *_TRIPOD),
    GraspType("lateral_tripod", 25, *_TRIPOD),
    GraspType("tip_pinch", 24, ("thumb_end", "index_end"), ("thumb", "index")),
)

GRASP_TYPES: Mapping[str, GraspType] = {kind.name: kind for kind in _ALL}
"""Every grasp type by name, in the order used for one-hot codes and tables."""


def as_type(given: GraspType | str) -> GraspType:
    """Read a grasp type: one as it is, or its name; for an unknown name an InputError names the nearest."""
    if isinstance(given, GraspType):
        return given
    known = GRASP_TYPES.get(str(given).strip().lower().replace("-", "_").replace(" ", "_"))
    if known is None:
        raise unknown("grasp type", given, GRASP_TYPES)
    return known
