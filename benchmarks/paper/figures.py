"""Figures of the documentation: heat maps of rates, training curves, grasps, objects and hand frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.hands import load_hand
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.studies.record import Cell, Evaluation
from graspcascade.viewer.pictures import FAINT, INK, blank_figure, save_png

from .published import MAIN_MODELS
from .runs import StageCurves, TrainingCurves, read_results

_FRAMES_OBJECT, _FRAMES_SIDE, _FRAMES_PER_TYPE = "box_medium", "x", 12
_SETTLED_AFTER = 10
"""Axis limits ignore the first of so many parts of the epochs."""
_LINEAR_SPAN = 20
"""Losses that fall by more than this factor are shown on a logarithmic scale."""
_NAMES_SHOWN = 3


def evaluation_figures(results: Path, folder: Path) -> list[Path]:
    """Draw heat maps of the page's evaluations and of the models of Table I, and the training curves.

    Args:
        results: folder of the results page's JSON files.
        folder: where the pictures are written; made if needed.

    Returns:
        The files written.

    Raises:
        InputError: matplotlib is not installed, or the folder holds no evaluation.
        FileFormatError: a file is not JSON, foreign, or contradicts itself or another.
    """
    read = read_results(results)
    maps = {f"success_{entry.stem}": entry.evaluation for entry in read.same if entry.has_own_file}
    training: Sequence[TrainingCurves] = ()
    if read.paper is not None:
        training = read.paper.training
        runs = [read.paper.runs[name] for name in MAIN_MODELS if name in read.paper.runs]
        maps |= {f"success_paper_{run.model}": replace(run.pooled, model=run.title) for run in runs}
    folder.mkdir(parents=True, exist_ok=True)
    figures = {folder / f"{name}.png": partial(success_heat_map, evaluation) for name, evaluation in maps.items()}
    if training:
        figures[folder / "training_curves.png"] = partial(training_figure, training)
    for path, draw in figures.items():
        save_png(draw(), path)
    return list(figures)


def draw_pictures(folder: Path, model: str = "default") -> list[Path]:
    """Draw the grasp types, the objects and the sampled hand frames into a folder.

    Raises:
        InputError: matplotlib or an offscreen renderer is missing, or no such model.
    """
    from graspcascade.viewer.pictures import Renderer

    from .pictures import grasp_types_sheet, objects_sheet, pose_frames

    sampler = GraspSampler.load(model) if Path(model).is_dir() else GraspSampler.pretrained(model)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / name for name in ("grasp_types.png", "objects.png", "pose_frames.png")]
    hand = load_hand(sampler.hand.name)
    with Renderer(hand) as renderer:
        save_png(grasp_types_sheet(renderer, sampler), paths[0])
        save_png(objects_sheet(renderer), paths[1])
    batches = [sampler.sample(kind, _FRAMES_OBJECT, _FRAMES_SIDE, _FRAMES_PER_TYPE) for kind in GRASP_TYPES]
    save_png(pose_frames(batches, hand), paths[2])
    return paths


def success_heat_map(evaluation: Evaluation) -> Any:
    """Draw held and faithful rates of every object (rows) and type (columns)."""
    figure = blank_figure(9.6, 5.2)
    axes = figure.subplots(1, 2, sharey=True)
    for place, what, total in zip(axes, ("held", "faithful"), (evaluation.held, evaluation.faithful), strict=True):
        drawn = _panel(place, evaluation, what)
        place.set_title(
            f"{what}: {100 * total.rate:.1f} % ({100 * total.low:.1f} to {100 * total.high:.1f})",
            fontsize=11,
            color=INK,
            pad=8,
        )
    axes[0].set_yticks(range(len(evaluation.by_object)), evaluation.by_object, fontsize=9, color=INK)
    figure.suptitle(
        f"{evaluation.model} under protocol {evaluation.protocol.name}: % of {evaluation.per_cell} trials a cell",
        fontsize=12,
        color=INK,
    )
    figure.subplots_adjust(left=0.13, right=0.91, top=0.85, bottom=0.21, wspace=0.05)
    bar = figure.colorbar(drawn, ax=axes, cax=figure.add_axes((0.93, 0.21, 0.015, 0.64)))
    bar.ax.tick_params(labelsize=8, colors=FAINT)
    bar.outline.set_visible(False)
    return figure


def _panel(place: Any, evaluation: Evaluation, what: str) -> Any:
    rates = _percent(evaluation, what)
    drawn = place.imshow(rates, vmin=0, vmax=100, cmap="viridis", aspect="auto")
    for row, column in np.ndindex(*rates.shape):
        rate = rates[row, column]
        if np.isfinite(rate):
            ink = "white" if rate < 60 else "black"
            place.text(column, row, f"{rate:.0f}", ha="center", va="center", fontsize=9, color=ink)
    names = [name.replace("_", " ") for name in evaluation.by_type]
    place.set_xticks(range(len(names)), names, rotation=35, ha="right", fontsize=9, color=INK)
    place.tick_params(length=0)
    place.spines[:].set_visible(False)
    return drawn


def _percent(evaluation: Evaluation, what: str) -> NDArray[np.float64]:
    """Arrange rates in percent as objects by types, NaN where a cell was not evaluated."""
    cells: dict[tuple[str, str], Cell] = {(cell.object_label, cell.grasp_type): cell for cell in evaluation.cells}
    rates = np.full((len(evaluation.by_object), len(evaluation.by_type)), np.nan)
    for row, label in enumerate(evaluation.by_object):
        for column, kind in enumerate(evaluation.by_type):
            cell = cells.get((label, kind))
            if cell is not None:
                rates[row, column] = 100 * (cell.held if what == "held" else cell.faithful) / cell.n
    return rates


def training_figure(training: Sequence[TrainingCurves]) -> Any:
    """Draw the loss of every stage by epoch, one panel a stage: of held-out rows solid, of the training rows dotted.

    Runs whose curves are the same, such as the posture stages of cascades that differ later, share one line.
    """
    panels: dict[str, dict[StageCurves, list[str]]] = {}
    for curves in training:
        for stage, values in curves.stages.items():
            panels.setdefault(curves.panel(stage), {}).setdefault(values, []).append(curves.model)
    colours = {name: f"C{number % 10}" for number, name in enumerate(dict.fromkeys(c.model for c in training))}
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    height = 1.2 + 3.0 * rows
    figure = blank_figure(9.6, height)
    for number, (title, lines) in enumerate(panels.items()):
        _curve_panel(figure.add_subplot(rows, columns, number + 1), title, lines, colours)
    figure.suptitle("Training: loss of held-out rows (solid) and of training rows (dotted)", fontsize=12, color=INK)
    keys = [figure.axes[0].plot([], [], color=colour, label=name)[0] for name, colour in colours.items()]
    # The legend has the foot of the figure to itself: in a panel it would cover curves.
    figure.legend(handles=keys, loc="lower center", ncols=5, fontsize=9, frameon=False, labelcolor=INK)
    figure.tight_layout(rect=(0, 0.6 / height, 1, 1))
    return figure


def _curve_panel(
    place: Any, title: str, lines: Mapping[StageCurves, Sequence[str]], colours: Mapping[str, str]
) -> None:
    sharing: dict[str, list[str]] = {}
    for values, models in lines.items():
        sharing.setdefault(models[0], []).extend(models)
        style = {"color": colours[models[0]], "linewidth": 1.1}
        place.plot(values.epoch, _held_out(values), **style)
        place.plot(values.epoch, values.train_loss, linestyle=":", **style)
    shared = [_shared_line(list(dict.fromkeys(models))) for models in sharing.values() if len(set(models)) > 1]
    if shared:
        style = {"transform": place.transAxes, "ha": "right", "va": "top", "fontsize": 8, "color": FAINT}
        # Curves fall from the upper left and may pass behind.
        behind = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5}
        place.text(0.98, 0.97, "\n".join(shared), bbox=behind, **style)
    _scale(place, list(lines))
    place.set_title(title, fontsize=11, color=INK)
    place.set_xlabel("epoch", fontsize=9, color=FAINT)
    place.tick_params(labelsize=8, colors=FAINT)
    place.spines[["top", "right"]].set_visible(False)
    place.spines[["left", "bottom"]].set_color(FAINT)


def _held_out(values: StageCurves) -> list[float]:
    return [np.nan if value is None else value for value in values.validation_loss]


def _scale(place: Any, lines: Sequence[StageCurves]) -> None:
    """Fit the scale to all but the first epochs, which fall by far more than what follows and would flatten it."""
    curves = [curve for values in lines for curve in (values.train_loss, _held_out(values))]
    settled = np.concatenate([curve[len(curve) // _SETTLED_AFTER :] for curve in curves])
    low, high = np.nanmin(settled), np.nanmax(settled)
    if 0 < _LINEAR_SPAN * low < high:
        place.set_yscale("log")
        place.yaxis.set_major_formatter("{x:g}")
        place.set_ylim(low / 1.3, high * 1.3)
    else:
        margin = 0.05 * (high - low) or 0.5
        place.set_ylim(low - margin, high + margin)


def _shared_line(names: Sequence[str]) -> str:
    """Say which models a line stands for, by name as long as they are few."""
    others = ", ".join(names[1:]) if len(names) <= _NAMES_SHOWN else f"{len(names) - 1} more models"
    return f"{names[0]}: the same for {others}"
