"""Labelled seed postures by inverse kinematics that stays human, and the human statistics it stays close to.

Each seed starts at a draw from the human statistics of its type and moves, by least squares, as little as it can (in
human standard deviations) until the opposing places are a given aperture apart and the others lie on the object beside
the first finger's.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..core.errors import MAX_SEED, InputError, check_name, check_whole
from ..core.taxonomy import GRASP_TYPES, TAXONOMIES, GraspType
from ..hands import Hand
from ..hands.hand import middle
from .postures import LabelledPostures

Array = NDArray[np.float64]
_FINEST_TOLERANCE_M = 1e-9
_UNRECORDED_SD_RAD = np.radians(5.0)
"""Spread given to joints without recordings."""
_STILL_JOINTS = ("LFJ5",)
"""Joints without recordings that humans kept near zero."""
_DIGIT_PREFIX = {"thumb": "TH", "index": "FF", "middle": "MF", "ring": "RF", "little": "LF"}


@dataclass(frozen=True)
class SeedSpec:
    """Weigh the aims of the inverse kinematics; a residual of one counts the same for all.

    Raises:
        InputError: a value out of range.

    Examples:
        >>> from graspcascade import load_hand
        >>> make_seeds(load_hand("shadow"), SeedSpec(per_type=1)).grasp_type.tolist()[:2]
        ['tripod', 'palmar_pinch']
    """

    per_type: int = 200
    """Seed postures for each grasp type."""
    aperture_min_m: float = 0.010
    """Smallest distance between the opposing places."""
    aperture_max_m: float = 0.065
    """Largest distance between the opposing places."""
    aperture_skew: float = 1.2
    """1 spreads the distances evenly from smallest to largest, more makes small ones more frequent: fingers that
    would meet inside the object grip it, fingers that stay farther apart than it is wide do not touch it."""
    aperture_tolerance_m: float = 0.0005
    """Deviation from the drawn aperture that counts one."""
    support_plane_tolerance_m: float = 0.001
    """Distance of a supporting place from the index finger's contact plane that counts one."""
    support_reach_m: float = 0.021
    """A place farther than this beside the first finger's is drawn nearer, the next one from twice as far."""
    support_reach_tolerance_m: float = 0.003
    """Excess over that reach that counts one."""
    normal_weight: float = 2.0
    """Weight of the opposing places' normals along the opposition axis."""
    support_normal_weight: float = 0.0
    """The same of the places beside the first finger's."""
    human_weight: float = 0.5
    """Weight of the deviation from the human draw, in human standard deviations."""
    draw_spread: float = 0.7
    """Spread of the human draw, in human standard deviations."""
    most_draws: int = 1
    """Draws of a posture until the recorded humans would call it by its type (see `nearest_human_type`)."""
    taxonomy: str = "paper"
    """Whose grasp types: "paper" or "feix"."""
    seed: int = 0
    """Seed of the draws."""

    def __post_init__(self) -> None:
        check_name("taxonomy", self.taxonomy, TAXONOMIES)
        check_whole("per_type", self.per_type, 1)
        check_whole("most_draws", self.most_draws, 1)
        check_whole("seed", self.seed, most=MAX_SEED)
        if not 0.0 <= self.aperture_min_m <= self.aperture_max_m < np.inf:
            raise InputError(
                "apertures must be finite and not negative, the smallest no larger than the largest, "
                f"got aperture_min_m {self.aperture_min_m} and aperture_max_m {self.aperture_max_m}"
            )
        for name in ("aperture_tolerance_m", "support_plane_tolerance_m", "support_reach_tolerance_m"):
            if not getattr(self, name) >= _FINEST_TOLERANCE_M:
                raise InputError(f"{name} must be at least {_FINEST_TOLERANCE_M:g}, got {getattr(self, name)}")
        weights = ("normal_weight", "support_normal_weight", "human_weight")
        for name in ("aperture_skew", "support_reach_m", "draw_spread", *weights):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise InputError(f"{name} must be finite and not negative, got {getattr(self, name)}")


FEIX_SEEDS = SeedSpec(
    aperture_min_m=0.008, support_reach_m=0.035, support_normal_weight=2.0, most_draws=16, taxonomy="feix"
)
"""Seeds of Feix's types: fingers as far apart as recorded humans hold them, pads or sides turned to the object."""


def make_seeds(
    hand: Hand, spec: SeedSpec | None = None, progress: Callable[[int], None] | None = None
) -> LabelledPostures:
    """Make seed postures for all types that the hand can make, apertures evenly spread.

    Args:
        hand: the hand; its joints carry the Shadow names the human statistics use.
        spec: counts, weights and seed.
        progress: called with 1 after each posture.

    Raises:
        InputError: the hand can make no type, or has joints of which no human statistics are known.
    """
    spec = spec or SeedSpec()
    types = TAXONOMIES[spec.taxonomy]
    possible = seedable(hand, spec.taxonomy)
    span = spec.aperture_max_m - spec.aperture_min_m
    apertures = spec.aperture_min_m + span * np.linspace(0.0, 1.0, spec.per_type) ** spec.aperture_skew
    postures, order = [], list(types)
    for kind in possible:
        number = order.index(kind.name)
        rng = np.random.default_rng([spec.seed, number])
        for aperture in apertures.tolist():
            posture = _solve(hand, kind, aperture, spec, rng)
            for _ in range(spec.most_draws - 1):
                if nearest_human_type(hand.executed(posture[None]), hand.joint_names)[0] == kind.name:
                    break
                posture = _solve(hand, kind, aperture, spec, rng)
            postures.append(posture)
            if progress is not None:
                progress(1)
    names = np.repeat([kind.name for kind in possible], spec.per_type)
    return LabelledPostures(hand.joint_names, np.array(postures), names, taxonomy=spec.taxonomy)


def seedable(hand: Hand, taxonomy: str) -> tuple[GraspType, ...]:
    """List the types of a taxonomy for which a hand can have seeds: those that it can make.

    Raises:
        InputError: there are none, or the hand has joints of which no human statistics are known.
    """
    possible = hand.possible(TAXONOMIES[taxonomy].values())
    if not possible:
        raise InputError(f"hand {hand.name} has the digits and contact places of no grasp type")
    recorded = human_statistics(possible[0].name, hand.joint_names).recorded
    pairs = zip(hand.joint_names, recorded.tolist(), strict=True)
    if foreign := [name for name, known in pairs if not known and name not in _STILL_JOINTS]:
        raise InputError(
            f"seed postures follow human statistics, which name joints as the Shadow Hand does, and {hand.name} has "
            f"{', '.join(foreign)}; begin with recorded postures instead: graspcascade prior --postures FILE.csv"
        )
    return possible


def _solve(hand: Hand, kind: GraspType, aperture_m: float, spec: SeedSpec, rng: np.random.Generator) -> Array:
    human = human_statistics(kind.name, hand.joint_names)
    lower, upper = hand.lower_rad + 1e-4, hand.upper_rad - 1e-4
    drawn = human.mean + spec.draw_spread * human.sd * rng.standard_normal(len(human.mean))
    wished = np.clip(drawn, lower, upper)
    spread = np.maximum(human.sd, np.radians(1.0))

    def residuals(postures: Array) -> Array:
        moved = hand.executed(postures)
        aims = _contact_residuals(hand, kind, aperture_m, spec, moved)
        return np.concatenate([aims, spec.human_weight * (postures - wished) / spread], axis=1)

    def jacobian(posture: Array) -> Array:
        step = 1e-6
        # All forward differences in one batch: the kinematics is vectorised over postures.
        moved = residuals(posture + step * np.concatenate([np.zeros((1, len(posture))), np.eye(len(posture))]))
        return np.asarray((moved[1:] - moved[0]).T / step)

    bounds = (lower, upper)
    return np.asarray(
        least_squares(lambda q: residuals(q[None])[0], wished, jac=jacobian, bounds=bounds, max_nfev=60).x
    )


def _contact_residuals(hand: Hand, kind: GraspType, aperture_m: float, spec: SeedSpec, postures: Array) -> Array:
    thumb_name, *opposing = kind.opposition
    beside_first = (*opposing[1:], *kind.support)
    places = hand.place_points(postures, [name for name in (*kind.opposition, *kind.support) if name in hand.places])
    thumb, first = places[thumb_name], places[opposing[0]]
    line = middle([places[name].point_m for name in opposing]) - thumb.point_m
    distance = np.linalg.norm(line, axis=-1, keepdims=True)
    axis = line / np.maximum(distance, 1e-9)
    parts = [
        (distance - aperture_m) / spec.aperture_tolerance_m,
        spec.normal_weight * (thumb.normal - axis),
        *(spec.normal_weight * (places[name].normal + axis) for name in opposing),
    ]
    for fingers_between, name in enumerate(beside_first):
        if name not in places:
            continue
        offset = places[name].point_m - first.point_m
        out_of_plane = (offset * axis).sum(axis=-1, keepdims=True)
        beside = np.linalg.norm(offset - out_of_plane * axis, axis=-1, keepdims=True)
        reach = spec.support_reach_m * (1 + fingers_between)
        parts.append(out_of_plane / spec.support_plane_tolerance_m)
        parts.append(np.maximum(beside - reach, 0.0) / spec.support_reach_tolerance_m)
        if spec.support_normal_weight and name not in opposing:
            parts.append(spec.support_normal_weight * (places[name].normal + axis))
    return np.concatenate(parts, axis=1)


# Human statistics


@dataclass(frozen=True)
class HumanStatistics:
    """Hold mean and standard deviation of one type's joint angles, ``(J,)`` radians in the order asked for."""

    n_grasps: int
    """Recorded grasps behind the figures."""
    recorded: NDArray[np.bool_]
    """Flags of the joints that were recorded."""
    mean: Array
    sd: Array


@lru_cache(maxsize=1)
def _rows() -> Mapping[tuple[str, str], Mapping[str, str]]:
    lines = (files("graspcascade.studies") / "human_statistics.csv").read_text().splitlines()
    return {(row["grasp_type"], row["statistic"]): row for row in csv.DictReader(lines)}


def human_statistics(grasp_type: str, joint_names: tuple[str, ...]) -> HumanStatistics:
    """Look up the figures of a grasp type; a joint without recordings has mean 0 and a spread of 5 degrees."""
    rows = _rows()
    recorded = np.array([f"{name}_deg" in rows[grasp_type, "mean"] for name in joint_names])

    def figures(statistic: str, default: float) -> Array:
        row = rows[grasp_type, statistic]
        return np.array([np.radians(float(row[f"{n}_deg"])) if f"{n}_deg" in row else default for n in joint_names])

    n_grasps = int(rows[grasp_type, "mean"]["n_grasps"])
    return HumanStatistics(n_grasps, recorded, figures("mean", 0.0), figures("sd", _UNRECORDED_SD_RAD))


_LEAST_SD_RAD = np.radians(4.0)
"""Spread below which differences say nothing: some joints were recorded almost still."""


def nearest_human_type(postures: Array, joint_names: Sequence[str]) -> NDArray[np.str_]:
    """Name the type ``(n,)`` under whose recorded figures postures ``(n, J)`` are likeliest, joint by joint."""
    likelihood = []
    for name in GRASP_TYPES:
        human = human_statistics(name, tuple(joint_names))
        sd = np.maximum(human.sd, _LEAST_SD_RAD)
        each = -0.5 * ((postures - human.mean) / sd) ** 2 - np.log(sd)
        likelihood.append(each[:, human.recorded].sum(axis=1))
    return np.asarray(np.array(list(GRASP_TYPES))[np.argmax(likelihood, axis=0)])


@dataclass(frozen=True)
class Likeness:
    """Compare one type's postures with the human ones, over the recorded joints of the digits that hold the object."""

    grasp_type: str
    n_postures: int
    n_human: int
    deviation_sd: dict[str, float]
    """Mean posture minus human mean in human standard deviations, by joint name."""

    @property
    def outliers(self) -> dict[str, float]:
        """Joints whose mean is more than one human standard deviation off."""
        return {name: value for name, value in self.deviation_sd.items() if abs(value) > 1.0}

    @property
    def share_within(self) -> float:
        """Share of joints whose mean is within one human standard deviation."""
        return 1.0 - len(self.outliers) / len(self.deviation_sd)


def human_likeness(postures: LabelledPostures) -> list[Likeness]:
    """Compare the postures of each type present; joints carry the Shadow names that the statistics use."""
    present = [kind for kind in GRASP_TYPES.values() if (postures.grasp_type == kind.name).any()]
    names, compared = np.array(postures.joint_names), []
    for kind in present:
        rows, human = postures.grasp_type == kind.name, human_statistics(kind.name, postures.joint_names)
        deviation = (postures.posture[rows].mean(axis=0) - human.mean) / human.sd
        prefixes = tuple(_DIGIT_PREFIX[digit] for digit in kind.digits)
        holding = np.array([name.startswith(prefixes) for name in postures.joint_names]) & human.recorded
        by_joint = dict(zip(names[holding].tolist(), deviation[holding].tolist(), strict=True))
        compared.append(Likeness(kind.name, int(rows.sum()), human.n_grasps, by_joint))
    return compared
