"""Labelled seed postures by inverse kinematics that stays human.

Each seed starts at a draw from the human statistics of its type and moves, by least squares, as little as it can (in
human standard deviations) until the opposing places are a given aperture apart and the supporting ones lie on the
object beside the index finger's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..errors import InputError
from ..hands import HandModel
from ..taxonomy import GRASP_TYPES, GraspType
from .human import human_statistics
from .labelled import LabelledPostures

Array = NDArray[np.float64]
_FINEST_TOLERANCE_M = 1e-9


@dataclass(frozen=True)
class SeedSpec:
    """Weigh the aims of the inverse kinematics; a residual of one counts the same for all.

    Raises:
        InputError: a value out of range.
    """

    per_type: int = 200
    """Seed postures for each grasp type."""
    aperture_min_m: float = 0.010
    """Smallest distance between the opposing places."""
    aperture_max_m: float = 0.065
    """Largest distance between the opposing places."""
    aperture_skew: float = 1.2
    """Apertures are spread as the smallest plus the range times u to this power, u even on 0 to 1: a posture that
    closes far inside the object grips it, one that stays wider than the object cannot."""
    aperture_tolerance_m: float = 0.0005
    """Deviation from the drawn aperture that counts one."""
    support_plane_tolerance_m: float = 0.001
    """Distance of a supporting place from the index finger's contact plane that counts one."""
    support_reach_m: float = 0.021
    """A supporting place farther than this beside the index finger's is drawn nearer."""
    support_reach_tolerance_m: float = 0.003
    """Excess over that reach that counts one."""
    normal_weight: float = 2.0
    """Weight of the pads' normals along the opposition axis."""
    human_weight: float = 0.5
    """Weight of the deviation from the human draw, in human standard deviations."""
    draw_spread: float = 0.7
    """Spread of the human draw, in human standard deviations."""
    seed: int = 0
    """Seed of the draws."""

    def __post_init__(self) -> None:
        if not self.per_type >= 1:
            raise InputError(f"per_type must be at least 1, got {self.per_type}")
        if not 0.0 <= self.aperture_min_m <= self.aperture_max_m < np.inf:
            raise InputError(
                "apertures must be finite and not negative, the smallest no larger than the largest, "
                f"got aperture_min_m {self.aperture_min_m} and aperture_max_m {self.aperture_max_m}"
            )
        for name in ("aperture_tolerance_m", "support_plane_tolerance_m", "support_reach_tolerance_m"):
            if not getattr(self, name) >= _FINEST_TOLERANCE_M:
                raise InputError(f"{name} must be at least {_FINEST_TOLERANCE_M:g}, got {getattr(self, name)}")
        for name in ("aperture_skew", "support_reach_m", "normal_weight", "human_weight", "draw_spread"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise InputError(f"{name} must be finite and not negative, got {getattr(self, name)}")
        if not self.seed >= 0:
            raise InputError(f"seed must not be negative, got {self.seed}")


def make_seeds(
    hand: HandModel, spec: SeedSpec | None = None, progress: Callable[[int], None] | None = None
) -> LabelledPostures:
    """Make seed postures for all six types, apertures evenly spread.

    Args:
        hand: the hand; its joints carry the Shadow names the human statistics use.
        spec: counts, weights and seed.
        progress: called with 1 after each posture.
    """
    spec = spec or SeedSpec()
    postures, labels = [], []
    for number, kind in enumerate(GRASP_TYPES.values()):
        rng = np.random.default_rng([spec.seed, number])
        span = spec.aperture_max_m - spec.aperture_min_m
        apertures = spec.aperture_min_m + span * np.linspace(0.0, 1.0, spec.per_type) ** spec.aperture_skew
        for aperture in apertures:
            postures.append(_solve(hand, kind, float(aperture), spec, rng))
            labels.append(kind.name)
            if progress is not None:
                progress(1)
    return LabelledPostures(hand.joint_names, np.array(postures), np.array(labels))


def _solve(hand: HandModel, kind: GraspType, aperture_m: float, spec: SeedSpec, rng: np.random.Generator) -> Array:
    human = human_statistics(kind.name, hand.joint_names)
    wished = human.mean + spec.draw_spread * human.sd * rng.standard_normal(len(human.mean))
    margin = 1e-4
    lower, upper = hand.lower_rad + margin, hand.upper_rad - margin
    wished = np.clip(wished, lower, upper)
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

    start = wished
    found = least_squares(
        lambda posture: residuals(posture[None])[0], start, jac=jacobian, bounds=(lower, upper), max_nfev=60
    )
    return np.asarray(found.x)


def _contact_residuals(hand: HandModel, kind: GraspType, aperture_m: float, spec: SeedSpec, postures: Array) -> Array:
    thumb_name, other_name = kind.opposition
    places = hand.places(postures, [thumb_name, other_name, *kind.support])
    thumb, other = places[thumb_name], places[other_name]
    line = other.point_m - thumb.point_m
    distance = np.linalg.norm(line, axis=-1, keepdims=True)
    axis = line / np.maximum(distance, 1e-9)
    parts = [
        (distance - aperture_m) / spec.aperture_tolerance_m,
        spec.normal_weight * (thumb.normal - axis),
        spec.normal_weight * (other.normal + axis),
    ]
    for name in kind.support:
        offset = places[name].point_m - other.point_m
        out_of_plane = (offset * axis).sum(axis=-1, keepdims=True)
        beside = np.linalg.norm(offset - out_of_plane * axis, axis=-1, keepdims=True)
        reach = spec.support_reach_m * (1 + _rank(kind, name))
        parts.append(out_of_plane / spec.support_plane_tolerance_m)
        parts.append(np.maximum(beside - reach, 0.0) / spec.support_reach_tolerance_m)
    return np.concatenate(parts, axis=1)


def _rank(kind: GraspType, support: str) -> int:
    """Count the fingers between a supporting place and the opposing finger."""
    return kind.support.index(support)
