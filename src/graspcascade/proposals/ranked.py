"""Proposals made of others: likely grasps for users, and disturbed ones for the next collection."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError, check_whole
from ..core.grasps import Grasps
from ..core.objects import GraspObject
from ..core.poses import Pose, canonical_quat, quat_multiply
from ..core.protocols import HOLD, Conditions
from ..core.tasks import Task, Tasks
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

    @property
    def takes_any_size(self) -> bool:
        """Whether the other can be asked for objects of any size."""
        return self.proposal.takes_any_size


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
        return cls(cascade, Scorer.load(folder), name=f"{cascade.name}, ranked", **options)

    def _conditions(self, n: int) -> Conditions:
        return Conditions.of(HOLD.physics, n, friction=self.friction, gain_factor=self.gain_factor)

    def chances(self, grasps: Grasps) -> Array:
        """Estimate the chances ``(n,)`` that grasps hold as their type asks, wherever they come from."""
        return self.scorer.chances(grasps, self._conditions(len(grasps))).faithful

    def propose(self, tasks: Tasks, rng: np.random.Generator) -> Grasps:  # noqa: D102 (inherited)
        return self._ranked(tasks, self._drawn(tasks, rng), rng)

    def _ranked(self, tasks: Tasks, columns: dict[str, Array], rng: np.random.Generator) -> Grasps:
        """Draw on from one draw for each row, whose columns are given, and choose."""
        task, asked = tasks.row, np.bincount(tasks.row, minlength=len(tasks.table))
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

    def notes(self, grasps: Grasps) -> tuple[str, ...]:
        """Say which of its grasps are unlikely to hold, and what of the same object is likelier."""
        said = [*self.proposal.notes(grasps), *self._unseen(grasps)]
        known: dict[GraspObject, tuple[Feasibility, ...]] = {}
        for task, rows in grasps.tasks.groups(lambda task: task):
            chance = grasps.probability[rows]
            if not (unlikely := int((chance < FAIR).sum())):
                continue
            obj, kind, side = task.object, task.grasp_type.name, task.site.name
            if obj not in known:
                known[obj] = feasibility(self, obj)
            mean = float(chance.mean())
            likelier = [
                each
                for each in known[obj]
                if each.chance >= max(FAIR, mean) and (each.grasp_type, each.side_axis) != (kind, side)
            ]
            likelier.sort(key=lambda each: (each.grasp_type != kind, -each.chance))
            best = ", ".join(
                f"{each.grasp_type} by {each.side_axis} ({100 * each.chance:.0f} %)" for each in likelier[:3]
            )
            which = f"{unlikely} of {len(chance)} {kind} grasps of {obj.name} by side {side}: chance below 50 %"
            if best or mean < FAIR:
                which += f"; likelier: {best}" if best else "; no type or side of it reaches that"
            said.append(which)
        return tuple(said)

    def _unseen(self, grasps: Grasps) -> list[str]:
        """Say which conditions are beyond those of the trials that the scorer learned from, if these were recorded."""
        mass_g = [1000 * task.object.mass_kg for task in grasps.tasks.distinct]
        asked = {"friction": [self.friction], "mass_g": mass_g}
        return [
            f"the scorer saw {name.replace('_', ' in ')} {low:g} to {high:g}; chances at {wrong[0]:.4g} are guesses"
            for name, (low, high) in self.scorer.seen.items()
            if (wrong := [value for value in asked.get(name, ()) if not low <= round(value, 2) <= high])
        ]

    def describe(self) -> dict[str, Any]:
        """Say for a record what is drawn from, and what is good enough."""
        return self.proposal.describe() | self._ranking()

    def _ranking(self) -> dict[str, Any]:
        rule = {name: getattr(self, name) for name in ("good_enough", "most_draws", "friction", "gain_factor")}
        return {"scorer": self.scorer.fingerprint(), "ranking": rule}

    def origin(self, kind: GraspType, obj: GraspObject) -> dict[str, Any]:
        """Say for a file where grasps come from; what was measured of unranked ones is left out."""
        return self.proposal.origin(kind, obj) | {"model": self.name, "measured": {}} | self._ranking()


FAIR = 0.5
"""Chance below which a user is told."""
WORDS = {"good": 0.9, "fair": FAIR, "poor": 0.1, "none": 0.0}
"""What a type and side of an object are called from a mean chance on."""


@dataclass(frozen=True)
class Feasibility:
    """Say how likely grasps of a type are that hold an object by one of its sides.

    Attributes:
        grasp_type, side_axis: names of the type and of the side's body axis.
        side_m: length of the side, metres.
        chance: mean chance of ranked grasps to hold as the type asks.
        good_draws: share of draws that are good enough without a second one.
    """

    grasp_type: str
    side_axis: str
    side_m: float
    chance: float
    good_draws: float

    @property
    def word(self) -> str:
        """Word the chance, in whole percent, as `WORDS` says."""
        return next(word for word, least in WORDS.items() if round(self.chance, 2) >= least)

    def to_json(self) -> dict[str, Any]:
        """Describe it as plain data."""
        return asdict(self) | {"works": self.word}


def feasibility(ranked: Ranked, obj: GraspObject, n: int = 64, seed: int = 0) -> tuple[Feasibility, ...]:
    """Estimate for each type, and each side within the hand's reach, how well grasps of an object work.

    Args:
        ranked: whose types, in their order, and whose friction.
        obj: the object, with its mass.
        n: grasps drawn of each type and side.
        seed: of the draws.

    Raises:
        InputError: no side is within the hand's reach, or see `Proposal.propose`.
    """
    reach_m = ranked.hand.reach_m
    table = tuple(Task(kind, obj, site) for kind in ranked.grasp_types for site in obj.sites(reach_m).values())
    if not table:
        raise InputError(f"no side of {obj.name} is within the hand's reach of {reach_m * 100:g} cm")
    tasks = Tasks(table, np.repeat(np.arange(len(table)), n))
    rng, shape = np.random.default_rng(seed), (len(table), n)
    drawn = ranked._drawn(tasks, rng)
    likely = ranked._ranked(tasks, drawn, rng)
    chance = likely.probability.reshape(shape).mean(axis=1).tolist()
    good = (drawn["probability"] >= ranked.good_enough).reshape(shape).mean(axis=1).tolist()
    rows = zip(table, chance, good, strict=True)
    return tuple(Feasibility(task.grasp_type.name, task.site.name, task.site.width_m, *each) for task, *each in rows)


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
