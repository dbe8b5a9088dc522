"""What hand and objects look like: colours, bounds, triangle meshes, and their nodes in a viser scene.

A browser lights a vertex by the triangles that share it, so the corners of sharp edges are there once for each face.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, cast

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from trimesh import Trimesh, creation
from trimesh.graph import smooth_shade
from trimesh.util import concatenate

from ..core.objects import Shape
from ..core.poses import Pose, as_quat
from ..hands import Hand, read_spec
from ..worlds import meshes
from .recording import Frame

if TYPE_CHECKING:
    from viser import FrameHandle, SceneApi

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
_FLOOR_M = -0.26
_STILL_M, _STILL_QUAT = 5e-5, 5e-4
"""Smaller changes of a position or a quaternion cannot be seen and are not sent."""


@dataclass(frozen=True)
class Part:
    """What a body shows in one colour: a mesh in metres in its frame, triangles counter-clockwise seen from outside."""

    body: str
    mesh: Trimesh
    rgb: RGB


@lru_cache(maxsize=64)
def shape_mesh(shape: Shape) -> Trimesh:
    """Mesh a shape in its body frame."""
    return _sharp(meshes.shape_mesh(shape))


@lru_cache(maxsize=4)
def hand_parts(hand: Hand) -> tuple[Part, ...]:
    """Mesh what a hand's MJCF draws.

    Wrist and forearm, which never move in a grasp, are parts of the palm's body; its frame is the hand frame.

    Raises:
        InputError: the hand has no MJCF.
    """
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
            number = int(model.geom_dataid[geom])
            vertices, faces = model.mesh_vertadr[number], model.mesh_faceadr[number]
            mesh = Trimesh(
                model.mesh_vert[vertices : vertices + model.mesh_vertnum[number]].astype(np.float64),
                model.mesh_face[faces : faces + model.mesh_facenum[number]].astype(np.int64),
                process=False,  # which corners are split is the model's own choice
            )
        case _:
            return None
    return _moved(mesh, Pose.of(model.geom_pos[geom], model.geom_quat[geom]))


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
    origins = [origin for _, origin in hand.frames(posture).values()]
    points = np.concatenate([*origins, *hand.tips(posture, list(hand.digits)).values()])
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max()) + _MARGIN_M


class SceneNodes:
    """Own the nodes of one hand and its object; the world frame is the hand frame with its base at rest."""

    def __init__(self, scene: SceneApi, hand: Hand) -> None:
        self._scene, self._hand = scene, hand
        scene.add_grid(
            "/floor",
            plane="xy",
            position=(0.0, 0.0, _FLOOR_M),
            infinite_grid=True,
            cell_size=0.02,
            section_size=0.1,
            cell_color=(225, 228, 232),
            section_color=(195, 200, 206),
            fade_distance=1.5,
        )
        self._base = scene.add_frame("/base", show_axes=False)
        self._bodies: dict[str, FrameHandle] = {}
        for number, part in enumerate(hand_parts(hand)):
            if part.body not in self._bodies:
                self._bodies[part.body] = scene.add_frame(f"/base/{part.body}", show_axes=False)
            _add_mesh(scene, f"/base/{part.body}/part{number}", part.mesh, part.rgb)
        self._object = scene.add_frame("/base/object", show_axes=False)
        self._shape: Shape | None = None

    def show(self, frame: Frame) -> None:
        """Move everything to where a frame has it; its posture is in the order of the hand's joints."""
        if frame.object.shape != self._shape:
            self._shape = frame.object.shape
            # A node of the same name takes the place of the one before.
            _add_mesh(self._scene, "/base/object/shape", shape_mesh(self._shape), OBJECT_RGB)
        _place(self._base, frame.base_m, np.array([1.0, 0.0, 0.0, 0.0]))
        _place(self._object, frame.X_hand_object.position_m, frame.X_hand_object.quat_wxyz)
        places = self._hand.frames(frame.posture, list(self._bodies))
        quats = as_quat(Rotation.from_matrix(np.concatenate([places[body][0] for body in self._bodies])))
        for (body, node), quat in zip(self._bodies.items(), quats, strict=True):
            _place(node, places[body][1][0], quat)


def _add_mesh(scene: SceneApi, name: str, mesh: Trimesh, rgb: RGB) -> None:
    scene.add_mesh_simple(name, mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32), color=rgb)


def _place(node: FrameHandle, position_m: NDArray[np.float64], quat_wxyz: NDArray[np.float64]) -> None:
    if np.abs(node.position - position_m).max() > _STILL_M:
        node.position = position_m
    if 1.0 - abs(float(node.wxyz @ quat_wxyz)) > _STILL_QUAT**2 / 2:
        node.wxyz = quat_wxyz
