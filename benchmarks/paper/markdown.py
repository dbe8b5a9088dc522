"""Markdown tables, the wording of rates in them, and generated blocks of a page.

A generated block stands between two comments; text outside such blocks stays as it is::

    <!-- generated: name -->
    ...
    <!-- end -->
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from graspcascade.core.errors import check_name
from graspcascade.core.intervals import Difference, Interval
from graspcascade.studies.record import Evaluation, Tally

MISSING = "—"
"""Stands where there is no number."""
_BLOCK = re.compile(r"(<!-- generated: (\S+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
_HEADING = ("title", "description", "file_only")


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


def rates(evaluation: Evaluation) -> tuple[str, str, str]:
    """Word the number of trials of an evaluation, and its rates of held and of faithful ones."""
    return str(evaluation.n), rate(evaluation.held), rate(evaluation.faithful)


def pair(tally: Tally | None) -> str:
    """Word the rates of held and faithful trials in per cent: ``91.0 / 88.5``."""
    return MISSING if tally is None else f"{percent(tally.held_rate.rate)} / {percent(tally.faithful_rate.rate)}"


def pair_rows(evaluation: Evaluation) -> list[list[str]]:
    """Word the rates of every object and type (see `pair`): a row for each object, headed by its label."""
    cells = {(cell.object_label, cell.grasp_type): cell for cell in evaluation.cells}
    return [[label, *(pair(cells.get((label, kind))) for kind in evaluation.by_type)] for label in evaluation.by_object]


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


def spread(data: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Walk over an object's values, those of inner objects under ``outer.inner``."""
    for key, value in data.items():
        if isinstance(value, Mapping) and value.keys() != {"rate", "low", "high"}:
            yield from spread(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def measurement(stem: str, data: Mapping[str, Any], prior: str | None = None) -> str:
    """Write any JSON object of measurements as tables, named as in its file.

    `title` and `description` head the section, single values become one table, each list of objects a table of its own.
    What `file_only` names stays in the file and is counted.

    Args:
        stem: of the file.
        data: what the file holds.
        prior: the one behind the page's rates; a measurement with another one says so.
    """
    only = data.get("file_only", [])
    kept = "".join(f" It also holds {len(data[name])} {name}." for name in only)
    blocks = [f"## {data.get('title', stem)}", f"File `{stem}.json`.{kept}"]
    if prior is not None and data.get("prior", prior) != prior:
        blocks.append(f"Measured with another prior than the rates of the results page, which are of {prior}.")
    if "description" in data:
        blocks.append(str(data["description"]))
    values = list(spread({key: value for key, value in data.items() if key not in (*_HEADING, *only)}))
    single = [(name, plain(value)) for name, value in values if not _is_table(value)]
    if single:
        blocks.append(table(("quantity", "value"), single))
    for name, rows in values:
        if _is_table(rows):
            blocks += [f"{name}:", _row_table(rows)]
    return "\n\n".join(blocks)


def _row_table(rows: list[Mapping[str, Any]]) -> str:
    flat = [dict(spread(row)) for row in rows]
    columns = list(dict.fromkeys(name for row in flat for name in row))
    return table(columns, [[plain(row.get(name)) for name in columns] for row in flat])


def _is_table(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(row, Mapping) for row in value)


def fill_blocks(text: str, makers: Mapping[str, Callable[[], str]]) -> str:
    """Write the generated blocks of a page again, each by the maker of its name.

    Raises:
        InputError: no maker has the name of a block.
    """

    def block(match: re.Match[str]) -> str:
        begin, name, _, end = match.groups()
        check_name("generated block", name, makers)
        return f"{begin}\n{makers[name]()}\n\n{end}"

    return _BLOCK.sub(block, text)
