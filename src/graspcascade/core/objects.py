"""Shapes, the sites by which they can be held, and objects: a shape with a name and a density."""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError, check_name, shortened, unknown
from .poses import as_quat, canonical_quat, quat_conjugate, quat_multiply

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
AXES: tuple[str, ...] = ("x", "y", "z")
DENSITY_KG_M3 = 600.0
"""Density of an object of which nothing else is known."""
SIZES_M, DENSITIES_KG_M3 = (0.001, 1.0), (1.0, 30_000.0)
"""Extents and densities outside these bounds are taken for a slip of the unit."""

_BASIS: Mapping[str, Vector] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_HALF_TURNS = np.eye(4)  # identity, then half-turns about x, y and z, as quaternions


@dataclass(frozen=True)
class Site:
    """A line along which two digits may oppose each other through an object, in the object's body frame.

    Attributes:
        axis: unit direction of the opposition axis.
        width_m: extent of the object along that axis, metres: what the opposing digits must span.
        centre_m: point of the axis midway between the two surfaces, metres.
    """

    axis: Vector
    width_m: float
    centre_m: Vector = (0.0, 0.0, 0.0)

    @property
    def name(self) -> str:
        """Axis (x, y or z) of a site through the body's centre, the numbers of any other."""
        names = [name for name, axis in _BASIS.items() if axis == self.axis and not any(self.centre_m)]
        return names[0] if names else f"axis {self.axis} through {self.centre_m} m"


@dataclass(frozen=True)
class Shape(ABC):
    """A convex primitive, its body frame at the centre."""

    kind: ClassVar[str]
    """Name of the shape on the command line and in files."""
    _fields_xyz: ClassVar[tuple[str, str, str]]  # fields that hold the extents; equal sides have the same
    _fill: ClassVar[float]  # volume as a share of the enclosing box
    _rotations: ClassVar[str]  # symmetry group, or a finite part of it, as scipy spells it

    @property
    def extents_m(self) -> Vector:
        """Full extents along body x, y, z in metres."""
        x, y, z = (getattr(self, name) for name in self._fields_xyz)
        return x, y, z

    @property
    def side_of_axis(self) -> dict[str, str]:
        """For each body axis the first one whose side is equal to its own by symmetry."""
        return {axis: AXES[self._fields_xyz.index(name)] for axis, name in zip(AXES, self._fields_xyz, strict=True)}

    @property
    def volume_m3(self) -> float:
        """Volume in cubic metres."""
        return math.prod(self.extents_m, start=self._fill)

    def fold(self, quat_wxyz: ArrayLike, reference_wxyz: ArrayLike) -> Array:
        """Replace rotations by the equivalent ones nearest to a reference.

        Two rotations are the same grasp when they differ by a symmetry applied in the body frame: half-turns about the
        axes of a box; any turn about z and the half-turns across it for a cylinder; everything for a sphere.

        Args:
            quat_wxyz: ``(..., 4)`` object rotations in any fixed frame.
            reference_wxyz: ``(4,)`` or ``(..., 4)`` rotations in the same frame.

        Returns:
            ``(..., 4)`` unit quaternions with w >= 0.
        """
        quat = np.asarray(quat_wxyz, dtype=np.float64)
        reference = np.broadcast_to(np.asarray(reference_wxyz, dtype=np.float64), quat.shape)
        options = self._images(quat[..., None, :], reference[..., None, :])
        nearness = np.abs((options * reference[..., None, :]).sum(axis=-1))
        # A tie (a rotation exactly between two images) goes to the first, whatever the rounding.
        best = np.argmax(nearness >= nearness.max(axis=-1, keepdims=True) - 1e-12, axis=-1)
        return canonical_quat(np.take_along_axis(options, best[..., None, None], axis=-2)[..., 0, :])

    @abstractmethod
    def _images(self, quat: Array, reference: Array) -> Array: ...  # equivalents, the nearest among them

    def symmetries(self, turns: int = 8) -> Array:
        """List rotations ``(k, 4)`` that map the shape onto itself, the identity first.

        Four for a box, two times `turns` for a cylinder, the 24 rotations of a cube for a sphere.
        """
        # Only this needs scipy, which sampling should not wait for.
        from scipy.spatial.transform import Rotation

        group = as_quat(Rotation.create_group(self._rotations.format(turns=turns)))
        return group[np.argsort(np.abs(group[:, 0]) < 1 - 1e-9, kind="stable")]

    def nearest_side(self, direction: ArrayLike, sides: Iterable[str]) -> str:
        """Choose of some distinct sides, by axis, the one nearest to a direction ``(3,)`` in the body frame."""
        squares = dict(zip(AXES, np.square(direction).tolist(), strict=True))
        equal = self.side_of_axis.items()
        return max(sides, key=lambda side: sum(squares[axis] for axis, first in equal if first == side))

    def has_site(self, site: Site) -> bool:
        """Tell whether both ends of a site lie on the surface, to 2 mm or a quarter of its width."""
        half, slack = site.width_m / 2, min(0.002, site.width_m / 4)
        along = np.multiply.outer([-half - slack, slack - half, half - slack, half + slack], site.axis)
        squares = (2 * (along + site.centre_m) / self.extents_m) ** 2
        # Axes of one length are round about each other: their squares are summed.
        round_about = [[name == other for other in self._fields_xyz] for name in self._fields_xyz]
        inside = (squares @ np.array(round_about, dtype=np.float64) <= 1.0).all(axis=1)
        return inside.tolist() == [False, True, True, False]

    def spelling(self) -> str:
        """Spell the shape as `as_object` reads it, such as ``box:32x41x60mm``."""
        return f"{self.kind}:{'x'.join(f'{size * 1000:.10g}' for size in astuple(self))}mm"


@dataclass(frozen=True)
class Box(Shape):
    """A box by its extents along body x, y and z, metres."""

    x_m: float
    y_m: float
    z_m: float

    kind, _fill, _rotations = "box", 1.0, "D2"
    _fields_xyz = ("x_m", "y_m", "z_m")

    def _images(self, quat: Array, reference: Array) -> Array:
        return quat_multiply(quat, _HALF_TURNS)


@dataclass(frozen=True)
class Cylinder(Shape):
    """A cylinder about body z by its diameter and height, metres."""

    diameter_m: float
    height_m: float

    kind, _fill, _rotations = "cylinder", np.pi / 4, "D{turns}"
    _fields_xyz = ("diameter_m", "diameter_m", "height_m")

    def _images(self, quat: Array, reference: Array) -> Array:
        flipped = quat_multiply(quat, _HALF_TURNS[:2])
        # The turn about body z that brings an option nearest to the reference maximises
        # |c cos(t/2) + s sin(t/2)|, with c and s the components of option^-1 * reference along w and z.
        turn = quat_multiply(quat_conjugate(flipped), reference) * np.array([1.0, 0.0, 0.0, 1.0])
        norm = np.linalg.norm(turn, axis=-1, keepdims=True)
        return quat_multiply(flipped, np.where(norm > 1e-12, turn / np.maximum(norm, 1e-12), _HALF_TURNS[0]))


@dataclass(frozen=True)
class Sphere(Shape):
    """A sphere by its diameter, metres."""

    diameter_m: float

    kind, _fill, _rotations = "sphere", np.pi / 6, "O"
    _fields_xyz = ("diameter_m", "diameter_m", "diameter_m")

    def _images(self, quat: Array, reference: Array) -> Array:
        return reference


SHAPES: Mapping[str, type[Shape]] = {shape.kind: shape for shape in (Box, Cylinder, Sphere)}
"""Every shape by its name on the command line."""
_SPELLING = re.compile(r"(?P<kind>[a-z]+):(?P<sizes>[0-9.e+x-]+?)(?P<unit>mm|cm|m)?", re.IGNORECASE)
_METRES = {"mm": 1000.0, "cm": 100.0, "m": 1.0}
_EXAMPLES = "box:32x41x60mm, cylinder:27x80mm (diameter x height), sphere:40mm"


@dataclass(frozen=True)
class GraspObject:
    """A shape with a name and a density.

    Attributes:
        name: identifier used in files and on the command line.
        shape: a `Box`, `Cylinder` or `Sphere`.

    Raises:
        InputError: an extent outside `SIZES_M`, a density outside `DENSITIES_KG_M3`, a name that spells another size.

    Examples:
        >>> marker = as_object("cylinder:18x120mm")
        >>> marker.name, round(marker.mass_kg, 4), marker.sides_m
        ('cylinder:18x120mm', 0.0183, {'x': 0.018, 'z': 0.12})
    """

    name: str
    shape: Shape
    density_kg_m3: float = DENSITY_KG_M3

    def __post_init__(self) -> None:
        (low, high), name = SIZES_M, shortened(self.name)
        for extent in self.extents_m:
            if not low <= extent <= high:
                raise InputError(f"an extent of {name} is {extent:g} m; extents are {low * 1000:g} mm to {high:g} m")
        least, most = DENSITIES_KG_M3
        if not least <= self.density_kg_m3 <= most:
            raise InputError(
                f"the density of {name} is {self.density_kg_m3} kg/m3; densities are {least:g} to {most:g} kg/m3"
            )
        spelled = _SPELLING.fullmatch(self.name)
        if spelled and spelled["unit"] and spelled["kind"].lower() in SHAPES:
            said = _read_size(self.name)
            apart = max(abs(one - other) for one, other in zip(said.extents_m, self.extents_m, strict=True))
            if said.kind != self.shape.kind or apart > 1e-6:
                raise InputError(f"an object named {name} is a {self.shape.spelling()}; give it another name")

    @property
    def extents_m(self) -> Vector:
        """Full extents along body x, y, z in metres."""
        return self.shape.extents_m

    @property
    def mass_kg(self) -> float:
        """Mass in kilograms."""
        return self.shape.volume_m3 * self.density_kg_m3

    def weighing(self, mass_kg: float) -> GraspObject:
        """Make the same object of another mass.

        Raises:
            InputError: it would need a density outside `DENSITIES_KG_M3`.
        """
        volume = self.shape.volume_m3
        least, most = (density * volume for density in DENSITIES_KG_M3)
        if not least <= mass_kg <= most:
            grams = f"{least * 1000:.3g} to {most * 1000:.5g} g"
            raise InputError(f"{shortened(self.name)} can have a mass of {grams}, got {mass_kg * 1000:g} g")
        return replace(self, density_kg_m3=mass_kg / volume)

    @property
    def sides_m(self) -> dict[str, float]:
        """Distinct sides by axis: all of a box, x (diameter) and z (height) of a cylinder, x of a sphere."""
        return {axis: self.extents_m[AXES.index(axis)] for axis in dict.fromkeys(self.shape.side_of_axis.values())}

    def sites(self, reach_m: float = np.inf) -> dict[str, Site]:
        """List the sites through the centre along each distinct side no wider than a reach, by axis."""
        return {axis: Site(_BASIS[axis], side) for axis, side in self.sides_m.items() if side <= reach_m + 1e-9}

    def site(self, axis: str, reach_m: float = np.inf) -> Site:
        """Find the site along a body axis, or along the one its symmetry makes that equal to.

        Raises:
            InputError: no such axis, or the side is wider than the reach.
        """
        if axis not in AXES:
            raise unknown("side axis", axis, self.sides_m)
        canonical, sites = self.shape.side_of_axis[axis], self.sites(reach_m)
        if canonical not in sites:
            too_wide = f"side {axis} of {self.name} is {self.sides_m[canonical] * 100:g} cm, beyond the hand's reach of"
            raise InputError(f"{too_wide} {reach_m * 100:g} cm. Graspable sides: {self.describe_sides(reach_m)}.")
        return sites[canonical]

    def site_of_length(self, side_m: float, reach_m: float = np.inf, tolerance_m: float = 0.0005) -> Site:
        """Find the site whose width is a given length in metres.

        Raises:
            InputError: the object has no such side, or it is wider than the reach.
        """
        if not np.isfinite(side_m) or side_m <= 0:
            raise InputError(f"a side must be a positive length, got {side_m * 100:g} cm")
        axis, length = min(self.sides_m.items(), key=lambda item: abs(item[1] - side_m))
        if abs(length - side_m) > tolerance_m:
            problem = f"{self.name} has no side of {side_m * 100:g} cm."
            if any(abs(length - side_m / 10) <= tolerance_m for length in self.sides_m.values()):
                problem = f"{problem[:-1]}; were millimetres meant?"
            elif side_m > reach_m:
                problem = f"a side of {side_m * 100:g} cm is beyond the hand's reach of {reach_m * 100:g} cm."
            raise InputError(f"{problem} Graspable sides of {self.name}: {self.describe_sides(reach_m)}.")
        return self.site(axis, reach_m)

    def describe_sides(self, reach_m: float = np.inf) -> str:
        """List the graspable sides for a message: ``x = 2 cm, z = 5 cm``."""
        return ", ".join(f"{axis} = {s.width_m * 100:g} cm" for axis, s in self.sites(reach_m).items()) or "none"

    def to_json(self) -> dict[str, Any]:
        """Describe shape, extents in metres and, where it is not the usual one, density, as files do."""
        about: dict[str, Any] = {"shape": self.shape.kind, "extents_m": list(self.extents_m)}
        return about if self.density_kg_m3 == DENSITY_KG_M3 else about | {"density_kg_m3": self.density_kg_m3}

    @classmethod
    def from_json(cls, name: str, data: Mapping[str, Any]) -> GraspObject:
        """Rebuild an object from its name and `to_json()`; an InputError says what does not fit."""
        for key in data:
            check_name(f"entry of object {shortened(name)}", key, ("shape", "extents_m", "density_kg_m3"))
        kind, extents = data.get("shape"), data.get("extents_m")
        if not isinstance(kind, str) or kind not in SHAPES:
            raise unknown("shape", kind, SHAPES)
        numbers = [*extents, data.get("density_kg_m3", DENSITY_KG_M3)] if isinstance(extents, list | tuple) else []
        # Python's whole numbers have no end; a float has, and what is longer is no size either.
        if len(numbers) != 4 or not all(type(n) is float or (type(n) is int and abs(n) < 1e9) for n in numbers):
            raise InputError(f"object {shortened(name)} needs three extents in metres and a density that is a number")
        x, y, z, density = map(float, numbers)
        shape = SHAPES[kind](**dict(zip(SHAPES[kind]._fields_xyz, (x, y, z), strict=True)))
        if shape.extents_m != (x, y, z):
            raise InputError(f"the extents {x:g} x {y:g} x {z:g} m of {shortened(name)} are not those of a {kind}")
        return cls(name, shape, density)


CATALOGUE: Mapping[str, GraspObject] = {
    f"{shape.kind}_{size}": GraspObject(f"{shape.kind}_{size}", shape)
    for shapes in (
        (Box(0.02, 0.03, 0.04), Box(0.03, 0.045, 0.06), Box(0.04, 0.055, 0.07)),
        (Cylinder(0.02, 0.05), Cylinder(0.035, 0.07), Cylinder(0.05, 0.09)),
        (Sphere(0.03), Sphere(0.045), Sphere(0.06)),
    )
    for size, shape in zip(("small", "medium", "large"), shapes, strict=True)
}
"""The nine objects of the paper's kind, by name, in the order used for one-hot codes and tables."""


def as_object(given: GraspObject | str) -> GraspObject:
    """Read an object: one as it is, a name of `CATALOGUE`, or a size such as ``box:32x41x60mm``.

    Sizes are those along x, y and z of a box, diameter x height of a cylinder, the diameter of a sphere, with the unit
    mm, cm or m.

    Raises:
        InputError: neither; the message names the nearest name, or says what a size needs.
    """
    if isinstance(given, GraspObject):
        return given
    text = str(given).strip()
    known = CATALOGUE.get(text.lower().replace("-", "_"))
    if known is not None:
        return known
    if text.lower().partition(":")[0] == "any":
        many = f"{shortened(text)!r} means objects of random size, which collections and evaluations draw"
        raise InputError(f"{many}; give one object: {', '.join(CATALOGUE)} or a size: {_EXAMPLES}")
    if ":" not in text:
        raise InputError(f"{unknown('object', text, CATALOGUE)} Or a size: {_EXAMPLES}.")
    shape = _read_size(text)
    return GraspObject(shape.spelling(), shape)


def _read_size(text: str) -> Shape:
    apart = re.search(r"[0-9.e+-] +[0-9.e+-]", text)  # spaces within a number
    parts = None if apart else _SPELLING.fullmatch(text.replace(" ", ""))
    if parts is None:
        raise InputError(f"{shortened(text)!r} is not the size of an object; sizes are like {_EXAMPLES}")
    kind, unit = parts["kind"].lower(), (parts["unit"] or "").lower()
    check_name("shape", kind, SHAPES)
    if not unit:
        raise InputError(f"{shortened(text)!r} lacks a unit: mm, cm or m, as in {_EXAMPLES}")
    try:
        # To the nanometre: the same size written in another unit is the same object.
        sizes = [round(float(number) / _METRES[unit], 9) for number in parts["sizes"].lower().split("x")]
    except ValueError:
        raise InputError(f"{shortened(text)!r} holds something that is no number; sizes are like {_EXAMPLES}") from None
    expected = len(fields(SHAPES[kind]))
    if len(sizes) != expected:
        needed = f"a {kind} has {expected} size{'s' * (expected > 1)}, got {len(sizes)}"
        raise InputError(f"{needed}: {shortened(text)!r}; like {_EXAMPLES}")
    return SHAPES[kind](*sizes)
