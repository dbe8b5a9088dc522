"""Where the grasps under evaluation come from, behind one call."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..candidates import candidates
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


def heuristic_source(hand: HandModel, prior: PosturePrior) -> Source:
    """Give the paper's heuristic: postures of the prior, placed as they come and not screened.

    Raises:
        InputError: the prior is of other joints than the hand.
    """
    prior.check_hand(hand)

    def draw(grasp_types: Names, object_labels: Names, side_axes: Names, rng: np.random.Generator) -> Grasps:
        postures = prior.sample(grasp_types, rng)
        return candidates(hand, postures, grasp_types, object_labels, side_axes, rng)

    return draw


def model_source(sampler: RowSampler) -> Source:
    """Give the grasps of a trained cascade, one draw a row."""
    return sampler.sample_rows
