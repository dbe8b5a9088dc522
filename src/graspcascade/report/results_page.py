"""The results page: every number of docs/results.md, made from the committed JSON files and from nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..evaluation import HEURISTIC
from ..evaluation.record import Evaluation, Tally
from ..files import write_text
from ..trials import VERDICTS
from .entries import Entry, ResultsFolder, read_results
from .gallery import Gallery
from .markdown import MISSING, over, pair_rows, percent, plain, rate, table, widest
from .measurements import measurement_section, spread
from .paper_runs import NOTES_FILE
from .paper_section import paper_section


def write_report(results_dir: Path | str, out: Path | str, figures: Path | str | None = None) -> None:
    """Write the results page from a folder of JSON files.

    Evaluations come first, the heuristic before all; a folder `paper` among them becomes the section of the paper's
    tables, and stands in for the heuristic and the full model where these have no file of their own; other JSON objects
    follow as tables. The text of `notes.md` in the folder, if there, becomes the section
    "What falls short". The same files give the same page.

    Args:
        results_dir: folder of the JSON files.
        out: Markdown file to write.
        figures: folder into which the page's pictures are drawn along with it; without one, those that lie in `figures`
            beside the page are shown.

    Raises:
        InputError: the folder holds no evaluation.
        FileFormatError: a file is not JSON, or an evaluation that contradicts itself.
    """
    page = Path(out)
    gallery = Gallery(page, page.parent / "figures" if figures is None else Path(figures), figures is not None)
    write_text(page, render(Path(results_dir), gallery))


def render(folder: Path, gallery: Gallery) -> str:
    """Word the results page."""
    found = read_results(folder)
    blocks = [_opening(folder), _protocol_section(found.base), _summary_section(found.same, found.base)]
    if found.paper is not None:
        blocks.append(paper_section(found.paper, gallery))
    blocks.append(_verdict_section(found.entries))
    if found.other:
        blocks.append(_conditions_section(found))
    if found.measurements:
        prior = found.base.evaluation.model_metadata.get("prior")
        sections = [measurement_section(stem, data, prior) for stem, data in found.measurements.items()]
        blocks.append("\n\n".join(["## Other measurements", *sections]))
    notes = folder / NOTES_FILE
    if notes.is_file():
        blocks.append("## What falls short\n\n" + notes.read_text(encoding="utf-8").strip("\n"))
    blocks += [_model_section(entry, gallery) for entry in found.same]
    return "\n\n".join(blocks) + "\n"


def _opening(folder: Path) -> str:
    return f"""# Results

Made by `graspcascade report` from the JSON files in `{folder.name}/`, never by hand; the same command makes it again.

*Held*: at the end of the trial the object touches the thumb and a finger and has stayed in place. *Faithful*: held, and
it touches every digit that the grasp type needs. Square brackets are 95 % confidence intervals: Wilson's score interval
for a rate (DOI `10.1080/01621459.1927.10502953`), Newcombe's hybrid score interval for a difference of rates
(DOI `10.1002/(SICI)1097-0258(19980430)17:8<873::AID-SIM779>3.0.CO;2-I`), which takes the samples as independent.
Sides are drawn uniformly from each object's graspable sides; every grasp that a model gives is executed and counted."""


def _protocol_section(base: Entry) -> str:
    protocol = base.evaluation.protocol
    rows = [(name, plain(value)) for name, value in protocol.to_json().items() if name != "name"]
    return "\n\n".join(
        [f"## Protocol `{protocol.name}`", f"Hand `{base.evaluation.hand}`.", table(("parameter", "value"), rows)]
    )


def _summary_section(entries: Sequence[Entry], base: Entry) -> str:
    heuristic = next((entry for entry in entries if entry.evaluation.model == HEURISTIC), None)
    header = ("model", "trials", "held", "faithful", "held, points over heuristic", "faithful, points over heuristic")
    rows = []
    for entry in entries:
        total = entry.total
        row = [entry.label, str(total.n), rate(total.held_rate), rate(total.faithful_rate)]
        if heuristic is None or entry is heuristic:
            rows.append([*row, MISSING, MISSING])
        else:
            rows.append([*row, *over(total, heuristic.total)])
    return "\n\n".join([f"## Success rates under protocol `{base.evaluation.protocol.name}`", table(header, rows)])


def _verdict_section(entries: Sequence[Entry]) -> str:
    header = ("model", "protocol", "trials", *(f"{verdict} %" for verdict in VERDICTS))
    rows = [
        [
            entry.label,
            f"`{entry.evaluation.protocol.name}`",
            str(entry.total.n),
            *(percent(count / entry.total.n) for count in entry.total.verdicts.values()),
        ]
        for entry in entries
    ]
    text = "Share of trials that ended in each verdict; the intervals of the held are in the tables of rates."
    return "\n\n".join(["## Verdicts", text, table(header, rows, text_columns=2)])


def _conditions_section(found: ResultsFolder) -> str:
    base = found.base
    name = base.evaluation.protocol.name
    header = (
        "model", "protocol", "what differs", "trials", "held", "faithful", f"held, points over `{name}`",
        f"faithful, points over `{name}`",
    )  # fmt: skip
    rows = []
    for entry in found.other:
        usual = _usual(entry, found)
        differing = [
            f"{key} {_condition(value)} (`{name}`: {_condition(there)})"
            for key, value, there in _differing(entry, base)
        ]
        rows.append(
            [
                entry.label,
                f"`{entry.evaluation.protocol.name}`",
                "; ".join(differing) or "the name alone",
                str(entry.total.n),
                rate(entry.total.held_rate),
                rate(entry.total.faithful_rate),
                *((MISSING, MISSING) if usual is None or usual is entry else over(entry.total, usual.total)),
            ]
        )
    text = (
        f"Differences are to the same model under protocol `{name}` with hand `{base.evaluation.hand}`: to the row in "
        "which nothing but the name differs, where there is one of as many trials from the same seed. These are the "
        "same grasps, so that the intervals, which take them as independent, are rather too wide."
    )
    return "\n\n".join(["## Other conditions", text, table(header, rows, text_columns=3)])


def _differing(entry: Entry, base: Entry) -> list[tuple[str, Any, Any]]:
    """List the conditions that differ: names, values, and what they are on the page."""
    usual = base.conditions
    return [
        (key, value, usual[key]) for key, value in entry.conditions.items() if key != "name" and value != usual[key]
    ]


def _usual(entry: Entry, found: ResultsFolder) -> Entry | None:
    """Give what an evaluation under other conditions is compared with; see `_conditions_section`."""

    def like(other: Entry) -> bool:
        return _same_model(other.evaluation, entry.evaluation)

    alike = (other for other in found.other if like(other) and not _differing(other, found.base))
    same_grasps = (other for other in alike if (other.seeds, other.total.n) == (entry.seeds, entry.total.n))
    return next(same_grasps, None) or next(filter(like, found.same), None)


def _same_model(one: Evaluation, other: Evaluation) -> bool:
    """Tell whether two evaluations are of one model, as far as both say of it."""
    ours, theirs = one.model_metadata, other.model_metadata
    return one.model == other.model and all(ours[key] == theirs[key] for key in ours.keys() & theirs.keys())


def _condition(value: Any) -> str:
    return f"{len(value)} of object and type" if isinstance(value, list) else plain(value)


def _model_section(entry: Entry, gallery: Gallery) -> str:
    found = entry.evaluation
    facts = [
        f"{entry.source}, protocol `{found.protocol.name}`, hand `{found.hand}`, {found.n} trials, "
        f"{found.per_cell} per cell, seed {', '.join(map(str, entry.seeds))}; "
        + ", ".join(f"{name} {version}" for name, version in found.versions.items())
        + "."
    ]
    pictures: list[str] = []
    # Settings and pictures of the paper's experiment stand in its own section.
    if entry.has_own_file:
        if found.model_metadata:
            facts.append("; ".join(f"{key}: {plain(value)}" for key, value in spread(found.model_metadata)) + ".")
        pictures = gallery.show(entry.heat_map, f"Success of {entry.label} on every object with every grasp type")
    return "\n\n".join(
        [
            f"## {entry.label}",
            *facts,
            _breakdown("grasp type", {**found.by_type, "all": found.total}),
            _breakdown("object", {**found.by_object, "all": found.total}),
            _matrix(found),
            *pictures,
        ]
    )


def _breakdown(kind: str, tallies: Mapping[str, Tally]) -> str:
    rows = [
        (
            name,
            str(tally.n),
            str(tally.held),
            rate(tally.held_rate),
            str(tally.faithful),
            rate(tally.faithful_rate),
            rate(tally.faithful_of_held),
        )
        for name, tally in tallies.items()
    ]
    return table((kind, "trials", "held", "held rate", "faithful", "faithful rate", "faithful of the held"), rows)


def _matrix(found: Evaluation) -> str:
    text = (
        f"Held % / faithful % of each object and type under protocol `{found.protocol.name}`, {found.per_cell} trials "
        f"each; the widest of these 95 % intervals reaches {widest(found.cells)} points to either side of its middle:"
    )
    return text + "\n\n" + table(("object", *found.by_type), pair_rows(found))
