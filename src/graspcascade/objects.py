"""Boxes, cylinders and spheres: extents, graspable sides, and the symmetry that makes rotations the same grasp."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError, unknown
from .poses import as_quat, as_rotation, canonical_quat, quat_conjugate, quat_multiply

Shape = Literal["box", "cylinder", "sphere"]
AXES: tuple[str, ...] = ("x", "y", "z")
MAX_SIDE_M = 0.065
"""Widest side the hand's opposing digits reach round."""
DENSITY_KG_M3 = 600.0

_HALF_TURNS = {axis: np.insert(row, 0, 0.0) for axis, row in zip(AXES, np.eye(3), strict=True)}
_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class GraspObject:
    """Describe a convex primitive, its body frame at the centre.

    Attributes:
        label: identifier used in files and on the command line.
        shape: a cylinder's axis is its body z axis.
        extents_m: full extents along body x, y, z in metres.
    """

    label: str
    shape: Shape
    extents_m: tuple[float, float, float]

    @property
    def sides_m(self) -> dict[str, float]:
        """Give the distinct sides by axis: all of a box, x (diameter) and z (height) of a cylinder, x of a sphere."""
        kept = {"box": "xyz", "cylinder": "xz", "sphere": "x"}[self.shape]
        return {axis: self.extents_m[AXES.index(axis)] for axis in kept}

    @property
    def graspable_sides_m(self) -> dict[str, float]:
        """Give the sides no wider than `MAX_SIDE_M`."""
        return {axis: side for axis, side in self.sides_m.items() if side <= MAX_SIDE_M + 1e-9}

    def to_json(self) -> dict[str, Any]:
        """Give shape and extents, in metres, as files describe an object under its label."""
        return {"shape": self.shape, "extents_m": list(self.extents_m)}

    @property
    def volume_m3(self) -> float:
        """Give the volume in cubic metres."""
        x, y, z = self.extents_m
        return {"box": x * y * z, "cylinder": np.pi / 4 * x * y * z, "sphere": np.pi / 6 * x * y * z}[self.shape]

    def side_axis(self, axis: str) -> str:
        """Check that the object can be held by an axis and name the axis its symmetry makes it equal to.

        Raises:
            InputError: no such axis, or the side is beyond the hand's reach.
        """
        if axis not in AXES:
            raise unknown("side axis", axis, self.sides_m)
        canonical = {"box": axis, "cylinder": "z" if axis == "z" else "x", "sphere": "x"}[self.shape]
        if canonical not in self.graspable_sides_m:
            raise InputError(
                f"side {axis} of {self.label} is {self.sides_m[canonical] * 100:g} cm, beyond the hand's reach of "
                f"{MAX_SIDE_M * 100:g} cm. Graspable sides: {self.describe_sides()}."
            )
        return canonical

    def side_axis_of_length(self, side_m: float, tolerance_m: float = 0.0005) -> str:
        """Find the axis of a side by its length in metres.

        Raises:
            InputError: the object has no such side, or it is beyond the hand's reach.
        """
        if not np.isfinite(side_m) or side_m <= 0:
            raise InputError(f"a side must be a positive length, got {side_m * 100:g} cm")
        axis, length = min(self.sides_m.items(), key=lambda item: abs(item[1] - side_m))
        if abs(length - side_m) > tolerance_m:
            if side_m > MAX_SIDE_M:
                raise InputError(
                    f"a side of {side_m * 100:g} cm is beyond the hand's reach of {MAX_SIDE_M * 100:g} cm. "
                    f"Graspable sides of {self.label}: {self.describe_sides()}."
                )
            raise InputError(
                f"{self.label} has no side of {side_m * 100:g} cm. Its graspable sides: {self.describe_sides()}."
            )
        return self.side_axis(axis)

    def describe_sides(self) -> str:
        """Word the graspable sides for a message: ``x = 2 cm, z = 5 cm``."""
        return ", ".join(f"{axis} = {side * 100:g} cm" for axis, side in self.graspable_sides_m.items())

    def fold(self, quat_wxyz: ArrayLike, reference_wxyz: ArrayLike) -> NDArray[np.float64]:
        """Replace rotations of the object by the equivalent ones nearest to a reference.

        Two rotations are the same grasp when they differ by a symmetry applied in the body frame: half-turns about
        the axes of a box; any turn about z and the half-turns across it for a cylinder; everything for a sphere.

        Args:
            quat_wxyz: ``(..., 4)`` object rotations in any fixed frame.
            reference_wxyz: ``(4,)`` or ``(..., 4)`` rotations in the same frame.

        Returns:
            ``(..., 4)`` unit quaternions with w >= 0.
        """
        quat = np.asarray(quat_wxyz, dtype=np.float64)
        reference = np.broadcast_to(np.asarray(reference_wxyz, dtype=np.float64), quat.shape)
        if self.shape == "sphere":
            return canonical_quat(reference)
        if self.shape == "box":
            group = np.stack([_IDENTITY, *_HALF_TURNS.values()])
            options = quat_multiply(quat[..., None, :], group)
        else:
            flipped = quat_multiply(quat[..., None, :], np.stack([_IDENTITY, _HALF_TURNS["x"]]))
            # The turn about body z that brings an option nearest to the reference maximises
            # |c cos(t/2) + s sin(t/2)|, with c and s the components of option^-1 * reference along w and z.
            relative = quat_multiply(quat_conjugate(flipped), reference[..., None, :])
            turn = np.stack([relative[..., 0], 0 * relative[..., 0], 0 * relative[..., 0], relative[..., 3]], axis=-1)
            norm = np.linalg.norm(turn, axis=-1, keepdims=True)
            options = quat_multiply(flipped, np.where(norm > 1e-12, turn / np.maximum(norm, 1e-12), _IDENTITY))
        nearness = np.abs((options * reference[..., None, :]).sum(axis=-1))
        # A tie (a rotation exactly between two images) goes to the first, whatever the rounding.
        best = np.argmax(nearness >= nearness.max(axis=-1, keepdims=True) - 1e-12, axis=-1)
        return canonical_quat(np.take_along_axis(options, best[..., None, None], axis=-2)[..., 0, :])

    def random_symmetry(self, rng: np.random.Generator, n: int) -> NDArray[np.float64]:
        """Draw ``(n, 4)`` elements of the symmetry group."""
        if self.shape == "sphere":
            draws = rng.normal(size=(n, 4))
            return canonical_quat(draws)
        if self.shape == "box":
            return np.stack([_IDENTITY, *_HALF_TURNS.values()])[rng.integers(4, size=n)]
        turns = np.zeros((n, 3))
        turns[:, 2] = rng.uniform(0, 2 * np.pi, n)
        spin = as_quat(as_rotation(_IDENTITY).from_rotvec(turns))
        return canonical_quat(quat_multiply(spin, np.stack([_IDENTITY, _HALF_TURNS["x"]])[rng.integers(2, size=n)]))


def _make(shape: Shape, size: str, *extents_mm: float) -> GraspObject:
    x, y, z = (extent / 1000.0 for extent in extents_mm)
    return GraspObject(f"{shape}_{size}", shape, (x, y, z))


CATALOGUE: Mapping[str, GraspObject] = {
    obj.label: obj
    for obj in (
        _make("box", "small", 20, 30, 40),
        _make("box", "medium", 30, 45, 60),
        _make("box", "large", 40, 55, 70),
        _make("cylinder", "small", 20, 20, 50),
        _make("cylinder", "medium", 35, 35, 70),
        _make("cylinder", "large", 50, 50, 90),
        _make("sphere", "small", 30, 30, 30),
        _make("sphere", "medium", 45, 45, 45),
        _make("sphere", "large", 60, 60, 60),
    )
}
"""The nine objects of the paper's kind, by label, in the order used for one-hot codes and tables."""


def grasp_object(label: str) -> GraspObject:
    """Look up a catalogue object.

    Raises:
        InputError: the label is not in `CATALOGUE`; the message names the nearest.
    """
    found = CATALOGUE.get(str(label).strip().lower().replace("-", "_"))
    if found is None:
        raise unknown("object", label, CATALOGUE)
    return found
