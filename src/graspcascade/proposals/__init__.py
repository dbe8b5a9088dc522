"""Where grasps come from: the geometric heuristic and the trained cascade, both a `Proposal`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.errors import MAX_SEED, InputError, check_whole
from ..core.grasps import Grasps
from ..core.objects import CATALOGUE, GraspObject, Site, as_object
from ..core.poses import Pose
from ..core.tasks import Task, Tasks, draw_tasks
from ..core.taxonomy import GRASP_TYPES, GraspType, as_type
from ..hands.hand import Hand

Array = NDArray[np.float64]


class Proposal(ABC):
    """Turn tasks into grasps; the same generator state gives the same grasps.

    Attributes:
        name: what rates are quoted under.
        hand: the hand that the grasps are for.
        source: what a file of grasps calls this kind of proposal.
    """

    source: ClassVar[str] = "own"
    screening: ClassVar[str] = "none"
    """What `hopeless` does, for a record."""
    name: str
    hand: Hand

    @property
    def grasp_types(self) -> tuple[GraspType, ...]:
        """Grasp types that it can propose; here those that the hand can make."""
        return self.hand.grasp_types

    @property
    def objects(self) -> tuple[GraspObject, ...]:
        """Objects that it is usually tried on; here those of the catalogue."""
        return tuple(CATALOGUE.values())

    @property
    def takes_any_size(self) -> bool:
        """Whether objects of any size can be asked for; else `objects` are all that it knows."""
        return True

    def as_type(self, given: GraspType | str) -> GraspType:
        """Read a grasp type: one as it is, or a name, of its own types first; an unknown one is an InputError."""
        return as_type(given, {**GRASP_TYPES, **{kind.name: kind for kind in self.grasp_types}})

    def check_types(self, kinds: Iterable[GraspType]) -> None:
        """Check that types are of the taxonomy of its own of these names; an InputError names the first that is not."""
        own = {kind.name: kind for kind in self.grasp_types}
        for kind in kinds:
            if (known := own.get(kind.name, kind).taxonomy) != kind.taxonomy:
                other = f"{self.name} knows the {kind.name} of taxonomy {known!r}, not that of {kind.taxonomy!r}"
                raise InputError(f"{other}; give it by name")

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

    def sample(
        self,
        grasp_type: GraspType | str,
        obj: GraspObject | str,
        side: Site | str | None = None,
        n: int = 10,
        seed: int = 0,
    ) -> Grasps:
        """Draw n grasps of one object; the same arguments give the same grasps.

        The object may be a size such as ``box:30x45x60mm``, and the side one of its body axes, ``"x"``, or a site. With
        no side, each grasp draws one of those that the hand can hold.

        Raises:
            InputError: an unknown name, a side that cannot be held, n < 1, a negative seed, or see `propose`.
        """
        kind, target = self.as_type(grasp_type), as_object(obj)
        check_whole("n", n, 1)
        check_whole("seed", seed, most=MAX_SEED)
        rng = np.random.default_rng(seed)
        if side is None:
            return self.propose_any_side(target, kind, n, rng)
        site = target.site(side, self.hand.reach_m) if isinstance(side, str) else side
        return self.propose(Tasks.repeat(Task(kind, target, site), n), rng)

    def hopeless(self, grasps: Grasps) -> NDArray[np.bool_]:
        """Tell which of its grasps ``(n,)`` a collection need not try; here none."""
        return np.zeros(len(grasps), dtype=bool)

    def notes(self, grasps: Grasps) -> tuple[str, ...]:
        """Say what a user should be told of grasps that it drew; here nothing."""
        return ()

    def describe(self) -> dict[str, Any]:
        """Say for a record what the grasps are drawn from."""
        return {}

    def origin(self, kind: GraspType, obj: GraspObject) -> dict[str, Any]:
        """Say for a file of such grasps where they come from.

        `measured` holds what became of others of the type and object in trials, by "type/object"; empty where unknown.
        """
        return {"source": self.source, "model": self.name, "hand": self.hand.name, "measured": {}}


def as_proposed(
    hand: Hand, tasks: Tasks, posture: Array, X_hand_object: Pose, grasp_size_m: Array, object_size_m: Array
) -> Grasps:
    """Make grasps of a hand that opens as it always does, their chances unknown; arguments are as in `Grasps`."""
    return Grasps(
        hand=hand.name,
        joint_names=hand.joint_names,
        tasks=tasks,
        posture=posture,
        pregrasp=np.broadcast_to(hand.pregrasp, posture.shape).copy(),
        X_hand_object=X_hand_object,
        grasp_size_m=grasp_size_m,
        object_size_m=object_size_m,
        probability=np.full(len(tasks), np.nan),
    )


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
