"""Digits that take no part in a grasp: left out of a simulation while they are clear of everything.

The base of the hand stands still, so that a digit which touches nothing has no effect on the object or on the other
digits: leaving it out changes nothing but rounding. What a tendon ties holds only the sum of its joints: under weight a
digit tips over between them, so that it must be clear however they share the sum. The object may slip, and is watched.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...hands import Hand
from ...worlds.pairs import digit_of_bodies, digit_of_geoms
from ...worlds.world import OBJECT, World, object_rows


def idle_sets(hand: Hand) -> list[tuple[str, ...]]:
    """List the digits that may be left out together, in order of preference: all but the index, or all but two."""
    return [fingers for fingers in (hand.fingers[1:], hand.fingers[2:]) if fingers]


_LEAVE_OBJECT_M, _LEAVE_DIGIT_M = 0.006, 0.0015
"""A digit is left out if it is at least this far from the object, and from digits that stay, after closing."""
_KEEP_M = 0.001
"""It stays out while it is at least this far from the object."""
_NEAR_M = 0.02
"""Clearance is measured up to this distance."""
_TIPPED = (-1.0, -0.5, 0.5, 1.0)
"""How far joints that share a tendon are tipped, as shares of the way to their limits either way."""
_LEAST_LEVER_M = 0.06
"""Turns of the object count by its radius, and at least by this."""


@dataclass(frozen=True)
class Idle:
    """Remember which digits were left out of a trial, and where they were.

    Attributes:
        place: place in `idle_sets`.
        qpos: state of the whole world after closing.
        slack_m: how far the object may move before it could come near them.
    """

    place: int
    qpos: NDArray[np.float64]
    slack_m: float


class IdleFinder:
    """Find digits that are clear of the rest, and tell whether they still are.

    The world is a reduced one with all digits: its contact pairs say what can touch what.
    """

    def __init__(self, world: World, hand: Hand) -> None:
        # Objects are written into it, and the world's own model is shared.
        self._model = copy.copy(world.model)
        self._data, self._rows = mujoco.MjData(self._model), object_rows(self._model)
        self._pairs = np.stack([world.model.pair_geom1, world.model.pair_geom2], axis=1)
        self._with_object = (self._pairs == world.model.geom(OBJECT).id).any(axis=1)
        self._leave = np.where(self._with_object, _LEAVE_OBJECT_M, _LEAVE_DIGIT_M)
        digit, order = digit_of_geoms(world.model, hand)[self._pairs], list(hand.digits)
        # The first bodies of neighbouring digits turn side by side about axes of their own and cannot meet.
        roots = [int(world.model.body(hand.prefix + digit.root).id) for digit in hand.digits.values()]
        side_by_side = np.isin(world.model.geom_bodyid[self._pairs], roots).all(axis=1)
        self._tips = [_tips(world.model, hand, names) for names in idle_sets(hand)]
        self._between = [
            np.setdiff1d(_boundary(digit, [order.index(name) for name in names]), np.flatnonzero(side_by_side))
            for names in idle_sets(hand)
        ]

    def use(self, fields: Mapping[str, NDArray[Any]]) -> None:
        """Measure with an object of these `worlds.world.object_fields`."""
        for name, values in fields.items():
            if name.startswith("geom_"):
                getattr(self._model, name)[self._rows[name]] = values

    def find(self, qpos: NDArray[np.float64]) -> Idle | None:
        """Find the first of `idle_sets` that is clear in a state of the whole world, None if none is."""
        for place, between in enumerate(self._between):
            pairs, distances = self._distances(qpos, between)
            if (distances >= self._leave[pairs]).all():
                slack = self._slack(qpos, place)
                if slack >= _LEAVE_OBJECT_M - _KEEP_M:
                    return Idle(place, qpos.copy(), slack)
        return None

    def slack(self, idle: Idle, qpos: NDArray[np.float64], addresses: NDArray[np.intp]) -> float:
        """Measure how far the object may move, metres, before it could come near the digits left out.

        It is zero or less where it is near already. `qpos` is a state of the world without these digits, `addresses`
        where its entries stand in the state of the whole world.
        """
        whole = idle.qpos.copy()
        whole[addresses] = qpos
        return self._slack(whole, idle.place)

    def _slack(self, qpos: NDArray[np.float64], place: int) -> float:
        between, slack = self._between[place], _NEAR_M
        with_object = between[self._with_object[between]]
        for state in _tipped(qpos, self._tips[place]):
            slack = min(slack, self._distances(state, with_object)[1].min(initial=_NEAR_M))
        return slack - _KEEP_M

    def _distances(
        self, qpos: NDArray[np.float64], places: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Measure the pairs that are nearer than `_NEAR_M`: their places and distances."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        first, second = self._pairs[places].T
        centres, radii = self._data.geom_xpos, self._model.geom_rbound
        apart = np.linalg.norm(centres[first] - centres[second], axis=1) - (radii[first] + radii[second])
        near, fromto = places[apart < _NEAR_M], np.zeros(6)
        pairs = self._pairs[near].tolist()
        distances = [
            mujoco.mj_geomDistance(self._model, self._data, one, other, _NEAR_M, fromto) for one, other in pairs
        ]
        return near, np.array(distances)


@dataclass(frozen=True)
class _Tip:
    """Two joints that share a tendon: addresses in qpos, weights in its sum, and limits, rows lower and upper."""

    addresses: tuple[int, int]
    weights: NDArray[np.float64]
    limits: NDArray[np.float64]


def _tips(model: Any, hand: Hand, digits: Sequence[str]) -> list[_Tip]:
    """List the neighbouring joints of each tendon in some digits."""
    digit, places = digit_of_bodies(model, hand), [list(hand.digits).index(name) for name in digits]
    tips = []
    for coupling in hand.couplings:
        joints = [model.joint(hand.prefix + name) for name in coupling.joints]
        if coupling.kind == "tendon" and digit[joints[0].bodyid[0]] in places:
            for first in range(len(joints) - 1):
                pair, weights = joints[first : first + 2], np.array(coupling.coefficients[first : first + 2])
                addresses = (int(pair[0].qposadr[0]), int(pair[1].qposadr[0]))
                tips.append(_Tip(addresses, weights, np.array([joint.range for joint in pair]).T))
    return tips


def _tipped(qpos: NDArray[np.float64], tips: Sequence[_Tip]) -> list[NDArray[np.float64]]:
    """Copy a state, the first as it is, with joints that share a tendon tipped against each other, their sum kept."""
    states = [qpos]
    for share in _TIPPED if tips else ():
        state = qpos.copy()
        for tip in tips:
            # One joint turns by 1 / weight, the other by -1 / weight; the first limit met ends it.
            turn = np.array([1.0, -1.0]) / tip.weights * np.sign(share)
            angles = qpos[list(tip.addresses)]
            room = np.where(turn > 0.0, tip.limits[1] - angles, tip.limits[0] - angles) / turn
            state[list(tip.addresses)] = angles + abs(share) * max(float(room.min()), 0.0) * turn
        states.append(state)
    return states


def object_moved(
    world: World, a: NDArray[np.float64], b: NDArray[np.float64], radius_m: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Bound how far any part of the object moved between states ``(k, n_qpos)``, metres ``(k,)``.

    `radius_m` ``(k,)`` is the distance of the object's farthest point from its centre.
    """
    position, quat = (slice(world.object_qpos + first, world.object_qpos + last) for first, last in ((0, 3), (3, 7)))
    shift = np.linalg.norm(b[:, position] - a[:, position], axis=1)
    # Two unit quaternions differ by 2 sin(angle / 4), and the half of an angle is at most pi / 2 times its sine.
    apart = np.minimum(*(np.linalg.norm(a[:, quat] - sign * b[:, quat], axis=1) for sign in (1.0, -1.0)))
    return np.asarray(shift + np.maximum(radius_m, _LEAST_LEVER_M) * np.pi * apart)


def _boundary(digits: NDArray[np.int64], idle: Sequence[int]) -> NDArray[np.int64]:
    """Find the pairs of which exactly one geom belongs to an idle digit, from ``(n_pairs, 2)`` digits."""
    return np.flatnonzero(np.isin(digits, idle).sum(axis=1) == 1)
