"""Forward kinematics of a tree of hinges for many postures at once, in numpy alone: no physics engine is loaded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = tuple[float, float, float]
Array = NDArray[np.float64]
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_Moving = tuple[tuple[Array, Array, Array], Array]
"""A body's axes (the columns of its rotation) and origin, each ``(3, n)``, or ``(3, 1)`` where no joint moves it."""
_X, _Y, _Z = np.eye(3)[:, :, None]
_AT_REST: _Moving = ((_X, _Y, _Z), np.zeros((3, 1)))


@dataclass(frozen=True)
class Link:
    """One body of the tree, fixed to its parent (None for the root) by at most one hinge at its origin.

    Attributes:
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
    """Links of a hand, parents before children; the root's frame is the hand frame."""

    links: tuple[Link, ...]

    def frames(
        self, angles: Mapping[str, ArrayLike], bodies: Sequence[str] | None = None
    ) -> dict[str, tuple[Array, Array]]:
        """Compute body frames in the hand frame.

        Args:
            angles: ``(n,)`` radians by joint name; joints left out stay at zero.
            bodies: bodies wanted (those they hang from come along), None for all.

        Returns:
            ``(n, 3, 3)`` rotations and ``(n, 3)`` origins in metres by body name.
        """
        frames, n = {}, _rows(angles)
        for name, (axes, origin) in self._moving(angles, bodies).items():
            columns = np.empty((4, 3, n))
            for place, column in enumerate((*axes, origin)):
                columns[place] = column
            frames[name] = (columns[:3].transpose(2, 1, 0), columns[3].T)
        return frames

    def points(
        self, angles: Mapping[str, ArrayLike], spots: Sequence[tuple[str, Vector]], root: _Moving = _AT_REST
    ) -> Array:
        """Locate points that ride on bodies, metres, without the cost of whole frames.

        Args:
            angles: as for `frames`.
            spots: bodies, and points in their frames.
            root: the root's axes and origin in the frame to locate points in, by default its own.

        Returns:
            ``(m, 3, n)``, the postures last; real numbers of the type that the root's are of.
        """
        moving = self._moving(angles, [body for body, _ in spots], root)
        shape = np.broadcast_shapes((3, _rows(angles)), root[1].shape)
        located = np.empty((len(spots), *shape), root[1].dtype)
        for place, (body, point) in zip(located, spots, strict=True):
            axes, origin = moving[body]
            np.add(origin, _combined(axes, point), out=place)
        return located

    def _moving(
        self, angles: Mapping[str, ArrayLike], bodies: Sequence[str] | None, root: _Moving = _AT_REST
    ) -> dict[str, _Moving]:
        # The batch is the last axis: each step is then a few long contiguous operations.
        wanted = None if bodies is None else self.ancestry(bodies)
        moving: dict[str, _Moving] = {}
        for link in self.links:
            if wanted is not None and link.name not in wanted:
                continue
            axes, origin = root
            if link.parent is not None:
                above, origin = moving[link.parent]
                if any(link.position_m):
                    origin = origin + _combined(above, link.position_m)
                axes = _turned(above, link.matrix)
            if link.joint is not None and link.joint in angles:
                axes = _hinged(axes, link.axis, np.asarray(angles[link.joint]))
            moving[link.name] = (axes, origin)
        return moving

    def ancestry(self, bodies: Sequence[str]) -> set[str]:
        """List bodies and everything they hang from."""
        listed = set(bodies)
        for link in reversed(self.links):
            if link.name in listed and link.parent is not None:
                listed.add(link.parent)
        return listed

    def to_json(self) -> list[dict[str, Any]]:
        """Describe the links as plain lists and numbers."""
        return [vars(link) | {} for link in self.links]

    @classmethod
    def from_json(cls, data: list[dict[str, Any]]) -> Kinematics:
        """Rebuild from `to_json`."""
        vectors = ("position_m", "matrix", "axis")
        rows = [{key: _frozen(value) if key in vectors else value for key, value in row.items()} for row in data]
        return cls(tuple(Link(**row) for row in rows))


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value


def _rows(angles: Mapping[str, ArrayLike]) -> int:
    return max((np.size(values) for values in angles.values()), default=1)


def _combined(axes: tuple[Array, Array, Array], weights: Sequence[float]) -> Array:
    """Sum the axes by weight; most weights of a hand's tree are zero or one, and those cost nothing."""
    terms = [axis if weight == 1.0 else axis * weight for axis, weight in zip(axes, weights, strict=True) if weight]
    return sum(terms[1:], start=terms[0]) if terms else np.zeros((3, 1))


def _turned(axes: tuple[Array, Array, Array], matrix: Sequence[Sequence[float]]) -> tuple[Array, Array, Array]:
    """Multiply rotations from the right by one constant matrix."""
    if matrix == IDENTITY:
        return axes
    x, y, z = (_combined(axes, column) for column in zip(*matrix, strict=True))
    return x, y, z


def _hinged(axes: tuple[Array, Array, Array], about: Vector, angle: Array) -> tuple[Array, Array, Array]:
    """Multiply rotations from the right by a turn of `angle` ``(n,)`` about one axis."""
    sine, cosine = np.sin(angle), np.cos(angle)
    main = max(range(3), key=lambda part: abs(about[part]))
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
    hinge = hinge.astype(angle.dtype, copy=False)
    x, y, z = (sum(axis * part for axis, part in zip(axes, hinge[:, k], strict=True)) for k in range(3))
    return x, y, z
