"""Sheets: grasps at three moments of their trial."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...core.errors import InputError
from ...core.grasps import Grasps
from ...core.protocols import PAPER, Protocol
from ..recording import Frame, Recording, record
from .paper import FAINT, INK, blank_figure
from .render import FINGER_SIDE, THUMB_SIDE, Image, Renderer

MOMENTS: tuple[str, ...] = ("placed", "closed", "end of trial")
"""The open hand about the object, the fingers closed, and what became of it."""


def moments(recording: Recording) -> tuple[Frame, ...]:
    """Choose the frames of `MOMENTS`; a trial that ended before one repeats its end."""
    return recording.frame(0), recording.frame(recording.closed_row), recording.frame(-1)


def grasp_strip(renderer: Renderer, grasps: Grasps, protocol: Protocol = PAPER) -> Any:
    """Draw grasps in rows of three moments, each from two sides, whatever became of them.

    Raises:
        InputError: the grasps' joints are not those of the renderer's hand.
    """
    recordings = record(in_order(grasps, renderer), renderer.hand, protocol)
    views = (THUMB_SIDE, FINGER_SIDE)
    rows = [[renderer.frame(frame, view) for frame in moments(one) for view in views] for one in recordings]
    words = [_words(index, grasps[index], one) for index, one in enumerate(recordings)]
    height = 1.9 * len(rows)
    figure = grid(rows, words, (11.0, height + 0.3))
    figure.subplots_adjust(left=0.12, right=0.998, top=height / (height + 0.3), bottom=0.0, wspace=0.0, hspace=0.0)
    for number, moment in enumerate(MOMENTS):
        left, right = (figure.axes[2 * number + side].get_position() for side in (0, 1))
        middle = (left.x0 + right.x1) / 2
        figure.text(middle, 1 - 0.06 / (height + 0.3), moment, ha="center", va="top", fontsize=11, color=FAINT)
    return figure


def in_order(grasps: Grasps, renderer: Renderer) -> Grasps:
    """Check that grasps are of the joints of the renderer's hand, in order."""
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


def _words(index: int, grasp: Grasps, recording: Recording) -> str:
    task = grasp.tasks.distinct[0]
    verdict = str(recording.outcome.verdict[0]).replace("_", " ")
    faithful = ",\nfaithful" if recording.outcome.faithful(grasp)[0] else ""
    return f"{index}: {task.site.name} {task.site.width_m * 100:g} cm\n{verdict}{faithful}"
