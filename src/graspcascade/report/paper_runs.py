"""The paper's experiment as it was run here: evaluations by model and training seed, read from one folder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ..cascade import CascadeTraining
from ..errors import FileFormatError
from ..evaluation.record import Evaluation, pool
from .curves import TrainingCurves, read_training
from .markdown import plain
from .measurements import spread
from .published import FULL_MODEL, PAPER_MODELS

PAPER_FOLDER = "paper"
"""Folder of the experiment beside the other evaluations."""
EXPERIMENTS_FOLDER, TRAINING_FOLDER, NOTES_FILE = "experiments", "training", "notes.md"

# A retrained model differs in these without being another model.
_INCIDENTAL = ("versions.", "final_loss.", "weights", "config.training.seed", "config.training.threads")
_NETWORKS = "networks."


@dataclass(frozen=True)
class Runs:
    """Hold the evaluations of one model, one for each training seed.

    Attributes:
        model: its name.
        by_seed: evaluations by training seed; None is the seed of what is not trained, such as the heuristic.
    """

    model: str
    by_seed: Mapping[int | None, Evaluation]

    @cached_property
    def pooled(self) -> Evaluation:
        """Give the trials of all training seeds together, as one evaluation."""
        return pool(list(self.by_seed.values()))

    @property
    def title(self) -> str:
        """Name the model and, if there are several, the number of its training seeds."""
        return self.model if len(self.by_seed) == 1 else f"{self.model}, {len(self.by_seed)} training seeds"


@dataclass(frozen=True)
class PaperRuns:
    """Hold what the folder of the experiment holds.

    Attributes:
        runs: by model, in the order of the paper's tables; without those that were not run.
        experiments: evaluations of other settings, by label.
        training: training curves.
        notes: text on what they show; empty without any.
    """

    runs: Mapping[str, Runs]
    experiments: Mapping[str, Evaluation]
    training: Sequence[TrainingCurves]
    notes: str

    @property
    def conditions(self) -> dict[str, Any]:
        """Give what all rates of the paper's models have in common; empty if none was run."""
        return next((runs.pooled.conditions for runs in self.runs.values()), {})

    def comparable(self, found: Evaluation) -> bool:
        """Tell whether an experiment was evaluated under the conditions of the paper's models."""
        return found.conditions == self.conditions

    def base_of(self, experiment: Evaluation) -> Evaluation | None:
        """Give the model an experiment made something of: of its name or else the full model, None if not yet run.

        Of several training seeds it is the experiment's own, which also asks for the same grasps.
        """
        runs = self.runs.get(experiment.model) or self.runs.get(FULL_MODEL)
        return None if runs is None else runs.by_seed.get(training_seed(experiment), runs.pooled)

    @property
    def by_setting(self) -> dict[str, dict[str, Evaluation]]:
        """Give, by setting and model, the comparable experiments that were made with the full model and with others.

        Those with another than the full model are labelled with the setting and the model. The first setting is the
        usual one, with the same training seeds; there is none without experiments.
        """
        found: dict[str, dict[str, Evaluation]] = {}
        for label, one in self.experiments.items():
            if self.comparable(one):
                found.setdefault(label.removesuffix(f" {one.model}"), {})[one.model] = one
        found = {name: models for name, models in found.items() if FULL_MODEL in models and len(models) > 1}
        usual = {one.model: base for models in found.values() for one in models.values() if (base := self.base_of(one))}
        return {"as above": usual, **found} if FULL_MODEL in usual and len(usual) > 1 else {}


def read_paper_runs(folder: Path | str) -> PaperRuns | None:
    """Read the folder of the experiment.

    Evaluations of the paper's models are its own JSON files, those of other settings lie in `experiments/` and training
    curves in `training/`.

    Returns:
        What is there, in any state of completion; None where there is no folder.

    Raises:
        FileFormatError: a file is foreign; one of the models' is of no model of the paper, repeats a training seed, or
            was run under other conditions than its neighbours.
    """
    folder = Path(folder)
    if not folder.is_dir():
        return None
    found: dict[str, dict[int | None, Evaluation]] = {}
    first: tuple[Path, dict[str, Any]] | None = None
    for path in sorted(folder.glob("*.json")):
        evaluation = Evaluation.load(path)
        first = first or (path, evaluation.conditions)
        _check_conditions(path, evaluation, *first)
        if evaluation.model not in PAPER_MODELS:
            raise FileFormatError(
                f"{path} is of {evaluation.model!r}, no model of the paper; valid: {', '.join(PAPER_MODELS)}"
            )
        seeds = found.setdefault(evaluation.model, {})
        seed = training_seed(evaluation)
        if seed in seeds:
            raise FileFormatError(f"{path} repeats training seed {seed} of {evaluation.model}; trials count once")
        seeds[seed] = evaluation
    notes = folder / NOTES_FILE
    return PaperRuns(
        {name: Runs(name, dict(sorted(found[name].items(), key=_by_seed))) for name in PAPER_MODELS if name in found},
        {_label(path): Evaluation.load(path) for path in sorted((folder / EXPERIMENTS_FOLDER).glob("*.json"))},
        read_training(folder / TRAINING_FOLDER),
        notes.read_text(encoding="utf-8").strip("\n") if notes.is_file() else "",
    )


def training_seed(found: Evaluation) -> int | None:
    """Give the seed a model was trained with, None if its metadata tells none."""
    seed = dict(spread(found.model_metadata)).get("config.training.seed")
    return None if seed is None else int(seed)


def metadata_differences(found: Evaluation, base: Evaluation) -> str:
    """Word what a model was trained with where that differs from another; empty if it does not."""
    ours, theirs = dict(settings(found)), dict(settings(base))
    keys = [key for key in dict.fromkeys((*theirs, *ours)) if not key.startswith(_INCIDENTAL)]
    # Another division into stages has other networks; only those of the same name can differ in their settings.
    keys = [key for key in keys if not key.startswith(_NETWORKS) or (key in ours and key in theirs)]
    return "; ".join(
        f"{key} {plain(ours.get(key))} (`{base.model}`: {plain(theirs.get(key))})"
        for key in keys
        if ours.get(key) != theirs.get(key)
    )


def settings(found: Evaluation) -> Iterator[tuple[str, Any]]:
    """Walk over what is recorded of a model, by path; settings that are younger than it have their defaults."""
    about = dict(found.model_metadata)
    if "config" in about:
        usual, own = asdict(CascadeTraining()), about["config"]
        # Given with every stage's network, from the fingertip error.
        training = {name: value for name, value in own.get("training", {}).items() if name != "metric_weight"}
        del usual["training"]["metric_weight"]
        about["config"] = usual | own | {"training": usual["training"] | training}
    return spread(about)


def _check_conditions(path: Path, found: Evaluation, first: Path, usual: Mapping[str, Any]) -> None:
    differing = [key for key, value in found.conditions.items() if value != usual[key]]
    if differing:
        raise FileFormatError(
            f"{path} and {first} differ in {', '.join(differing)}; one table needs one protocol, hand and set of cells"
        )


def _by_seed(item: tuple[int | None, Evaluation]) -> int:
    return -1 if item[0] is None else item[0]


def _label(path: Path) -> str:
    return path.stem.replace("_", " ")
