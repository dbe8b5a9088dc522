"""Proposals made of others: likely grasps for users, and disturbed ones for the next collection."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError, check_whole
from ..core.grasps import Grasps
from ..core.objects import GraspObject
from ..core.poses import Pose, canonical_quat, quat_multiply
from ..core.protocols import HOLD, Conditions
from ..core.tasks import Tasks
from ..core.taxonomy import GraspType
from ..hands.hand import Hand
from . import Proposal
from .cascade.sampler import GraspSampler
from .scorer import Scorer

Array = NDArray[np.float64]


class _Derived(Proposal):
    """A proposal for the hand, types and objects of another."""

    proposal: Proposal

    @property
    def hand(self) -> Hand:  # type: ignore[override]
        """Hand that the grasps are for."""
        return self.proposal.hand

    @property
    def grasp_types(self) -> tuple[GraspType, ...]:
        """Grasp types that the other proposes."""
        return self.proposal.grasp_types

    @property
    def objects(self) -> tuple[GraspObject, ...]:
        """Objects that the other is usually tried on."""
        return self.proposal.objects


@dataclass(frozen=True, eq=False)
class Ranked(_Derived):
    """Draw more grasps than are asked for, and keep those whose chance of success is good enough.

    Of the draws for a task as many are kept as it has rows: the first that are good enough and, where these are too
    few, the likeliest of the others. So grasps are spread as those of the proposal that are good enough and do not
    collapse to the likeliest; the probability of one that is not good enough says so.

    Attributes:
        proposal: where grasps come from.
        scorer: estimates their chances.
        good_enough: chance at which a grasp is taken.
        most_draws: draws for one grasp, on average over the rows of a task.
        friction: sliding friction that is assumed.
        gain_factor: factor on the actuators' own gains that is assumed.

    Raises:
        InputError: a number out of range.
    """

    proposal: Proposal
    scorer: Scorer
    good_enough: float = 0.9
    most_draws: int = 4
    friction: float = HOLD.physics.friction
    gain_factor: float = HOLD.physics.gain_factor
    name: str = "ranked"

    source = "cascade"

    def __post_init__(self) -> None:
        check_whole("most_draws", self.most_draws, 1)
        if not 0.0 <= self.good_enough <= 1.0:
            raise InputError(f"good_enough must be 0 to 1, got {self.good_enough}")
        self._conditions(1)

    @classmethod
    def load(cls, folder: Path | str, **options: Any) -> Ranked:
        """Load a cascade and the scorer beside it; options are fields of this class.

        Raises:
            InputError: there is no such folder, or it has no scorer.
            FileFormatError: a file is truncated, foreign or of another kind.
        """
        cascade = GraspSampler.load(folder)
        return cls(cascade, Scorer.load(folder), name=cascade.name, **options)

    def _conditions(self, n: int) -> Conditions:
        return Conditions.of(HOLD.physics, n, friction=self.friction, gain_factor=self.gain_factor)

    def chances(self, grasps: Grasps) -> Array:
        """Estimate the chances ``(n,)`` that grasps hold as their type asks, wherever they come from."""
        return self.scorer.chances(grasps, self._conditions(len(grasps))).faithful

    def propose(self, tasks: Tasks, rng: np.random.Generator) -> Grasps:  # noqa: D102 (inherited)
        columns, task, asked = self._drawn(tasks, rng), tasks.row, np.bincount(tasks.row, minlength=len(tasks.table))
        some_row = np.zeros(len(asked), dtype=np.intp)
        some_row[task] = np.arange(len(tasks))
        while True:
            draws = np.bincount(task, minlength=len(asked))
            good = np.bincount(task, columns["probability"] >= self.good_enough, len(asked))
            # A tenth more than it should take: a third pass over a few rows costs more.
            hoped = np.ceil(1.1 * np.maximum(asked - good, 0) * (draws + 2) / (good + 1))
            more = np.minimum(hoped, self.most_draws * asked - draws).astype(np.intp)
            if not more.any():
                break
            rows = np.repeat(some_row, more)
            later = self._drawn(tasks[rows], rng)
            columns = {name: np.concatenate([column, later[name]]) for name, column in columns.items()}
            task = np.concatenate([task, tasks.row[rows]])
        kept = self._kept(columns["probability"], task, len(tasks))
        kept_columns = {name: column[kept] for name, column in columns.items()}
        return Grasps.from_columns(self.hand.name, self.hand.joint_names, tasks, kept_columns)

    def _drawn(self, tasks: Tasks, rng: np.random.Generator) -> dict[str, Array]:
        grasps = self.proposal.propose(tasks, rng)
        return grasps.columns() | {"probability": self.chances(grasps)}

    def _kept(self, chance: Array, task: NDArray[np.intp], n: int) -> NDArray[np.intp]:
        """Choose a draw for each of n rows, whose own draws are the first n; a row whose own is chosen keeps it."""
        order = np.lexsort((-np.minimum(chance, self.good_enough), task))
        draws, asked = np.bincount(task), np.bincount(task[:n], minlength=task.max(initial=-1) + 1)
        rank = np.arange(len(task)) - np.repeat(np.cumsum(draws) - draws, draws)
        chosen = order[rank < np.repeat(asked, draws)]
        rows = np.arange(n)
        others = np.setdiff1d(rows, chosen)
        rows[others[np.argsort(task[others], kind="stable")]] = chosen[chosen >= n]
        return rows

    def describe(self) -> dict[str, Any]:
        """Say for a record what is drawn from, and what is good enough."""
        rule = {name: getattr(self, name) for name in ("good_enough", "most_draws", "friction", "gain_factor")}
        return self.proposal.describe() | {"scorer": self.scorer.fingerprint(), "ranking": rule}

    def origin(self, kind: GraspType, obj: GraspObject) -> dict[str, Any]:  # noqa: D102 (inherited)
        return self.proposal.origin(kind, obj) | {"scorer": self.scorer.fingerprint()}


@dataclass(frozen=True, eq=False)
class Disturbed(_Derived):
    """Disturb grasps, so that a collection learns what lies beside them.

    Attributes:
        proposal: where grasps come from.
        posture_sd_rad: disturbance of each joint's angle, a standard deviation, radians.
        position_sd_m: that of the object's position along each axis, metres.
        rotation_sd_rad: that of the angle about each axis by which the object is turned, radians.
    """

    proposal: Proposal
    posture_sd_rad: float = 0.05
    position_sd_m: float = 0.003
    rotation_sd_rad: float = 0.1
    name: str = "disturbed"

    def propose(self, tasks: Tasks, rng: np.random.Generator) -> Grasps:  # noqa: D102 (inherited)
        grasps, n = self.proposal.propose(tasks, rng), len(tasks)
        posture = grasps.posture + self.posture_sd_rad * rng.standard_normal(grasps.posture.shape)
        position = grasps.X_hand_object.position_m + self.position_sd_m * rng.standard_normal((n, 3))
        # Small turns about the three axes make, to first order, a turn about their sum.
        turn = 0.5 * self.rotation_sd_rad * rng.standard_normal((n, 3))
        turned = quat_multiply(np.concatenate([np.ones((n, 1)), turn], axis=1), grasps.X_hand_object.quat_wxyz)
        posture = self.hand.executed(posture)
        return replace(
            grasps,
            posture=posture,
            X_hand_object=Pose(position, canonical_quat(turned / np.linalg.norm(turned, axis=1, keepdims=True))),
            grasp_size_m=self.hand.tip_distance(posture),
        )

    def describe(self) -> dict[str, Any]:
        """Say for a record what is disturbed, and how."""
        noise = {name: getattr(self, name) for name in ("posture_sd_rad", "position_sd_m", "rotation_sd_rad")}
        return self.proposal.describe() | {"noise": noise}
