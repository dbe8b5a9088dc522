"""What a cascade is trained on: which grasps of a dataset, and their quantities as columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..candidates import opposition_points
from ..dataset import Dataset
from ..errors import InputError, check_name
from ..grasps import Grasps
from ..hands import HandModel
from ..nets import TrainingSpec
from ..postures import contact_metric
from ..trials import Outcomes
from .encoding import Cells, Request, encode_posture, encode_request
from .frames import fold_rotations, learning_frame
from .sizes import SizeRule
from .stages import Factorization, Target

Array = NDArray[np.float64]
LearnFrom = Literal["faithful", "held"]
ObjectPose = Literal["placed", "settled"]
_FINGERTIP_ERRORS_M = (1e-9, 1e9)
"""Beyond these bounds the weight of the contact metric, an inverse square, is no longer a number."""


@dataclass(frozen=True)
class CascadeTraining:
    """Say what to learn from and how long.

    Raises:
        InputError: an unknown name or a value out of range.
    """

    learn_from: LearnFrom = "faithful"
    """Which successes: those that also touch every digit their type needs, or all that held."""
    object_pose: ObjectPose = "placed"
    """The object's pose to learn: where the candidate put it, or where closing left it."""
    most_repeats: int = 20
    """Grasps of an object and type that has fewer than most are repeated up to so many times, so that all are learned
    alike; 1 for never."""
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
        if not self.most_repeats >= 1:
            raise InputError(f"most_repeats must be at least 1, got {self.most_repeats}")
        least, most = _FINGERTIP_ERRORS_M
        if not least <= self.fingertip_error_m <= most:
            raise InputError(f"fingertip_error_m must be from {least:g} to {most:g}, got {self.fingertip_error_m}")
        if not 0.0 < self.position_weight < np.inf:
            raise InputError(f"position_weight must be positive and finite, got {self.position_weight}")
        if self.training.metric_weight:
            raise InputError("metric_weight follows from fingertip_error_m in a cascade; give that instead")


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
