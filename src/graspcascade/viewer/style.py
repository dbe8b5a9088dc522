"""Colours of hand and object and the room they take, the same on the page and in pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..hands import Hand

RGB = tuple[int, int, int]

OBJECT_RGB: RGB = (237, 125, 49)
_LINK, _TIP, _KNUCKLE = (204, 209, 217), (69, 94, 120), (97, 105, 115)
_PALM, _BASE = (153, 161, 171), (122, 128, 136)
_MARGIN_M = 0.02
"""Thickness of the hand about the points that `hand_bounds` measures."""


def body_rgb(hand: Hand, body: str) -> RGB:
    """Choose a body's colour by what it is: tips that are meant to touch, knuckles, links, palm, forearm and wrist."""
    if body in {digit.tip_body for digit in hand.digits.values()}:
        return _TIP
    if body in {digit.root for digit in hand.digits.values()}:
        return _KNUCKLE
    if body == hand.body or body in hand.palm_bodies:
        return _PALM
    return _LINK if body in {link.name for link in hand.kinematics.links} else _BASE


def hand_bounds(hand: Hand) -> tuple[NDArray[np.float64], float]:
    """Compute the middle ``(3,)`` and the radius of the open hand, forearm left out, metres in the hand frame."""
    posture = hand.pregrasp[None]
    points = np.concatenate(
        [origin for _, origin in hand.frames(posture).values()] + list(hand.tips(posture, list(hand.digits)).values())
    )
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max()) + _MARGIN_M
