"""Heat maps of success rates and training curves, drawn from the JSON of the results page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..evaluation.record import Cell, Evaluation
from ..pictures.paper import FAINT, INK, blank_figure, save_png
from .curves import StageCurves, TrainingCurves
from .entries import read_results
from .gallery import TRAINING_CURVES, pooled_heat_map_name
from .paper_runs import PAPER_FOLDER, read_paper_runs
from .published import MAIN_MODELS

_SETTLED_AFTER = 10
"""A scale is that of the losses after one in so many of the epochs."""
_LINEAR_SPAN = 20
"""Losses that fall by more than this factor are shown on a logarithmic scale."""
_NAMES_SHOWN = 3


def heat_maps(results_dir: Path | str, folder: Path | str) -> list[Path]:
    """Draw one heat map for each evaluation under the page's conditions that has a file of its own.

    Args:
        results_dir: folder of the JSON files.
        folder: where ``success_<file stem>.png`` are written; made if needed.

    Returns:
        The files written, by name.

    Raises:
        InputError: matplotlib is not installed, or the folder holds no evaluation.
        FileFormatError: a file is not JSON, or an evaluation that contradicts itself.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for entry in read_results(results_dir).same:
        if entry.has_own_file:
            written.append(folder / entry.heat_map)
            save_png(success_heat_map(entry.evaluation), written[-1])
    return written


def paper_figures(results_dir: Path | str, folder: Path | str) -> list[Path]:
    """Draw what belongs to the paper's experiment: heat maps of the models of Table I, and all training curves.

    Args:
        results_dir: folder of the results page's JSON files, of which the experiment's is a part.
        folder: where the pictures are written; made if needed.

    Returns:
        The files written, none without such an experiment.

    Raises:
        InputError: matplotlib is not installed.
        FileFormatError: a file of the experiment is foreign or contradicts another (see `read_paper_runs`).
    """
    found = read_paper_runs(Path(results_dir) / PAPER_FOLDER)
    if found is None:
        return []
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name in MAIN_MODELS:
        if name in found.runs:
            runs = found.runs[name]
            written.append(folder / pooled_heat_map_name(name))
            save_png(success_heat_map(replace(runs.pooled, model=runs.title)), written[-1])
    if found.training:
        written.append(folder / TRAINING_CURVES)
        save_png(training_figure(found.training), written[-1])
    return written


def success_heat_map(found: Evaluation) -> Any:
    """Draw held and faithful rates of every object (rows) and type (columns)."""
    figure = blank_figure(9.6, 5.2)
    axes = figure.subplots(1, 2, sharey=True)
    for place, what, total in zip(axes, ("held", "faithful"), (found.held, found.faithful), strict=True):
        drawn = _panel(place, found, what)
        place.set_title(
            f"{what}: {100 * total.rate:.1f} % ({100 * total.low:.1f} to {100 * total.high:.1f})",
            fontsize=11,
            color=INK,
            pad=8,
        )
    axes[0].set_yticks(range(len(found.by_object)), found.by_object, fontsize=9, color=INK)
    figure.suptitle(
        f"{found.model} under protocol {found.protocol.name}: % of {found.per_cell} trials a cell",
        fontsize=12,
        color=INK,
    )
    figure.subplots_adjust(left=0.13, right=0.91, top=0.85, bottom=0.21, wspace=0.05)
    bar = figure.colorbar(drawn, ax=axes, cax=figure.add_axes((0.93, 0.21, 0.015, 0.64)))
    bar.ax.tick_params(labelsize=8, colors=FAINT)
    bar.outline.set_visible(False)
    return figure


def _panel(place: Any, found: Evaluation, what: str) -> Any:
    rates = _percent(found, what)
    drawn = place.imshow(rates, vmin=0, vmax=100, cmap="viridis", aspect="auto")
    for row, column in np.ndindex(*rates.shape):
        rate = rates[row, column]
        if np.isfinite(rate):
            ink = "white" if rate < 60 else "black"
            place.text(column, row, f"{rate:.0f}", ha="center", va="center", fontsize=9, color=ink)
    names = [name.replace("_", " ") for name in found.by_type]
    place.set_xticks(range(len(names)), names, rotation=35, ha="right", fontsize=9, color=INK)
    place.tick_params(length=0)
    place.spines[:].set_visible(False)
    return drawn


def _percent(found: Evaluation, what: str) -> NDArray[np.float64]:
    """Arrange rates in percent as objects by types, NaN where a cell was not evaluated."""
    cells: dict[tuple[str, str], Cell] = {(cell.object_label, cell.grasp_type): cell for cell in found.cells}
    rates = np.full((len(found.by_object), len(found.by_type)), np.nan)
    for row, label in enumerate(found.by_object):
        for column, kind in enumerate(found.by_type):
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
