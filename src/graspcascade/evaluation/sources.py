"""Where the grasps under evaluation come from, behind one call."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..candidates import candidates, cannot_touch
from ..grasps import Grasps
from ..hands import HandModel
from ..postures import PosturePrior

Names = NDArray[np.str_]

HEURISTIC = "heuristic"
"""Name of the heuristic among models, and stem of its evaluation's file."""


class Source(Protocol):
    """Draw one grasp for each row; the same generator state gives the same grasps."""

    def __call__(
        self, grasp_types: Names, object_labels: Names, side_axes: Names, rng: np.random.Generator, /
    ) -> Grasps:
        """Draw grasps for ``(n,)`` type names, object labels and side axes, in that order."""
        ...


class RowSampler(Protocol):
    """Name the one method of `cascade.GraspSampler` that an evaluation needs."""

    def sample_rows(
        self, grasp_types: Names, object_labels: Names, side_axes: Names, rng: np.random.Generator, /
    ) -> Grasps:
        """Draw one grasp for each row."""
        ...


def heuristic_source(hand: HandModel, prior: PosturePrior, most_draws: int = 1) -> Source:
    """Give the paper's heuristic: postures of the prior, placed as they come and, unless asked for, not screened.

    Args:
        hand: the hand.
        prior: what postures are drawn from.
        most_draws: how often a posture is drawn for a grasp whose opposing places are too far apart to touch the
            object (see `candidates.cannot_touch`). Above 1 this screens, as a collection does, but keeps the side
            asked for; a grasp that no draw helps stays the last one.

    Raises:
        InputError: the prior is of other joints than the hand.
    """
    prior.check_hand(hand)

    def draw(grasp_types: Names, object_labels: Names, side_axes: Names, rng: np.random.Generator) -> Grasps:
        postures = prior.sample(grasp_types, rng)
        grasps = candidates(hand, postures, grasp_types, object_labels, side_axes, rng)
        for _ in range(most_draws - 1):
            rows = np.flatnonzero(cannot_touch(hand, grasps))
            if not rows.size:
                break
            postures[rows] = prior.sample(grasp_types[rows], rng)
            grasps = candidates(hand, postures, grasp_types, object_labels, side_axes, rng)
        return grasps

    return draw


def heuristic_metadata(prior: PosturePrior, most_draws: int = 1) -> dict[str, Any]:
    """Say for a record what `heuristic_source` draws from, and whether it screens."""
    return {"prior": prior.fingerprint()} | ({"most_draws": most_draws} if most_draws > 1 else {})


def model_source(sampler: RowSampler) -> Source:
    """Give the grasps of a trained cascade, one draw a row."""
    return sampler.sample_rows
