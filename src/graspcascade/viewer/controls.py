"""The widgets of one browser's panel; what they do is `page`'s business."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

from viser import (
    GuiApi,
    GuiButtonGroupHandle,
    GuiButtonHandle,
    GuiDropdownHandle,
    GuiHtmlHandle,
    GuiInputHandle,
    GuiNumberHandle,
    GuiSliderHandle,
)

from ..formats import FORMATS_BY_NAME
from ..objects import CATALOGUE, grasp_object
from ..taxonomy import GRASP_TYPES
from ..trials import Protocol
from .session import VIEWS, SampleRequest

Value = TypeVar("Value")
ANY_SIDE = "any"
SPEEDS = {"0.25 x": 0.25, "0.5 x": 0.5, "1 x": 1.0, "2 x": 2.0, "4 x": 4.0, "8 x": 8.0}
THIS, ALL = "this grasp", "all grasps"
PREVIOUS, NEXT = "previous", "next"
_VIEW_HINT = (
    "pregrasp: before closing; posture: what the joints are told to reach, their squeeze into the object included; "
    "settled: where closing ended in physics"
)


@dataclass(frozen=True)
class Controls:
    """Hold every widget that is read or written later."""

    grasp_type: GuiDropdownHandle[str]
    object_label: GuiDropdownHandle[str]
    side: GuiDropdownHandle[str]
    n: GuiNumberHandle[int]
    seed: GuiNumberHandle[int]
    sample: GuiButtonHandle
    message: GuiHtmlHandle
    grasp: GuiSliderHandle[int]
    flip: GuiButtonGroupHandle
    view: GuiDropdownHandle[str]
    about: GuiHtmlHandle
    friction: GuiNumberHandle[float]
    play: GuiButtonHandle
    stop: GuiButtonHandle
    try_all: GuiButtonHandle
    speed: GuiDropdownHandle[str]
    time: GuiSliderHandle[float]
    table: GuiHtmlHandle
    scope: GuiDropdownHandle[str]
    file_format: GuiDropdownHandle[str]
    download: GuiButtonHandle


def build(gui: GuiApi, request: SampleRequest, protocol: Protocol) -> Controls:
    """Lay the panel out, set to what was asked for."""
    message = gui.add_html("")
    with gui.add_folder("Sample"):
        grasp_type = gui.add_dropdown("type", tuple(GRASP_TYPES), initial_value=request.grasp_type)
        object_label = gui.add_dropdown("object", tuple(CATALOGUE), initial_value=request.object_label)
        side = gui.add_dropdown(
            "held by", side_choices(request.object_label), hint="Side that the opposing digits span"
        )
        n = gui.add_number("n", request.n, step=1, hint="How many grasps")
        seed = gui.add_number("seed", request.seed, step=1, hint="The same seed gives the same grasps")
        sample = gui.add_button("Sample", color="blue")
    with gui.add_folder("Grasp"):
        about = gui.add_html("")
        grasp = gui.add_slider("grasp", 0, max(request.n - 1, 1), 1, 0)
        flip = gui.add_button_group("flip", (PREVIOUS, NEXT))
        view = gui.add_dropdown("show", VIEWS, initial_value="posture", hint=_VIEW_HINT)
    with gui.add_folder("Physics trial"):
        friction = gui.add_number("friction", protocol.friction, step=0.1, hint="Sliding friction of hand and object")
        play, stop = gui.add_button("Play trial", color="teal"), gui.add_button("Stop", color="gray", visible=False)
        speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1 x")
        duration = round(protocol.total_steps * protocol.time_step_s, 2)
        time = gui.add_slider("time s", 0.0, duration, 0.02, 0.0, disabled=True, hint="Of the trial last played")
        try_all = gui.add_button("Try all", hint="Execute every grasp that was not tried yet")
    panel = gui.add_panel()
    with panel.add_tab("Samples"):
        table = gui.add_html("")
        with gui.add_folder("Download"):
            scope = gui.add_dropdown("what", (THIS, ALL), initial_value=ALL)
            file_format = gui.add_dropdown("format", tuple(FORMATS_BY_NAME))
            download = gui.add_button("Download")
    panel.float(x=15, y=-15, width=330)
    put(side, same_side(side.options, request.side_axis))
    return Controls(
        grasp_type=grasp_type,
        object_label=object_label,
        side=side,
        n=n,
        seed=seed,
        sample=sample,
        message=message,
        grasp=grasp,
        flip=flip,
        view=view,
        about=about,
        friction=friction,
        play=play,
        stop=stop,
        try_all=try_all,
        speed=speed,
        time=time,
        table=table,
        scope=scope,
        file_format=file_format,
        download=download,
    )


def put(widget: GuiInputHandle[Value], value: Value) -> None:
    """Write a value into a widget."""
    # viser defines the setter apart from the getter, where a type checker does not find it.
    widget.value = value  # type: ignore[misc]


def side_choices(object_label: str) -> tuple[str, ...]:
    """Word the sides an object can be held by, and the choice to draw among them."""
    sides = grasp_object(object_label).graspable_sides_m
    return (ANY_SIDE, *(f"{axis} = {side * 100:g} cm" for axis, side in sides.items()))


def side_axis(choice: str) -> str | None:
    """Read the axis off a choice of `side_choices`."""
    return None if choice == ANY_SIDE else choice[0]


def same_side(choices: Iterable[str], axis: str | None) -> str:
    """Find the choice of an axis among another object's, or any side where it has none such."""
    return next((choice for choice in choices if side_axis(choice) == axis), ANY_SIDE)


def request_of(controls: Controls) -> SampleRequest:
    """Read what the panel asks for, unchecked."""
    return SampleRequest(
        grasp_type=controls.grasp_type.value,
        object_label=controls.object_label.value,
        side_axis=side_axis(controls.side.value),
        n=controls.n.value,
        seed=controls.seed.value,
    )
