"""``graspcascade export``: grasp files from one format into another."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from tyro.conf import Positional, arg

from ..core.errors import FileFormatError, InputError
from ..core.grasps import Grasps
from ..core.objects import as_object
from ..core.outcomes import Outcomes
from ..core.taxonomy import as_type
from ..formats import (
    FORMATS_BY_NAME,
    Assumptions,
    ExportOptions,
    GraspDocument,
    check_target,
    held_rates,
    load_document,
    save_grasps,
)
from ..formats.registry import format_to_read, format_to_write
from ..hands import Hand, load_hand
from . import console
from .console import HandName, Json, PoseNumbers, Trust

if TYPE_CHECKING:
    from ..studies.record import Evaluation

_FORMAT_HELP = "Format to write; by default the suffix of --out says. One of " + "; ".join(
    f"{name} ({known.description})" for name, known in FORMATS_BY_NAME.items()
)


_YAML = ("isaac_grasp", "moveit_grasp")
_READ: Mapping[str, tuple[str, ...]] = {
    "joint_numbering": _YAML,
    **dict.fromkeys(("grasp_type", "object", "side_axis"), (*_YAML, "dexgraspbench", "dexgraspnet")),
}
"""Options that say something only of files read in some formats, and of these."""
_WRITTEN: Mapping[str, tuple[str, ...]] = {
    "frame_id": ("moveit_grasp",),
    "parent_link": ("moveit_grasp",),
    "frame_keys": ("isaac_grasp",),
    "object_root": ("dexgraspbench",),
    **dict.fromkeys(("joint_prefix", "joint_numbering", "evaluation"), _YAML),
}
"""Likewise of files written."""


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
    from_format: Annotated[str | None, arg(metavar="NAME")] = None
    """Format of GRASPS; by default told by its suffix and content."""
    trust_pickle: Trust = False
    grasp_type: str | None = None
    """Type of grasps whose file does not say."""
    object: str | None = None
    """What the file's object is, where its name does not say: a catalogue name or a size."""
    side_axis: str | None = None
    """Side axis (x, y or z) of grasps whose file does not say; by default the one nearest to the opposition axis."""
    hand: HandName = "shadow"
    evaluation: Path | None = None
    """Evaluation (JSON) of the model: its held rates become the confidence of grasps without a probability, instead of
    those that came with the model the grasps were sampled from."""
    settle: bool | None = None
    """Try the grasps in physics first and write joints and object pose in contact, where a format has them. By default
    formats that mean a hand in contact (dexgraspbench, dexgraspnet) are settled, others not."""
    object_pose: Annotated[PoseNumbers | None, arg(metavar="X Y Z QW QX QY QZ")] = None
    """Object pose in the world, metres and a unit quaternion, instead of the one GRASPS may give."""
    frame_id: str | None = None
    """Name of the frame that poses are in (moveit_grasp); '' for the object's own."""
    parent_link: Literal["forearm", "palm"] = "forearm"
    """Link whose pose is stated (moveit_grasp)."""
    frame_keys: Literal["frame", "frame_link"] = "frame"
    """Whether isaac_grasp says object_frame or object_frame_link, and the same of the gripper."""
    joint_prefix: str = ""
    """Put before link and joint names, such as rh_ (isaac_grasp, moveit_grasp)."""
    joint_numbering: Literal[0, 1] = 1
    """Number of the outermost joints in names, read and written; older Shadow models begin with 0."""
    object_root: str | None = None
    """Folder that object paths are written under (dexgraspbench); by default that of the export itself."""
    json: Json = False

    def run(self) -> None:
        """Read, then write."""
        check_target(self.out, self.format)
        written = format_to_write(self.out, self.format)
        settle = written.contact if self.settle is None else self.settle
        evaluation = None if self.evaluation is None else _evaluation(self.evaluation)
        hand, placed = load_hand(self.hand), console.object_pose(self.object_pose)
        kind = None if self.grasp_type is None else as_type(self.grasp_type).name
        obj = None if self.object is None else as_object(self.object)
        assume = Assumptions(kind, obj, self.side_axis, self.joint_numbering, hand)
        self._check_served(format_to_read(self.grasps, self.from_format).name, written.name)
        document = load_document(self.grasps, self.from_format, trust_pickle=self.trust_pickle, assume=assume)
        grasps = document.grasps
        if not len(grasps):
            raise InputError(f"{self.grasps} holds no grasps")
        others = [] if evaluation is None else _other_origin(evaluation, document)
        for note in (*document.notes, *others):
            print(f"graspcascade export: {note}", file=sys.stderr)
        options = ExportOptions(
            held_rates={} if evaluation is None else held_rates(evaluation),
            outcomes=_settle(grasps, hand) if settle else None,
            contact="settled" if settle else "target",
            frame_id=self.frame_id,
            frame_keys=self.frame_keys,
            parent_link=self.parent_link,
            joint_prefix=self.joint_prefix,
            joint_numbering=self.joint_numbering,
            object_root=self.object_root,
            hand=hand,
        )
        placed = document.X_world_object if placed is None else placed
        metadata = document.metadata
        save_grasps(self.out, grasps, metadata=metadata, X_world_object=placed, format=self.format, options=options)
        unknown = int(np.isnan(options.with_rates_of(metadata).confidence(grasps)).sum())
        held = None if options.outcomes is None else int(options.outcomes.held.sum())
        if self.json:
            console.print_json({"out": str(self.out), "n": len(grasps), "without_confidence": unknown, "held": held})
            return
        print(f"wrote {len(grasps)} grasps to {self.out}")
        if held is not None:
            print(f"{held} of them held in the trial")
        if unknown and self.format in ("isaac_grasp", "moveit_grasp"):
            print(f"{unknown} of them have no measured confidence and say 0: --evaluation FILE.json gives it")

    def _check_served(self, read: str, written: str) -> None:
        for option in fields(self):
            reads, writes = _READ.get(option.name, ()), _WRITTEN.get(option.name, ())
            unused = (reads or writes) and read not in reads and written not in writes
            if unused and getattr(self, option.name) != option.default:
                name, of = option.name.replace("_", "-"), ", ".join(sorted({*reads, *writes}))
                raise InputError(f"--{name} says nothing of an export from {read} to {written}; it is for {of}")


def _other_origin(evaluation: Evaluation, document: GraspDocument) -> list[str]:
    pairs = {"hand": document.grasps.hand, "model": document.metadata.get("model")}.items()
    other = [(key, getattr(evaluation, key), own) for key, own in pairs if own not in (None, getattr(evaluation, key))]
    return [f"the evaluation is of {key} {rated}, the grasps are of {own}" for key, rated, own in other]


def _evaluation(path: Path) -> Evaluation:
    # Evaluations load the physics engine.
    from ..studies.record import Evaluation

    try:
        return Evaluation.load(path)
    except FileFormatError as error:
        raise FileFormatError(f"{error} (--evaluation takes what `graspcascade evaluate --json` prints)") from error


def _settle(grasps: Grasps, hand: Hand) -> Outcomes:
    from ..engines import run_trials

    with console.bar("trials", len(grasps)) as progress:
        return run_trials(grasps, hand=hand, progress=progress.advance)
