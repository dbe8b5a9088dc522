"""Closed convex triangle meshes of boxes, cylinders and spheres, in metres about the body's centre, and OBJ files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..objects import GraspObject

CYLINDER_SIDES = 64
SPHERE_SUBDIVISIONS = 3


@dataclass(frozen=True)
class Mesh:
    """Hold a closed triangle mesh.

    Attributes:
        vertices_m: ``(v, 3)`` metres.
        triangles: ``(t, 3)`` vertex numbers from 0, counterclockwise seen from outside.
    """

    vertices_m: NDArray[np.float64]
    triangles: NDArray[np.int64]

    @property
    def volume_m3(self) -> float:
        """Give the enclosed volume in cubic metres, by the divergence theorem."""
        a, b, c = np.moveaxis(self.vertices_m[self.triangles], 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def object_mesh(obj: GraspObject) -> Mesh:
    """Mesh an object; vertices lie on its surface, so a round one's mesh encloses up to 1 % less than the object."""
    unit = {"box": _box, "cylinder": _cylinder, "sphere": _sphere}[obj.shape]()
    return Mesh(unit.vertices_m * np.array(obj.extents_m), unit.triangles)


def write_obj(path: Path, mesh: Mesh) -> None:
    """Write a Wavefront OBJ file in metres."""
    lines = ["# metres, origin at the centre, z along a cylinder's axis"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices_m.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.triangles + 1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _box() -> Mesh:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return Mesh(corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))


def _cylinder(sides: int = CYLINDER_SIDES) -> Mesh:
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = 0.5 * np.stack([np.cos(angle), np.sin(angle), np.zeros(sides)], axis=1)
    half = np.array([0.0, 0.0, 0.5])
    vertices = np.concatenate([ring - half, ring + half, [-half, half]])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    low, high = np.full(sides, 2 * sides), np.full(sides, 2 * sides + 1)
    triangles = [(i, j, sides + j), (i, sides + j, sides + i), (low, j, i), (high, sides + i, sides + j)]
    return Mesh(vertices, np.concatenate([np.stack(t, axis=1) for t in triangles]))


def _sphere(subdivisions: int = SPHERE_SUBDIVISIONS) -> Mesh:
    """Subdivide an icosahedron, pushing new vertices out to the sphere of diameter one."""
    golden = (1 + 5**0.5) / 2
    base = np.array([[0.0, s, t * golden] for s in (-1, 1) for t in (-1, 1)])
    points = np.concatenate([base, np.roll(base, 1, axis=1), np.roll(base, 2, axis=1)])
    near = np.linalg.norm(points[:, None] - points[None], axis=2) < 2.1
    triangles = np.array(
        [(a, b, c) for a in range(12) for b in range(a) for c in range(b) if near[a, b] and near[b, c] and near[a, c]]
    )
    for _ in range(subdivisions):
        edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
        unique, index = np.unique(edges, axis=0, return_inverse=True)
        ab, bc, ca = (index.reshape(3, -1) + len(points)).tolist()
        a, b, c = triangles.T.tolist()
        points = np.concatenate([points, points[unique].mean(axis=1)])
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        triangles = np.concatenate([np.array(t).T for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    points = 0.5 * points / np.linalg.norm(points, axis=1, keepdims=True)
    corner = points[triangles]
    inward = np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return Mesh(points, triangles)
