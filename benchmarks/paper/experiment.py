"""Train the paper's models on a collected dataset and evaluate each; run again to go on where it stopped.

Example, with the dataset that docs/reproduce.md tells how to collect::

    python -m benchmarks.paper.experiment --data data --out runs --results docs/results/paper

Trained models and finished rounds of trials stay in `--out`; the JSON that the report reads goes to
`--results`. An interruption costs one training of one model, or one round of trials.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import command, shipped_heuristic
from benchmarks.paper.runs import EXPERIMENTS_FOLDER, TRAINING_FOLDER
from benchmarks.paper.settings import Run, Trained, experiments, paper_runs
from graspcascade.cli.console import bar, interval
from graspcascade.core.errors import InputError, unknown
from graspcascade.core.files import write_folder_staged, write_text
from graspcascade.hands import load_hand
from graspcascade.nets import EpochRecord, TrainingSpec
from graspcascade.proposals import Proposal
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.heuristic import Screened
from graspcascade.studies.dataset import Dataset, load_dataset, read_metadata, shards_digest
from graspcascade.studies.evaluate import evaluate
from graspcascade.studies.learn import TRAINING_FILE, CascadeTraining, fit_cascade
from graspcascade.studies.record import Evaluation


@dataclass(frozen=True)
class Arguments:
    """Run the paper's experiment."""

    data: Path = Path("data")
    """Folder of the dataset."""
    out: Path = Path("runs")
    """Folder for trained models and finished rounds of trials."""
    results: Path = Path("docs/results/paper")
    """Folder for the JSON files of the results page."""
    only: tuple[str, ...] = ()
    """Names of runs to make, the paper's models without it; `--list` shows them."""
    experiments: bool = False
    """Make the further experiments too."""
    train_only: bool = False
    """Train, and evaluate nothing."""
    list: bool = False
    """Print the names of all runs and do nothing."""


class Experiment:
    """Make runs, each once.

    Args:
        arguments: where to read and write.
    """

    def __init__(self, arguments: Arguments) -> None:
        self._arguments = arguments

    def make(self, run: Run) -> None:
        """Train what a run needs, evaluate it and publish its JSON."""
        sampler = None if run.trained is None else self._trained(run.trained)
        if run.trained is not None and not run.is_experiment:
            self._publish(self._model_folder(run.trained) / TRAINING_FILE, TRAINING_FOLDER, run.trained.name)
        if self._arguments.train_only:
            return
        print(f"{run.name}: held {interval(self._evaluate(run, sampler).held.to_json())}", flush=True)

    @cache  # noqa: B019 - one experiment lives as long as the program
    def _dataset(self) -> Dataset:
        return load_dataset(self._arguments.data)

    def _trained(self, wanted: Trained) -> GraspSampler:
        folder = self._model_folder(wanted)
        if not folder.is_dir():
            folder.parent.mkdir(parents=True, exist_ok=True)
            write_folder_staged(folder, lambda staged: self._fit(wanted, staged))
        sampler = GraspSampler.load(folder)
        if trained_with(sampler) != wanted.training or sampler.factorization != wanted.factorization:
            raise InputError(f"{folder} was trained with other settings; remove it to train again")
        about, learned = read_metadata(self._arguments.data), sampler.metadata["dataset"]
        if (learned["shards"], learned["trials"]) != (shards_digest(about), trials_used(about, wanted.trials_per_cell)):
            raise InputError(f"{folder} was trained on another dataset than {self._arguments.data}; remove it")
        return sampler

    def _model_folder(self, wanted: Trained) -> Path:
        return self._arguments.out / "models" / wanted.name

    def _fit(self, wanted: Trained, folder: Path) -> None:
        dataset = self._dataset()
        if wanted.trials_per_cell is not None:
            dataset = first_trials(dataset, wanted.trials_per_cell)
        done: dict[str, int] = {}
        with bar(f"training {wanted.name}") as progress:

            def show(stage: str, record: EpochRecord) -> None:
                done[stage] = record.epoch
                progress.show(sum(done.values()), len(wanted.factorization.stages) * record.epochs)

            fitted = fit_cascade(load_hand("shadow"), dataset, wanted.factorization, wanted.training, show)
        fitted.save(folder)

    def _evaluate(self, run: Run, sampler: GraspSampler | None) -> Evaluation:
        if sampler is None:
            heuristic = shipped_heuristic()
            proposal: Proposal = Screened(heuristic) if run.screened else heuristic
        else:
            proposal = replace(sampler, size_mode=run.size_mode)
        folder = self._arguments.out / "trials" / run.name
        with bar(f"trials of {run.name}") as progress:
            evaluation = evaluate(
                proposal,
                per_cell=run.per_cell,
                seed=run.seed,
                out=folder,
                progress=progress.show,
                name=run.model,
            )
        self._publish(folder / "evaluation.json", EXPERIMENTS_FOLDER if run.is_experiment else ".", run.name)
        return evaluation

    def _publish(self, path: Path, folder: str, name: str) -> None:
        write_text(self._arguments.results / folder / f"{name}.json", path.read_text(encoding="utf-8"))


def trained_with(sampler: GraspSampler) -> CascadeTraining:
    """Rebuild the settings a model was trained with."""
    config = sampler.metadata["config"]
    return CascadeTraining(**config | {"training": TrainingSpec(**config["training"])})


def trials_used(about: dict[str, Any], per_cell: int | None) -> int:
    """Count the trials of a dataset, or the first of each object and type (see `first_trials`), by its metadata."""
    trials = [cell["trials"] for cell in about["counts"]["cells"]]
    return sum(trials if per_cell is None else (min(count, per_cell) for count in trials))


def first_trials(dataset: Dataset, per_cell: int) -> Dataset:
    """Keep the first trials of each object and type."""
    cells = dataset.grasps.tasks.groups(lambda task: task.cell)
    rows = np.sort(np.concatenate([np.flatnonzero(of_cell)[:per_cell] for _, of_cell in cells]))
    return Dataset(dataset.grasps[rows], dataset.outcomes[rows], dataset.metadata)


def main(arguments: Arguments) -> None:
    """Make the runs that were asked for, one after another."""
    runs = {run.name: run for run in paper_runs()}
    others = {run.name: run for run in experiments()}
    if arguments.list:
        print("\n".join([*runs, *(f"{name} (experiment)" for name in others)]))
        return
    for name in arguments.only:
        if name not in runs | others:
            raise unknown("run", name, [*runs, *others])
    chosen = arguments.only or (*runs, *(others if arguments.experiments else ()))
    experiment = Experiment(arguments)
    for name in chosen:
        experiment.make((runs | others)[name])


if __name__ == "__main__":
    sys.exit(command("benchmarks.paper.experiment", Arguments, main))
