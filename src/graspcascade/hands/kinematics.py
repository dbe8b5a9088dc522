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
        for link in self.links:
            if wanted is not None and link.name not in wanted:
                continue
            offset, turn = np.array(link.position_m), np.array(link.matrix)
            if link.parent is None:
                rotation, origin = np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3))
            else:
                up_rotation, up_origin = found[link.parent]
                rotation, origin = up_rotation @ turn, up_origin + up_rotation @ offset
            if link.joint is not None and link.joint in angles:
                rotation = rotation @ _hinge(np.array(link.axis), np.asarray(angles[link.joint], dtype=np.float64))
            found[link.name] = (rotation, origin)
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


def _hinge(axis: Array, angle: Array) -> Array:
    """Rotate by `angle` ``(n,)`` about one axis (Rodrigues' formula)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
