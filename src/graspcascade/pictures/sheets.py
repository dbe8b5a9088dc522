"""Sheets: grasps in three stages of their trial, and the catalogue."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..grasps import Grasps
from ..objects import CATALOGUE, GraspObject
from ..poses import Pose, canonical_quat
from ..trials import PAPER, Outcomes, Protocol, run
from .paper import FAINT, INK, blank_figure
from .studio import Image, Studio

STAGES: tuple[str, ...] = ("placed", "closed", "held")
"""The open hand about the object, the fingers closed, and the end of the trial."""
TYPES_ON: tuple[tuple[str, str], ...] = (
    ("tripod", "box_medium"),
    ("palmar_pinch", "box_medium"),
    ("parallel_extension", "box_large"),
    ("writing_tripod", "cylinder_small"),
    ("lateral_tripod", "cylinder_medium"),
    ("tip_pinch", "sphere_small"),
)
"""A grasp type and the object it is shown on."""

Sample = Callable[[str, str, int, int], Grasps]


@dataclass(frozen=True)
class Stages:
    """Hold what one trial looked like at `STAGES`; a trial that failed before a stage repeats what it reached.

    Attributes:
        posture: ``(3, J)`` joint angles, radians.
        X_hand_object: object poses in the hand frame, ``(3, 3)`` and ``(3, 4)``.
        verdict: what became of the trial.
        faithful: whether every digit of the type touched.
    """

    grasp: Grasps
    posture: NDArray[np.float64]
    X_hand_object: Pose
    verdict: str
    faithful: bool


def stages_of(grasps: Grasps, protocol: Protocol = PAPER, n_threads: int = 1) -> list[Stages]:
    """Execute grasps and keep each at its three stages."""
    last: dict[int, tuple[NDArray[Any], NDArray[Any]]] = {}

    def observe(rows: NDArray[Any], _: NDArray[Any], posture: NDArray[Any], pose: NDArray[Any]) -> None:
        for place, row in enumerate(rows.tolist()):
            if np.isfinite(posture[place]).all() and np.isfinite(pose[place]).all():
                last[row] = (posture[place].copy(), pose[place].copy())

    outcomes = run(grasps, protocol, n_threads=n_threads, observe=observe)
    return [_stages(grasps[row], outcomes[row], last.get(row)) for row in range(len(grasps))]


def _stages(grasp: Grasps, outcome: Outcomes, end: tuple[NDArray[Any], NDArray[Any]] | None) -> Stages:
    start, settled = grasp.X_hand_object, outcome.X_hand_object_settled
    postures = [grasp.pregrasp[0], outcome.settled_posture[0]]
    poses = [np.concatenate([p.position_m[0], p.quat_wxyz[0]]) for p in (start, settled)]
    if not np.isfinite(postures[1]).all():
        postures[1], poses[1] = (postures[0], poses[0]) if end is None else end
    final = (postures[1], poses[1]) if end is None else end
    rows = np.stack([*poses, final[1]])
    return Stages(
        grasp=grasp,
        posture=np.stack([*postures, final[0]]),
        X_hand_object=Pose(rows[:, :3], canonical_quat(rows[:, 3:])),
        verdict=str(outcome.verdict[0]),
        faithful=bool(outcome.faithful(grasp)[0]),
    )


def grasp_strip(studio: Studio, grasps: Grasps, protocol: Protocol = PAPER) -> Any:
    """Draw grasps in rows of three stages, whatever became of them."""
    found = stages_of(grasps, protocol)
    titles = [f"{i}: {one.grasp.side_axis[0]} {one.grasp.side_m[0] * 100:g} cm" for i, one in enumerate(found)]
    return _sheet([_shots(studio, one) for one in found], titles, [_verdict(one) for one in found])


def grasp_types_sheet(studio: Studio, sample: Sample, protocol: Protocol = PAPER, tries: int = 12) -> Any:
    """Draw each grasp type on an object in three stages: the first of some samples that held with every digit.

    Args:
        studio: where to draw.
        sample: gives grasps for a type, an object label, their number and a seed.
        protocol: the trial.
        tries: samples among which a held and faithful one is looked for.

    Raises:
        InputError: none of the samples of a type held with every digit.
    """
    chosen = [_good(sample(kind, label, tries, 0), protocol) for kind, label in TYPES_ON]
    titles = [f"{kind.replace('_', ' ')}\n{label.replace('_', ' ')}" for kind, label in TYPES_ON]
    return _columns([_shots(studio, one) for one in chosen], titles)


def _good(grasps: Grasps, protocol: Protocol) -> Stages:
    found = next((one for one in stages_of(grasps, protocol) if one.faithful), None)
    if found is None:
        raise InputError(
            f"none of {len(grasps)} {grasps.grasp_type[0]} grasps of {grasps.object_label[0]} was faithful"
        )
    return found


def objects_sheet(studio: Studio) -> Any:
    """Draw the catalogue at one scale with its sizes."""
    figure = blank_figure(7.2, 8.2)
    axes = figure.subplots(3, 3)
    for place, obj in zip(axes.flat, CATALOGUE.values(), strict=True):
        place.imshow(studio.object(obj.label))
        place.set_axis_off()
        place.set_title(obj.label, fontsize=11, color=INK, pad=2, family="monospace")
        place.text(0.5, -0.01, _sizes(obj), transform=place.transAxes, ha="center", va="top", fontsize=9, color=FAINT)
    figure.subplots_adjust(left=0.01, right=0.99, top=0.955, bottom=0.035, wspace=0.02, hspace=0.2)
    return figure


def _sizes(obj: GraspObject) -> str:
    return ", ".join(
        f"{axis} {side * 100:g} cm" + ("" if axis in obj.graspable_sides_m else " (too wide)")
        for axis, side in obj.sides_m.items()
    )


def _shots(studio: Studio, stages: Stages) -> list[Image]:
    grasp, pose = stages.grasp, stages.X_hand_object
    return [
        studio.grasp(
            str(grasp.object_label[0]),
            grasp.joint_names,
            stages.posture[row],
            Pose(pose.position_m[row], pose.quat_wxyz[row]),
        )
        for row in range(len(STAGES))
    ]


def _sheet(rows: Sequence[Sequence[Image]], titles: Sequence[str], notes: Sequence[str]) -> Any:
    """Lay one grasp a row."""
    figure = blank_figure(7.2, 2.4 * len(rows) + 0.3)
    axes = figure.subplots(len(rows), len(STAGES), squeeze=False)
    for line, shots, title, note in zip(axes, rows, titles, notes, strict=True):
        for place, shot in zip(line, shots, strict=True):
            place.imshow(shot)
            place.set_axis_off()
        at = line[0].transAxes
        line[0].text(-0.02, 0.5, f"{title}\n{note}", transform=at, ha="right", va="center", fontsize=9, color=INK)
    for place, stage in zip(axes[0], STAGES, strict=True):
        place.set_title(stage if stage != "held" else "end of trial", fontsize=10, color=FAINT, pad=3)
    top = 1 - 0.3 / (2.4 * len(rows) + 0.3)
    figure.subplots_adjust(left=0.17, right=0.995, top=top, bottom=0.005, wspace=0.02, hspace=0.02)
    return figure


def _columns(columns: Sequence[Sequence[Image]], titles: Sequence[str]) -> Any:
    """Lay one grasp a column, stages downwards."""
    figure = blank_figure(1.72 * len(columns) + 0.35, 6.75)
    axes = figure.subplots(len(STAGES), len(columns), squeeze=False)
    for line, stage, shots in zip(axes, STAGES, zip(*columns, strict=True), strict=True):
        for place, shot in zip(line, shots, strict=True):
            place.imshow(shot)
            place.set_axis_off()
        at = line[0].transAxes
        line[0].text(-0.03, 0.5, stage, transform=at, rotation=90, ha="right", va="center", fontsize=11, color=FAINT)
    for place, title in zip(axes[0], titles, strict=True):
        place.set_title(title, fontsize=10, color=INK, pad=4)
    figure.subplots_adjust(left=0.03, right=0.998, top=0.93, bottom=0.004, wspace=0.02, hspace=0.02)
    return figure


def _verdict(stages: Stages) -> str:
    word = stages.verdict.replace("_", " ")
    return f"{word}, faithful" if stages.faithful else word
