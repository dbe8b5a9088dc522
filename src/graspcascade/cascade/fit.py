"""Fitting a cascade to a dataset: one call of the training loop for each stage (needs torch, the `train` extra)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..dataset import Dataset
from ..dataset.shards import shards_digest
from ..errors import InputError
from ..files import write_json
from ..hands import HandModel
from ..machine import versions
from ..nets import EpochRecord, NumpyDecoder, TrainingSpec, VaeSpec
from ..workers import run_jobs
from .encoding import condition_matrix, vae_spec
from .material import CascadeTraining, Material, prepare
from .sampler import GraspSampler
from .stages import Factorization, Stage

if TYPE_CHECKING:
    from ..nets import Fitted

Progress = Callable[[str, EpochRecord], None]
TRAINING_FILE = "training.json"
_CURVES = ("epoch", "learning_rate", "train_loss", "train_reconstruction", "train_kl", "validation_loss")


@dataclass(frozen=True)
class FittedCascade:
    """Hold a trained cascade and its training curves.

    Attributes:
        sampler: ready to sample.
        history: one record per epoch by stage name.
    """

    sampler: GraspSampler
    history: dict[str, tuple[EpochRecord, ...]]

    def save(self, folder: Path | str) -> None:
        """Write weights and metadata to `folder` (see `GraspSampler.save`), and the training curves beside them."""
        self.sampler.save(folder)
        write_json(Path(folder) / TRAINING_FILE, self.curves())

    def curves(self) -> dict[str, Any]:
        """Give the training curves with what they are of: by stage a list for each quantity, one value per epoch."""
        about = self.sampler.metadata
        stages = {
            name: {curve: [getattr(record, curve) for record in records] for curve in _CURVES}
            for name, records in self.history.items()
        }
        return {
            "factorization": self.sampler.factorization.name,
            "seed": about["config"]["training"]["seed"],
            "learned_from": about["learned_from"],
            "dataset": about["dataset"],
            "config": about["config"],
            "versions": about["versions"],
            "stages": stages,
        }


def fit_cascade(
    hand: HandModel,
    dataset: Dataset,
    factorization: Factorization,
    config: CascadeTraining | None = None,
    progress: Progress | None = None,
    workers: int = 0,
) -> FittedCascade:
    """Train every stage of a factorization on the successes of a dataset.

    Stages need the data and not each other, so they are trained side by side.

    Args:
        hand: the hand that the dataset is of.
        dataset: trials, of which the successes are learned.
        factorization: the stages.
        config: what to learn and how long.
        progress: called in this process after every epoch of every stage.
        workers: processes to train in, 0 for as many as processors and at most one a stage; 1 trains in this process.
            The weights are the same bit by bit.

    Raises:
        InputError: the dataset is of another hand or holds too few successes, or `workers` is negative.
        FloatingPointError: a stage's loss stopped being finite.
    """
    config = config or CascadeTraining()
    if dataset.grasps.joint_names != hand.joint_names:
        raise InputError(f"the dataset's joints are not those of {hand.description.name}")
    own = hand.description.fingerprint()
    if dataset.metadata.get("hand_fingerprint", own) != own:
        raise InputError(f"the dataset was collected with another model of the hand than {hand.description.name}")
    material = prepare(hand, dataset, factorization, config)
    fitted = _fit_stages(material, factorization, config, progress, workers)
    decoders = {name: NumpyDecoder.from_fitted(found) for name, found in fitted.items()}
    history = {name: found.history for name, found in fitted.items()}
    metadata = _metadata(dataset, config, material.n_grasps, history)
    return FittedCascade(
        GraspSampler(factorization.name, hand, factorization, decoders, material.sizes, metadata), history
    )


@dataclass(frozen=True, eq=False)
class StageJob:
    """Hold all that training one stage takes, so that another process can do it.

    Attributes:
        name: the stage's name.
        spec: its network.
        training: its training loop.
        target: ``(n, spec.target_dim)``.
        condition: ``(n, spec.condition_dim)``.
        metric: computes the contact metric that weighs its errors, None without one.
    """

    name: str
    spec: VaeSpec
    training: TrainingSpec
    target: NDArray[np.float32]
    condition: NDArray[np.float32]
    metric: Callable[[], NDArray[np.float32]] | None

    @classmethod
    def of(cls, material: Material, stage: Stage, config: CascadeTraining) -> StageJob:
        """Collect what a stage takes."""
        condition = condition_matrix(stage, material.quantities)
        target = np.concatenate([material.targets[name] for name in stage.targets], axis=1).astype(np.float32)
        has_posture = stage.targets[0] == "posture"
        return cls(
            stage.name,
            vae_spec(stage, material.targets["posture"].shape[1], condition.shape[1], config.position_weight),
            replace(config.training, metric_weight=1.0 / config.fingertip_error_m**2 if has_posture else 0.0),
            target,
            condition,
            material.metric if has_posture else None,
        )

    @property
    def cost(self) -> tuple[bool, int]:
        """Compare with other stages of the same rows: a metric is work before training and in every step."""
        widths = (self.spec.encoder_widths, self.spec.decoder_widths)
        return self.metric is not None, sum(a * b for layers in widths for a, b in pairwise(layers))

    def __call__(self, report: Callable[[EpochRecord], None]) -> Fitted:
        """Train the stage."""
        # torch is an optional extra: only fitting needs it.
        from ..nets.training import fit

        metric = None if self.metric is None else self.metric()
        return fit(self.spec, self.training, self.target, self.condition, metric, report)


def _fit_stages(
    material: Material, factorization: Factorization, config: CascadeTraining, progress: Progress | None, workers: int
) -> dict[str, Fitted]:
    """Train the stages, the longest first so that none of the others has to wait for it in the end."""
    jobs = [StageJob.of(material, stage, config) for stage in factorization.stages]
    jobs.sort(key=lambda job: job.cost, reverse=True)

    def report(number: int, record: EpochRecord) -> None:
        if progress is not None:
            progress(jobs[number].name, record)

    found = dict(zip([job.name for job in jobs], run_jobs(jobs, workers, report), strict=True))
    return {stage.name: found[stage.name] for stage in factorization.stages}


def _metadata(
    dataset: Dataset, config: CascadeTraining, n: int, history: dict[str, tuple[EpochRecord, ...]]
) -> dict[str, Any]:
    about = dataset.metadata
    return {
        "config": asdict(config),
        "learned_from": n,
        "dataset": {key: about.get(key) for key in ("seed", "prior", "hand", "screening")}
        | {"trials": len(dataset.outcomes), "protocol": about["protocol"]["name"], "shards": shards_digest(about)},
        "versions": versions() | {"torch": version("torch")},
        "final_loss": {name: round(records[-1].train_loss, 4) for name, records in history.items()},
    }
