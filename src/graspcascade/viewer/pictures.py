"""Pictures drawn without a display: a hand and an object offscreen, sheets of grasps, figures as small PNG files."""

from __future__ import annotations

import io
import os
import sys
import textwrap
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError
from ..core.files import write_staged
from ..core.grasps import Grasps
from ..core.objects import GraspObject, Shape
from ..core.protocols import PAPER, Protocol
from ..hands import Hand, read_spec
from ..worlds.world import hand_to_world, object_geom
from .recording import Frame, Recording, record
from .shapes import OBJECT_RGB, RGB, body_rgb, hand_bounds
from .words import chance_text

Image = NDArray[np.uint8]

INK, FAINT = "#22262b", "#7a828c"
"""Colours of text, and of what is said in passing."""
MOMENTS = ("placed", "closed", "end of trial")
"""The open hand about the object, the fingers closed, and what became of it."""
_COLOURS = 256
_OBJECT = "shown_object"
_OVERSAMPLING = 2
"""Pixels are averaged from this many a side: software rendering smooths no edges itself."""
_FIELD_DEG = 18.0
"""Field of view; a long lens, so that lengths can be compared."""


@dataclass(frozen=True)
class View:
    """From where the camera looks, in the hand frame (z along the fingers, -y out of the palm, +x to the thumb).

    Attributes:
        azimuth_deg: direction of sight about z; 90 looks at the palm, 180 at the thumb's side.
        elevation_deg: direction of sight above the horizon; negative looks down.
        span_m: height of what the picture shows; by default the open hand.
    """

    azimuth_deg: float = 162.0
    elevation_deg: float = -14.0
    span_m: float | None = None


THUMB_SIDE = View()
"""Shows the opposition of thumb and fingers in profile."""
FINGER_SIDE = View(azimuth_deg=28.0)
"""Shows the fingers that the object hides from the thumb's side."""


class Renderer(AbstractContextManager["Renderer"]):
    """Draw one hand with any object, in the colours of the page; width and height of a picture are in pixels.

    Raises:
        InputError: nothing to draw with is installed; the message says what to install.
    """

    def __init__(self, hand: Hand, width: int = 350, height: int = 390) -> None:
        self.hand = hand
        self._size = (width * _OVERSAMPLING, height * _OVERSAMPLING)
        self._context = _gl_context(*self._size)
        self._drawables: dict[tuple[str, bool], _Drawable] = {}

    def close(self) -> None:
        """Release the drawing surface."""
        for drawable in self._drawables.values():
            drawable.gpu.free()
        self._drawables.clear()
        self._context.free()

    def __exit__(self, *_: object) -> None:
        self.close()

    def frame(self, frame: Frame, view: View = THUMB_SIDE) -> Image:
        """Draw a moment, its posture in the order of the hand's joints; ``(height, width, 3)`` red, green and blue.

        A hand without an MJCF is an `InputError`.
        """
        drawable = self._drawable(frame.object.shape, with_hand=True)
        for name, angle in zip(self.hand.joint_names, frame.posture, strict=True):
            drawable.data.joint(self.hand.prefix + name).qpos = angle
        drawable.data.mocap_pos[0] = frame.X_hand_object.position_m
        drawable.data.mocap_quat[0] = frame.X_hand_object.quat_wxyz
        centre, radius = hand_bounds(self.hand)
        return drawable.picture(view, centre, view.span_m or 1.85 * radius, *self._size)

    def object(self, obj: GraspObject, span_m: float = 0.11) -> Image:
        """Draw an object alone, its z axis up; objects drawn with one span are at one scale."""
        view = View(azimuth_deg=125.0, elevation_deg=-22.0)
        return self._drawable(obj.shape, with_hand=False).picture(view, np.zeros(3), span_m, *self._size)

    def _drawable(self, shape: Shape, *, with_hand: bool) -> _Drawable:
        """Look up what draws a kind of shape, and give it the shape's size."""
        key = (shape.kind, with_hand)
        self._context.make_current()
        if key not in self._drawables:
            self._drawables[key] = _build(self.hand if with_hand else None, shape, *self._size)
        model = self._drawables[key].model
        model.geom(_OBJECT).size = object_geom(shape)[1]
        model.geom_rbound[model.geom(_OBJECT).id] = np.linalg.norm(shape.extents_m) / 2
        return self._drawables[key]


@dataclass(frozen=True)
class _Drawable:
    """A compiled model with its state and what MuJoCo draws it with; the world frame is the hand frame."""

    model: Any
    data: Any
    scene: Any
    gpu: Any

    def picture(self, view: View, towards_m: Any, span_m: float, width: int, height: int) -> Image:
        mujoco.mj_forward(self.model, self.data)
        camera, everything = mujoco.MjvCamera(), mujoco.mjtCatBit.mjCAT_ALL.value
        camera.type, camera.lookat = mujoco.mjtCamera.mjCAMERA_FREE, towards_m
        camera.azimuth, camera.elevation = view.azimuth_deg, view.elevation_deg
        camera.distance = span_m / 2 / np.tan(np.radians(_FIELD_DEG) / 2)
        mujoco.mjv_updateScene(self.model, self.data, mujoco.MjvOption(), None, camera, everything, self.scene)
        area = mujoco.MjrRect(0, 0, width, height)
        # All draw on one surface, and each into the buffer that was bound last.
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self.gpu)
        mujoco.mjr_render(area, self.scene, self.gpu)
        pixels = np.empty((height, width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, area, self.gpu)
        k = _OVERSAMPLING
        fine = pixels[::-1].reshape(height // k, k, width // k, k, 3).astype(np.float64)
        return np.asarray(fine.mean(axis=(1, 3)).round(), dtype=np.uint8)


def _build(hand: Hand | None, shape: Shape, width: int, height: int) -> _Drawable:
    spec = mujoco.MjSpec() if hand is None else read_spec(hand)
    if hand is not None:
        hand_to_world(spec, hand)
        for geom in spec.geoms:
            geom.material = ""
            geom.rgba = _rgba(body_rgb(hand, geom.parent.name.removeprefix(hand.prefix)))
    visual, white = spec.visual, {"rgb1": [1.0] * 3, "rgb2": [1.0] * 3, "width": 64, "height": 64}
    visual.global_.offwidth, visual.global_.offheight, visual.global_.fovy = width, height, _FIELD_DEG
    visual.map.znear, visual.map.zfar, visual.quality.shadowsize = 0.1, 30.0, 4096
    head = visual.headlight
    head.ambient, head.diffuse, head.specular = [0.42] * 3, [0.16] * 3, [0.08] * 3
    backdrop, flat = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_FLAT
    spec.add_texture(name="backdrop", type=backdrop, builtin=flat, **white)
    for position, strength, shadow in (([0.4, -0.5, 1.0], 0.52, True), ([-0.8, -0.6, 0.2], 0.2, False)):
        light = spec.worldbody.add_light(pos=position, dir=[-coordinate for coordinate in position], castshadow=shadow)
        light.type, light.diffuse, light.specular = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, [strength] * 3, [0.15] * 3
    kind, size = object_geom(shape)
    body = spec.worldbody.add_body(name=_OBJECT, mocap=True)
    body.add_geom(name=_OBJECT, type=kind, size=size, rgba=_rgba(OBJECT_RGB), contype=0, conaffinity=0)
    model = spec.compile()
    # Clipping planes and shadows are relative to the extent, which must not depend on the object.
    model.stat.extent, model.stat.center = 0.3, [0.0, 0.0, 0.0]
    scene = mujoco.MjvScene(model, maxgeom=500)
    scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
    gpu = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
    return _Drawable(model, mujoco.MjData(model), scene, gpu)


def _rgba(rgb: RGB) -> list[float]:
    return [*(channel / 255 for channel in rgb), 1.0]


def need_renderer() -> None:
    """Check that pictures can be drawn offscreen, or raise an `InputError` that says what to install."""
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


def moments(recording: Recording) -> tuple[Frame, ...]:
    """Choose the frames of `MOMENTS`; a trial that ended before one repeats its end."""
    return recording.frame(0), recording.frame(recording.closed_row), recording.frame(-1)


def grasp_strip(renderer: Renderer, grasps: Grasps, protocol: Protocol = PAPER) -> Any:
    """Draw grasps in rows of three moments, each from two sides, whatever became of them; errors are `in_order`'s."""
    rows, words = [], []
    for index, one in enumerate(record(in_order(grasps, renderer), renderer.hand, protocol)):
        rows.append([renderer.frame(frame, view) for frame in moments(one) for view in (THUMB_SIDE, FINGER_SIDE)])
        site, verdict = grasps.tasks[[index]].distinct[0].site, str(one.outcome.verdict[0]).replace("_", " ")
        faithful = ",\nfaithful" if one.outcome.faithful(grasps[index])[0] else ""
        chance = float(grasps.probability[index])
        likely = f"\nchance {chance_text(chance)}" if np.isfinite(chance) else ""
        words.append(f"{index}: {site.name} {site.width_m * 100:g} cm{likely}\n{verdict}{faithful}")
    height = 1.9 * len(rows)
    figure = grid(rows, words, (11.0, height + 0.3))
    figure.subplots_adjust(left=0.12, right=0.998, top=height / (height + 0.3), bottom=0.0, wspace=0.0, hspace=0.0)
    for number, moment in enumerate(MOMENTS):
        left, right = (figure.axes[2 * number + side].get_position() for side in (0, 1))
        middle = (left.x0 + right.x1) / 2
        figure.text(middle, 1 - 0.06 / (height + 0.3), moment, ha="center", va="top", fontsize=11, color=FAINT)
    return figure


def in_order(grasps: Grasps, renderer: Renderer) -> Grasps:
    """Refuse by an `InputError` grasps of other joints than the renderer's hand, or in another order."""
    if grasps.joint_names != renderer.hand.joint_names:
        raise InputError(f"these grasps are of other joints than {renderer.hand.name}'s, or in another order")
    return grasps


def grid(rows: Sequence[Sequence[Image]], words: Sequence[str], size: tuple[float, float], rotation: int = 0) -> Any:
    """Lay pictures out in rows with words on their left."""
    figure = blank_figure(*size)
    axes = figure.subplots(len(rows), len(rows[0]), squeeze=False)
    for line, pictures, text in zip(axes, rows, words, strict=True):
        for place, picture in zip(line, pictures, strict=True):
            place.imshow(picture)
            place.set_axis_off()
        style = {"rotation": rotation, "ha": "right", "va": "center", "fontsize": 9, "color": INK}
        line[0].text(-0.03, 0.5, text, transform=line[0].transAxes, **style)
    return figure


_RATES: Mapping[str, tuple[str, str]] = {
    "held": ("#2a78d6", "-"),
    "faithful": ("#1c8a5a", "--"),
    "steady": ("#d9742b", ":"),
}
"""Colour and line of each rate."""


def draw_sweep(document: Mapping[str, Any]) -> Any:
    """Draw the rates of a sweep with their 95 % intervals, one panel for each condition.

    `document` is that of `studies.sweep.sweep_to_json`. Where matplotlib is missing it is an InputError.
    """
    conditions = document["conditions"]
    figure = blank_figure(4.2 * len(conditions) + 0.4, 3.4)
    for place, (name, about) in enumerate(conditions.items(), 1):
        axes = figure.add_subplot(1, len(conditions), place)
        rows = sorted((row for row in document["points"] if row["condition"] == name), key=lambda row: row["value"])
        values = [row["value"] for row in rows]
        for rate, (colour, line) in _RATES.items():
            of_rate = [row[rate] for row in rows]
            low, high = ([100 * one[end] for one in of_rate] for end in ("low", "high"))
            axes.fill_between(values, low, high, color=colour, alpha=0.15, linewidth=0)
            shares = [100 * one["rate"] for one in of_rate]
            axes.plot(values, shares, line, color=colour, marker="o", markersize=4, label=rate)
        if about["is_factor"] and len(values) > 1:
            axes.set_xscale("log")
            axes.set_xticks(values, [f"{value:g}" for value in values])
            axes.minorticks_off()
        axes.set_ylim(0, 102)
        axes.set_xlabel(textwrap.fill(about["label"], 40), color=INK, fontsize=9)
        axes.set_ylabel(f"% of {rows[0]['n']} trials", color=INK, fontsize=9)
        axes.tick_params(colors=INK, labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(axis="y", color=FAINT, alpha=0.25, linewidth=0.6)
    axes.legend(frameon=False, fontsize=8, loc="lower right")
    title = f"{document['model']} under protocol {document['protocol']['name']}"
    figure.suptitle(title, color=INK, fontsize=10)
    figure.tight_layout()
    return figure


def need_matplotlib() -> None:
    """Check that figures can be drawn, or raise an `InputError` that says what to install."""
    if find_spec("matplotlib") is None:
        raise InputError("pictures need matplotlib: install the extra 'view', in a checkout: pip install '.[view]'")


def blank_figure(width_inch: float, height_inch: float) -> Any:
    """Make an empty white figure that belongs to no window."""
    need_matplotlib()
    # Only those who draw wait for matplotlib to load.
    from matplotlib.figure import Figure

    return Figure(figsize=(width_inch, height_inch), facecolor="white")


def check_png(path: Path) -> None:
    """Refuse by an `InputError` a picture that is no .png file or has no folder, before the work of drawing it."""
    if path.suffix.lower() != ".png":
        raise InputError(f"a picture is a .png file, got {path.name!r}")
    if path.is_dir() or not path.parent.is_dir():
        raise InputError(f"{path} is a folder, or the folder {path.parent} does not exist")


def save_png(figure: Any, path: Path, dpi: int = 120) -> None:
    """Write a figure as a PNG of 256 colours, a fraction of the full file and hard to tell from it."""
    from PIL import Image

    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=dpi)
    image = Image.open(drawn).convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE)
    write_staged(path, lambda staged: image.save(staged, format="PNG", optimize=True))
