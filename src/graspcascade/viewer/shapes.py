"""Triangle meshes of the hand's bodies and of the objects, as a browser draws them.

A browser lights a vertex by the triangles that share it, so the corners of sharp edges are there once for each face.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from trimesh import Trimesh, creation
from trimesh.graph import smooth_shade
from trimesh.util import concatenate

from ..core.objects import GraspObject, Shape
from ..core.poses import Pose
from ..hands import Hand, read_spec
from ..worlds.meshes import object_mesh

RGB = tuple[int, int, int]

OBJECT_RGB: RGB = (237, 125, 49)
_LINK, _TIP, _KNUCKLE = (204, 209, 217), (69, 94, 120), (97, 105, 115)
_PALM, _BASE = (153, 161, 171), (122, 128, 136)
_MARGIN_M = 0.02
"""Thickness of the hand about the points that `hand_bounds` measures."""
_SHARP_RAD = np.radians(20.0)
"""Faces that meet at a larger angle keep their edge; facets of round shapes meet at 15 degrees or less."""
_SHOWN_GROUPS = (0, 1, 2)
"""Geom groups that MuJoCo's own viewer draws; a hand with visual meshes keeps its collision shapes in others."""


@dataclass(frozen=True)
class Part:
    """Hold what one body shows in one colour.

    Attributes:
        body: body that carries it.
        mesh: metres in the body's frame; triangles counter-clockwise seen from outside.
        rgb: colour, 0 to 255.
    """

    body: str
    mesh: Trimesh
    rgb: RGB


@lru_cache(maxsize=64)
def shape_mesh(shape: Shape) -> Trimesh:
    """Mesh a shape in its body frame."""
    return _sharp(object_mesh(GraspObject(shape.kind, shape)))


@lru_cache(maxsize=4)
def hand_parts(hand: Hand) -> tuple[Part, ...]:
    """Mesh what a hand's MJCF draws.

    Wrist and forearm, which never move in a grasp, are parts of the palm's body; its frame is the hand frame.

    Raises:
        InputError: the hand has no MJCF.
    """
    import mujoco

    model = read_spec(hand).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    place = [Pose.of(data.xpos[body], data.xquat[body]) for body in range(model.nbody)]
    X_hand_world = (place[model.body(hand.prefix + hand.body).id] @ hand.X_body_hand).inverse()
    moving = {link.name for link in hand.kinematics.links} - {hand.body}
    meshes: dict[tuple[str, RGB], list[Trimesh]] = {}
    for geom in range(model.ngeom):
        mesh = geom_mesh(model, geom) if model.geom_group[geom] in _SHOWN_GROUPS else None
        if mesh is None:
            continue
        body = int(model.geom_bodyid[geom])
        name = model.body(body).name.removeprefix(hand.prefix)
        rgb = body_rgb(hand, name)
        if name not in moving:
            name, mesh = hand.body, _moved(mesh, X_hand_world @ place[body])
        meshes.setdefault((name, rgb), []).append(mesh)
    return tuple(Part(name, cast("Trimesh", concatenate(parts)), rgb) for (name, rgb), parts in meshes.items())


def geom_mesh(model: Any, geom: int) -> Trimesh | None:
    """Mesh one geom of a compiled MuJoCo model in its body's frame; None for kinds that have no volume."""
    import mujoco

    kind, size = mujoco.mjtGeom, model.geom_size[geom]
    match kind(int(model.geom_type[geom])):
        case kind.mjGEOM_SPHERE:
            mesh = _scaled(creation.icosphere(), size[[0, 0, 0]])
        case kind.mjGEOM_ELLIPSOID:
            mesh = _scaled(creation.icosphere(), size)
        case kind.mjGEOM_CAPSULE:
            # In radii: trimesh drops triangles of less than 1e-8 square units, which in metres a fingertip may have.
            mesh = _scaled(creation.capsule(2 * size[1] / size[0], 1.0, count=(12, 24)), size[[0, 0, 0]])
        case kind.mjGEOM_CYLINDER:
            mesh = _scaled(_sharp(creation.cylinder(1.0, 2.0, sections=24)), size[[0, 0, 1]])
        case kind.mjGEOM_BOX:
            mesh = _scaled(_sharp(creation.box()), 2 * size)
        case kind.mjGEOM_MESH:
            mesh = _stored_mesh(model, int(model.geom_dataid[geom]))
        case _:
            return None
    return _moved(mesh, Pose.of(model.geom_pos[geom], model.geom_quat[geom]))


def _stored_mesh(model: Any, number: int) -> Trimesh:
    vertices, faces = model.mesh_vertadr[number], model.mesh_faceadr[number]
    return Trimesh(
        model.mesh_vert[vertices : vertices + model.mesh_vertnum[number]].astype(np.float64),
        model.mesh_face[faces : faces + model.mesh_facenum[number]].astype(np.int64),
        process=False,  # which corners are split is the model's own choice
    )


def _scaled(unit: Trimesh, factor_m: Any) -> Trimesh:
    return Trimesh(unit.vertices * factor_m, unit.faces, process=False)


def _sharp(mesh: Trimesh) -> Trimesh:
    split: Trimesh = smooth_shade(mesh, angle=_SHARP_RAD, facet_minarea=None)
    return split


def _moved(mesh: Trimesh, pose: Pose) -> Trimesh:
    return Trimesh(pose.apply(mesh.vertices), mesh.faces, process=False)


def body_rgb(hand: Hand, body: str) -> RGB:
    """Choose a body's colour by what it is: tips that are meant to touch, knuckles, links, palm, forearm and wrist."""
    if body in {digit.tip_body for digit in hand.digits.values()}:
        return _TIP
    if body in {digit.root for digit in hand.digits.values()}:
        return _KNUCKLE
    if body == hand.body or body in hand.palm_bodies:
        return _PALM
    return _LINK if body in {link.name for link in hand.kinematics.links} else _BASE


def hand_bounds(hand: Hand) -> tuple[NDArray[np.float64], float]:
    """Compute the middle ``(3,)`` and the radius of the open hand, forearm left out, metres in the hand frame."""
    posture = hand.pregrasp[None]
    points = np.concatenate(
        [origin for _, origin in hand.frames(posture).values()] + list(hand.tips(posture, list(hand.digits)).values())
    )
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max()) + _MARGIN_M
