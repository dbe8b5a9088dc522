"""Pictures of the documentation: the grasp types, the objects, and sampled hand frames (the paper's figure 5)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import CATALOGUE, GraspObject, as_object
from graspcascade.core.poses import Pose, quat_to_matrix
from graspcascade.core.protocols import PAPER, Protocol
from graspcascade.core.taxonomy import as_type
from graspcascade.hands import Hand
from graspcascade.proposals import Proposal
from graspcascade.viewer.pictures import FAINT, INK, MOMENTS, Renderer, blank_figure, grid, in_order, moments
from graspcascade.viewer.recording import record

TYPES_ON: tuple[tuple[str, str], ...] = (
    ("tripod", "box_medium"),
    ("palmar_pinch", "box_medium"),
    ("parallel_extension", "box_large"),
    ("writing_tripod", "cylinder_small"),
    ("lateral_tripod", "cylinder_medium"),
    ("tip_pinch", "sphere_small"),
)
"""A grasp type and the object it is shown on."""


Array = NDArray[np.float64]

_AXIS_COLOURS = ("#c62828", "#2e7d32", "#1565c0")
_OBJECT, _OPPOSITION = "#d2691e", "#6a1b9a"
_OTHER_DIGITS, _OPPOSING_DIGITS = "#dfe2e6", "#a9b0b8"
_ARROW_M = 0.018
_FOCUS_M = (-0.020, -0.011, 0.028)
"""Middle of every panel: hands come from the left, so that they need more room there."""
_REACH_M = 0.112
_ELEVATION_DEG, _AZIMUTH_DEG = 18.0, -62.0
_TOWARDS_VIEWER = np.array(
    [
        np.cos(np.radians(_ELEVATION_DEG)) * np.cos(np.radians(_AZIMUTH_DEG)),
        np.cos(np.radians(_ELEVATION_DEG)) * np.sin(np.radians(_AZIMUTH_DEG)),
        np.sin(np.radians(_ELEVATION_DEG)),
    ]
)
_UP = np.array([0.0, 0.0, 1.0])


def pose_frames(grasps: Sequence[Grasps], hand: Hand) -> Any:
    """Draw the hand frames of one batch a panel, in the object's frame: x red, y green, z (along the fingers) blue.

    One hand of each batch is a grey stick figure in its commanded posture, which squeezes into the object; its opposing
    digits are darker, and the opposition axis is dashed.

    Args:
        grasps: batches, each of one type and one object.
        hand: the hand that they are of.
    """
    columns = 3
    rows = -(-len(grasps) // columns)
    figure = blank_figure(9.6, 3.3 * rows)
    for number, batch in enumerate(grasps):
        axes = figure.add_subplot(rows, columns, number + 1, projection="3d")
        _panel(axes, batch, hand)
    figure.subplots_adjust(left=0.0, right=1.0, top=0.95, bottom=0.02, wspace=0.0, hspace=0.1)
    return figure


def _panel(axes: Any, batch: Grasps, hand: Hand) -> None:
    obj = batch.tasks.distinct[0].object
    X_object_hand = batch.hand_pose(Pose.of([0, 0, 0], [1, 0, 0, 0]))
    turned = quat_to_matrix(X_object_hand.quat_wxyz)
    _draw_hand(axes, batch, hand, X_object_hand, _best_seen(turned))
    for edge in _edges(obj.extents_m):
        axes.plot(*edge.T, color=_OBJECT, linewidth=1.4)
    origin = X_object_hand.position_m
    for axis, colour in enumerate(_AXIS_COLOURS):
        arrows = turned[:, :, axis].T * _ARROW_M
        axes.quiver(*origin.T, *arrows, color=colour, linewidth=0.8, arrow_length_ratio=0.25)
    for set_limits, focus in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), _FOCUS_M, strict=True):
        set_limits(focus - _REACH_M, focus + _REACH_M)
    axes.set_box_aspect((1, 1, 1), zoom=1.5)
    axes.set_proj_type("ortho")
    axes.view_init(elev=_ELEVATION_DEG, azim=_AZIMUTH_DEG)
    axes.set_axis_off()
    axes.set_title(str(batch.grasp_type[0]).replace("_", " "), fontsize=12, color=INK, pad=-2)
    words = f"{obj.name}, {len(batch)} samples"
    axes.text2D(0.5, 0.01, words, transform=axes.transAxes, ha="center", fontsize=8, color=FAINT)


def _best_seen(turned: Array) -> int:
    """Choose the hand that is best seen: fingers pointing down the picture, palm turned aside."""
    fingers_down = -turned[:, :, 2] @ _UP
    palm_aside = 1.0 - np.abs(turned[:, :, 1] @ _TOWARDS_VIEWER)
    fingers_aside = 1.0 - np.abs(turned[:, :, 2] @ _TOWARDS_VIEWER)
    return int(np.argmax(fingers_down + palm_aside + fingers_aside))


def _draw_hand(axes: Any, batch: Grasps, hand: Hand, X_object_hand: Pose, row: int) -> None:
    kind = as_type(str(batch.grasp_type[row]))
    posture = hand.executed(batch.posture[row : row + 1])
    place = Pose(X_object_hand.position_m[row : row + 1], X_object_hand.quat_wxyz[row : row + 1])
    opposing = {name.partition("_")[0] for name in kind.opposition}
    for digit, segment in _segments(hand, posture):
        darker = digit in opposing
        colour = _OPPOSING_DIGITS if darker else _OTHER_DIGITS
        axes.plot(*place.apply(segment).T, color=colour, linewidth=4.5, solid_capstyle="round", zorder=1 + darker)
    ends = np.concatenate([place.apply(point) for point in hand.opposition(batch.posture[row : row + 1], kind)])
    direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    centre = ends.mean(axis=0)
    axis = np.stack([centre - 0.05 * direction, centre + 0.05 * direction])
    axes.plot(*axis.T, color=_OPPOSITION, linewidth=1.2, linestyle=(0, (4, 2)), zorder=5)
    axes.scatter(*ends.T, color=_OPPOSITION, s=12, depthshade=False, zorder=6)


def _segments(hand: Hand, posture: Array) -> Iterator[tuple[str, Array]]:
    """Walk over the hand's links as segments ``(2, 3)`` in the hand frame, each with its digit ("" for the palm)."""
    frames = hand.frames(posture)
    parents = {link.name: link.parent for link in hand.kinematics.links}
    for digit, tip in hand.tips(posture, list(hand.digits)).items():
        body: str | None = hand.digits[digit].tip_body
        end = tip[0]
        while body is not None:
            start = frames[body][1][0]
            yield digit if parents[body] else "", np.stack([start, end])
            body, end = parents[body], start


def _edges(extents_m: tuple[float, float, float]) -> list[Any]:
    corners = np.array(list(product(*((-e / 2, e / 2) for e in extents_m))))
    return [np.stack(pair) for pair in combinations(corners, 2) if np.count_nonzero(pair[0] != pair[1]) == 1]


def grasp_types_sheet(renderer: Renderer, proposal: Proposal, protocol: Protocol = PAPER, tries: int = 12) -> Any:
    """Draw each grasp type on an object at three moments: the first of some grasps that held with every digit.

    Args:
        renderer: what draws.
        proposal: where grasps come from.
        protocol: the trial.
        tries: grasps among which a held and faithful one is looked for.

    Raises:
        InputError: none of the grasps of a type held with every digit.
    """
    chosen = []
    for kind, obj in TYPES_ON:
        grasps = proposal.propose_any_side(as_object(obj), as_type(kind), tries, np.random.default_rng(0))
        recordings = record(in_order(grasps, renderer), renderer.hand, protocol)
        faithful = [one for row, one in enumerate(recordings) if one.outcome.faithful(grasps[row])[0]]
        if not faithful:
            raise InputError(f"none of {tries} {kind} grasps of {obj} was faithful")
        chosen.append([renderer.frame(frame) for frame in moments(faithful[0])])
    rows = list(zip(*chosen, strict=True))
    figure = grid(rows, MOMENTS, (1.72 * len(chosen) + 0.35, 6.75), rotation=90)
    for place, (kind, obj) in zip(figure.axes, TYPES_ON, strict=False):
        place.set_title(f"{kind}\n{obj}".replace("_", " "), fontsize=10, color=INK, pad=4)
    figure.subplots_adjust(left=0.03, right=0.998, top=0.93, bottom=0.004, wspace=0.02, hspace=0.02)
    return figure


def objects_sheet(renderer: Renderer) -> Any:
    """Draw the catalogue at one scale with its sizes."""
    figure = blank_figure(7.2, 8.2)
    axes = figure.subplots(3, 3)
    for place, obj in zip(axes.flat, CATALOGUE.values(), strict=True):
        place.imshow(renderer.object(obj))
        place.set_axis_off()
        place.set_title(obj.name, fontsize=11, color=INK, pad=2, family="monospace")
        sizes = _sizes(obj, renderer.hand.reach_m)
        place.text(0.5, -0.01, sizes, transform=place.transAxes, ha="center", va="top", fontsize=9, color=FAINT)
    figure.subplots_adjust(left=0.01, right=0.99, top=0.955, bottom=0.035, wspace=0.02, hspace=0.2)
    return figure


def _sizes(obj: GraspObject, reach_m: float) -> str:
    return ", ".join(
        f"{axis} {side * 100:g} cm" + ("" if axis in obj.sites(reach_m) else " (too wide)")
        for axis, side in obj.sides_m.items()
    )
