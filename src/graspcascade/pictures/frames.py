"""Where a sampler puts the hand: sampled hand frames about an object, one panel a type."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product
from typing import Any

import numpy as np

from ..grasps import Grasps
from ..objects import grasp_object
from ..poses import Pose, quat_to_matrix
from .paper import FAINT, INK, blank_figure

_COLOURS = ("#c62828", "#2e7d32", "#1565c0")
_ARROW_M = 0.028
_REACH_M = 0.13


def pose_frames(grasps: Sequence[Grasps]) -> Any:
    """Draw the hand frames of one batch a panel, in the object's frame: x red, y green, z (along the fingers) blue."""
    columns = 3
    rows = -(-len(grasps) // columns)
    figure = blank_figure(9.6, 3.3 * rows)
    for number, batch in enumerate(grasps):
        axes = figure.add_subplot(rows, columns, number + 1, projection="3d")
        _panel(axes, batch)
    figure.subplots_adjust(left=0.0, right=1.0, top=0.96, bottom=0.02, wspace=0.0, hspace=0.1)
    return figure


def _panel(axes: Any, batch: Grasps) -> None:
    label = str(batch.object_label[0])
    for edge in _edges(grasp_object(label).extents_m):
        axes.plot(*edge.T, color="#d2691e", linewidth=1.2)
    hands = batch.hand_pose(Pose.of([0, 0, 0], [1, 0, 0, 0]))
    origin, turned = hands.position_m, quat_to_matrix(hands.quat_wxyz)
    for axis, colour in enumerate(_COLOURS):
        axes.quiver(*origin.T, *(turned[:, :, axis].T * _ARROW_M), color=colour, linewidth=0.7, arrow_length_ratio=0.0)
    axes.set(xlim=(-_REACH_M, _REACH_M), ylim=(-_REACH_M, _REACH_M), zlim=(-_REACH_M, _REACH_M))
    axes.set_box_aspect((1, 1, 1), zoom=1.35)
    axes.view_init(elev=22, azim=-58)
    axes.set_axis_off()
    title = str(batch.grasp_type[0]).replace("_", " ")
    axes.set_title(title, fontsize=11, color=INK, pad=-2)
    axes.text2D(
        0.5, 0.01, f"{label}, {len(batch)} samples", transform=axes.transAxes, ha="center", fontsize=8, color=FAINT
    )


def _edges(extents_m: tuple[float, float, float]) -> list[Any]:
    corners = np.array(list(product(*((-e / 2, e / 2) for e in extents_m))))
    return [np.stack(pair) for pair in combinations(corners, 2) if np.count_nonzero(pair[0] != pair[1]) == 1]
