"""Heat maps of success rates, drawn from an evaluation's JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..pictures.paper import FAINT, INK, blank_figure, save_png
from .files import read_json
from .record import Cell, Evaluation, is_evaluation
from .results_page import HEURISTIC


def heat_maps(results_dir: Path | str, folder: Path | str) -> list[Path]:
    """Draw one heat map for each evaluation, of those in a folder of JSON files, under the page's protocol.

    Args:
        results_dir: folder of the JSON files.
        folder: where ``success_<file stem>.png`` are written; made if needed.

    Returns:
        The files written, by name.

    Raises:
        InputError: matplotlib is not installed.
        FileFormatError: a file is not JSON, or an evaluation that contradicts itself.
    """
    paths = sorted(Path(results_dir).glob("*.json"), key=lambda path: (path.stem != HEURISTIC, path.stem))
    found = {path.stem: Evaluation.load(path) for path in paths if is_evaluation(read_json(path))}
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for stem, evaluation in found.items():
        if evaluation.protocol == next(iter(found.values())).protocol:
            written.append(folder / f"success_{stem}.png")
            save_png(success_heat_map(evaluation), written[-1])
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
