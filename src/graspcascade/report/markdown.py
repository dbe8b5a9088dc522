"""Markdown tables and the wording of rates in them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ..evaluation.record import Evaluation, Tally
from ..intervals import Difference, Interval

MISSING = "—"
"""Stands where there is no number."""


def table(header: Sequence[str], rows: Iterable[Sequence[str]], *, text_columns: int = 1) -> str:
    """Write a table whose first columns are text and whose others are numbers, aligned right."""
    rule = ["---" if column < text_columns else "---:" for column in range(len(header))]
    escaped = [[cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in [list(header), rule, *escaped])


def percent(share: float, decimals: int = 1) -> str:
    """Word a share in per cent; NaN is a dash."""
    return MISSING if math.isnan(share) else f"{100 * share:.{decimals}f}"


def rate(interval: Interval, decimals: int = 1) -> str:
    """Word a rate and its interval: ``46.0 % [43.1, 48.9]``."""
    if math.isnan(interval.rate):
        return MISSING
    value, low, high = (percent(share, decimals) for share in (interval.rate, interval.low, interval.high))
    return f"{value} % [{low}, {high}]"


def points(difference: Difference) -> str:
    """Word a difference in percentage points and its interval: ``+12.5 [+8.1, +16.8]``."""
    if math.isnan(difference.difference):
        return MISSING
    value, low, high = (f"{100 * x:+.1f}" for x in (difference.difference, difference.low, difference.high))
    return f"{value} [{low}, {high}]"


def rates(found: Evaluation) -> tuple[str, str, str]:
    """Word the number of trials of an evaluation, and its rates of held and of faithful ones."""
    return str(found.n), rate(found.held), rate(found.faithful)


def pair(tally: Tally | None) -> str:
    """Word the rates of held and faithful trials in per cent: ``91.0 / 88.5``."""
    return MISSING if tally is None else f"{percent(tally.held_rate.rate)} / {percent(tally.faithful_rate.rate)}"


def pair_rows(found: Evaluation) -> list[list[str]]:
    """Word the rates of every object and type (see `pair`): a row for each object, headed by its label."""
    cells = {(cell.object_label, cell.grasp_type): cell for cell in found.cells}
    return [[label, *(pair(cells.get((label, kind))) for kind in found.by_type)] for label in found.by_object]


def over(tally: Tally, base: Tally) -> tuple[str, str]:
    """Word by how many points the rates of held and of faithful trials are above others."""
    return points(tally.held_over(base)), points(tally.faithful_over(base))


def widest(tallies: Iterable[Tally]) -> str:
    """Word how far the widest interval of the rates reaches to either side of its middle, in points."""
    intervals = [interval for tally in tallies for interval in (tally.held_rate, tally.faithful_rate)]
    return percent(max((interval.high - interval.low) / 2 for interval in intervals))


def plain(value: Any) -> str:
    """Word a JSON value; rates with their intervals as `rate` does, two decimals within 1 % of none or all."""
    if isinstance(value, Mapping) and value.keys() == {"rate", "low", "high"}:
        known = {key: math.nan if number is None else float(number) for key, number in value.items()}
        return rate(Interval(**known), 1 if 0.01 < known["rate"] < 0.99 else 2)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return MISSING
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return ", ".join(plain(item) for item in value)
    return str(value)
