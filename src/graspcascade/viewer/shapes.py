"""Triangle meshes of the hand's bodies and of the objects, from the primitives the physics uses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..hands import HandModel, load_spec
from ..objects import GraspObject
from ..poses import Pose

OBJECT_RGB = (224, 122, 56)
_SEGMENTS = 24
_HEMISPHERE_RINGS = 6
_LIFT = 0.14
"""Lightest black: the form of quite dark parts would be lost on a page."""
_SHOWN_GROUPS = (0, 1, 2)
"""Geom groups that MuJoCo's own viewer draws; a hand with visual meshes keeps its collision shapes in others."""

Profile = NDArray[np.float64]


@dataclass(frozen=True)
class Mesh:
    """Hold a closed surface, triangles counter-clockwise seen from outside.

    Attributes:
        vertices_m: ``(V, 3)`` metres; corners of sharp edges are there once for each face.
        faces: ``(F, 3)`` rows of `vertices_m`.
        rgb: colour, 0 to 255.
    """

    vertices_m: NDArray[np.float64]
    faces: NDArray[np.int64]
    rgb: tuple[int, int, int] = (128, 128, 128)

    def moved(self, pose: Pose) -> Mesh:
        """Map the vertices by a single rigid transform."""
        return replace(self, vertices_m=pose.apply(self.vertices_m))


def join(meshes: Sequence[Mesh]) -> Mesh:
    """Put meshes into one, in the colour of the first."""
    offsets = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices_m for mesh in meshes]),
        np.concatenate([mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]),
        meshes[0].rgb,
    )


def box(half_m: ArrayLike) -> Mesh:
    """Mesh a box of half extents ``(3,)``."""
    half = np.asarray(half_m, dtype=np.float64)
    sides = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            first, second = np.eye(3)[(axis + 1) % 3], sign * np.eye(3)[(axis + 2) % 3]
            centre = sign * np.eye(3)[axis]
            corners = [centre - first - second, centre + first - second, centre + first + second]
            sides.append(Mesh(np.array([*corners, centre - first + second]) * half, np.array([[0, 1, 2], [0, 2, 3]])))
    return join(sides)


def ellipsoid(semi_axes_m: ArrayLike) -> Mesh:
    """Mesh an ellipsoid of semi-axes ``(3,)``; equal ones make a sphere."""
    angle = np.linspace(np.pi / 2, -np.pi / 2, 2 * _HEMISPHERE_RINGS + 1)
    unit = _revolved(np.stack([np.cos(angle), np.sin(angle)], axis=1))
    return replace(unit, vertices_m=unit.vertices_m * np.asarray(semi_axes_m, dtype=np.float64))


def capsule(radius_m: float, half_m: float) -> Mesh:
    """Mesh a capsule along z whose straight part is twice `half_m` long."""
    angle = np.linspace(np.pi / 2, 0, _HEMISPHERE_RINGS + 1)
    top = np.stack([radius_m * np.cos(angle), half_m + radius_m * np.sin(angle)], axis=1)
    return _revolved(np.concatenate([top, top[::-1] * [1.0, -1.0]]))


def cylinder(radius_m: float, half_m: float) -> Mesh:
    """Mesh a cylinder along z of height twice `half_m`."""
    rim, foot = [radius_m, half_m], [radius_m, -half_m]
    pieces = ([[0.0, half_m], rim], [rim, foot], [foot, [0.0, -half_m]])
    return join([_revolved(np.array(piece)) for piece in pieces])


def _revolved(profile: Profile) -> Mesh:
    """Turn a profile ``(K, 2)`` of radius and height, from top to bottom, about z; its ends may lie on the axis."""
    turn = np.linspace(0, 2 * np.pi, _SEGMENTS, endpoint=False)
    rings, vertices, faces = [], [], []
    count = 0
    for radius, height in profile:
        # A point on the axis is one vertex: many in one place would each be lit by a single triangle.
        angles = turn if radius > 1e-9 else turn[:1]
        vertices.append(np.stack([radius * np.cos(angles), radius * np.sin(angles), 0 * angles + height], axis=1))
        rings.append(count + np.arange(_SEGMENTS) % len(angles))
        count += len(angles)
    for upper, lower in pairwise(rings):
        faces.append(np.stack([upper, lower, np.roll(lower, -1)], axis=1))
        faces.append(np.stack([upper, np.roll(lower, -1), np.roll(upper, -1)], axis=1))
    triangles = np.concatenate(faces)
    corners = np.sort(triangles, axis=1)
    return Mesh(np.concatenate(vertices), triangles[(np.diff(corners, axis=1) > 0).all(axis=1)])


def object_mesh(obj: GraspObject) -> Mesh:
    """Mesh an object in its body frame."""
    half = np.array(obj.extents_m) / 2
    found = {
        "box": lambda: box(half),
        "cylinder": lambda: cylinder(half[0], half[2]),
        "sphere": lambda: ellipsoid(half),
    }[obj.shape]()
    return replace(found, rgb=OBJECT_RGB)


def hand_meshes(hand: HandModel) -> dict[str, tuple[Mesh, ...]]:
    """Mesh what a hand's MJCF draws, one mesh for each colour of a body.

    Returns:
        Meshes in the frame of their body, by body name. Wrist and forearm, which never move in a grasp, are part of
        the hand body.
    """
    import mujoco

    model = load_spec(hand.description).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    prefix, root = hand.description.prefix, hand.description.hand_body
    place = [Pose.of(data.xpos[body], data.xquat[body]) for body in range(model.nbody)]
    X_hand_world = place[model.body(prefix + root).id].inverse()
    moving = {link.name for link in hand.kinematics.links}
    found: dict[tuple[str, tuple[int, int, int]], list[Mesh]] = {}
    for geom in range(model.ngeom):
        mesh = _geom_mesh(model, geom) if model.geom_group[geom] in _SHOWN_GROUPS else None
        if mesh is None:
            continue
        body = int(model.geom_bodyid[geom])
        name = model.body(body).name.removeprefix(prefix)
        if name not in moving:
            name, mesh = root, mesh.moved(X_hand_world @ place[body])
        found.setdefault((name, mesh.rgb), []).append(mesh)
    return {
        name: tuple(join(parts) for (owner, _), parts in found.items() if owner == name)
        for name in dict.fromkeys(owner for owner, _ in found)
    }


def _geom_mesh(model: Any, geom: int) -> Mesh | None:
    """Mesh one geom in its body's frame; None for kinds that have no volume."""
    import mujoco

    kind, size = mujoco.mjtGeom, model.geom_size[geom]
    makers = {
        kind.mjGEOM_SPHERE: lambda: ellipsoid(size[[0, 0, 0]]),
        kind.mjGEOM_CAPSULE: lambda: capsule(size[0], size[1]),
        kind.mjGEOM_ELLIPSOID: lambda: ellipsoid(size),
        kind.mjGEOM_CYLINDER: lambda: cylinder(size[0], size[1]),
        kind.mjGEOM_BOX: lambda: box(size),
        kind.mjGEOM_MESH: lambda: _stored_mesh(model, int(model.geom_dataid[geom])),
    }
    make = makers.get(kind(int(model.geom_type[geom])))
    if make is None:
        return None
    red, green, blue = (round(255 * (_LIFT + (1 - _LIFT) * float(channel))) for channel in model.geom_rgba[geom, :3])
    placed = make().moved(Pose.of(model.geom_pos[geom], model.geom_quat[geom]))
    return replace(placed, rgb=(red, green, blue))


def _stored_mesh(model: Any, number: int) -> Mesh:
    vertices, faces = model.mesh_vertadr[number], model.mesh_faceadr[number]
    return Mesh(
        model.mesh_vert[vertices : vertices + model.mesh_vertnum[number]].astype(np.float64),
        model.mesh_face[faces : faces + model.mesh_facenum[number]].astype(np.int64),
    )
