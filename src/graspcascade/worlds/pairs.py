"""Which pairs of geoms a trial tests for contact: the object with the hand, and digits that can reach each other."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..hands import Hand

_POSTURES = 400
_CLEARANCE_M = 0.005
"""Geoms that stay farther apart than this in all of `_POSTURES` postures are taken never to touch."""

Pair = tuple[int, int]


def digit_of_bodies(model: Any, hand: Hand) -> NDArray[np.int64]:
    """Find the place of each body's digit among the hand's ``(n_bodies,)``, -1 for what belongs to none."""
    place = {hand.prefix + digit.root: place for place, digit in enumerate(hand.digits.values())}
    of_body = np.full(model.nbody, -1, dtype=np.int64)
    for body in range(1, model.nbody):  # parents come before their children
        of_body[body] = place.get(model.body(body).name, of_body[model.body_parentid[body]])
    return of_body


def digit_of_geoms(model: Any, hand: Hand) -> NDArray[np.int64]:
    """Find the place of each geom's digit among the hand's ``(n_geoms,)``, -1 for what belongs to none."""
    return np.asarray(digit_of_bodies(model, hand)[model.geom_bodyid])


def digit_pairs(digit_of_geom: Mapping[int, int], thumb: int) -> list[Pair]:
    """List the geom pairs of the thumb with each finger and of neighbouring fingers, from each geom's digit's place."""

    def meet(a: int, b: int) -> bool:
        return a != b and (thumb in (a, b) or abs(a - b) == 1)

    return [(a, b) for a, b in combinations(digit_of_geom, 2) if meet(digit_of_geom[a], digit_of_geom[b])]


def reachable(model: Any, pairs: Sequence[Pair]) -> list[Pair]:
    """Keep the geom pairs that come near each other in some posture within the joint limits.

    Postures are drawn from a fixed seed, with each joint most often near a limit, where extremes of reach lie.
    """
    data = mujoco.MjData(model)
    hinges = model.jnt_type != mujoco.mjtJoint.mjJNT_FREE
    addresses, (low, high) = model.jnt_qposadr[hinges], model.jnt_range[hinges].T
    fractions = np.random.default_rng(0).beta(0.5, 0.5, size=(_POSTURES, len(addresses)))
    if not pairs:
        return []
    first, second = (np.array(column, dtype=np.intp) for column in zip(*pairs, strict=True))
    reach = model.geom_rbound[first] + model.geom_rbound[second] + _CLEARANCE_M
    near = np.zeros(len(pairs), dtype=bool)
    fromto = np.zeros(6)
    for fraction in fractions:
        data.qpos[addresses] = low + fraction * (high - low)
        mujoco.mj_kinematics(model, data)
        apart = np.linalg.norm(data.geom_xpos[first] - data.geom_xpos[second], axis=1)
        for place in np.flatnonzero(~near & (apart < reach)):
            one, other = pairs[int(place)]
            distance = mujoco.mj_geomDistance(model, data, one, other, 2.0 * _CLEARANCE_M, fromto)
            near[place] = distance < _CLEARANCE_M
    return [pair for pair, kept in zip(pairs, near, strict=True) if kept]


def declare(spec: Any, pairs: Iterable[tuple[Any, Any]], contact: Mapping[str, Any]) -> None:
    """Make the given pairs of the spec's geoms the only ones that are tested, with these contact parameters.

    An explicit list costs one bounding-sphere test a pair and spares the engine the search for pairs in every step.
    """
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = 0, 0
    for one, other in pairs:
        spec.add_pair(geomname1=one.name, geomname2=other.name, **contact)
