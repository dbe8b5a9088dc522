"""`Session`: what one browser looks at, without the browser; where its grasps come from, what files they leave in."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ..core.errors import InputError, check_name
from ..core.grasps import Grasps
from ..core.intervals import Interval, wilson
from ..core.objects import GraspObject, as_object
from ..core.outcomes import Outcomes
from ..core.poses import Pose
from ..core.protocols import PAPER, Protocol
from ..core.taxonomy import GraspType, as_type
from ..engines import run_trials
from ..formats import FORMATS_BY_NAME, ExportOptions, load_executable, save_grasps
from ..hands import Hand
from ..proposals import Proposal
from ..proposals.ranked import Ranked
from .recording import Frame, Recording, record

MAX_GRASPS = 200
"""Most grasps sampled onto a page at once."""
VIEWS = ("settled", "pregrasp", "target")
"""Where closing ended in physics; the open hand; the joint angles commanded, their squeeze into the object included."""
FRICTION_RANGE = (0.01, 5.0)
MAX_SEED = 2**32 - 1
_OBJECT_ROOT = "objects"
"""Where a format that names object files says they are: beside the grasps, wherever the archive is unpacked."""

_PHYSICS = threading.Lock()
"""Trials of several browsers take turns: side by side they would only slow each other down."""


@dataclass(frozen=True)
class SampleRequest:
    """What to sample.

    Attributes:
        side_axis: None draws among the graspable sides.
        friction: that the chances of ranked grasps are estimated for; None is the model's own.
    """

    grasp_type: GraspType
    object: GraspObject
    side_axis: str | None
    n: int
    seed: int
    friction: float | None = None

    @classmethod
    def of(
        cls,
        grasp_type: GraspType | str = "tripod",
        object: GraspObject | str = "box_medium",
        side_axis: str | None = None,
        n: float = 10,
        seed: float = 0,
        friction: float | None = None,
    ) -> SampleRequest:
        """Read what a person or a browser asks for.

        Raises:
            InputError: an unknown name or size, or a number that is not whole or out of range.
        """
        for name, value, low, high in (("n", n, 1, MAX_GRASPS), ("seed", seed, 0, MAX_SEED)):
            if not low <= value <= high or value != int(value):
                raise InputError(f"{name} must be a whole number between {low} and {high}, got {value}")
        return cls(as_type(grasp_type), as_object(object), side_axis, int(n), int(seed), friction)


@dataclass(frozen=True)
class Batch:
    """The grasps on a page and where they come from.

    Attributes:
        grasps: at least one, joints in the order of the hand.
        name: stem of a downloaded file.
        metadata: what a file says of their origin.
        X_world_object: object pose that a file was written for, None where there was none.
        notes: what a user should be told of them.
    """

    grasps: Grasps
    name: str
    metadata: dict[str, Any] = field(default_factory=dict)
    X_world_object: Pose | None = None
    notes: tuple[str, ...] = ()


def sample_batch(proposal: Proposal, hand: Hand, request: SampleRequest) -> Batch:
    """Sample what is asked for, or raise an `InputError`; the same request gives the same grasps."""
    # A page is asked for a type before there is a model whose types they are: only its name counts.
    kind, obj, axis = proposal.as_type(request.grasp_type.name), request.object, request.side_axis
    n, seed = request.n, request.seed
    hand.check_type(kind)
    asked: dict[str, Any] = {"grasp_type": kind.name, "object": obj.name, "side_axis": axis, "n": n, "seed": seed}
    if request.friction is not None:
        if not isinstance(proposal, Ranked):
            raise InputError(
                f"{proposal.name} estimates no chances, so that a friction of {request.friction:g} is of no use"
            )
        proposal, asked["friction"] = replace(proposal, friction=request.friction), request.friction
    grasps = proposal.sample(kind, obj, axis, n, seed)
    name = "_".join([kind.name, obj.name, *([axis] if axis else []), f"seed{seed}"]).replace(":", "_")
    metadata = proposal.origin(kind, obj) | {"asked": asked}
    return Batch(_ordered(grasps, hand), name, metadata, notes=proposal.notes(grasps))


def file_batch(path: Path, hand: Hand, trust_pickle: bool = False) -> Batch:
    """Open a grasp file of any format, or raise an `InputError` where it cannot be read or lacks joints of the hand.

    Pickled files, which run whatever code they carry, are read only where they are trusted.
    """
    document = load_executable(path, hand, trust_pickle=trust_pickle)
    return Batch(_ordered(document.grasps, hand), path.stem, document.metadata, document.X_world_object, document.notes)


def _ordered(grasps: Grasps, hand: Hand) -> Grasps:
    order = hand.columns_in(grasps.joint_names)
    posture, pregrasp = grasps.posture[:, order], grasps.pregrasp[:, order]
    return replace(grasps, joint_names=hand.joint_names, posture=posture, pregrasp=pregrasp)


def measured(proposal: Proposal, kind: GraspType, obj: GraspObject) -> Mapping[str, Any] | None:
    """Look up what was measured of a type and object: `held` of `n` trials under `protocol`; None where nothing was."""
    return next(iter(proposal.origin(kind, obj)["measured"].values()), None)


def with_friction(friction: float) -> Protocol:
    """Make the paper protocol at another friction, under a name that says so; `FRICTION_RANGE` is allowed."""
    low, high = FRICTION_RANGE
    if not low <= friction <= high:
        raise InputError(f"friction must be between {low:g} and {high:g}, got {friction:g}")
    if friction == PAPER.physics.friction:
        return PAPER
    return PAPER.with_physics(f"paper, friction {friction:g}", friction=friction)


class Session:
    """Keep the grasps shown, the one looked at, and what became of those tried under the present protocol."""

    def __init__(self, batch: Batch, hand: Hand, protocol: Protocol = PAPER) -> None:
        self.batch, self.hand, self.protocol, self.index = batch, hand, protocol, 0
        self._forget()

    def __len__(self) -> int:
        """Count the grasps."""
        return len(self.batch.grasps)

    @property
    def grasp(self) -> Grasps:
        """The grasp looked at, a batch of one."""
        return self.batch.grasps[self.index]

    @property
    def outcome(self) -> Outcomes | None:
        """What became of the grasp looked at, None untried."""
        return self.outcomes.get(self.index)

    def show(self, batch: Batch) -> None:
        """Replace the grasps and look at the first."""
        self.batch, self.index = batch, 0
        self._forget()

    def use(self, protocol: Protocol) -> None:
        """Choose the protocol of the trials to come; verdicts of another one are dropped."""
        if protocol != self.protocol:
            self.protocol = protocol
            self._forget()

    def go(self, index: int) -> None:
        """Look at another grasp; behind the last comes the first."""
        self.index = index % len(self)

    def recording(self) -> Recording:
        """Look up the recording of the grasp looked at, which is executed once."""
        if self.index not in self._recordings:
            with _PHYSICS:
                (recording,) = record(self.grasp, self.hand, self.protocol)
            self._recordings[self.index], self.outcomes[self.index] = recording, recording.outcome
        return self._recordings[self.index]

    def try_some(self, count: int = 16) -> int:
        """Execute the next untried grasps and count those left."""
        untried = [index for index in range(len(self)) if index not in self.outcomes]
        if chosen := untried[:count]:
            with _PHYSICS:
                outcomes = run_trials(self.batch.grasps[chosen], self.protocol, hand=self.hand)
            self.outcomes |= {index: outcomes[row] for row, index in enumerate(chosen)}
        return len(untried) - len(chosen)

    def frame(self, view: str) -> Frame:
        """Look at the grasp in one of `VIEWS`; another name is an `InputError`.

        `settled` executes the grasp if need be; of a trial that ended before the hand had closed it is the end.
        """
        check_name("view", view, VIEWS)
        if view == "settled":
            recording = self.recording()
            return recording.frame(recording.closed_row)
        grasp = self.grasp
        pose = Pose(grasp.X_hand_object.position_m[0], grasp.X_hand_object.quat_wxyz[0])
        posture = grasp.pregrasp[0] if view == "pregrasp" else grasp.posture[0]
        return Frame(grasp.tasks.distinct[0].object, posture, pose, np.zeros(3))

    @property
    def closed(self) -> bool:
        """Whether the trial of the grasp looked at got as far as closing the hand."""
        return self.outcome is not None and bool(np.isfinite(self.outcome.settled_posture).all())

    def faithful(self, index: int) -> bool:
        """Tell whether a tried grasp held with every digit its type needs."""
        return index in self.outcomes and bool(self.outcomes[index].faithful(self.batch.grasps[index])[0])

    def held(self) -> Interval:
        """Compute the rate held among those tried, NaN when none is."""
        return wilson(sum(bool(outcome.held[0]) for outcome in self.outcomes.values()), len(self.outcomes))

    def _forget(self) -> None:
        self.outcomes: dict[int, Outcomes] = {}
        self._recordings: dict[int, Recording] = {}


@dataclass(frozen=True)
class Download:
    """A file for a browser to save."""

    name: str
    content: bytes


def pack(session: Session, format_name: str, rows: Sequence[int]) -> Download:
    """Write some of a session's grasps as a file; a format of several files comes as a zip archive.

    Formats with a place for outcomes of trials get them where all of the grasps were tried.

    Raises:
        InputError: an unknown format, one that cannot hold these grasps, or that needs a package not installed here.
    """
    check_name("format", format_name, FORMATS_BY_NAME)
    form, batch, tried = FORMATS_BY_NAME[format_name], session.batch, session.outcomes
    if form.missing:
        raise InputError(f"{format_name} needs a package that is not installed here: {', '.join(form.missing)}")
    grasps = batch.grasps[rows]
    outcomes = Outcomes.concatenate([tried[row] for row in rows]) if all(row in tried for row in rows) else None
    name = f"{batch.name}_grasp{rows[0]}" if len(rows) == 1 < len(session) else batch.name
    one_file = form.layout == "file" or (form.layout == "either" and len(grasps.tasks.objects) == 1)
    options = ExportOptions(outcomes=outcomes, object_root=_OBJECT_ROOT, hand=session.hand)
    about: dict[str, Any] = {"metadata": batch.metadata, "X_world_object": batch.X_world_object}
    with TemporaryDirectory(prefix="graspcascade-") as folder:
        inside = Path(folder) / "packed"
        inside.mkdir()
        target = inside / f"{name}{form.suffixes[0] if one_file else ''}"
        save_grasps(target, grasps, **about, format=format_name, options=options)
        if target.is_file():
            return Download(target.name, target.read_bytes())
        return Download(f"{name}_{format_name}.zip", Path(shutil.make_archive(str(inside), "zip", inside)).read_bytes())
