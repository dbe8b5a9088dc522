"""Closed convex triangle meshes of shapes, in metres about the body's centre."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..core.objects import Box, Cylinder, Shape, Sphere

if TYPE_CHECKING:
    from trimesh import Trimesh

CYLINDER_SIDES = 64
SPHERE_SUBDIVISIONS = 3


def shape_mesh(shape: Shape) -> Trimesh:
    """Mesh a shape, triangles counterclockwise seen from outside.

    Vertices lie on its surface, so a round one's mesh encloses up to 1 % less than the shape.
    """
    # Slow to load, and only drawing and a few file formats need meshes.
    from trimesh import creation

    mesh: Trimesh
    match shape:
        case Box():
            mesh = creation.box(shape.extents_m)
        case Cylinder():
            mesh = creation.cylinder(shape.diameter_m / 2, shape.height_m, sections=CYLINDER_SIDES)
        case Sphere():
            mesh = creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS, radius=shape.diameter_m / 2)
        case _:
            raise NotImplementedError(f"no mesh for a {type(shape).__name__}")
    return mesh


def write_obj(path: Path, mesh: Trimesh) -> None:
    """Write a Wavefront OBJ file, exact to the last bit; its folder is made if needed."""
    lines = ["# metres, origin at the centre, z along a cylinder's axis"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1).tolist()]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
