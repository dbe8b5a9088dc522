"""What the paper's experiment consists of: every model to train and every evaluation to make, as data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from graspcascade.proposals.cascade.sizes import SizeMode
from graspcascade.proposals.cascade.stages import FACTORIZATIONS, Factorization, Stage
from graspcascade.proposals.heuristic import HEURISTIC
from graspcascade.studies.learn import CascadeTraining

from .published import FULL_MODEL, PAPER_MODELS

SEEDS = dict.fromkeys(("model1", "model2", FULL_MODEL, "plain_rotation"), (0, 1, 2))
"""Training seeds of the models of Tables I and II; the others have the first alone."""
PAPER_PER_CELL, EXPERIMENT_PER_CELL = 500, 100
"""Trials for each object and type."""
PLAIN = "plain_training_and_paper_sizes"
"""Learns from all that held, unrepeated, unfolded, fingertip errors next to weightless; asks for the paper's sizes."""
_PLAIN: Mapping[str, Any] = {
    "learn_from": "held",
    "most_repeats": 1,
    "fold_rotations": False,
    "fingertip_error_m": 1.0,
}

_METRES_BESIDE_RADIANS = 0.0022
"""The weight of the position under which its error in metres counts like that of joint angles in radians.

Over the paper-sized dataset the variance of a coordinate is 0.00055 times that of a joint angle, whose weight is 4.
"""


@dataclass(frozen=True)
class Trained:
    """Describe one trained model.

    Attributes:
        name: of its folder.
        factorization: its stages.
        training: its training loop.
        trials_per_cell: learn from the first so many trials of each object and type; None for all.
    """

    name: str
    factorization: Factorization
    training: CascadeTraining = field(default_factory=CascadeTraining)
    trials_per_cell: int | None = None


@dataclass(frozen=True)
class Run:
    """Describe one evaluation.

    Attributes:
        name: of its folder and its JSON file.
        trained: the model, None for the heuristic.
        size_mode: how sizes are chosen for a side.
        screened: whether the heuristic draws again for an object that a posture is too wide for.
        is_experiment: whether it asks what another setting would do; the paper's own models do not.
    """

    name: str
    trained: Trained | None
    size_mode: SizeMode = "best"
    screened: bool = False
    is_experiment: bool = False

    @property
    def model(self) -> str:
        """Name under which rates are quoted."""
        return HEURISTIC if self.trained is None else self.trained.factorization.name

    @property
    def seed(self) -> int:
        """Seed of the evaluation: the training seed, so that trials of several seeds are independent."""
        return 0 if self.trained is None else self.trained.training.training.seed

    @property
    def per_cell(self) -> int:
        """Trials for each object and type."""
        return EXPERIMENT_PER_CELL if self.is_experiment else PAPER_PER_CELL


def paper_runs() -> list[Run]:
    """List the heuristic and the ten models, further training seeds after the first of all."""
    runs = [Run(HEURISTIC, None)]
    models = sorted((name for name in PAPER_MODELS if name != HEURISTIC), key=lambda name: name != FULL_MODEL)
    for number in range(max(map(len, SEEDS.values()))):
        runs += [Run(trained.name, trained) for name in models for trained in _seed(name, number)]
    return runs


def _seed(model: str, number: int) -> Iterable[Trained]:
    for seed in SEEDS.get(model, (0,))[number : number + 1]:
        yield Trained(f"{model}_seed{seed}", FACTORIZATIONS[model], _training(seed=seed))


def _training(seed: int = 0, **changes: Any) -> CascadeTraining:
    usual = CascadeTraining(**changes)
    return replace(usual, training=replace(usual.training, seed=seed))


def experiments() -> list[Run]:
    """List what else was tried: changes of Model 3, of Models 1 and 2 what may explain their rates, and screening."""
    shared = [run for model in (FULL_MODEL, "model1") for run in _shared(model)]
    screened = Run("heuristic_screened", None, screened=True, is_experiment=True)
    return [*_full_model_experiments(), *shared, _narrow("model2"), screened]


def _full_model_experiments() -> list[Run]:
    one = partial(_changed, FULL_MODEL)
    stages = partial(_with_stages, FULL_MODEL)
    return [
        *(one(f"sizes_{mode}", size_mode=mode) for mode in ("median", "drawn")),
        one("settled_object_pose", training=_training(object_pose="settled")),
        one("rare_cells_not_repeated", training=_training(most_repeats=1)),
        one("rotation_from_mixture", factorization=stages(lambda stage: replace(stage, rotation_head="vmf_mixture"))),
        one("twice_the_latent", factorization=stages(lambda stage: replace(stage, latent_dim=2 * stage.latent_dim))),
        one("divergence_weight_0.1", factorization=stages(lambda stage: replace(stage, kl_weight=0.1))),
        one("divergence_weight_1", factorization=stages(lambda stage: replace(stage, kl_weight=1.0))),
        one("layers_twice_as_wide", factorization=stages(_scale_layers(2))),
        one("1200_trials_per_cell", trials_per_cell=1200),
        one("opposition_frame", factorization=FACTORIZATIONS["model3_opposition_frame"]),
    ]


def _shared(model: str) -> list[Run]:
    one = partial(_changed, model)
    half = _with_stages(model, lambda stage: replace(stage, latent_dim=max(1, stage.latent_dim // 2)))
    return [
        one("sizes_paper", size_mode="paper"),
        one("learn_from_all_held", training=_training(learn_from="held")),
        one("rotations_not_folded", training=_training(fold_rotations=False)),
        one("fingertip_errors_hardly_count", training=_training(fingertip_error_m=1.0)),
        one("errors_in_metres_and_radians", training=_training(position_weight=_METRES_BESIDE_RADIANS)),
        one("half_the_latent", factorization=half),
        _narrow(model),
        one("300_trials_per_cell", trials_per_cell=300),
        one(PLAIN, training=_training(**_PLAIN), size_mode="paper"),
    ]


def _narrow(model: str) -> Run:
    return _changed(model, "layers_an_eighth_as_wide", factorization=_with_stages(model, _scale_layers(1 / 8)))


def _changed(model: str, name: str, size_mode: SizeMode = "best", **fields: Any) -> Run:
    usual = Trained(f"{model}_seed0", FACTORIZATIONS[model])
    name = name if model == FULL_MODEL else f"{name}_{model}"
    return Run(name, replace(usual, name=name, **fields) if fields else usual, size_mode, is_experiment=True)


def _with_stages(model: str, change: Callable[[Stage], Stage]) -> Factorization:
    usual = FACTORIZATIONS[model]
    return replace(usual, stages=tuple(change(stage) for stage in usual.stages))


def _scale_layers(factor: float) -> Callable[[Stage], Stage]:
    return lambda stage: replace(stage, hidden=tuple(round(factor * width) for width in stage.hidden))
