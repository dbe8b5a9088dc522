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
    """Draw each grasp again until its chance of success is good enough.

    So grasps are spread as those of the proposal that are good enough, and do not collapse to the likeliest. A grasp
    for which no draw is good enough is the best of its draws; its probability says so.

    Attributes:
        proposal: where grasps come from.
        scorer: estimates their chances.
        good_enough: chance at which a grasp is taken.
        most_draws: draws of one grasp.
        friction: sliding friction that is assumed.
        gain_factor: factor on the actuators' own gains that is assumed.

    Raises:
        InputError: a number out of range.
    """

    proposal: Proposal
    scorer: Scorer
    good_enough: float = 0.9
    most_draws: int = 8
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
        grasps = self.proposal.propose(tasks, rng)
        columns = grasps.columns() | {"probability": self.chances(grasps)}
        for _ in range(self.most_draws - 1):
            poor = np.flatnonzero(columns["probability"] < self.good_enough)
            if not poor.size:
                break
            again = self.proposal.propose(tasks[poor], rng)
            drawn = again.columns() | {"probability": self.chances(again)}
            better = drawn["probability"] > columns["probability"][poor]
            for name, column in columns.items():
                column[poor[better]] = drawn[name][better]
        return Grasps.from_columns(grasps.hand, grasps.joint_names, tasks, columns)

    def describe(self) -> dict[str, Any]:
        """Say for a record what is drawn from, and what is good enough."""
        rule = {name: getattr(self, name) for name in ("good_enough", "most_draws", "friction", "gain_factor")}
        return self.proposal.describe() | {"scorer": self.scorer.fingerprint(), "ranking": rule}

    def origin(self, kind: GraspType, obj: GraspObject) -> dict[str, Any]:  # noqa: D102 (inherited)
        assumed = {"friction": self.friction, "gain_factor": self.gain_factor}
        return self.proposal.origin(kind, obj) | {"scorer": self.scorer.fingerprint(), "assumed": assumed}


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
