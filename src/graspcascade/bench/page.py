"""The tables of docs/performance.md, made from committed JSON files and from nothing else.

The page names its generated blocks by the file they are made from; "aims" is made from several.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from ..errors import FileFormatError
from ..files import read_json, write_text
from ..report.blocks import fill_blocks
from ..report.markdown import MISSING, table
from .aims import aims_table

_TRIALS = {
    "collection": "collection",
    "evaluation": "evaluation of the shipped cascade",
    "evaluation_heuristic": "evaluation of the heuristic",
}

Json = Mapping[str, Any]


def fill_page(page: Path, folder: Path) -> None:
    """Make the generated blocks of a page again; the same files give the same page.

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
    makers: dict[str, Callable[[], str]] = {n: partial(_made, n, folder / f"{n}.json") for n in _MAKERS}
    return fill_blocks(text, makers | {"aims": partial(aims_table, folder.parent)})


def _made(name: str, path: Path) -> str:
    if not path.exists():
        return f"There is no `{path.parent.name}/{path.name}` yet."
    data = read_json(path)
    try:
        return _MAKERS[name](data)
    except (KeyError, TypeError, AttributeError) as error:
        raise FileFormatError(f"{path} lacks or garbles {error}") from error


def _bench(found: Json) -> str:
    blocks = [_machine(found["environment"])]
    if any(name in found for name in ("raw", *_TRIALS)):
        blocks += [_rates(found), _trial_settings(found)]
    if "sampling" in found or "cold_start" in found or "training" in found:
        blocks.append(_ratios(found))
    if "training" in found:
        blocks.append(_training_settings(found["training"]))
    return "\n\n".join(blocks)


def _machine(about: Json) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in about["versions"].items())
    return (
        f"{about['cpu']}, {about['logical_cores']} logical cores, {about['threads']} threads, {about['system']}; "
        f"{versions}."
    )


def _rates(found: Json) -> str:
    rows = []
    for name, words in _TRIALS.items():
        if name in found:
            part = found[name]
            raw = part["raw_steps_per_s"]
            rates = _between(part["trials_per_s"]), f"{part['held_per_s']['median']:.1f}"
            full = f"{raw['median'] / part['steps_per_trial']:.1f}"
            rows.append([words, *rates, _thousands(raw), full, _between(part["gain"])])
    if "raw" in found:
        speed = _thousands(found["raw"]["steps_per_s"])
        rows.append(["raw engine by itself", MISSING, MISSING, speed, MISSING, MISSING])
    header = ("what", "trials/s", "held/s", "raw engine, 1,000 steps/s", "raw trials/s", "gain")
    return table(header, rows)


def _thousands(found: Json) -> str:
    return _between({name: value / 1000.0 for name, value in found.items()}, 1)


def _trial_settings(found: Json) -> str:
    words = [f"{found['repetitions']} repetitions in turn"]
    for name in _TRIALS:
        if name in found:
            part = found[name]
            rounds = f"{part['trials']} trials in rounds of {part['round_per_cell']} a cell"
            words.append(f"{name.replace('_', ' of the ')}: {rounds}, raw engine on {part['raw_trials']} grasps")
    if "collection" in found:
        words.append(f"peak memory when a collection was done {found['collection']['peak_rss_mb']:.0f} MB")
    return "; ".join(words) + "."


def _ratios(found: Json) -> str:
    rows = []
    if "sampling" in found:
        part = found["sampling"]
        takes = f"{_between(part['ms'])} ms", f"{_between(part['yardstick_ms'])} ms"
        rows.append(_ratio(f"{part['grasps']} grasps after loading, one core", part["yardstick"], takes, part))
    if "cold_start" in found:
        part = found["cold_start"]
        takes = f"{_between(part['s'])} s", f"{_between(part['yardstick_s'])} s"
        rows.append(_ratio(f"`{part['command']}`, start to finish", f"`{part['yardstick']}`", takes, part))
    if "training" in found:
        part = found["training"]
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


def _scaling(found: Json) -> str:
    rows = [
        [
            f"{run['trials']:,}",
            f"{run['held']:,}",
            f"{run['seconds']:.0f}",
            f"{run['trials_per_s']:.1f}",
            f"{run['peak_rss_mb']:.0f}",
        ]
        for run in found["runs"]
    ]
    header = ("trials", "held", "seconds", "trials/s", "peak memory MB")
    return "\n\n".join([_machine(found["environment"]), table(header, rows, text_columns=0)])


def _trial_speed(found: Json) -> str:
    ladder = table(
        ("means, each on top of those before", "trials/s"),
        [[row["means"], f"{row['trials_per_s']:.1f}"] for row in found["ladder"]],
        text_columns=1,
    )
    parts = [key for key in found["step"][0] if key.endswith("_us")]
    step = table(
        ("scene", "degrees of freedom", "contacts", *(f"`mj_{part.removesuffix('_us')}`" for part in parts)),
        [
            [row["scene"], str(row["dofs"]), f"{row['contacts']:.1f}", *(f"{row[part]:.1f}" for part in parts)]
            for row in found["step"]
        ],
        text_columns=1,
    )
    settings = f"{found['trials']} screened candidates, median of {found['repetitions']} repetitions in turn."
    unit = "Microseconds of the parts of one step while an object is held, one thread:"
    return "\n\n".join([_machine(found["environment"]), settings, ladder, unit, step])


_MAKERS: Mapping[str, Callable[[Json], str]] = {
    "bench": _bench,
    "collection_scaling": _scaling,
    "trial_speed": _trial_speed,
}
"""What each block is made by."""


def _between(found: Json, decimals: int = 2) -> str:
    """Word a median and its range: ``6.10 [5.90, 6.30]``."""
    median, least, greatest = (f"{found[name]:.{decimals}f}" for name in ("median", "min", "max"))
    return f"{median} [{least}, {greatest}]"
