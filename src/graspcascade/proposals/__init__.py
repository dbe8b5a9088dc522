"""Where grasps come from: the geometric heuristic and the trained cascade, both a `Proposal`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..core.grasps import Grasps
from ..core.objects import GraspObject
from ..core.tasks import Tasks, draw_tasks
from ..core.taxonomy import GraspType
from ..hands.hand import Hand


class Proposal(ABC):
    """Turn tasks into grasps; the same generator state gives the same grasps.

    Attributes:
        name: what rates are quoted under.
        hand: the hand that the grasps are for.
    """

    name: str
    hand: Hand

    @abstractmethod
    def propose(self, tasks: Tasks, rng: np.random.Generator) -> Grasps:
        """Draw one grasp for each task.

        Args:
            tasks: what to grasp, by sites within the hand's reach.
            rng: source of all draws.

        Raises:
            InputError: a task that it cannot propose for.
        """

    def propose_any_side(self, obj: GraspObject, kind: GraspType, n: int, rng: np.random.Generator) -> Grasps:
        """Draw n grasps of an object, each by a side drawn among those the hand can hold.

        Raises:
            InputError: the hand can hold the object by none of its sides, or see `propose`.
        """
        return self.propose(draw_tasks([(obj, kind)], n, self.hand.reach_m, rng), rng)

    def describe(self) -> dict[str, Any]:
        """Say for a record what the grasps are drawn from."""
        return {}


def check_reach(hand: Hand, tasks: Tasks) -> None:
    """Check that the hand can reach round every site.

    Raises:
        InputError: a site is wider than the hand's reach.
    """
    for task in tasks.distinct:
        if task.site.width_m > hand.reach_m + 1e-9:
            raise InputError(
                f"side {task.site.name} of {task.object.name} is {task.site.width_m * 100:g} cm, beyond the hand's "
                f"reach of {hand.reach_m * 100:g} cm. Graspable sides: {task.object.describe_sides(hand.reach_m)}."
            )
