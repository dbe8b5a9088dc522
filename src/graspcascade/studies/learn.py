"""Training the posture prior on labelled postures and a cascade on a dataset (needs torch, the `train` extra)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError, check_name, check_whole
from ..core.files import write_json
from ..core.grasps import Grasps
from ..core.machine import versions
from ..core.outcomes import Outcomes
from ..core.poses import canonical_quat, quat_multiply
from ..core.tasks import Task
from ..core.taxonomy import GRASP_TYPES, TAXONOMIES, GraspType, as_type
from ..hands import Hand
from ..nets import EpochRecord, HeadSpec, NumpyDecoder, TrainingSpec, VaeSpec
from ..proposals.cascade.encoding import (
    Request,
    Vocabulary,
    check_side,
    condition_matrix,
    encode_posture,
    encode_request,
    fold_rotations,
    learning_frame,
    site_frames,
    vae_spec,
)
from ..proposals.cascade.sampler import GraspSampler
from ..proposals.cascade.sizes import SizeRule
from ..proposals.cascade.stages import Factorization, ObjectCode, Stage, Target
from ..proposals.heuristic import opposition_points
from ..proposals.prior import PosturePrior, type_codes
from .dataset import Dataset, shards_digest
from .executor import run_jobs
from .postures import LabelledPostures

if TYPE_CHECKING:
    from ..nets import Fitted

Array = NDArray[np.float64]
LearnFrom = Literal["faithful", "held"]
ObjectPose = Literal["placed", "settled"]
Progress = Callable[[str, EpochRecord], None]
TRAINING_FILE = "training.json"
_TYPES = [kind for types in TAXONOMIES.values() for kind in types.values()]
N_ROWS = 3 * max(len(kind.opposition) - 1 + len(kind.support) for kind in _TYPES)
"""Rows of a contact metric: from the thumb's place to the first opposing it, then from there to each further place."""
_CURVES = ("epoch", "learning_rate", "train_loss", "train_reconstruction", "train_kl", "validation_loss")
_FINGERTIP_ERRORS_M = (1e-9, 1e9)
"""Beyond these bounds the weight of the contact metric, an inverse square, is no longer a number."""


# The prior

PRIOR_TRAINING = TrainingSpec(
    epochs=600,
    min_steps=2400,  # what 600 passes over the 1,200 default seeds make
    batch_size=256,
    learning_rate=2e-3,
    metric_weight=1.0 / 0.002**2,
    validation_fraction=0.0,
)
"""Default training of the prior; a fingertip error of 2 mm weighs as much as one standard deviation of a joint."""


def fit_prior(
    hand: Hand,
    seeds: LabelledPostures,
    training: TrainingSpec = PRIOR_TRAINING,
    progress: Callable[[EpochRecord], None] | None = None,
) -> PosturePrior:
    """Train the prior on labelled postures (needs torch, the `train` extra).

    Raises:
        InputError: the postures are of other joints than the hand, or in another order, or none are left to train on.
        FloatingPointError: the loss stopped being finite.
    """
    if seeds.joint_names != hand.joint_names:
        raise InputError(
            f"the labelled postures are of the joints {', '.join(seeds.joint_names)}, but those of "
            f"{hand.name} are, in order, {', '.join(hand.joint_names)}"
        )
    # torch is an optional extra: only fitting needs it.
    from ..nets.training import fit

    heads = (HeadSpec("gaussian", len(hand.joint_names), weight=4.0),)
    types = TAXONOMIES[seeds.taxonomy]
    kinds = tuple(name for name in types if name in seeds.grasp_type)
    spec = VaeSpec(condition_dim=len(kinds), heads=heads, latent_dim=10, hidden=(128, 128), kl_weight=0.5)
    postures, codes = hand.executed(seeds.posture), type_codes(seeds.grasp_type, kinds)
    metric = contact_metric(hand, postures, seeds.grasp_type, types)
    fitted = fit(spec, training, postures.astype(np.float32), codes, metric, progress)
    about = {"kind": "posture prior", "hand": hand.name, "n_postures": len(seeds), "training": asdict(training)}
    return PosturePrior(hand.joint_names, kinds, NumpyDecoder.from_fitted(fitted), about, seeds.taxonomy)


def contact_metric(
    hand: Hand, postures: Array, grasp_types: NDArray[np.str_], types: Mapping[str, GraspType] = GRASP_TYPES
) -> NDArray[np.float32]:
    """Differentiate the contact geometry of postures ``(n, J)``, radians, of named types with respect to their joints.

    It is the measure by which errors of a posture matter.

    Returns:
        ``(n, N_ROWS, J)`` metres per radian; rows without a supporting place are zero.
    """
    jacobians = np.zeros((len(postures), N_ROWS, postures.shape[1]), dtype=np.float32)
    steps = 1e-5 * np.eye(postures.shape[1])
    for name in np.unique(grasp_types):
        kind, rows = as_type(str(name), types), np.flatnonzero(grasp_types == name)
        for chunk in np.array_split(rows, max(1, len(rows) // 2000)):
            some = postures[chunk]
            changes = [_geometry(hand, some + step, kind) - _geometry(hand, some - step, kind) for step in steps]
            jacobians[chunk, : changes[0].shape[1]] = np.stack(changes, axis=-1) / 2e-5
    return jacobians


def _geometry(hand: Hand, postures: Array, kind: GraspType) -> Array:
    thumb, first, *others = kind.opposition
    others += [name for name in kind.support if name in hand.places]
    # Averaged by hand instead of `executed`, whose clipping at the limits would hide the slope there.
    places = hand.place_points(hand.share(postures), [thumb, first, *others])
    vectors = [places[first].point_m - places[thumb].point_m]
    vectors += [places[name].point_m - places[first].point_m for name in others]
    return np.concatenate(vectors, axis=-1)


# What a cascade is trained on


@dataclass(frozen=True)
class CascadeTraining:
    """Say what to learn from and how long.

    Raises:
        InputError: an unknown name or a value out of range.

    Examples:
        >>> CascadeTraining(learn_from="held", training=TrainingSpec(epochs=5)).most_repeats
        20
    """

    learn_from: LearnFrom = "faithful"
    """Which successes: those that also touch every digit their type needs, or all that held."""
    object_pose: ObjectPose = "placed"
    """The object's pose to learn: where the candidate put it, or where closing left it."""
    most_repeats: int = 20
    """Oversample rare pairs of object and type, up to so many copies of a grasp; 1 for never."""
    fold_rotations: bool = True
    """Learn of each rotation the one image under the object's symmetry that lies nearest to a reference; else all of
    them as they come."""
    fingertip_error_m: float = 0.002
    """Error of the contact places that counts as much as one standard deviation of a joint angle."""
    position_weight: float = 4.0
    """Weight of the squared error of the object's position, in standard deviations; joint angles have 4."""
    training: TrainingSpec = field(
        default_factory=lambda: TrainingSpec(epochs=80, max_steps=10_000, batch_size=512, learning_rate=4e-3)
    )
    """The training loop of every stage; its metric weight is set from the fingertip error."""

    def __post_init__(self) -> None:
        check_name("choice of grasps to learn from", self.learn_from, get_args(LearnFrom))
        check_name("object pose to learn", self.object_pose, get_args(ObjectPose))
        check_whole("most_repeats", self.most_repeats, 1)
        least, most = _FINGERTIP_ERRORS_M
        if not least <= self.fingertip_error_m <= most:
            raise InputError(f"fingertip_error_m must be from {least:g} to {most:g}, got {self.fingertip_error_m}")
        if not 0.0 < self.position_weight < np.inf:
            raise InputError(f"position_weight must be positive and finite, got {self.position_weight}")
        if self.training.metric_weight:
            raise InputError("metric_weight follows from fingertip_error_m in a cascade; give that instead")


@dataclass(frozen=True)
class TrainingData:
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
    vocabulary: Vocabulary


def prepare(hand: Hand, dataset: Dataset, factorization: Factorization, config: CascadeTraining) -> TrainingData:
    """Encode the successes of a dataset for training.

    Raises:
        InputError: fewer than 100 successes, or an object held by what is none of its sides.
    """
    for task in dataset.grasps.tasks.distinct:
        check_side(task)
    held = dataset.outcomes.held
    rows = dataset.outcomes.faithful(dataset.grasps) if config.learn_from == "faithful" else held
    if rows.sum() < 100:
        raise InputError(f"only {int(rows.sum())} {config.learn_from} grasps to learn from; at least 100 are needed")
    code, sizes = factorization.object_code, SizeRule({}, {}, {})
    vocabulary = Vocabulary.of(dataset.grasps.tasks[rows], code)
    if factorization.asks_sizes:
        sizes = SizeRule.measure(_request(dataset.grasps, dataset.outcomes, vocabulary), rows, held)
    places = repeat_rare(dataset.grasps, np.flatnonzero(rows), config.most_repeats, config.training.seed, code)
    grasps, outcomes = dataset.grasps[places], dataset.outcomes[places]
    request = _request(grasps, outcomes, vocabulary)
    pose = grasps.X_hand_object if config.object_pose == "placed" else outcomes.X_hand_object_settled
    thumb, other = opposition_points(hand, grasps.posture, grasps.tasks)
    in_frame = learning_frame(thumb, other, factorization.frame).inverse() @ pose
    rotation = in_frame.quat_wxyz
    if config.fold_rotations:
        rotation = fold_rotations(rotation, grasps.tasks, factorization.frame)
    if code == "site":
        rotation = canonical_quat(quat_multiply(rotation, site_frames(grasps.tasks)))
    if factorization.asks_sizes:
        # The object size that will be asked for is the cell's median, so training sees that and not each grasp's own.
        _, aimed = sizes.apply(request, "median", np.random.default_rng(0))
        request = replace(request, object_size_m=aimed)
    asked = encode_request(request, vocabulary, code)
    generated = {"posture": encode_posture(grasps.posture, thumb, other), "position": in_frame.position_m}
    targets: dict[Target, Array] = {"posture": grasps.posture, "position": in_frame.position_m, "rotation": rotation}
    metric = partial(contact_metric, hand, grasps.posture, grasps.grasp_type, TAXONOMIES[vocabulary.taxonomy])
    return TrainingData(int(rows.sum()), request, targets, {**asked, **generated}, metric, sizes, vocabulary)


def repeat_rare(
    grasps: Grasps, places: NDArray[np.intp], most: int, seed: int, code: ObjectCode = "label"
) -> NDArray[np.intp]:
    """Repeat grasps of rare objects and types until these have as many as the median one.

    Args:
        grasps: from which to choose.
        places: ``(n,)`` the chosen ones.
        most: most copies of one grasp.
        seed: picks which grasps get the one extra copy.
        code: what makes an object another (see `case_of`).

    Returns:
        The places, each at least once, in order.
    """
    cells = np.unique(grasps.tasks[places].column(lambda task: case_of(task, code), str), return_inverse=True)[1]
    counts = np.bincount(cells)
    enough, rng = int(np.median(counts)), np.random.default_rng(seed)
    chosen = [places]
    for rare in np.flatnonzero(counts < enough):
        some = places[cells == rare]
        repeats, rest = divmod(min(enough, most * len(some)) - len(some), len(some))
        chosen += [np.repeat(some, repeats), rng.permutation(some)[:rest]]
    return np.sort(np.concatenate(chosen))


def case_of(task: Task, code: ObjectCode) -> str:
    """Name the case that a task is of: its type, and the object, told by its name or by what it asks of the hand.

    That is its kind, for a cylinder the axis it is held along, and how many contacts the type asks of one so long.
    """
    if code == "label":
        return "/".join((task.grasp_type.name, task.object.name))
    kind = task.object.shape.kind
    n_contacts = sum(task.length_m >= contact.from_length_m for contact in task.grasp_type.contacts)
    return f"{task.grasp_type.name}/{kind}{task.site.name if kind == 'cylinder' else ''}/{n_contacts}"


def _request(grasps: Grasps, outcomes: Outcomes, vocabulary: Vocabulary) -> Request:
    return Request(vocabulary.renamed(grasps.tasks), grasps.grasp_size_m, outcomes.object_size_m)


# Its training


@dataclass(frozen=True)
class FittedCascade:
    """Hold a trained cascade and its training curves."""

    sampler: GraspSampler
    history: dict[str, tuple[EpochRecord, ...]]
    """One record per epoch, by stage."""

    def save(self, folder: Path | str) -> None:
        """Write weights and metadata to `folder` (see `GraspSampler.save`), and the training curves beside them."""
        self.sampler.save(folder)
        write_json(Path(folder) / TRAINING_FILE, self.curves())

    def curves(self) -> dict[str, Any]:
        """Return what was trained on what, and by stage a list of each quantity with one value per epoch."""
        about = self.sampler.metadata
        stages = {
            name: {curve: [getattr(record, curve) for record in records] for curve in _CURVES}
            for name, records in self.history.items()
        }
        named = {"factorization": self.sampler.factorization.name, "seed": about["config"]["training"]["seed"]}
        return (
            named | {key: about[key] for key in ("learned_from", "dataset", "config", "versions")} | {"stages": stages}
        )


def fit_cascade(
    hand: Hand,
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
        config: what to learn and how long; by default `CascadeTraining()`.
        progress: called in this process after every epoch of every stage.
        workers: processes to train in, 0 for as many as processors and at most one a stage; 1 trains in this process.
            The weights are the same bit by bit.

    Raises:
        InputError: the dataset is of another hand, names no protocol, holds too few successes or objects that the
            factorization cannot tell apart, or `workers` is negative.
        FloatingPointError: a stage's loss stopped being finite.
    """
    config = config or CascadeTraining()
    if (dataset.grasps.hand, dataset.grasps.joint_names) != (hand.name, hand.joint_names):
        raise InputError(f"the dataset is of hand {dataset.grasps.hand!r} or of other joints than {hand.name} has")
    if dataset.metadata.get("hand_fingerprint", hand.fingerprint()) != hand.fingerprint():
        raise InputError(f"the dataset was collected with another model of the hand than {hand.name}")
    # What is recorded with the weights is asked for before hours of training, not after.
    about = dataset.metadata
    if not isinstance(trial := about.get("protocol"), dict) or "name" not in trial:
        raise InputError("the dataset's metadata must name the protocol of its trials")
    learned_on = {key: about.get(key) for key in ("seed", "prior", "hand", "engine", "screening")}
    learned_on |= {"trials": len(dataset.outcomes), "protocol": trial["name"], "shards": shards_digest(about)}
    data = prepare(hand, dataset, factorization, config)
    # The longest stage first, so that none of the others has to wait for it in the end.
    jobs = [StageJob.of(data, stage, config) for stage in factorization.stages]
    jobs.sort(key=lambda job: job.cost, reverse=True)

    def report(number: int, record: EpochRecord) -> None:
        if progress is not None:
            progress(jobs[number].name, record)

    trained = dict(zip([job.name for job in jobs], run_jobs(jobs, workers, report), strict=True))
    fitted = {stage.name: trained[stage.name] for stage in factorization.stages}
    decoders = {name: NumpyDecoder.from_fitted(stage) for name, stage in fitted.items()}
    metadata = {
        "config": asdict(config),
        "learned_from": data.n_grasps,
        "dataset": learned_on,
        "versions": versions() | {"torch": version("torch")},
        "final_loss": {name: round(stage.history[-1].train_loss, 4) for name, stage in fitted.items()},
    }
    sampler = GraspSampler(factorization.name, hand, factorization, data.vocabulary, decoders, data.sizes, metadata)
    return FittedCascade(sampler, {name: stage.history for name, stage in fitted.items()})


@dataclass(frozen=True, eq=False)
class StageJob:
    """Hold all that training one stage takes, so that another process can do it."""

    name: str
    spec: VaeSpec
    training: TrainingSpec
    target: NDArray[np.float32]
    condition: NDArray[np.float32]
    metric: Callable[[], NDArray[np.float32]] | None
    """Computes the contact metric that weighs its errors, None without one."""

    @classmethod
    def of(cls, data: TrainingData, stage: Stage, config: CascadeTraining) -> StageJob:
        """Collect what a stage takes."""
        condition = condition_matrix(stage, data.quantities)
        target = np.concatenate([data.targets[name] for name in stage.targets], axis=1).astype(np.float32)
        spec = vae_spec(stage, data.targets["posture"].shape[1], condition.shape[1], config.position_weight)
        if stage.targets[0] != "posture":
            return cls(stage.name, spec, replace(config.training, metric_weight=0.0), target, condition, None)
        training = replace(config.training, metric_weight=1.0 / config.fingertip_error_m**2)
        return cls(stage.name, spec, training, target, condition, data.metric)

    @property
    def cost(self) -> tuple[bool, int]:
        """Sort key by the estimated training time: a metric is work before training and in every step."""
        widths = (self.spec.encoder_widths, self.spec.decoder_widths)
        return self.metric is not None, sum(a * b for layers in widths for a, b in pairwise(layers))

    def __call__(self, report: Callable[[EpochRecord], None]) -> Fitted:
        """Train the stage."""
        # torch is an optional extra: only fitting needs it.
        from ..nets.training import fit

        metric = None if self.metric is None else self.metric()
        return fit(self.spec, self.training, self.target, self.condition, metric, report)
