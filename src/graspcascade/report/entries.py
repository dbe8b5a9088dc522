"""What a folder of results holds: evaluations in the page's order, the paper's experiment, other measurements."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import FileFormatError, InputError
from ..evaluation import HEURISTIC
from ..evaluation.record import Evaluation, Tally, is_evaluation
from ..files import read_json
from .gallery import heat_map_name
from .paper_runs import PAPER_FOLDER, PaperRuns, read_paper_runs
from .published import FULL_MODEL


@dataclass(frozen=True)
class Entry:
    """Hold one evaluation and how the page speaks of it.

    Attributes:
        stem: of its file; ``paper/<model>`` for all training seeds of a model of the paper's experiment.
        evaluation: the evaluation.
        label: the name it goes by.
        seeds: of the evaluations counted together.
    """

    stem: str
    evaluation: Evaluation
    label: str
    seeds: tuple[int, ...]

    @property
    def conditions(self) -> dict[str, Any]:
        """Give the evaluation's conditions."""
        return self.evaluation.conditions

    @property
    def total(self) -> Tally:
        """Count all trials together."""
        return self.evaluation.total

    @property
    def has_own_file(self) -> bool:
        """Tell it from one of the paper's experiment."""
        return not self.stem.startswith(f"{PAPER_FOLDER}/")

    @property
    def source(self) -> str:
        """Say where it is from."""
        return f"File `{self.stem}.json`" if self.has_own_file else f"Folder `{PAPER_FOLDER}`"

    @property
    def heat_map(self) -> str:
        """Name the file of its heat map, where it has a file of its own."""
        return heat_map_name(self.stem)


@dataclass(frozen=True)
class ResultsFolder:
    """Hold what a folder of results holds.

    Attributes:
        entries: evaluations; the conditions of the first, the heuristic's if there is one, are the page's.
        paper: the paper's experiment, None without one.
        measurements: other JSON objects by file stem.
    """

    entries: Sequence[Entry]
    paper: PaperRuns | None
    measurements: Mapping[str, Mapping[str, Any]]

    @property
    def base(self) -> Entry:
        """Give the evaluation whose conditions are the page's."""
        return self.entries[0]

    @property
    def same(self) -> list[Entry]:
        """Give the evaluations under the page's conditions."""
        return [entry for entry in self.entries if entry.conditions == self.base.conditions]

    @property
    def other(self) -> list[Entry]:
        """Give the evaluations under other conditions."""
        return [entry for entry in self.entries if entry.conditions != self.base.conditions]


def read_results(folder: Path | str) -> ResultsFolder:
    """Read a folder of results.

    The paper's experiment, in the folder `paper`, stands in for the heuristic and the full model where these have no
    file of their own.

    Raises:
        InputError: it holds no evaluation.
        FileFormatError: a file is not JSON, or an evaluation that contradicts itself.
    """
    folder = Path(folder)
    paper = read_paper_runs(folder / PAPER_FOLDER)
    entries, measurements = _read_files(folder)
    if paper is not None:
        entries += _stand_ins(paper, entries)
    if not entries:
        raise InputError(
            f"{folder} holds no evaluation; copy the evaluation.json of `graspcascade evaluate --out` there"
        )
    entries.sort(key=lambda entry: Path(entry.stem).name != HEURISTIC)
    return ResultsFolder(entries, paper, measurements)


def _read_files(folder: Path) -> tuple[list[Entry], dict[str, Mapping[str, Any]]]:
    entries: list[Entry] = []
    measurements: dict[str, Mapping[str, Any]] = {}
    taken: set[tuple[str, str]] = set()
    for path in sorted(folder.glob("*.json"), key=_order):
        data = read_json(path)
        if is_evaluation(data):
            found = Evaluation.load(path)
            name = (found.model, found.protocol.name)
            # The first to bear a name keeps it; further training seeds, or hands, are told apart by their files.
            label = f"{found.model} ({path.stem})" if name in taken else found.model
            entries.append(Entry(path.stem, found, label, (found.seed,)))
            taken.add(name)
        elif isinstance(data, Mapping):
            measurements[path.stem] = data
        else:
            raise FileFormatError(f"{path} is neither an evaluation nor a JSON object of measurements")
    return entries, measurements


def _stand_ins(paper: PaperRuns, own: Sequence[Entry]) -> list[Entry]:
    there = {(entry.evaluation.model, entry.evaluation.protocol.name) for entry in own}
    return [
        Entry(f"{PAPER_FOLDER}/{name}", runs.pooled, runs.title, tuple(one.seed for one in runs.by_seed.values()))
        for name, runs in paper.runs.items()
        if name in (HEURISTIC, FULL_MODEL) and (name, runs.pooled.protocol.name) not in there
    ]


def _order(path: Path) -> tuple[bool, list[tuple[bool, int, str]]]:
    """Put the heuristic first and `model10` after `model9`."""
    parts = re.findall(r"\d+|\D+", path.stem)
    return path.stem != HEURISTIC, [(p.isdigit(), int(p) if p.isdigit() else 0, p) for p in parts]
