"""Fitting a cascade to a dataset: one call of the training loop for each stage (needs torch, the `train` extra)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..candidates import opposition_points
from ..dataset import Dataset
from ..dataset.collect import versions
from ..errors import InputError
from ..grasps import Grasps
from ..hands import HandModel
from ..nets import EpochRecord, NumpyDecoder, TrainingSpec
from ..postures import contact_metric
from ..trials import Outcomes
from .encoding import Request, condition_matrix, encode_posture, encode_request, vae_spec
from .frames import fold_rotations, learning_frame
from .sampler import GraspSampler
from .sizes import SizeRule
from .stages import Factorization, Stage, Target

if TYPE_CHECKING:
    from ..nets import Fitted

Array = NDArray[np.float64]
Progress = Callable[[str, EpochRecord], None]


@dataclass(frozen=True)
class CascadeTraining:
    """Say what to learn from and how long."""

    learn_from: Literal["faithful", "held"] = "faithful"
    """Which successes: those that also touch every digit their type needs, or all that held."""
    object_pose: Literal["placed", "settled"] = "placed"
    """The object's pose to learn: where the candidate put it, or where closing left it."""
    fingertip_error_m: float = 0.002
    """Error of the contact places that counts as much as one standard deviation of a joint angle."""
    training: TrainingSpec = field(default_factory=lambda: TrainingSpec(epochs=80, batch_size=1024))
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
        """Write weights and metadata to `folder` (see `GraspSampler.save`)."""
        self.sampler.save(folder)


def fit_cascade(
    hand: HandModel,
    dataset: Dataset,
    factorization: Factorization,
    config: CascadeTraining | None = None,
    progress: Progress | None = None,
) -> FittedCascade:
    """Train every stage of a factorization on the successes of a dataset.

    Raises:
        InputError: the dataset is of another hand or holds too few successes.
    """
    config = config or CascadeTraining()
    if dataset.grasps.joint_names != hand.joint_names:
        raise InputError(f"the dataset's joints are not those of {hand.description.name}")
    material = prepare(hand, dataset, factorization, config)
    decoders, history = {}, {}
    for stage in factorization.stages:
        fitted = _fit_stage(material, stage, config, progress)
        decoders[stage.name] = NumpyDecoder.from_fitted(fitted)
        history[stage.name] = fitted.history
    metadata = _metadata(dataset, config, len(material.request.side_m), history)
    return FittedCascade(
        GraspSampler(factorization.name, hand, factorization, decoders, material.sizes, metadata), history
    )


@dataclass(frozen=True)
class Material:
    """Hold what stages are trained on: requests, targets by name, condition columns by quantity, contact metric."""

    request: Request
    targets: dict[Target, Array]
    quantities: dict[Any, Array]
    metric: NDArray[np.float32]
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
    grasps, outcomes = dataset.grasps[rows], dataset.outcomes[rows]
    request = _request(grasps, outcomes)
    pose = grasps.X_hand_object if config.object_pose == "placed" else outcomes.X_hand_object_settled
    thumb, other = opposition_points(hand, grasps.posture, grasps.grasp_type)
    in_frame = learning_frame(thumb, other, factorization.frame).inverse() @ pose
    rotation = fold_rotations(in_frame.quat_wxyz, grasps.object_label, grasps.side_axis, factorization.frame)
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
    metric = contact_metric(hand, grasps.posture, grasps.grasp_type)
    return Material(request, targets, quantities, metric, sizes)


def _request(grasps: Grasps, outcomes: Outcomes) -> Request:
    return Request(
        grasps.grasp_type,
        grasps.object_label,
        grasps.side_axis,
        grasps.side_m,
        grasps.grasp_size_m,
        outcomes.object_size_m,
    )


def _fit_stage(material: Material, stage: Stage, config: CascadeTraining, progress: Progress | None) -> Fitted:
    # torch is an optional extra: only fitting needs it.
    from ..nets.training import fit

    condition = condition_matrix(stage, material.quantities)
    target = np.concatenate([material.targets[name] for name in stage.targets], axis=1).astype(np.float32)
    spec = vae_spec(stage, material.targets["posture"].shape[1], condition.shape[1])
    has_posture = stage.targets[0] == "posture"
    weight = 1.0 / config.fingertip_error_m**2 if has_posture else 0.0
    return fit(
        spec,
        replace(config.training, metric_weight=weight),
        target,
        condition,
        metric=material.metric if has_posture else None,
        progress=None if progress is None else lambda record: progress(stage.name, record),
    )


def _metadata(
    dataset: Dataset, config: CascadeTraining, n: int, history: dict[str, tuple[EpochRecord, ...]]
) -> dict[str, Any]:
    about = dataset.metadata
    return {
        "config": asdict(config),
        "learned_from": n,
        "dataset": {key: about.get(key) for key in ("seed", "prior", "hand", "screening")}
        | {"trials": len(dataset.outcomes), "protocol": about["protocol"]["name"]},
        "versions": versions(),
        "final_loss": {name: round(records[-1].train_loss, 4) for name, records in history.items()},
    }
