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

Array = NDArray[np.float64]


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
    position_m: tuple[float, float, float]
    matrix: tuple[tuple[float, ...], ...]
    joint: str | None = None
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)


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
        wanted = None if bodies is None else self.ancestry(bodies)
        n = max((np.size(a) for a in angles.values()), default=1)
        found: dict[str, tuple[Array, Array]] = {}
        # The batch axis is last while computing: each step is then a few long contiguous operations.
        for link in self.links:
            if wanted is not None and link.name not in wanted:
                continue
            if link.parent is None:
                rotation, origin = np.broadcast_to(np.eye(3)[:, :, None], (3, 3, n)), np.zeros((3, n))
            else:
                up_rotation, up_origin = found[link.parent]
                origin = up_origin + np.einsum("ijn,j->in", up_rotation, np.array(link.position_m))
                rotation = _turned(up_rotation, np.array(link.matrix))
            if link.joint is not None and link.joint in angles:
                angle = np.asarray(angles[link.joint], dtype=np.float64)
                rotation = _hinged(rotation, np.array(link.axis), angle)
            found[link.name] = (rotation, origin)
        return {name: (np.moveaxis(r, -1, 0), np.moveaxis(o, -1, 0)) for name, (r, o) in found.items()}

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


def _turned(rotation: Array, matrix: Array) -> Array:
    """Multiply rotations ``(3, 3, n)`` from the right by one constant matrix."""
    if np.array_equal(matrix, np.eye(3)):
        return rotation
    return np.asarray(np.einsum("ijn,jk->ikn", rotation, matrix))


def _hinged(rotation: Array, axis: Array, angle: Array) -> Array:
    """Multiply rotations ``(3, 3, n)`` from the right by a turn of `angle` ``(n,)`` about one axis."""
    sine, cosine = np.sin(angle), np.cos(angle)
    main = int(np.argmax(np.abs(axis)))
    if abs(axis[main]) == 1.0:
        # About a coordinate axis only the other two columns change.
        sine = sine * axis[main]
        first, second = (main + 1) % 3, (main + 2) % 3
        turned = np.empty((3, 3, len(angle)))
        turned[:, main] = rotation[:, main]
        turned[:, first] = cosine * rotation[:, first] + sine * rotation[:, second]
        turned[:, second] = cosine * rotation[:, second] - sine * rotation[:, first]
        return turned
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # Rodrigues' formula.
    hinge = np.eye(3)[:, :, None] + sine * cross[:, :, None] + (1.0 - cosine) * (cross @ cross)[:, :, None]
    return np.asarray(np.einsum("ijn,jkn->ikn", rotation, hinge))
