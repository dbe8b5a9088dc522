"""What a caller may say about an export or an import, beyond the grasps themselves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..grasps import Grasps

if TYPE_CHECKING:
    # Both rooms load the physics engine, which a reader or writer of files does not need.
    from ..evaluation import Evaluation
    from ..trials import Outcomes

HeldRates = Mapping[tuple[str, str], float]
"""Measured held rate in [0, 1] by grasp type and object label."""
PARENT_LINKS = ("forearm", "palm")


@dataclass(frozen=True)
class ExportOptions:
    """Say what other formats have a place for and grasps do not carry; a format ignores what it has no place for.

    Attributes:
        held_rates: measured held rates, the confidence of grasps that carry no probability of their own.
        outcomes: trials of these very grasps, in their order; gives the joints and the object's pose in contact.
        frame_id: name of the frame that poses are given in; by default ``world`` where the object's pose in the world
            is known and the object's label where it is not.
        parent_link: link whose pose a MoveIt grasp states; with ``forearm`` the wrist joints are listed, at zero.
        joint_prefix: put before link and joint names, such as ``rh_``.
        approach_m: length of the approach before closing, metres.
        retreat_m: length of the retreat after closing, metres.
        object_root: folder that object paths are written under; by default the exported folder's own, absolute.
    """

    held_rates: HeldRates = field(default_factory=dict)
    outcomes: Outcomes | None = None
    frame_id: str | None = None
    parent_link: Literal["forearm", "palm"] = "forearm"
    joint_prefix: str = ""
    approach_m: float = 0.1
    retreat_m: float = 0.1
    object_root: str | None = None

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            InputError: a rate outside [0, 1], a negative length or an unknown parent link.
        """
        if any(not 0 <= rate <= 1 for rate in self.held_rates.values()):
            raise InputError("a held rate must lie between 0 and 1")
        if not (0 <= self.approach_m < np.inf and 0 <= self.retreat_m < np.inf):
            raise InputError(f"approach and retreat must be lengths, got {self.approach_m} m and {self.retreat_m} m")
        if self.parent_link not in PARENT_LINKS:
            raise InputError(f"parent_link must be one of {', '.join(PARENT_LINKS)}, got {self.parent_link!r}")

    def confidence(self, grasps: Grasps) -> NDArray[np.float64]:
        """Give each grasp's own probability, else the held rate of its type and object, else NaN."""
        pairs = zip(grasps.grasp_type.tolist(), grasps.object_label.tolist(), strict=True)
        measured = np.array([self.held_rates.get(pair, np.nan) for pair in pairs])
        return np.where(np.isnan(grasps.probability), measured.reshape(len(grasps)), grasps.probability)

    def with_rates_of(self, metadata: Mapping[str, Any]) -> ExportOptions:
        """Add the measured rates that a document's metadata carries (see `GraspSampler.measured`); own rates win."""
        try:
            carried = {
                (kind, label): float(cell["held"]) / float(cell["n"])
                for key, cell in dict(metadata.get("measured", {})).items()
                for kind, label in [key.split("/")]
            }
        except (TypeError, ValueError, KeyError, ZeroDivisionError):
            # Metadata is free-form: what does not read as rates is none.
            return self
        return replace(self, held_rates=carried | dict(self.held_rates))


@dataclass(frozen=True)
class Assumptions:
    """Say of every grasp in a foreign file what the file itself does not.

    Attributes:
        grasp_type: name of a grasp type.
        object_label: catalogue object that the file's object is.
        side_axis: body axis it is held by; None takes the side nearest to the opposition axis.
    """

    grasp_type: str | None = None
    object_label: str | None = None
    side_axis: str | None = None


def held_rates(evaluation: Evaluation) -> dict[tuple[str, str], float]:
    """Give the held rates of an evaluation's cells by grasp type and object label."""
    return {(cell.grasp_type, cell.object_label): cell.held_rate.rate for cell in evaluation.cells if cell.n}
