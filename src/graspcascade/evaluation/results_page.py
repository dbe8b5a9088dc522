"""The results page: every number of docs/results.md, made from the committed JSON files and from nothing else."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import FileFormatError, InputError
from ..files import read_json, write_text
from ..trials import VERDICTS
from .gallery import Gallery, heat_map_name
from .markdown import MISSING, over, pair, percent, plain, rate, table, widest
from .measurements import measurement_section, spread
from .paper_runs import PAPER_FOLDER, read_paper_runs
from .paper_tables import paper_section
from .published import HEURISTIC
from .record import Evaluation, Tally, is_evaluation

NOTES_FILE = "notes.md"


@dataclass(frozen=True)
class _Entry:
    """Hold one evaluation, its file's stem and the name it goes by on the page."""

    stem: str
    evaluation: Evaluation
    label: str

    @property
    def conditions(self) -> dict[str, Any]:
        """Give all that must agree for two rates to be compared as two models."""
        return {"hand": self.evaluation.hand} | self.evaluation.protocol.to_json()

    @property
    def total(self) -> Tally:
        return self.evaluation.total


def report(results_dir: Path | str, out: Path | str, figures: Path | str | None = None) -> None:
    """Write the results page from a folder of JSON files.

    Evaluations come first, the heuristic before all; a folder `paper` among them becomes the section of the paper's
    tables; other JSON objects follow as tables. The text of `notes.md` in the folder, if there, becomes the section
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
    paper = read_paper_runs(folder / PAPER_FOLDER)
    entries, measurements = _read(folder)
    base = entries[0]
    same = [entry for entry in entries if entry.conditions == base.conditions]
    other = [entry for entry in entries if entry.conditions != base.conditions]
    blocks = [_opening(folder), _protocol_section(base), _summary_section(same, base)]
    if paper is not None:
        blocks.append(paper_section(paper, gallery))
    blocks.append(_verdict_section(entries))
    if other:
        blocks.append(_conditions_section(other, same, base))
    if measurements:
        sections = [measurement_section(stem, data) for stem, data in measurements.items()]
        blocks.append("\n\n".join(["## Other measurements", *sections]))
    notes = folder / NOTES_FILE
    if notes.is_file():
        blocks.append("## What falls short\n\n" + notes.read_text(encoding="utf-8").strip("\n"))
    blocks += [_model_section(entry, gallery) for entry in same]
    return "\n\n".join(blocks) + "\n"


def _read(folder: Path) -> tuple[list[_Entry], dict[str, Mapping[str, Any]]]:
    found, measurements = [], {}
    for path in sorted(folder.glob("*.json"), key=_order):
        data = read_json(path)
        if is_evaluation(data):
            found.append((path.stem, Evaluation.load(path)))
        elif isinstance(data, Mapping):
            measurements[path.stem] = data
        else:
            raise FileFormatError(f"{path} is neither an evaluation nor a JSON object of measurements")
    if not found:
        raise InputError(
            f"{folder} holds no evaluation; copy the evaluation.json of `graspcascade evaluate --out` there"
        )
    entries, taken = [], set()
    for stem, evaluation in found:
        name = (evaluation.model, evaluation.protocol.name)
        # The first to bear a name keeps it; further training seeds, or hands, are told apart by their files.
        entries.append(_Entry(stem, evaluation, f"{evaluation.model} ({stem})" if name in taken else evaluation.model))
        taken.add(name)
    return entries, measurements


def _order(path: Path) -> tuple[bool, list[tuple[bool, int, str]]]:
    """Put the heuristic first and `model10` after `model9`."""
    parts = re.findall(r"\d+|\D+", path.stem)
    return path.stem != HEURISTIC, [(p.isdigit(), int(p) if p.isdigit() else 0, p) for p in parts]


def _opening(folder: Path) -> str:
    return f"""# Results

Made by `graspcascade report` from the JSON files in `{folder.name}/`, never by hand; the same command makes it again.

*Held*: at the end of the trial the object touches the thumb and a finger and has stayed in place. *Faithful*: held, and
it touches every digit that the grasp type needs. Square brackets are 95 % confidence intervals: Wilson's score interval
for a rate (DOI `10.1080/01621459.1927.10502953`), Newcombe's hybrid score interval for a difference of rates
(DOI `10.1002/(SICI)1097-0258(19980430)17:8<873::AID-SIM779>3.0.CO;2-I`), which takes the samples as independent.
Sides are drawn uniformly from each object's graspable sides; every grasp that a model gives is executed and counted."""


def _protocol_section(base: _Entry) -> str:
    protocol = base.evaluation.protocol
    rows = [(name, plain(value)) for name, value in protocol.to_json().items() if name != "name"]
    return "\n\n".join(
        [f"## Protocol `{protocol.name}`", f"Hand `{base.evaluation.hand}`.", table(("parameter", "value"), rows)]
    )


def _summary_section(entries: Sequence[_Entry], base: _Entry) -> str:
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


def _verdict_section(entries: Sequence[_Entry]) -> str:
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


def _conditions_section(other: Sequence[_Entry], same: Sequence[_Entry], base: _Entry) -> str:
    name = base.evaluation.protocol.name
    header = (
        "model", "protocol", "what differs", "trials", "held", "faithful", f"held, points over `{name}`",
        f"faithful, points over `{name}`",
    )  # fmt: skip
    rows = []
    for entry in other:
        usual = next((e for e in same if e.evaluation.model == entry.evaluation.model), None)
        differing = [
            f"{key} {plain(value)} (`{name}`: {plain(base.conditions[key])})"
            for key, value in entry.conditions.items()
            if key != "name" and value != base.conditions[key]
        ]
        rows.append(
            [
                entry.label,
                f"`{entry.evaluation.protocol.name}`",
                "; ".join(differing) or "the name alone",
                str(entry.total.n),
                rate(entry.total.held_rate),
                rate(entry.total.faithful_rate),
                *((MISSING, MISSING) if usual is None else over(entry.total, usual.total)),
            ]
        )
    text = f"Differences are to the same model under protocol `{name}` with hand `{base.evaluation.hand}`."
    return "\n\n".join(["## Other conditions", text, table(header, rows, text_columns=3)])


def _model_section(entry: _Entry, gallery: Gallery) -> str:
    found = entry.evaluation
    facts = [
        f"File `{entry.stem}.json`, protocol `{found.protocol.name}`, hand `{found.hand}`, {found.n} trials, "
        f"{found.per_cell} per cell, seed {found.seed}; "
        + ", ".join(f"{name} {version}" for name, version in found.versions.items())
        + "."
    ]
    if found.model_metadata:
        facts.append("; ".join(f"{key}: {plain(value)}" for key, value in spread(found.model_metadata)) + ".")
    return "\n\n".join(
        [
            f"## {entry.label}",
            *facts,
            _breakdown("grasp type", {**found.by_type, "all": found.total}),
            _breakdown("object", {**found.by_object, "all": found.total}),
            _matrix(found),
            *gallery.show(heat_map_name(entry.stem), f"Success of {entry.label} on every object with every grasp type"),
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
    cells = {(cell.object_label, cell.grasp_type): cell for cell in found.cells}
    rows = [[label, *(pair(cells.get((label, kind))) for kind in found.by_type)] for label in found.by_object]
    text = (
        f"Held % / faithful % of each object and type under protocol `{found.protocol.name}`, {found.per_cell} trials "
        f"each; the widest of these 95 % intervals reaches {widest(found.cells)} points to either side of its middle:"
    )
    return text + "\n\n" + table(("object", *found.by_type), rows)
