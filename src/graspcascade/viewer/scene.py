"""Put a hand and its object into a viser scene and move them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from viser import FrameHandle, MeshHandle, SceneApi

from ..hands import HandModel
from ..objects import grasp_object
from ..poses import as_quat
from .recording import Frame
from .shapes import Part, object_part

CAMERA_POSITION_M = (0.21, -0.37, 0.27)
CAMERA_TARGET_M = (0.01, -0.02, 0.075)
_FLOOR_M = -0.26
_STILL_M, _STILL_QUAT = 5e-5, 5e-4
"""Smaller changes of a position or a quaternion cannot be seen and are not sent."""


@dataclass(frozen=True)
class HandShapes:
    """Pair a hand with the meshes of its bodies."""

    hand: HandModel
    meshes: dict[str, tuple[Part, ...]]


class Actors:
    """Own the nodes of one hand and its object; the world frame is the hand frame with its base at rest."""

    def __init__(self, scene: SceneApi, shapes: HandShapes) -> None:
        self._scene, self._shapes = scene, shapes
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
        for body, parts in shapes.meshes.items():
            self._bodies[body] = scene.add_frame(f"/base/{body}", show_axes=False)
            for number, part in enumerate(parts):
                _add_part(scene, f"/base/{body}/part{number}", part)
        self._object = scene.add_frame("/base/object", show_axes=False)
        self._solids: dict[str, MeshHandle] = {}

    def show(self, frame: Frame) -> None:
        """Move everything to where a frame has it."""
        self._show_object(frame.object_label)
        _place(self._base, frame.base_m, np.array([1.0, 0.0, 0.0, 0.0]))
        _place(self._object, frame.X_hand_object.position_m, frame.X_hand_object.quat_wxyz)
        places = self._shapes.hand.frames(frame.posture, list(self._bodies))
        quats = as_quat(Rotation.from_matrix(np.concatenate([places[body][0] for body in self._bodies])))
        for (body, node), quat in zip(self._bodies.items(), quats, strict=True):
            _place(node, places[body][1][0], quat)

    def _show_object(self, label: str) -> None:
        if label not in self._solids:
            self._solids[label] = _add_part(self._scene, f"/base/object/{label}", object_part(grasp_object(label)))
        for other, node in self._solids.items():
            node.visible = other == label


def _add_part(scene: SceneApi, name: str, part: Part) -> MeshHandle:
    vertices, faces = part.mesh.vertices.astype(np.float32), part.mesh.faces.astype(np.uint32)
    return scene.add_mesh_simple(name, vertices, faces, color=part.rgb)


def _place(node: FrameHandle, position_m: NDArray[np.float64], quat_wxyz: NDArray[np.float64]) -> None:
    if np.abs(node.position - position_m).max() > _STILL_M:
        node.position = position_m
    if 1.0 - abs(float(node.wxyz @ quat_wxyz)) > _STILL_QUAT**2 / 2:
        node.wxyz = quat_wxyz
