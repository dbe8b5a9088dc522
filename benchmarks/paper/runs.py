"""What a folder of results holds: evaluations, the paper's experiment, training curves, other measurements."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from statistics import variance
from typing import Any

import numpy as np

from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.files import read_json
from graspcascade.core.protocols import Protocol
from graspcascade.proposals.cascade.stages import FACTORIZATIONS
from graspcascade.proposals.heuristic import HEURISTIC
from graspcascade.studies.learn import CascadeTraining
from graspcascade.studies.record import Cell, Evaluation, Tally, is_evaluation

from .markdown import plain, spread
from .published import FULL_MODEL, PAPER_MODELS

PAPER_FOLDER, EXPERIMENTS_FOLDER, TRAINING_FOLDER, NOTES_FILE = "paper", "experiments", "training", "notes.md"

# A retrained model differs in these without being another model.
_INCIDENTAL = ("versions.", "final_loss.", "weights", "config.training.seed", "config.training.threads")
_NETWORKS = "networks."


@dataclass(frozen=True)
class StageCurves:
    """Losses of one stage of a cascade, one value per epoch (means over its rows).

    `validation_loss` is of the rows held out, None without any.
    """

    epoch: tuple[int, ...]
    train_loss: tuple[float, ...]
    train_reconstruction: tuple[float, ...]
    train_kl: tuple[float, ...]
    validation_loss: tuple[float | None, ...]

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> StageCurves:
        """Read the curves of one stage.

        Raises:
            KeyError, TypeError, ValueError: a curve is missing, too short, or not of finite numbers.
        """
        epoch = tuple(map(int, data["epoch"]))
        loss, reconstruction, kl = (
            tuple(map(float, data[name])) for name in ("train_loss", "train_reconstruction", "train_kl")
        )
        held_out = tuple(None if value is None else float(value) for value in data["validation_loss"])
        curves = (loss, reconstruction, kl, held_out)
        if not epoch or {len(epoch)} != set(map(len, curves)):
            raise ValueError("every curve needs one value for each epoch")
        if not all(math.isfinite(value) for curve in curves for value in curve if value is not None):
            raise ValueError("every value must be finite")
        return cls(epoch, loss, reconstruction, kl, held_out)


@dataclass(frozen=True)
class TrainingCurves:
    """Training curves of one cascade: its factorization's name, its seed, its stages by name in sampling order."""

    model: str
    seed: int
    stages: Mapping[str, StageCurves]

    @classmethod
    def load(cls, path: Path | str) -> TrainingCurves:
        """Read a `training.json`.

        Raises:
            FileFormatError: the file is missing or holds no training curves.
        """
        data = read_json(Path(path))
        try:
            stages = {str(name): StageCurves.from_json(curves) for name, curves in data["stages"].items()}
            if not stages:
                raise ValueError("it has no stage")
            return cls(str(data["factorization"]), int(data["seed"]), stages)
        except KeyError as error:
            raise FileFormatError(f"{path} holds no training curves: it lacks {error.args[0]!r}") from error
        except (TypeError, ValueError, AttributeError) as error:
            raise FileFormatError(f"{path} holds no training curves: {error}") from error

    def panel(self, stage: str) -> str:
        """Name the stage, and its rotation output if that is plain: its squared error is on another scale."""
        model = FACTORIZATIONS.get(self.model)
        plain_output = model is not None and any(
            one.name == stage and "rotation" in one.targets and one.rotation_head == "unit" for one in model.stages
        )
        return f"{stage}, plain output" if plain_output else stage


def read_training(folder: Path | str) -> list[TrainingCurves]:
    """Read all training curves in a folder, in the order of the models and their seeds; none without a folder.

    Raises:
        FileFormatError: a file holds no training curves.
    """
    order = {name: number for number, name in enumerate(FACTORIZATIONS)}
    curves = [TrainingCurves.load(path) for path in sorted(Path(folder).glob("*.json"))]
    return sorted(curves, key=lambda one: (order.get(one.model, len(order)), one.model, one.seed))


@dataclass(frozen=True)
class Runs:
    """Evaluations of one model by training seed; None is the seed of what is not trained, such as the heuristic."""

    model: str
    by_seed: Mapping[int | None, Evaluation]

    @cached_property
    def pooled(self) -> Evaluation:
        """Trials of all training seeds together, as one evaluation."""
        return pool(list(self.by_seed.values()))

    @property
    def title(self) -> str:
        """Model and, if there are several, the number of its training seeds."""
        return self.model if len(self.by_seed) == 1 else f"{self.model}, {len(self.by_seed)} training seeds"


def shared_runs(one: Runs, other: Runs) -> tuple[Evaluation, Evaluation]:
    """Pool the runs of two models over the training seeds that both have; all runs, where they share none.

    Under the same seed models are asked for the same types, objects and sides, and networks that they have in common
    are the same.
    """
    seeds = _shared_seeds(one, other)
    if not seeds:
        return one.pooled, other.pooled
    return pool([one.by_seed[seed] for seed in seeds]), pool([other.by_seed[seed] for seed in seeds])


def retraining_margin(one: Runs, other: Runs, all_runs: Mapping[str, Runs]) -> float | None:
    """Estimate how far the held rates of two equal models may differ, in 95 of 100 cases, by training them again.

    Over shared seeds: the residual of a two-way additive model (model + seed) of the rates of all models that have
    several seeds. Without a shared seed: the pooled variance between a model's seeds. Student's t in both cases. Every
    seed's trials are drawn afresh, so that their chance is part of it.

    Returns:
        A share, None where too few models have several seeds to know.
    """
    from scipy.stats import t

    shared = _shared_seeds(one, other)
    several = [runs for runs in all_runs.values() if len(runs.by_seed) > 1]
    if shared:
        squares, freedom = _residual(several)
        shares = 2.0 / len(shared)
    else:
        rates = [[evaluation.held.rate for evaluation in runs.by_seed.values()] for runs in several]
        freedom = sum(len(group) - 1 for group in rates)
        squares = sum((len(group) - 1) * variance(group) for group in rates)
        shares = sum(1 / len(runs.by_seed) for runs in (one, other) if None not in runs.by_seed)
    if freedom < 1:
        return None
    return float(t.ppf(0.975, freedom) * math.sqrt(squares / freedom * shares))


def _shared_seeds(one: Runs, other: Runs) -> list[int | None]:
    return [seed for seed in one.by_seed if seed is not None and seed in other.by_seed]


def _residual(several: Sequence[Runs]) -> tuple[float, int]:
    """Fit model + seed to the held rates; return the sum of squares that remains and its degrees of freedom."""
    rows = [(n, seed, one.held.rate) for n, runs in enumerate(several) for seed, one in runs.by_seed.items()]
    if not rows:
        return 0.0, 0
    models, seeds, rates = map(np.array, zip(*rows, strict=True))
    design = np.hstack([np.equal.outer(column, np.unique(column)) for column in (models, seeds)]).astype(float)
    solution, _, rank, _ = np.linalg.lstsq(design, rates, rcond=None)
    return float(((rates - design @ solution) ** 2).sum()), len(rates) - int(rank)


@dataclass(frozen=True)
class PaperRuns:
    """The paper's experiment, in any state of completion.

    Attributes:
        runs: by model, in the order of the paper's tables; without those that were not run.
        experiments: evaluations with other settings, by label.
        training: training curves.
        notes: text on what falls short of the paper; empty without any.
    """

    runs: Mapping[str, Runs]
    experiments: Mapping[str, Evaluation]
    training: Sequence[TrainingCurves]
    notes: str

    @property
    def conditions(self) -> dict[str, Any]:
        """What all rates of the paper's models have in common; empty if none was run."""
        return next((conditions(runs.pooled) for runs in self.runs.values()), {})

    def comparable(self, experiment: Evaluation) -> bool:
        """Tell whether an experiment was evaluated under the conditions of the paper's models."""
        return conditions(experiment) == self.conditions

    def base_of(self, experiment: Evaluation) -> Evaluation | None:
        """Find the model that an experiment changes: of its name or else the full model, of its seed; None if not run.

        The same training seed also asks for the same grasps.
        """
        runs = self.runs.get(experiment.model) or self.runs.get(FULL_MODEL)
        return None if runs is None else runs.by_seed.get(training_seed(experiment), runs.pooled)

    @property
    def by_setting(self) -> dict[str, dict[str, Evaluation]]:
        """Comparable experiments, by setting and model, that were made with the full model and with others.

        The label of an experiment with another model ends in that model's name. "as above" is the usual setting.
        """
        settings: dict[str, dict[str, Evaluation]] = {}
        for label, one in self.experiments.items():
            if self.comparable(one):
                settings.setdefault(label.removesuffix(f" {one.model}"), {})[one.model] = one
        settings = {name: models for name, models in settings.items() if FULL_MODEL in models and len(models) > 1}
        changed = [one for models in settings.values() for one in models.values()]
        usual = {one.model: base for one in changed if (base := self.base_of(one))}
        return {"as above": usual, **settings} if FULL_MODEL in usual and len(usual) > 1 else {}


def read_paper_runs(folder: Path | str) -> PaperRuns | None:
    """Read the folder of the paper's experiment; None where there is no such folder.

    Evaluations of the paper's models are its own JSON files, those with other settings lie in `experiments/` and
    training curves in `training/`.

    Raises:
        FileFormatError: a file is foreign; one of the models' is of no model of the paper, repeats a training seed, or
            was run under other conditions than its neighbours.
    """
    folder = Path(folder)
    if not folder.is_dir():
        return None
    models: dict[str, dict[int | None, Evaluation]] = {}
    first: tuple[Path, dict[str, Any]] | None = None
    for path in sorted(folder.glob("*.json")):
        evaluation = Evaluation.load(path)
        first = first or (path, conditions(evaluation))
        _check_conditions(path, evaluation, *first)
        if evaluation.model not in PAPER_MODELS:
            raise FileFormatError(
                f"{path} is of {evaluation.model!r}, no model of the paper; valid: {', '.join(PAPER_MODELS)}"
            )
        seeds, seed = models.setdefault(evaluation.model, {}), training_seed(evaluation)
        if seed in seeds:
            raise FileFormatError(f"{path} repeats training seed {seed} of {evaluation.model}; trials count once")
        seeds[seed] = evaluation
    experiments = sorted((folder / EXPERIMENTS_FOLDER).glob("*.json"))
    return PaperRuns(
        {name: Runs(name, dict(sorted(models[name].items(), key=_by_seed))) for name in PAPER_MODELS if name in models},
        {path.stem.replace("_", " "): Evaluation.load(path) for path in experiments},
        read_training(folder / TRAINING_FOLDER),
        read_notes(folder),
    )


def protocol_numbers(protocol: Protocol) -> dict[str, Any]:
    """List every number of a protocol, those of its phases as ``<phase>_<number>``, of a phase that recurs numbered."""
    kinds = [phase.kind for phase in protocol.phases]
    numbers: dict[str, Any] = {}
    for place, phase in enumerate(protocol.phases):
        before = kinds[:place].count(phase.kind)
        stem = phase.kind if not before else f"{phase.kind}{before + 1}"
        numbers |= {f"{stem}_{name}": value for name, value in asdict(phase).items()}
    data = protocol.to_json()
    own = {name: data[name] for name in ("overlap_m", "displacement_m", "turn_rad") if name in data}
    numbers |= own | data["physics"]
    return numbers


def conditions(evaluation: Evaluation) -> dict[str, Any]:
    """Collect what must agree for rates to stand in one table: hand, protocol and cells, each number by itself."""
    protocol, cells = evaluation.protocol, sorted(f"{one.object_label}/{one.grasp_type}" for one in evaluation.cells)
    return {"hand": evaluation.hand, "name": protocol.name, **protocol_numbers(protocol), "cells": cells}


def pool(evaluations: Sequence[Evaluation]) -> Evaluation:
    """Count the trials of evaluations under the same conditions together, as if each were a part of one.

    Name, versions and metadata are kept as far as all agree; the seed is the first one's.

    Raises:
        ValueError: there is none, or their conditions differ.
    """
    if not evaluations or any(conditions(one) != conditions(evaluations[0]) for one in evaluations):
        raise ValueError("only evaluations under the same conditions can be counted together")
    cells = [{(cell.object_label, cell.grasp_type): cell for cell in one.cells} for one in evaluations]
    counted = []
    for place in cells[0]:
        tally = Tally.sum(one[place] for one in cells)
        counted.append(Cell(tally.verdicts, tally.faithful, place[1], place[0]))
    return replace(
        evaluations[0],
        cells=tuple(counted),
        per_cell=sum(one.per_cell for one in evaluations),
        versions=_agreed([one.versions for one in evaluations]),
        model_metadata=_agreed([one.model_metadata for one in evaluations]),
    )


def _agreed(mappings: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Keep the entries, also of inner objects, that all have alike."""
    kept: dict[str, Any] = {}
    for key, value in mappings[0].items():
        inner = [other for one in mappings if isinstance(other := one.get(key), Mapping)]
        if len(inner) == len(mappings):
            kept[key] = _agreed(inner)
        elif all(one.get(key) == value for one in mappings):
            kept[key] = value
    return kept


def read_notes(folder: Path) -> str:
    """Read the hand-written Markdown of a folder of results; empty without any."""
    notes = folder / NOTES_FILE
    return notes.read_text(encoding="utf-8").strip("\n") if notes.is_file() else ""


def training_seed(evaluation: Evaluation) -> int | None:
    """Look up the seed a model was trained with, None if its metadata tells none."""
    seed = dict(spread(evaluation.model_metadata)).get("config.training.seed")
    return None if seed is None else int(seed)


def metadata_differences(evaluation: Evaluation, base: Evaluation) -> str:
    """Word what a model was trained with where that differs from another; empty if it does not."""
    ours, theirs = dict(settings(evaluation)), dict(settings(base))
    keys = [key for key in dict.fromkeys((*theirs, *ours)) if not key.startswith(_INCIDENTAL)]
    # Another division into stages has other networks; only those of the same name can differ in their settings.
    keys = [key for key in keys if not key.startswith(_NETWORKS) or (key in ours and key in theirs)]
    return "; ".join(
        f"{key} {plain(ours.get(key))} (`{base.model}`: {plain(theirs.get(key))})"
        for key in keys
        if ours.get(key) != theirs.get(key)
    )


def settings(evaluation: Evaluation) -> Iterator[tuple[str, Any]]:
    """Walk over what is recorded of a model, by path; settings that are younger than it have their defaults."""
    about = dict(evaluation.model_metadata)
    if "config" in about:
        usual, own = asdict(CascadeTraining()), about["config"]
        # Recorded with every stage's network, from the fingertip error.
        training = {name: value for name, value in own.get("training", {}).items() if name != "metric_weight"}
        del usual["training"]["metric_weight"]
        about["config"] = usual | own | {"training": usual["training"] | training}
    return spread(about)


def _check_conditions(path: Path, evaluation: Evaluation, first: Path, usual: Mapping[str, Any]) -> None:
    differing = [key for key, value in conditions(evaluation).items() if value != usual[key]]
    if differing:
        raise FileFormatError(
            f"{path} and {first} differ in {', '.join(differing)}; one table needs one protocol, hand and set of cells"
        )


def _by_seed(item: tuple[int | None, Evaluation]) -> int:
    return -1 if item[0] is None else item[0]


@dataclass(frozen=True)
class Entry:
    """One evaluation, and how the page speaks of it.

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
        """Protocol, hand and cells of the evaluation."""
        return conditions(self.evaluation)

    @property
    def total(self) -> Tally:
        """All trials together."""
        return self.evaluation.total

    @property
    def has_own_file(self) -> bool:
        """Tell it from one of the paper's experiment."""
        return not self.stem.startswith(f"{PAPER_FOLDER}/")


@dataclass(frozen=True)
class ResultsFolder:
    """A folder of results.

    Attributes:
        entries: evaluations; the conditions of the first, the heuristic's if there is one, are the page's.
        paper: the paper's experiment, None without one.
        measurements: other JSON objects by file stem.
        notes: text on where grasps fail; empty without any.
    """

    entries: Sequence[Entry]
    paper: PaperRuns | None
    measurements: Mapping[str, Mapping[str, Any]]
    notes: str

    @property
    def base(self) -> Entry:
        """The evaluation whose conditions are the page's."""
        return self.entries[0]

    @property
    def same(self) -> list[Entry]:
        """Evaluations under the page's conditions."""
        return [entry for entry in self.entries if entry.conditions == self.base.conditions]

    @property
    def other(self) -> list[Entry]:
        """Evaluations under other conditions."""
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
    return ResultsFolder(entries, paper, measurements, read_notes(folder))


def _read_files(folder: Path) -> tuple[list[Entry], dict[str, Mapping[str, Any]]]:
    entries: list[Entry] = []
    measurements: dict[str, Mapping[str, Any]] = {}
    taken: set[tuple[str, str]] = set()
    for path in sorted(folder.glob("*.json"), key=_order):
        data = read_json(path)
        if is_evaluation(data):
            evaluation = Evaluation.load(path)
            name = (evaluation.model, evaluation.protocol.name)
            # The first to bear a name keeps it; further training seeds, or hands, are told apart by their files.
            label = f"{evaluation.model} ({path.stem})" if name in taken else evaluation.model
            entries.append(Entry(path.stem, evaluation, label, (evaluation.seed,)))
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
