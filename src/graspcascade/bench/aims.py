"""What the project asks of its speed, beside what was measured: a table of the performance page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..files import read_json
from ..report.markdown import MISSING, plain, table

_BENCH = "performance/bench.json"
_SCALING = "performance/collection_scaling.json"
_AGREEMENT = "verdict_agreement.json"
_HEURISTIC, _CASCADE, _ABRIDGED = "heuristic, screened", "model3", "abridged as in a collection"
_ENDS = {"median": ("min", "max"), "rate": ("low", "high")}
"""What a figure's range is named beside it."""


@dataclass(frozen=True)
class Aim:
    """Say what is asked of one figure.

    Attributes:
        what: is measured.
        limit: it may reach.
        unit: of the limit, "%" for a share.
        file: of the measurement, in the folder of results.
        path: of the figure in the file. A mapping as a step picks the one row of a list with such entries, a negative
            number a row from its end.
        at_least: the figure must not be below the limit; else it must not be above.
    """

    what: str
    limit: float
    unit: str
    file: str
    path: tuple[str | int | Mapping[str, str], ...]
    at_least: bool = False


def _agreement(grasps: str, figure: str) -> tuple[str | Mapping[str, str], ...]:
    return "comparisons", {"grasps": grasps, "executed": _ABRIDGED}, figure, "rate"


@dataclass(frozen=True)
class Figure:
    """Hold what was measured, in the unit of its aim.

    Attributes:
        value: the median of repetitions, or the rate.
        low: the least repetition, or the interval's lower end; None where it was measured once.
        high: the greatest, or the upper end.
        extrapolated: it was measured in part.
    """

    value: float
    low: float | None = None
    high: float | None = None
    extrapolated: bool = False


AIMS = (
    Aim("collection, trials a second", 75, "", _BENCH, ("collection", "trials_per_s", "median"), True),
    Aim("collection, gain", 3, "", _BENCH, ("collection", "gain", "median"), True),
    Aim("evaluation, gain", 1.5, "", _BENCH, ("evaluation", "gain", "median"), True),
    Aim("peak memory of the largest collection", 2000, "MB", _SCALING, ("runs", -1, "peak_rss_mb")),
    Aim("1,000 grasps", 10, "ms", _BENCH, ("sampling", "ms", "median")),
    Aim("`graspcascade sample`, cold", 0.7, "s", _BENCH, ("cold_start", "s", "median")),
    Aim("training of a cascade", 300, "s", _BENCH, ("training", "s")),
    Aim("abridged verdicts that agree, heuristic", 99.5, "%", _AGREEMENT, _agreement(_HEURISTIC, "agreement"), True),
    Aim("abridged verdicts that agree, Model 3", 99.5, "%", _AGREEMENT, _agreement(_CASCADE, "agreement"), True),
    Aim("false successes, heuristic", 0.3, "%", _AGREEMENT, _agreement(_HEURISTIC, "false_successes")),
    Aim("false successes, Model 3", 0.3, "%", _AGREEMENT, _agreement(_CASCADE, "false_successes")),
)
"""What is asked on two processors."""


def aims_table(results: Path) -> str:
    """Write the table from the JSON files of a folder of results; what is not there is not measured.

    Raises:
        FileFormatError: a file is not JSON.
    """
    rows = []
    for aim in AIMS:
        found = measured(results, aim)
        words = f"{'at least' if aim.at_least else 'at most'} {_words(aim.limit, aim.unit)}"
        if found is None:
            rows.append([aim.what, words, "not measured", MISSING, MISSING])
        else:
            value = _words(found.value, aim.unit) + (", extrapolated" if found.extrapolated else "")
            rows.append([aim.what, words, value, _span(found, aim.unit), _met(aim, found)])
    return table(("what", "asked", "measured", "from, to", "met"), rows)


def measured(results: Path, aim: Aim) -> Figure | None:
    """Look up an aim's figure, in its unit; None where it was not measured.

    Raises:
        FileFormatError: the file is not JSON.
    """
    path = results / aim.file
    if not path.is_file():
        return None
    found: Any = read_json(path)
    around: Any = {}
    for step in aim.path:
        try:
            around, found = found, _picked(found, step) if isinstance(step, Mapping) else found[step]
        except (KeyError, IndexError):
            return None
    scale = 100.0 if aim.unit == "%" else 1.0
    ends = _ENDS.get(str(aim.path[-1]), ())
    low, high = (scale * float(around[end]) for end in ends) if ends else (None, None)
    return Figure(scale * float(found), low, high, bool(around.get("extrapolated", False)))


def _picked(rows: list[dict[str, Any]], entries: Mapping[str, str]) -> dict[str, Any]:
    matching = [row for row in rows if entries.items() <= row.items()]
    return matching[0]


def _met(aim: Aim, found: Figure) -> str:
    def reaches(value: float) -> bool:
        return value >= aim.limit if aim.at_least else value <= aim.limit

    if not reaches(found.value):
        return "**no**"
    whole = all(reaches(end) for end in (found.low, found.high) if end is not None)
    return "yes" if whole else "yes, though not over the whole range"


def _span(found: Figure, unit: str) -> str:
    if found.low is None or found.high is None:
        return MISSING
    return f"{_rounded(found.low, unit)}, {_rounded(found.high, unit)}"


def _words(value: float, unit: str) -> str:
    return f"{_rounded(value, unit)} {unit}".strip()


def _rounded(value: float, unit: str) -> str:
    # Shares come close to their limits.
    return plain(round(value, 3 if unit == "%" else 2))
