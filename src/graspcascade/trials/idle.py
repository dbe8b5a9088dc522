"""Digits that take no part in a grasp: left out of a simulation while they are clear of everything.

The base of the hand stands still, so that a digit which touches nothing has no effect on the object or on the other
digits: leaving it out changes nothing but rounding. Digits that closed without touching each other hold still from
then on; the object may slip, and is watched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..hands import HandDescription
from .pairs import digit_of_geoms
from .scene import OBJECT, Scene

IDLE_SETS: tuple[tuple[str, ...], ...] = (("middle", "ring", "little"), ("ring", "little"))
"""Digits that may be left out together, in order of preference."""

_LEAVE_OBJECT_M, _LEAVE_DIGIT_M = 0.006, 0.0015
"""A digit is left out if it is at least this far from the object, and from digits that stay, after closing."""
_KEEP_M = 0.001
"""It stays out while it is at least this far from the object."""
_NEAR_M = 0.02
"""Clearance is measured up to this distance."""
_OBJECT_LEVER_M = 0.06
"""No point of a graspable object is farther from its centre."""


@dataclass(frozen=True)
class Idle:
    """Remember which digits were left out of a trial, and where they were.

    Attributes:
        place: place in `IDLE_SETS`.
        qpos: state of the whole scene after closing.
        slack_m: how far the object may move before it could come near them.
    """

    place: int
    qpos: NDArray[np.float64]
    slack_m: float


class IdleFinder:
    """Find digits that are clear of the rest, and tell whether they still are.

    Args:
        scene: a reduced scene with all digits; its contact pairs say what can touch what.
        hand: the hand.
    """

    def __init__(self, scene: Scene, hand: HandDescription) -> None:
        self._model, self._data = scene.model, mujoco.MjData(scene.model)
        self._pairs = np.stack([scene.model.pair_geom1, scene.model.pair_geom2], axis=1)
        self._reach = scene.model.geom_rbound[self._pairs].sum(axis=1)
        self._with_object = (self._pairs == scene.model.geom(OBJECT).id).any(axis=1)
        self._leave = np.where(self._with_object, _LEAVE_OBJECT_M, _LEAVE_DIGIT_M)
        digit, order = digit_of_geoms(scene.model, hand)[self._pairs], list(hand.digit_roots)
        # The first bodies of neighbouring digits turn side by side about axes of their own and cannot meet.
        roots = [int(scene.model.body(hand.prefix + body).id) for body in hand.digit_roots.values()]
        side_by_side = np.isin(scene.model.geom_bodyid[self._pairs], roots).all(axis=1)
        self._between = [
            np.setdiff1d(_boundary(digit, [order.index(name) for name in names]), np.flatnonzero(side_by_side))
            for names in IDLE_SETS
        ]

    def find(self, qpos: NDArray[np.float64]) -> Idle | None:
        """Find the first of `IDLE_SETS` that is clear in a state of the whole scene, None if none is."""
        for place, between in enumerate(self._between):
            pairs, distances = self._distances(qpos, between)
            if (distances >= self._leave[pairs]).all():
                return Idle(place, qpos.copy(), self._slack(distances[self._with_object[pairs]]))
        return None

    def slack(self, idle: Idle, qpos: NDArray[np.float64], addresses: NDArray[np.intp]) -> float:
        """Give how far the object may move, metres, before it could come near the digits left out.

        Args:
            idle: what was left out.
            qpos: state of the scene without these digits.
            addresses: where its entries stand in the state of the whole scene.

        Returns:
            Zero or less where it is near already.
        """
        whole = idle.qpos.copy()
        whole[addresses] = qpos
        between = self._between[idle.place]
        return self._slack(self._distances(whole, between[self._with_object[between]])[1])

    @staticmethod
    def _slack(distances: NDArray[np.float64]) -> float:
        return float(distances.min(initial=_NEAR_M)) - _KEEP_M

    def _distances(
        self, qpos: NDArray[np.float64], places: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Measure the pairs that are nearer than `_NEAR_M`: their places and distances."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        first, second = self._pairs[places].T
        centres = self._data.geom_xpos
        apart = np.linalg.norm(centres[first] - centres[second], axis=1) - self._reach[places]
        near, fromto = places[apart < _NEAR_M], np.zeros(6)
        pairs = self._pairs[near].tolist()
        found = [mujoco.mj_geomDistance(self._model, self._data, one, other, _NEAR_M, fromto) for one, other in pairs]
        return near, np.array(found)


def object_moved(scene: Scene, a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bound how far any part of the object moved between states ``(k, n_qpos)``, metres ``(k,)``."""
    place, quat = (slice(scene.object_qpos + first, scene.object_qpos + last) for first, last in ((0, 3), (3, 7)))
    shift = np.linalg.norm(b[:, place] - a[:, place], axis=1)
    # Two unit quaternions differ by 2 sin(angle / 4), and the half of an angle is at most pi / 2 times its sine.
    apart = np.minimum(*(np.linalg.norm(a[:, quat] - sign * b[:, quat], axis=1) for sign in (1.0, -1.0)))
    return np.asarray(shift + _OBJECT_LEVER_M * np.pi * apart)


def _boundary(digits: NDArray[np.int64], idle: Sequence[int]) -> NDArray[np.int64]:
    """Give the pairs of which exactly one geom belongs to an idle digit, from ``(n_pairs, 2)`` digits."""
    return np.flatnonzero(np.isin(digits, idle).sum(axis=1) == 1)
