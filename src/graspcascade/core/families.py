"""Families of objects: shapes of random size, for studies whose trials each have an object of their own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from .errors import InputError, check_name
from .objects import SIZES_M, Box, Cylinder, GraspObject, Shape, Sphere, as_object

_ANY = "any"
_DECIMALS_M = 4
"""Sizes are drawn to 0.1 mm, so that names which spell them stay short."""


@dataclass(frozen=True)
class ObjectFamily:
    """Objects of one shape and of random size.

    Attributes:
        name: what records call it, as they call an object by its name.
        shape: `Box`, `Cylinder` or `Sphere`.
        ranges_m: least and largest value of each size of the shape, in the order of its fields, metres.
        widest_m: at least one side of every object is no wider, metres.

    Raises:
        InputError: a range for each size is needed, the lesser value first, within `objects.SIZES_M`.

    Examples:
        >>> rng = np.random.default_rng(0)
        >>> [obj.name for obj in FAMILIES["any:cylinder"].draw(2, rng)]
        ['cylinder:46.8x47mm', 'cylinder:17x21.7mm']
    """

    name: str
    shape: type[Shape]
    ranges_m: tuple[tuple[float, float], ...]
    widest_m: float = 0.065

    def __post_init__(self) -> None:
        least, largest = SIZES_M
        names = [field.name for field in fields(self.shape)]
        if len(self.ranges_m) != len(names) or not all(least <= a <= b <= largest for a, b in self.ranges_m):
            needed = f"needs a range for each of {', '.join(names)}, within {least:g} to {largest:g} m"
            raise InputError(f"{self.name} {needed}, got {self.ranges_m}")

    def draw(self, n: int, rng: np.random.Generator, reach_m: float = np.inf) -> list[GraspObject]:
        """Draw n objects, each size evenly from its range; again, where a hand of that reach could hold no side.

        Raises:
            InputError: all sides of all objects are wider than `widest_m` or the reach.
        """
        low, high = np.array(self.ranges_m).T
        widest = min(self.widest_m, reach_m) + 1e-9
        if np.round(low, _DECIMALS_M).min() > widest:
            raise InputError(f"{self.name} has no size of which a side is within the reach of {widest * 100:.3g} cm")
        sizes, again = np.zeros((n, len(low))), np.full(n, True)
        while again.any():
            sizes[again] = np.round(rng.uniform(low, high, (again.sum(), len(low))), _DECIMALS_M)
            again = sizes.min(axis=1) > widest
        shapes = [self.shape(*size) for size in sizes.tolist()]
        return [GraspObject(shape.spelling(), shape) for shape in shapes]

    def to_json(self) -> dict[str, Any]:
        """Describe shape and ranges, metres, as files do."""
        return {"shape": self.shape.kind, "ranges_m": [list(pair) for pair in self.ranges_m], "widest_m": self.widest_m}


_RANGES_M: Mapping[type[Shape], tuple[tuple[float, float], ...]] = {
    Box: ((0.015, 0.09),) * 3,
    Cylinder: ((0.015, 0.065), (0.02, 0.12)),
    Sphere: ((0.02, 0.065),),
}
FAMILIES: Mapping[str, ObjectFamily] = {
    family.name: family for family in (ObjectFamily(f"{_ANY}:{s.kind}", s, ranges) for s, ranges in _RANGES_M.items())
}
"""Every size that the default hand can hold, by name: ``any:box``, ``any:cylinder`` and ``any:sphere``."""


def read_objects(given: GraspObject | ObjectFamily | str) -> tuple[GraspObject | ObjectFamily, ...]:
    """Read what a study tries: an object or its name or size, a family or its name, or ``any`` for all of `FAMILIES`.

    Raises:
        InputError: an unknown name; the message names the nearest.
    """
    if isinstance(given, ObjectFamily):
        return (given,)
    text = given.strip().lower() if isinstance(given, str) else ""
    if text == _ANY:
        return tuple(FAMILIES.values())
    if text.startswith(f"{_ANY}:"):
        check_name("family of objects", text, FAMILIES)
        return (FAMILIES[text],)
    return (as_object(given),)
