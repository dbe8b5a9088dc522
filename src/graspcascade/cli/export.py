"""``graspcascade export``: grasp files from one format into another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from tyro.conf import Positional, arg

from ..errors import FileFormatError, InputError
from ..formats import (
    FORMATS_BY_NAME,
    Assumptions,
    ExportOptions,
    GraspDocument,
    check_target,
    load_document,
    save_grasps,
)
from ..poses import Pose
from .console import bar, print_json
from .sample import PoseNumbers

if TYPE_CHECKING:
    from ..trials import Outcomes

_FORMAT_HELP = "Format to write; by default the suffix of --out says. One of " + "; ".join(
    f"{name} ({found.description})" for name, found in FORMATS_BY_NAME.items()
)


@dataclass(frozen=True)
class Export:
    """Write the grasps of a file in another format.

    docs/formats.md says of each format its frame, joint order and units, and what it loses.
    """

    grasps: Annotated[Positional[Path], arg(metavar="GRASPS")]
    """Grasp file or folder to read, of any format."""
    out: Path
    """File to write, or for dexgraspbench, and several objects, a new folder."""
    format: Annotated[str | None, arg(help=_FORMAT_HELP + ".", metavar="NAME")] = None
    """Format to write."""
    from_format: Annotated[str | None, arg(metavar="NAME")] = None
    """Format of GRASPS; by default found from its suffix and content."""
    trust_pickle: bool = False
    """Read pickled .npy files, which run whatever code they carry: only from a source you trust."""
    grasp_type: str | None = None
    """Type of grasps whose file does not say."""
    object_label: str | None = None
    """Catalogue object that the file's object is, where its name does not say."""
    side_axis: str | None = None
    """Side axis (x, y or z) of grasps whose file does not say; by default the one nearest to the opposition axis."""
    evaluation: Path | None = None
    """Evaluation (JSON) of the model: its held rates become the confidence of grasps without a probability, instead of
    those that came with the model the grasps were sampled from."""
    settle: bool = False
    """Try the grasps in physics first and write joints and object pose in contact, where a format has them."""
    object_pose: Annotated[PoseNumbers | None, arg(metavar="X Y Z QW QX QY QZ")] = None
    """Object pose in the world, metres and a unit quaternion, instead of the one GRASPS may give."""
    frame_id: str | None = None
    """Name of the frame that poses are in (moveit_grasp)."""
    parent_link: Literal["forearm", "palm"] = "forearm"
    """Link whose pose is stated (moveit_grasp)."""
    joint_prefix: str = ""
    """Put before link and joint names, such as rh_ (isaac_grasp, moveit_grasp)."""
    object_root: str | None = None
    """Folder that object paths are written under (dexgraspbench); by default that of the export itself."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        """Read, then write."""
        check_target(self.out, self.format)
        rates = {} if self.evaluation is None else _rates(self.evaluation)
        assume = Assumptions(self.grasp_type, self.object_label, self.side_axis)
        found = load_document(self.grasps, self.from_format, trust_pickle=self.trust_pickle, assume=assume)
        if not len(found.grasps):
            raise InputError(f"{self.grasps} holds no grasps")
        placed = found.X_world_object
        if self.object_pose is not None:
            placed = Pose.of(self.object_pose[:3], self.object_pose[3:])
        options = ExportOptions(
            held_rates=rates,
            outcomes=_outcomes(found) if self.settle else None,
            frame_id=self.frame_id,
            parent_link=self.parent_link,
            joint_prefix=self.joint_prefix,
            object_root=self.object_root,
        )
        save_grasps(
            self.out,
            found.grasps,
            metadata=found.metadata,
            X_world_object=placed,
            format=self.format,
            options=options,
        )
        unknown = int(np.isnan(options.with_rates_of(found.metadata).confidence(found.grasps)).sum())
        reached = None if options.outcomes is None else int(options.outcomes.held.sum())
        if self.json:
            print_json({"out": str(self.out), "n": len(found.grasps), "without_confidence": unknown, "held": reached})
            return
        print(f"wrote {len(found.grasps)} grasps to {self.out}")
        if reached is not None:
            print(f"{reached} of them held in the trial")
        if unknown and self.format in ("isaac_grasp", "moveit_grasp"):
            print(f"{unknown} of them have no measured confidence and say 0: --evaluation FILE.json gives it")


def _rates(path: Path) -> dict[tuple[str, str], float]:
    # Evaluations load the physics engine.
    from ..evaluation import Evaluation
    from ..formats import held_rates

    try:
        return held_rates(Evaluation.load(path))
    except FileFormatError as error:
        raise FileFormatError(f"{error} (--evaluation takes what `graspcascade evaluate --json` prints)") from error


def _outcomes(found: GraspDocument) -> Outcomes:
    from ..trials import PAPER, run

    with bar("trials", len(found.grasps)) as progress:
        return run(found.grasps, PAPER, progress=progress.advance)
