"""Taxonomies of precision grasps: which contact places oppose, and where which digits must touch the object."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError, check_name, unknown

DIGITS: tuple[str, ...] = ("thumb", "index", "middle", "ring", "little")
"""Names that a hand's digits may have, in anatomical order."""
AREAS: tuple[str, ...] = (
    *("distal_pad", "distal_end", "distal_radial", "distal_ulnar", "distal_back"),
    *(f"{link}_{side}" for link in ("middle", "proximal") for side in ("pad", "radial", "ulnar", "back")),
)
"""Areas of a digit's surface, link by link from the tip; the place of each is its bit in masks of areas touched."""


@dataclass(frozen=True)
class Contact:
    """A contact that a type-faithful grasp must have.

    Attributes:
        digits: of these digits, those that the hand has, at least one must touch.
        areas: in one of these `AREAS`; anywhere if empty.
        from_length_m: asked for only of hands with such a digit and where the object is at least so long across the
            opposition axis (see `Task.length_m`); 0 is always.
    """

    digits: tuple[str, ...]
    areas: tuple[str, ...] = ()
    from_length_m: float = 0.0

    def __post_init__(self) -> None:
        for digit in self.digits:
            check_name("digit", digit, DIGITS)
        for area in self.areas:
            check_name("area of a digit", area, AREAS)

    @property
    def mask(self) -> int:
        """Bits of its areas."""
        return sum(1 << AREAS.index(area) for area in self.areas)


@dataclass(frozen=True)
class GraspType:
    """One grasp type of the Feix taxonomy (DOI 10.1109/THMS.2015.2470657).

    Attributes:
        taxonomy: which of `TAXONOMIES` the rules are of; types of one name differ between them.
        opposition: contact places, the thumb's first, then one or more that oppose it together: the opposition axis
            goes from the thumb's to the middle of the others.
        contacts: what a type-faithful grasp must touch with.
        support: contact places that inverse kinematics brings onto the object beside the opposing pair.
    """

    name: str
    feix_number: int
    opposition: tuple[str, ...]
    contacts: tuple[Contact, ...]
    support: tuple[str, ...] = ()
    taxonomy: str = "paper"

    @property
    def digits(self) -> tuple[str, ...]:
        """Digits that its contacts name."""
        return tuple(dict.fromkeys(digit for contact in self.contacts for digit in contact.digits))

    def asked_of(self, digits: Iterable[str]) -> list[Contact]:
        """List the contacts asked of a hand with certain digits: all but those for long objects that it cannot make."""
        return [each for each in self.contacts if not each.from_length_m or set(each.digits) & set(digits)]

    def is_faithful(
        self,
        touching: ArrayLike,
        digits: Sequence[str] = DIGITS,
        areas: ArrayLike = 0,
        length_m: ArrayLike = np.inf,
    ) -> NDArray[np.bool_]:
        """Tell which grasps ``(...)`` have every contact that the type asks for.

        Args:
            touching: ``(..., D)`` contact flags of the hand's digits; columns beyond those are ignored.
            digits: names of the D columns. A hand that lacks a digit that is always asked for is never faithful.
            areas: ``(..., D)`` masks of the `AREAS` touched, 0 where they were not recorded.
            length_m: ``(...)`` lengths of the objects across the opposition axis, metres.
        """
        names = list(digits)
        touching = np.asarray(touching, dtype=bool)[..., : len(names)]
        areas, length_m = np.broadcast_to(areas, touching.shape), np.asarray(length_m)
        faithful = np.ones(touching.shape[:-1], dtype=bool)
        for contact in self.asked_of(names):
            columns = [names.index(digit) for digit in contact.digits if digit in names]
            right = (areas & contact.mask) != 0 if contact.areas else touching
            faithful &= right[..., columns].any(axis=-1) | (length_m < contact.from_length_m)
        return faithful


def _contacts(**areas: tuple[str, ...]) -> tuple[Contact, ...]:
    return tuple(Contact((digit,), some) for digit, some in areas.items())


def _by_name(*kinds: GraspType) -> Mapping[str, GraspType]:
    return {kind.name: kind for kind in kinds}


_PADS, _PHALANX = ("thumb_pad", "index_pad"), ("thumb_pad", "index_phalanx")
_TWO, _THREE = _contacts(thumb=(), index=()), _contacts(thumb=(), index=(), middle=())
_PHALANGES = ("middle_phalanx", "ring_phalanx", "little_phalanx")
PAPER_TYPES: Mapping[str, GraspType] = _by_name(
    GraspType("tripod", 14, _PADS, _THREE, ("middle_pad",)),
    GraspType("palmar_pinch", 9, _PHALANX, _TWO),
    GraspType("parallel_extension", 22, _PHALANX, (*_TWO, Contact(("middle", "ring", "little"))), _PHALANGES),
    GraspType("writing_tripod", 20, _PADS, _THREE, ("middle_pad",)),
    GraspType("lateral_tripod", 25, _PADS, _THREE, ("middle_pad",)),
    GraspType("tip_pinch", 24, ("thumb_end", "index_end"), _TWO),
)
"""The paper's grasp types: certain digits touch, wherever on them that is."""

_TWO_PADS, _PAD_AND_SIDE = (*_PADS, "middle_pad"), (*_PADS, "middle_side")
_PAD, _END, _FLAT = ("distal_pad",), ("distal_end",), ("distal_pad", "middle_pad")
_TIP, _SIDE = (*_PAD, *_END), ("distal_radial",)
_HELD_FLAT = (
    *_contacts(thumb=_PAD, index=_FLAT, middle=_FLAT),
    Contact(("ring",), _FLAT, from_length_m=0.060),
    Contact(("little",), _FLAT, from_length_m=0.085),
)
_WRITING = _contacts(thumb=_TIP, index=(*_TIP, *_SIDE), middle=_SIDE)
_LATERAL = _contacts(thumb=_TIP, index=(*_TIP, *_SIDE), middle=(*_SIDE, "middle_radial"))
FEIX_TYPES: Mapping[str, GraspType] = _by_name(
    GraspType("tripod", 14, _TWO_PADS, _contacts(thumb=_TIP, index=_TIP, middle=_TIP), (), "feix"),
    GraspType("palmar_pinch", 9, _PADS, _contacts(thumb=_PAD, index=_PAD), (), "feix"),
    GraspType("parallel_extension", 22, _TWO_PADS, _HELD_FLAT, ("ring_pad", "little_pad"), "feix"),
    GraspType("writing_tripod", 20, _PAD_AND_SIDE, _WRITING, (), "feix"),
    GraspType("lateral_tripod", 25, _PAD_AND_SIDE, _LATERAL, (), "feix"),
    GraspType("tip_pinch", 24, ("thumb_end", "index_end"), _contacts(thumb=_END, index=_END), (), "feix"),
)
"""The same types as Feix et al. draw them: certain parts of certain digits touch."""

TAXONOMIES: Mapping[str, Mapping[str, GraspType]] = {"paper": PAPER_TYPES, "feix": FEIX_TYPES}
"""Every taxonomy by name; files that do not say have the paper's."""
GRASP_TYPES = PAPER_TYPES
"""Every grasp type by name, in the order used for one-hot codes and tables."""


def as_type(given: GraspType | str, types: Mapping[str, GraspType] = GRASP_TYPES) -> GraspType:
    """Read a grasp type: one as it is, or a name of some types; for an unknown name an InputError names the nearest."""
    if isinstance(given, GraspType):
        return given
    known = types.get(str(given).strip().lower().replace("-", "_").replace(" ", "_"))
    if known is None:
        raise unknown("grasp type", given, types)
    return known


def taxonomy_of(kinds: Iterable[GraspType]) -> str:
    """Name the taxonomy that grasp types are of, the paper's where there are none; an InputError if of several."""
    names = list(dict.fromkeys(kind.taxonomy for kind in kinds)) or ["paper"]
    if len(names) > 1:
        raise InputError(f"grasp types of {' and '.join(names)} have the same names and other rules; keep them apart")
    return names[0]
