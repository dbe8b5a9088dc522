"""What a caller may say about an export or an import, and where an exported hand is in contact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError, check_name
from ..core.grasps import Grasps
from ..core.objects import CATALOGUE, GraspObject
from ..core.outcomes import Outcomes
from ..core.poses import Pose
from ..core.tasks import Task
from ..hands import Hand, is_left

if TYPE_CHECKING:
    from ..studies.record import Evaluation

HeldRates = Mapping[tuple[str, str], float]
"""Measured held rate in [0, 1] by grasp type and object name."""
_CHOICES: Mapping[str, tuple[Any, ...]] = {
    "parent_link": ("forearm", "palm"),
    "frame_keys": ("frame", "frame_link"),
    "contact": ("settled", "target"),
    "joint_numbering": (0, 1),
}


@dataclass(frozen=True)
class ExportOptions:
    """Say what other formats have a place for and grasps do not carry; a format ignores what it has no place for.

    Attributes:
        held_rates: measured held rates, the confidence of grasps that carry no probability of their own.
        outcomes: trials of these very grasps, in their order; gives the joints and the object's pose in contact.
        contact: what formats of a hand in contact state: ``settled`` as in `outcomes`, or ``target``, which lies a
            little inside the object.
        frame_id: name of the frame that MoveIt poses are in; by default ``world`` where the object's pose in the world
            is known and the object's name where it is not; empty for the object's own frame.
        frame_keys: whether isaac_grasp says ``object_frame`` or ``object_frame_link``, and the same of the gripper.
        parent_link: link whose pose a MoveIt grasp states; with ``forearm`` the wrist joints are listed, at zero. A
            hand without a wrist has its palm only.
        joint_prefix: put before link and joint names, such as ``rh_``.
        joint_numbering: 1, or 0 to name joints as older Shadow models do, whose ``FFJ3`` is ``FFJ4`` here; angles stay.
        approach_m: length of the approach before closing, metres.
        retreat_m: length of the retreat after closing, metres.
        object_root: folder that object paths are written under; by default the exported folder's own, absolute.
        hand: the hand; by default the shipped one that the grasps are for.

    Raises:
        InputError: a rate outside [0, 1], a negative length, a left hand's prefix or an unknown choice.
    """

    held_rates: HeldRates = field(default_factory=dict)
    outcomes: Outcomes | None = None
    contact: Literal["settled", "target"] = "settled"
    frame_id: str | None = None
    frame_keys: Literal["frame", "frame_link"] = "frame"
    parent_link: Literal["forearm", "palm"] = "forearm"
    joint_prefix: str = ""
    joint_numbering: Literal[0, 1] = 1
    approach_m: float = 0.1
    retreat_m: float = 0.1
    object_root: str | None = None
    hand: Hand | None = None

    def __post_init__(self) -> None:
        if any(not 0 <= rate <= 1 for rate in self.held_rates.values()):
            raise InputError("a held rate must lie between 0 and 1")
        if not (0 <= self.approach_m < np.inf and 0 <= self.retreat_m < np.inf):
            raise InputError(f"approach and retreat must be lengths, got {self.approach_m} m and {self.retreat_m} m")
        if is_left(self.joint_prefix):
            raise InputError(f"joint prefix {self.joint_prefix!r} is of a left hand; all hands here are right ones")
        for name, choices in _CHOICES.items():
            check_name(name, str(getattr(self, name)), [str(choice) for choice in choices])

    def confidence(self, grasps: Grasps) -> NDArray[np.float64]:
        """Find each grasp's own probability ``(n,)``, else the held rate of its type and object, else NaN."""
        measured = grasps.tasks.column(self._rate, np.float64)
        return np.where(np.isnan(grasps.probability), measured, grasps.probability)

    def _rate(self, task: Task) -> float:
        obj = task.object
        # Rates are of the catalogue's objects; a file may give one's name to an object of another size.
        known = CATALOGUE.get(obj.name, obj) == obj
        return self.held_rates.get((task.grasp_type.name, obj.name), np.nan) if known else np.nan

    def with_rates_of(self, metadata: Mapping[str, Any]) -> ExportOptions:
        """Add the measured rates that a document's metadata carries (see `GraspSampler.measured`); own rates win."""
        try:
            carried = {
                (kind, name): float(cell["held"]) / float(cell["n"])
                for key, cell in dict(metadata.get("measured", {})).items()
                for kind, name in [key.split("/")]
            }
            return replace(self, held_rates=carried | dict(self.held_rates))
        except (TypeError, ValueError, KeyError, ZeroDivisionError):
            # Metadata is free-form: what does not read as rates is none.
            return self


@dataclass(frozen=True)
class Assumptions:
    """Say of every grasp in a foreign file what the file itself does not.

    Attributes:
        grasp_type: name of a grasp type.
        object: what the file's object is, or its spelling, at the size it has; for files that name none we know.
        side_axis: body axis it is held by; None takes the side nearest to the opposition axis.
        joint_numbering: number of the outermost joints in the file's names, 0 in files for older Shadow models.
        hand: the hand; by default the shipped one that the file is for, or the Shadow Hand where it does not say.

    Raises:
        InputError: an unknown joint numbering.
    """

    grasp_type: str | None = None
    object: GraspObject | str | None = None
    side_axis: str | None = None
    joint_numbering: Literal[0, 1] = 1
    hand: Hand | None = None

    def __post_init__(self) -> None:
        check_name("joint_numbering", str(self.joint_numbering), ("0", "1"))


def held_rates(evaluation: Evaluation) -> dict[tuple[str, str], float]:
    """Read the held rates of an evaluation's cells by grasp type and object name."""
    return {(cell.grasp_type, cell.object_label): cell.held_rate.rate for cell in evaluation.cells if cell.n}


def in_contact(grasps: Grasps, options: ExportOptions) -> tuple[Grasps, NDArray[np.bool_]]:
    """Replace joints and object poses by those in contact, where a trial reached closing; also tell where ``(n,)``."""
    placed, outcomes = grasps.X_hand_object, options.outcomes
    if outcomes is None or options.contact == "target":
        return grasps, np.zeros(len(grasps), dtype=bool)
    settled = outcomes.X_hand_object_settled
    reached = np.isfinite(np.concatenate([outcomes.settled_posture, settled.position_m], axis=1)).all(axis=1)
    rows = reached[:, None]
    position = np.where(rows, settled.position_m, placed.position_m)
    pose = Pose(position, np.where(rows, settled.quat_wxyz, placed.quat_wxyz))
    posture = np.where(rows, outcomes.settled_posture, grasps.posture)
    return replace(grasps, posture=posture, X_hand_object=pose), reached
