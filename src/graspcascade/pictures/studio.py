"""`Studio`: a hand and an object photographed offscreen, in any posture and pose."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..hands import SHADOW_HAND, HandDescription, load_spec
from ..objects import GraspObject, grasp_object
from ..poses import Pose, rotate

Image = NDArray[np.uint8]

ORANGE = (0.93, 0.49, 0.19, 1.0)
_LINK, _TIP = (0.80, 0.82, 0.85, 1.0), (0.27, 0.36, 0.47, 1.0)
_PALM, _KNUCKLE = (0.60, 0.63, 0.67, 1.0), (0.38, 0.41, 0.46, 1.0)
_OVERSAMPLING = 2
"""Pixels are averaged from this many a side: software rendering smooths no edges itself."""


@dataclass(frozen=True)
class View:
    """Say where the camera stands, in the hand frame (z along the fingers, -y out of the palm, +x to the thumb).

    Attributes:
        azimuth_deg: direction of sight about z; 90 looks at the palm, 180 at the thumb's side.
        elevation_deg: direction of sight above the horizon; negative looks down.
        span_m: height of what the picture shows.
        towards_m: what it looks at, in the hand frame.
    """

    azimuth_deg: float = 148.0
    elevation_deg: float = -14.0
    span_m: float = 0.222
    towards_m: tuple[float, float, float] = (0.012, -0.034, 0.1)


HAND_VIEW = View()
"""Shows the opposition of thumb and fingers, the object between them and the palm behind."""


class Studio:
    """Photograph one hand with any catalogue object.

    Args:
        hand: which hand.
        width: of a picture, pixels.
        height: of a picture, pixels.

    Raises:
        InputError: nothing to draw with is installed; the message says what to install.
    """

    def __init__(self, hand: HandDescription = SHADOW_HAND, width: int = 350, height: int = 420) -> None:
        self._hand = hand
        self._size = (width * _OVERSAMPLING, height * _OVERSAMPLING)
        self._context = _gl_context(*self._size)
        self._sets: dict[str, _Set] = {}

    def close(self) -> None:
        """Give the drawing surface back."""
        for found in self._sets.values():
            found.gpu.free()
        self._sets.clear()
        self._context.free()

    def __enter__(self) -> Studio:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def grasp(
        self,
        object_label: str,
        joint_names: tuple[str, ...],
        posture: NDArray[np.float64],
        X_hand_object: Pose,
        view: View = HAND_VIEW,
    ) -> Image:
        """Photograph a hand with an object.

        Args:
            object_label: which object.
            joint_names: names of the posture's columns.
            posture: ``(J,)`` radians.
            X_hand_object: object pose in the hand frame, ``(3,)`` and ``(4,)``.
            view: where the camera stands.

        Returns:
            ``(height, width, 3)`` red, green and blue.
        """
        found = self._set(object_label, with_hand=True)
        for name, angle in zip(joint_names, posture, strict=True):
            found.data.joint(self._hand.prefix + name).qpos = angle
        X_world_hand = _hand_pose(found, self._hand)
        placed = X_world_hand @ X_hand_object
        found.data.mocap_pos[0], found.data.mocap_quat[0] = placed.position_m, placed.quat_wxyz
        return self._shoot(found, view, X_world_hand)

    def object(self, object_label: str, span_m: float = 0.11) -> Image:
        """Photograph an object alone, its z axis up; all objects at one scale."""
        view = View(azimuth_deg=125.0, elevation_deg=-22.0, span_m=span_m, towards_m=(0.0, 0.0, 0.0))
        found = self._set(object_label, with_hand=False)
        return self._shoot(found, view, Pose.of([0, 0, 0], [1, 0, 0, 0]))

    def _set(self, label: str, *, with_hand: bool) -> _Set:
        key = f"{label} {with_hand}"
        if key not in self._sets:
            self._context.make_current()
            self._sets[key] = _build(self._hand if with_hand else None, grasp_object(label), *self._size)
        return self._sets[key]

    def _shoot(self, found: _Set, view: View, X_world_hand: Pose) -> Image:
        import mujoco

        self._context.make_current()
        mujoco.mj_forward(found.model, found.data)
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat = X_world_hand.apply(np.array(view.towards_m))
        ahead = rotate(X_world_hand.quat_wxyz, _direction(view))
        camera.azimuth = np.degrees(np.arctan2(ahead[1], ahead[0]))
        camera.elevation = np.degrees(np.arcsin(ahead[2]))
        camera.distance = view.span_m / 2 / np.tan(np.radians(_FIELD_DEG) / 2)
        return found.picture(camera, *self._size)


@dataclass(frozen=True)
class _Set:
    """Hold a compiled scene with its state and what MuJoCo draws it with."""

    model: Any
    data: Any
    scene: Any
    gpu: Any

    def picture(self, camera: Any, width: int, height: int) -> Image:
        import mujoco

        option = mujoco.MjvOption()
        mujoco.mjv_updateScene(
            self.model, self.data, option, None, camera, mujoco.mjtCatBit.mjCAT_ALL.value, self.scene
        )
        area = mujoco.MjrRect(0, 0, width, height)
        # Scenes share one surface, and each draws into the buffer that was bound last.
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self.gpu)
        mujoco.mjr_render(area, self.scene, self.gpu)
        pixels = np.empty((height, width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, area, self.gpu)
        k = _OVERSAMPLING
        fine = pixels[::-1].reshape(height // k, k, width // k, k, 3).astype(np.float64)
        return np.asarray(fine.mean(axis=(1, 3)).round(), dtype=np.uint8)


_FIELD_DEG = 18.0
"""Field of view; a long lens, so that lengths can be compared."""


def _build(hand: HandDescription | None, obj: GraspObject, width: int, height: int) -> _Set:
    import mujoco

    from ..trials.scene import object_geom

    spec = mujoco.MjSpec() if hand is None else load_spec(hand)
    _light(spec, width, height)
    if hand is not None:
        _dress(spec, hand)
    body = spec.worldbody.add_body(name="shown_object", mocap=True)
    kind, size = object_geom(obj)
    body.add_geom(type=kind, size=size, rgba=ORANGE)
    model = spec.compile()
    # Clipping planes and shadows are relative to the extent, which must not depend on the object.
    model.stat.extent, model.stat.center = 0.3, [0.0, 0.0, 0.3 if hand else 0.0]
    scene = mujoco.MjvScene(model, maxgeom=500)
    scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
    gpu = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
    return _Set(model, mujoco.MjData(model), scene, gpu)


def _light(spec: Any, width: int, height: int) -> None:
    import mujoco

    about = spec.visual
    about.global_.offwidth, about.global_.offheight = width, height
    about.global_.fovy = _FIELD_DEG
    about.map.znear, about.map.zfar = 0.1, 30.0
    about.quality.shadowsize = 4096
    about.headlight.ambient, about.headlight.diffuse = [0.42] * 3, [0.16] * 3
    about.headlight.specular = [0.08] * 3
    white = {"rgb1": [1.0] * 3, "rgb2": [1.0] * 3, "width": 64, "height": 64}
    spec.add_texture(
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT, **white, name="backdrop"
    )
    for position, strength, shadow in (([0.4, -0.5, 1.3], 0.52, True), ([-0.8, -0.6, 0.5], 0.2, False)):
        spec.worldbody.add_light(
            pos=position,
            dir=[-position[0], -position[1], 0.3 - position[2]],
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            diffuse=[strength] * 3,
            specular=[0.15] * 3,
            castshadow=shadow,
        )


def _dress(spec: Any, hand: HandDescription) -> None:
    """Colour links by what they are: palm, knuckles, phalanges and, darker, the tips that are meant to touch."""
    tips = {hand.prefix + body for body, _ in hand.tips.values()}
    palm = {hand.prefix + body for body in (hand.hand_body, *hand.palm_bodies)}
    roots = {hand.prefix + body for body in hand.digit_roots.values()}
    for geom in spec.geoms:
        name = geom.parent.name
        if name in tips:
            geom.rgba = _TIP
        elif name in palm:
            geom.rgba = _PALM
        elif name in roots:
            geom.rgba = _KNUCKLE
        elif any(joint.name for joint in geom.parent.joints) or geom.contype:
            geom.rgba = _LINK


def _hand_pose(found: _Set, hand: HandDescription) -> Pose:
    import mujoco

    mujoco.mj_kinematics(found.model, found.data)
    palm = found.data.body(hand.prefix + hand.hand_body)
    return Pose.of(palm.xpos, palm.xquat)


def _direction(view: View) -> NDArray[np.float64]:
    turn, rise = np.radians(view.azimuth_deg), np.radians(view.elevation_deg)
    return np.array([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])


def need_renderer() -> None:
    """Check that pictures can be drawn offscreen.

    Raises:
        InputError: nothing to draw with is installed; the message says what to install.
    """
    _gl_context(8, 8).free()


def _gl_context(width: int, height: int) -> Any:
    """Open a drawing surface: MUJOCO_GL's choice, or without a display the software renderer."""
    try:
        return _context_class()(width, height)
    # A missing library shows in as many ways as there are bindings between Python and OpenGL.
    except (ImportError, AttributeError, OSError, RuntimeError, TypeError) as error:
        raise InputError(
            f"nothing to draw pictures with ({error}): install OSMesa (Debian and Ubuntu: apt-get install libosmesa6) "
            "and set MUJOCO_GL=osmesa"
        ) from error


@lru_cache(maxsize=1)
def _context_class() -> Any:
    headless = sys.platform == "linux" and not os.environ.get("DISPLAY")
    if not os.environ.get("MUJOCO_GL") and headless:
        # MuJoCo's own default is a window, and it reads MUJOCO_GL only when first imported.
        return import_module("mujoco.osmesa").GLContext
    return import_module("mujoco.gl_context").GLContext
