"""The tables of docs/performance.md, made from committed JSON files and from nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.paper.markdown import MISSING, fill_blocks, plain, table
from graspcascade.core.errors import FileFormatError
from graspcascade.core.files import read_json, write_text

_TRIALS = {
    "collection": "collection",
    "evaluation": "evaluation of the shipped cascade",
    "evaluation_heuristic": "evaluation of the heuristic",
}

_SAMPLING = {
    "sampling": "after loading, one core",
    "sampling_raw": "of any size as drawn, one core",
    "sampling_ranked": "of any size ranked, one core",
}

Json = Mapping[str, Any]


def fill_page(page: Path, folder: Path) -> None:
    """Write the generated blocks of a page again; the same files give the same page.

    Args:
        page: Markdown file, changed in place; text outside the blocks stays.
        folder: where the JSON files are. A block whose file is not there says so.

    Raises:
        InputError: a block of a name that nothing is made for.
        FileFormatError: a file is not JSON, or lacks a number.
    """
    write_text(page, filled(page.read_text(encoding="utf-8"), folder))


def filled(text: str, folder: Path) -> str:
    """Fill the blocks of a page's text; see `fill_page`."""
    makers: dict[str, Callable[[], str]] = {
        name: partial(_made, make, folder / f"{file}.json") for name, (file, make) in _MAKERS.items()
    }
    return fill_blocks(text, makers | {"aims": partial(aims_table, folder.parent)})


def _made(make: Callable[[Json], str], path: Path) -> str:
    if not path.exists():
        return f"There is no `{path.parent.name}/{path.name}` yet."
    data = read_json(path)
    try:
        return make(data)
    except (KeyError, TypeError, AttributeError) as error:
        raise FileFormatError(f"{path} lacks or garbles {error}") from error


def _bench(data: Json) -> str:
    blocks = [_machine(data["environment"])]
    if any(name in data for name in ("raw", *_TRIALS)):
        blocks += [_rates(data), _trial_settings(data)]
    if "sampling" in data or "cold_start" in data or "training" in data:
        blocks.append(_ratios(data))
    if "training" in data:
        blocks.append(_training_settings(data["training"]))
    return "\n\n".join(blocks)


def _headline(data: Json) -> str:
    threads, sampled = data["environment"]["threads"], data["sampling"]
    return (
        f"With {threads} threads a collection decides **{data['collection']['trials_per_s']['median']:.0f} trials a "
        f"second** and a full evaluation {data['evaluation']['trials_per_s']['median']:.0f}; {sampled['grasps']:,} "
        f"grasps take **{sampled['ms']['median']:.1f} ms** on one core, `{data['cold_start']['command']}` "
        f"{data['cold_start']['s']['median']:.2f} s from nothing, and the training of a cascade "
        f"{data['training']['s'] / 60:.1f} minutes."
    )


def _machine(about: Json) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    return (
        f"{about['cpu']}, {about['logical_cores']} logical cores, {about['threads']} threads, {about['system']}; "
        f"{versions}."
    )


def _rates(data: Json) -> str:
    rows = []
    for name, words in _TRIALS.items():
        if name in data:
            part = data[name]
            raw = part["raw_steps_per_s"]
            rates = _between(part["trials_per_s"]), f"{part['held_per_s']['median']:.1f}"
            full = f"{raw['median'] / part['steps_per_trial']:.1f}"
            rows.append([words, *rates, _thousands(raw), full, _between(part["gain"])])
    if "raw" in data:
        speed = _thousands(data["raw"]["steps_per_s"])
        rows.append(["raw engine by itself", MISSING, MISSING, speed, MISSING, MISSING])
    header = ("what", "trials/s", "held/s", "raw engine, 1,000 steps/s", "raw trials/s", "gain")
    return table(header, rows)


def _thousands(data: Json) -> str:
    return _between({name: value / 1000.0 for name, value in data.items()}, 1)


def _trial_settings(data: Json) -> str:
    words = [f"{data['repetitions']} repetitions in turn"]
    for name in _TRIALS:
        if name in data:
            part = data[name]
            rounds = f"{part['trials']} trials in rounds of {part['round_per_cell']} a cell"
            words.append(f"{name.replace('_', ' of the ')}: {rounds}, raw engine on {part['raw_trials']} grasps")
    if "collection" in data:
        words.append(f"peak memory when a collection was done {data['collection']['peak_rss_mb']:.0f} MB")
    return "; ".join(words) + "."


def _ratios(data: Json) -> str:
    rows = []
    for name, words in _SAMPLING.items():
        if name in data:
            part = data[name]
            takes = f"{_between(part['ms'])} ms", f"{_between(part['yardstick_ms'])} ms"
            rows.append(_ratio(f"{part['grasps']} grasps {words}", part["yardstick"], takes, part))
    if "cold_start" in data:
        part = data["cold_start"]
        takes = f"{_between(part['s'])} s", f"{_between(part['yardstick_s'])} s"
        rows.append(_ratio(f"`{part['command']}`, start to finish", f"`{part['yardstick']}`", takes, part))
    if "training" in data:
        part = data["training"]
        takes = f"{part['s']:.1f} s", f"{part['yardstick_s']:.1f} s"
        what = f"training of `{part['factorization']}` on {part['rows']} grasps"
        rows.append(_ratio(what, part["yardstick"], takes, part))
    return table(("what", "yardstick", "takes", "yardstick takes", "ratio"), rows, text_columns=2)


def _ratio(what: str, yardstick: str, takes: tuple[str, str], part: Json) -> list[str]:
    return [what, yardstick, *takes, f"{part['ratio']:.2f}"]


def _training_settings(part: Json) -> str:
    how = (
        f"{part['epochs_measured']} of {part['epochs']} epochs timed and extended linearly"
        if part["extrapolated"]
        else f"all {part['epochs']} epochs timed"
    )
    return (
        f"Training: {how}, {part['workers']} processes of {part['threads_per_worker']} thread, batches of "
        f"{part['batch_size']}, rows are {part['rows_from']}."
    )


def _scaling(data: Json) -> str:
    rows = [
        [
            f"{run['trials']:,}",
            f"{run['held']:,}",
            f"{run['seconds']:.0f}",
            f"{run['trials_per_s']:.1f}",
            f"{run['peak_rss_mb']:.0f}",
        ]
        for run in data["runs"]
    ]
    header = ("trials", "held", "seconds", "trials/s", "peak memory MB")
    return "\n\n".join([_machine(data["environment"]), table(header, rows, text_columns=0)])


def _trial_speed(data: Json) -> str:
    ladder = table(
        ("means, each on top of those before", "trials/s"),
        [[row["means"], f"{row['trials_per_s']:.1f}"] for row in data["ladder"]],
        text_columns=1,
    )
    parts = [key for key in data["step"][0] if key.endswith("_us")]
    step = table(
        ("scene", "degrees of freedom", "contacts", *(f"`mj_{part.removesuffix('_us')}`" for part in parts)),
        [
            [row["scene"], str(row["dofs"]), f"{row['contacts']:.1f}", *(f"{row[part]:.1f}" for part in parts)]
            for row in data["step"]
        ],
        text_columns=1,
    )
    settings = f"{data['trials']} screened candidates, median of {data['repetitions']} repetitions in turn."
    unit = "Microseconds of the parts of one step while an object is held, one thread:"
    return "\n\n".join([_machine(data["environment"]), settings, ladder, unit, step])


_MAKERS: Mapping[str, tuple[str, Callable[[Json], str]]] = {
    "headline": ("bench", _headline),
    "bench": ("bench", _bench),
    "collection_scaling": ("collection_scaling", _scaling),
    "trial_speed": ("trial_speed", _trial_speed),
}
"""What each block is made from and by; "aims" is made from several files."""


def _between(data: Json, decimals: int = 2) -> str:
    """Word a median and its range: ``6.10 [5.90, 6.30]``."""
    median, least, greatest = (f"{data[name]:.{decimals}f}" for name in ("median", "min", "max"))
    return f"{median} [{least}, {greatest}]"


_BENCH_FILE = "performance/bench.json"
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
    Aim("collection, trials a second", 75, "", _BENCH_FILE, ("collection", "trials_per_s", "median"), True),
    Aim("collection, gain", 3, "", _BENCH_FILE, ("collection", "gain", "median"), True),
    Aim("evaluation, gain", 1.5, "", _BENCH_FILE, ("evaluation", "gain", "median"), True),
    Aim("peak memory of the largest collection", 2000, "MB", _SCALING, ("runs", -1, "peak_rss_mb")),
    Aim("1,000 grasps", 10, "ms", _BENCH_FILE, ("sampling", "ms", "median")),
    Aim("`graspcascade sample`, cold", 0.7, "s", _BENCH_FILE, ("cold_start", "s", "median")),
    Aim("training of a cascade", 300, "s", _BENCH_FILE, ("training", "s")),
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
        figure = measured(results, aim)
        words = f"{'at least' if aim.at_least else 'at most'} {_words(aim.limit, aim.unit)}"
        if figure is None:
            rows.append([aim.what, words, "not measured", MISSING, MISSING])
        else:
            value = _words(figure.value, aim.unit) + (", extrapolated" if figure.extrapolated else "")
            rows.append([aim.what, words, value, _span(figure, aim.unit), _met(aim, figure)])
    return table(("what", "asked", "measured", "from, to", "met"), rows)


def measured(results: Path, aim: Aim) -> Figure | None:
    """Look up an aim's figure, in its unit; None where it was not measured.

    Raises:
        FileFormatError: the file is not JSON.
    """
    path = results / aim.file
    if not path.is_file():
        return None
    value: Any = read_json(path)
    around: Any = {}
    for step in aim.path:
        try:
            around, value = value, _picked(value, step) if isinstance(step, Mapping) else value[step]
        except (KeyError, IndexError):
            return None
    scale = 100.0 if aim.unit == "%" else 1.0
    ends = _ENDS.get(str(aim.path[-1]), ())
    low, high = (scale * float(around[end]) for end in ends) if ends else (None, None)
    return Figure(scale * float(value), low, high, bool(around.get("extrapolated", False)))


def _picked(rows: list[dict[str, Any]], entries: Mapping[str, str]) -> dict[str, Any]:
    matching = [row for row in rows if entries.items() <= row.items()]
    return matching[0]


def _met(aim: Aim, figure: Figure) -> str:
    def reaches(value: float) -> bool:
        return value >= aim.limit if aim.at_least else value <= aim.limit

    if not reaches(figure.value):
        return "**no**"
    whole = all(reaches(end) for end in (figure.low, figure.high) if end is not None)
    return "yes" if whole else "yes, but for the worse end"


def _span(figure: Figure, unit: str) -> str:
    if figure.low is None or figure.high is None:
        return MISSING
    return f"{_rounded(figure.low, unit)}, {_rounded(figure.high, unit)}"


def _words(value: float, unit: str) -> str:
    return f"{_rounded(value, unit)} {unit}".strip()


def _rounded(value: float, unit: str) -> str:
    # Shares come close to their limits.
    return plain(round(value, 3 if unit == "%" else 2))
