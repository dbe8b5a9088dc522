"""Fitting a cascade to a dataset: one call of the training loop for each stage (needs torch, the `train` extra)."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..candidates import opposition_points
from ..dataset import Dataset
from ..dataset.collect import versions
from ..dataset.shards import shards_digest
from ..errors import InputError
from ..files import write_text
from ..grasps import Grasps
from ..hands import HandModel
from ..nets import EpochRecord, NumpyDecoder, TrainingSpec, VaeSpec
from ..postures import contact_metric
from ..trials import Outcomes
from ..workers import run_jobs
from .encoding import Cells, Request, condition_matrix, encode_posture, encode_request, vae_spec
from .frames import fold_rotations, learning_frame
from .sampler import GraspSampler
from .sizes import SizeRule
from .stages import Factorization, Stage, Target

if TYPE_CHECKING:
    from ..nets import Fitted

Array = NDArray[np.float64]
Progress = Callable[[str, EpochRecord], None]
TRAINING_FILE = "training.json"
_CURVES = ("epoch", "learning_rate", "train_loss", "train_reconstruction", "train_kl", "validation_loss")


@dataclass(frozen=True)
class CascadeTraining:
    """Say what to learn from and how long."""

    learn_from: Literal["faithful", "held"] = "faithful"
    """Which successes: those that also touch every digit their type needs, or all that held."""
    object_pose: Literal["placed", "settled"] = "placed"
    """The object's pose to learn: where the candidate put it, or where closing left it."""
    most_repeats: int = 20
    """Grasps of an object and type that has fewer than most are repeated up to so many times, so that all are learned
    alike; 1 for never."""
    fold_rotations: bool = True
    """Replace rotations by their images under the object's symmetry that lie nearest to one reference."""
    fingertip_error_m: float = 0.002
    """Error of the contact places that counts as much as one standard deviation of a joint angle."""
    training: TrainingSpec = field(
        default_factory=lambda: TrainingSpec(epochs=80, max_steps=10_000, batch_size=512, learning_rate=4e-3)
    )
    """The training loop of every stage; its metric weight is set from the fingertip error."""


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
        write_text(Path(folder) / TRAINING_FILE, json.dumps(self.curves(), indent=1) + "\n")

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
    material = prepare(hand, dataset, factorization, config)
    fitted = _fit_stages(material, factorization, config, progress, workers)
    decoders = {name: NumpyDecoder.from_fitted(found) for name, found in fitted.items()}
    history = {name: found.history for name, found in fitted.items()}
    metadata = _metadata(dataset, config, material.n_grasps, history)
    return FittedCascade(
        GraspSampler(factorization.name, hand, factorization, decoders, material.sizes, metadata), history
    )


@dataclass(frozen=True)
class Material:
    """Hold what stages are trained on: requests, targets by name, condition columns by quantity.

    `n_grasps` counts the grasps, some of which may be in several rows. The contact metric is computed when called: it
    is far larger than all the rest, and only one stage needs it.
    """

    n_grasps: int
    request: Request
    targets: dict[Target, Array]
    quantities: dict[Any, Array]
    metric: Callable[[], NDArray[np.float32]]
    sizes: SizeRule


def prepare(hand: HandModel, dataset: Dataset, factorization: Factorization, config: CascadeTraining) -> Material:
    """Encode the successes of a dataset for training.

    Raises:
        InputError: fewer than 100 successes.
    """
    held = dataset.outcomes.held
    rows = dataset.outcomes.faithful(dataset.grasps) if config.learn_from == "faithful" else held
    if rows.sum() < 100:
        raise InputError(f"only {int(rows.sum())} {config.learn_from} grasps to learn from; at least 100 are needed")
    sizes = SizeRule.measure(_request(dataset.grasps, dataset.outcomes), rows, held)
    places = repeat_rare(dataset.grasps, np.flatnonzero(rows), config.most_repeats, config.training.seed)
    grasps, outcomes = dataset.grasps[places], dataset.outcomes[places]
    request = _request(grasps, outcomes)
    pose = grasps.X_hand_object if config.object_pose == "placed" else outcomes.X_hand_object_settled
    thumb, other = opposition_points(hand, grasps.posture, grasps.grasp_type)
    in_frame = learning_frame(thumb, other, factorization.frame).inverse() @ pose
    rotation = in_frame.quat_wxyz
    if config.fold_rotations:
        rotation = fold_rotations(rotation, grasps.object_label, grasps.side_axis, factorization.frame)
    # The object size that will be asked for is the cell's median, so training sees that and not each grasp's own.
    _, aimed = sizes.apply(request, "median", np.random.default_rng(0))
    quantities: dict[Any, Array] = dict(encode_request(replace(request, object_size_m=aimed)))
    quantities["posture"] = encode_posture(grasps.posture, thumb, other)
    quantities["position"] = in_frame.position_m
    targets: dict[Target, Array] = {
        "posture": grasps.posture,
        "position": in_frame.position_m,
        "rotation": rotation,
    }
    metric = partial(contact_metric, hand, grasps.posture, grasps.grasp_type)
    return Material(int(rows.sum()), request, targets, quantities, metric, sizes)


def repeat_rare(grasps: Grasps, places: NDArray[np.intp], most: int, seed: int) -> NDArray[np.intp]:
    """Repeat grasps of rare objects and types until these have as many as the median one.

    Args:
        grasps: from which to choose.
        places: ``(n,)`` the chosen ones.
        most: times that one is in the answer at the most.
        seed: of the draw of those that are in it once more than others.

    Returns:
        The places, each at least once, in order.
    """
    cells = Cells.find(grasps.grasp_type[places], grasps.object_label[places]).of_row
    counts = np.bincount(cells)
    enough, rng = int(np.median(counts)), np.random.default_rng(seed)
    chosen = [places]
    for cell in np.flatnonzero(counts < enough):
        some = places[cells == cell]
        repeats, rest = divmod(min(enough, most * len(some)) - len(some), len(some))
        chosen += [np.repeat(some, repeats), rng.permutation(some)[:rest]]
    return np.sort(np.concatenate(chosen))


def _request(grasps: Grasps, outcomes: Outcomes) -> Request:
    return Request(
        grasps.grasp_type,
        grasps.object_label,
        grasps.side_axis,
        grasps.side_m,
        grasps.grasp_size_m,
        outcomes.object_size_m,
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
            vae_spec(stage, material.targets["posture"].shape[1], condition.shape[1]),
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
