"""Forward kinematics of a tree of hinges for many postures at once, in numpy alone.

Sampling needs the fingertips of a thousand postures in a millisecond or two and must not pay for loading a physics
engine, so the tree's constants are plain arrays that travel with the weights as JSON.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .description import Vector

Array = NDArray[np.float64]
_IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_Moving = tuple[tuple[Array, Array, Array], Array]
"""A body's axes (the columns of its rotation) and origin, each ``(3, n)``, or ``(3, 1)`` where no joint moves it."""


@dataclass(frozen=True)
class Link:
    """Describe one body of the tree, fixed to its parent by at most one hinge at its origin.

    Attributes:
        name: body name.
        parent: parent's body name, None for the root.
        position_m: origin in the parent's frame at zero angle, metres.
        matrix: rotation in the parent's frame at zero angle, rows of a 3 x 3 matrix.
        joint: name of the hinge that moves the body, None when fixed.
        axis: unit hinge axis in the body's own frame.
    """

    name: str
    parent: str | None
    position_m: Vector
    matrix: tuple[tuple[float, ...], ...]
    joint: str | None = None
    axis: Vector = (1.0, 0.0, 0.0)


@dataclass(frozen=True)
class Kinematics:
    """Hold the links of a hand, parents before children; the root's frame is the hand frame."""

    links: tuple[Link, ...]

    def frames(
        self, angles: Mapping[str, ArrayLike], bodies: Sequence[str] | None = None
    ) -> dict[str, tuple[Array, Array]]:
        """Compute body frames in the hand frame.

        Args:
            angles: ``(n,)`` radians by joint name; joints left out stay at zero.
            bodies: bodies wanted (their ancestors come along), None for all.

        Returns:
            ``(n, 3, 3)`` rotations and ``(n, 3)`` origins in metres by body name.
        """
        n = _rows(angles)
        found = {}
        for name, (axes, origin) in self._moving(angles, bodies).items():
            rotations, origins = np.empty((3, 3, n)), np.empty((3, n))
            for place, axis in enumerate(axes):
                rotations[:, place] = axis
            origins[:] = origin
            found[name] = (rotations.transpose(2, 0, 1), origins.T)
        return found

    def points(self, angles: Mapping[str, ArrayLike], spots: Mapping[str, tuple[str, Vector]]) -> dict[str, Array]:
        """Locate points that ride on bodies, without the cost of whole frames.

        Args:
            angles: ``(n,)`` radians by joint name; joints left out stay at zero.
            spots: body and place in the body's frame, metres, by a name of the caller's.

        Returns:
            ``(n, 3)`` metres in the hand frame by that name.
        """
        moving = self._moving(angles, [body for body, _ in spots.values()])
        found = {}
        for name, (body, point) in spots.items():
            axes, origin = moving[body]
            found[name] = np.empty((_rows(angles), 3))
            found[name].T[:] = origin + _combined(axes, point)
        return found

    def _moving(self, angles: Mapping[str, ArrayLike], bodies: Sequence[str] | None) -> dict[str, _Moving]:
        """Walk down the tree to the bodies wanted, all where None.

        The batch is the last axis: each step is then a few long contiguous operations.
        """
        wanted = None if bodies is None else self.ancestry(bodies)
        found: dict[str, _Moving] = {}
        for link in self.links:
            if wanted is not None and link.name not in wanted:
                continue
            if link.parent is None:
                x, y, z = np.eye(3)[:, :, None]
                axes, origin = (x, y, z), np.zeros((3, 1))
            else:
                above, origin = found[link.parent]
                origin = origin + _combined(above, link.position_m)
                axes = _turned(above, link.matrix)
            if link.joint is not None and link.joint in angles:
                axes = _hinged(axes, link.axis, np.asarray(angles[link.joint], dtype=np.float64))
            found[link.name] = (axes, origin)
        return found

    def ancestry(self, bodies: Sequence[str]) -> set[str]:
        """Name bodies and everything they hang from."""
        parent = {link.name: link.parent for link in self.links}
        found: set[str] = set()
        for body in bodies:
            name: str | None = body
            while name is not None and name not in found:
                found.add(name)
                name = parent[name]
        return found

    def to_json(self) -> list[dict[str, Any]]:
        """Give the links as plain lists and numbers."""
        return [vars(link) | {} for link in self.links]

    @classmethod
    def from_json(cls, data: list[dict[str, Any]]) -> Kinematics:
        """Rebuild from `to_json`."""
        return cls(
            tuple(
                Link(
                    name=row["name"],
                    parent=row["parent"],
                    position_m=tuple(row["position_m"]),
                    matrix=tuple(tuple(r) for r in row["matrix"]),
                    joint=row["joint"],
                    axis=tuple(row["axis"]),
                )
                for row in data
            )
        )


def _rows(angles: Mapping[str, ArrayLike]) -> int:
    return max((np.size(values) for values in angles.values()), default=1)


def _combined(axes: tuple[Array, Array, Array], weights: Sequence[float]) -> Array:
    """Sum the axes by weight; most weights of a hand's tree are zero or one, and those cost nothing."""
    terms = [axis if weight == 1.0 else axis * weight for axis, weight in zip(axes, weights, strict=True) if weight]
    return sum(terms[1:], start=terms[0]) if terms else np.zeros((3, 1))


def _turned(axes: tuple[Array, Array, Array], matrix: Sequence[Sequence[float]]) -> tuple[Array, Array, Array]:
    """Multiply rotations from the right by one constant matrix."""
    if matrix == _IDENTITY:
        return axes
    x, y, z = (_combined(axes, column) for column in zip(*matrix, strict=True))
    return x, y, z


def _hinged(axes: tuple[Array, Array, Array], about: Vector, angle: Array) -> tuple[Array, Array, Array]:
    """Multiply rotations from the right by a turn of `angle` ``(n,)`` about one axis."""
    sine, cosine = np.sin(angle), np.cos(angle)
    main = int(np.argmax(np.abs(about)))
    if abs(about[main]) == 1.0:
        # About a coordinate axis only the other two columns change.
        if about[main] < 0.0:
            sine = -sine
        first, second = (main + 1) % 3, (main + 2) % 3
        turned = list(axes)
        turned[first] = cosine * axes[first]
        turned[first] += sine * axes[second]
        turned[second] = cosine * axes[second]
        turned[second] -= sine * axes[first]
        return turned[0], turned[1], turned[2]
    x, y, z = about
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # Rodrigues' formula.
    hinge = np.eye(3)[:, :, None] + sine * cross[:, :, None] + (1.0 - cosine) * (cross @ cross)[:, :, None]
    turned_x, turned_y, turned_z = (
        sum(axis * part for axis, part in zip(axes, hinge[:, k], strict=True)) for k in range(3)
    )
    return turned_x, turned_y, turned_z
