"""Put a hand and its object into a viser scene and move them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from trimesh import Trimesh
from viser import FrameHandle, SceneApi

from ..core.objects import Shape
from ..core.poses import as_quat
from ..hands import Hand
from .recording import Frame
from .shapes import OBJECT_RGB, RGB, hand_parts, shape_mesh

_FLOOR_M = -0.26
_STILL_M, _STILL_QUAT = 5e-5, 5e-4
"""Smaller changes of a position or a quaternion cannot be seen and are not sent."""


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
