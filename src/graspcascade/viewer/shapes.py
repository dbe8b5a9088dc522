"""Triangle meshes of the hand's bodies and of the objects, as a browser draws them.

A browser lights a vertex by the triangles that share it, so the corners of sharp edges are there once for each face.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from trimesh import Trimesh, creation
from trimesh.graph import smooth_shade
from trimesh.util import concatenate

from ..formats.meshes import object_mesh
from ..hands import HandModel, load_spec
from ..objects import GraspObject
from ..poses import Pose

OBJECT_RGB = (224, 122, 56)
_SEGMENTS = 24
_RINGS = 12
_SHARP_RAD = np.radians(20.0)
"""Faces that meet at a larger angle keep their edge; facets of round shapes meet at 15 degrees or less."""
_LIFT = 0.14
"""Lightest black: the form of quite dark parts would be lost on a page."""
_SHOWN_GROUPS = (0, 1, 2)
"""Geom groups that MuJoCo's own viewer draws; a hand with visual meshes keeps its collision shapes in others."""


@dataclass(frozen=True)
class Part:
    """Hold what is drawn in one colour.

    Attributes:
        mesh: metres; triangles counter-clockwise seen from outside.
        rgb: colour, 0 to 255.
    """

    mesh: Trimesh
    rgb: tuple[int, int, int]


def object_part(obj: GraspObject) -> Part:
    """Mesh an object in its body frame."""
    mesh = object_mesh(obj)
    return Part(_sharp(Trimesh(mesh.vertices_m, mesh.triangles, process=False)), OBJECT_RGB)


def hand_meshes(hand: HandModel) -> dict[str, tuple[Part, ...]]:
    """Mesh what a hand's MJCF draws, one part for each colour of a body.

    Returns:
        Parts in the frame of their body, by body name. Wrist and forearm, which never move in a grasp, are part of
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
    found: dict[str, dict[tuple[int, int, int], list[Trimesh]]] = {}
    for geom in range(model.ngeom):
        part = geom_part(model, geom) if model.geom_group[geom] in _SHOWN_GROUPS else None
        if part is None:
            continue
        body = int(model.geom_bodyid[geom])
        name = model.body(body).name.removeprefix(prefix)
        if name not in moving:
            name, part = root, Part(_moved(part.mesh, X_hand_world @ place[body]), part.rgb)
        found.setdefault(name, {}).setdefault(part.rgb, []).append(part.mesh)
    return {
        name: tuple(Part(_joined(meshes), rgb) for rgb, meshes in colours.items()) for name, colours in found.items()
    }


def geom_part(model: Any, geom: int) -> Part | None:
    """Mesh one geom of a compiled MuJoCo model in its body's frame; None for kinds that have no volume."""
    import mujoco

    kind, size = mujoco.mjtGeom, model.geom_size[geom]
    makers = {
        kind.mjGEOM_SPHERE: lambda: _ellipsoid(size[[0, 0, 0]]),
        kind.mjGEOM_CAPSULE: lambda: _capsule(size[0], size[1]),
        kind.mjGEOM_ELLIPSOID: lambda: _ellipsoid(size),
        kind.mjGEOM_CYLINDER: lambda: _cylinder(size[0], size[1]),
        kind.mjGEOM_BOX: lambda: _scaled(_sharp(creation.box()), 2 * size),
        kind.mjGEOM_MESH: lambda: _stored_mesh(model, int(model.geom_dataid[geom])),
    }
    make = makers.get(kind(int(model.geom_type[geom])))
    if make is None:
        return None
    red, green, blue = (round(255 * (_LIFT + (1 - _LIFT) * float(channel))) for channel in model.geom_rgba[geom, :3])
    return Part(_moved(make(), Pose.of(model.geom_pos[geom], model.geom_quat[geom])), (red, green, blue))


def _ellipsoid(semi_axes_m: NDArray[np.float64]) -> Trimesh:
    return _scaled(creation.icosphere(), semi_axes_m)


def _capsule(radius_m: float, half_m: float) -> Trimesh:
    # In radii: trimesh drops triangles of less than 1e-8 square units, which in metres a fingertip may have.
    unit = creation.capsule(2 * half_m / radius_m, 1.0, count=(_RINGS, _SEGMENTS))
    return _scaled(unit, radius_m)


def _cylinder(radius_m: float, half_m: float) -> Trimesh:
    unit = creation.cylinder(1.0, 2.0, sections=_SEGMENTS)
    return _scaled(_sharp(unit), [radius_m, radius_m, half_m])


def _scaled(unit: Trimesh, factor_m: ArrayLike) -> Trimesh:
    return Trimesh(unit.vertices * np.asarray(factor_m), unit.faces, process=False)


def _stored_mesh(model: Any, number: int) -> Trimesh:
    vertices, faces = model.mesh_vertadr[number], model.mesh_faceadr[number]
    return Trimesh(
        model.mesh_vert[vertices : vertices + model.mesh_vertnum[number]].astype(np.float64),
        model.mesh_face[faces : faces + model.mesh_facenum[number]].astype(np.int64),
        process=False,  # which corners are split is the model's own choice
    )


def _sharp(mesh: Trimesh) -> Trimesh:
    split: Trimesh = smooth_shade(mesh, angle=_SHARP_RAD, facet_minarea=None)
    return split


def _joined(meshes: list[Trimesh]) -> Trimesh:
    return cast("Trimesh", concatenate(meshes))


def _moved(mesh: Trimesh, pose: Pose) -> Trimesh:
    return Trimesh(pose.apply(mesh.vertices), mesh.faces, process=False)
