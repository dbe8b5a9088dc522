"""`Session`: what one browser looks at, without the browser."""

from __future__ import annotations

import threading
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..cascade import GraspSampler
from ..errors import InputError, check_name
from ..formats import load_executable
from ..grasps import Grasps
from ..hands import HandModel
from ..intervals import Interval, wilson
from ..objects import grasp_object
from ..poses import Pose
from ..taxonomy import grasp_type
from ..trials import PAPER, Outcomes, Protocol, run
from .recording import Frame, Recording, record

MAX_GRASPS = 200
"""Most grasps sampled onto a page at once."""
VIEWS = ("pregrasp", "posture", "settled")
FRICTION_RANGE = (0.01, 5.0)
MAX_SEED = 2**32 - 1

_PHYSICS = threading.Lock()
"""Trials of several browsers take turns: side by side they would only slow each other down."""


@dataclass(frozen=True)
class SampleRequest:
    """Say what to sample.

    Attributes:
        grasp_type: name of a grasp type.
        object_label: label of a catalogue object.
        side_axis: body axis to hold it by, None to draw among the graspable sides.
        n: how many grasps.
        seed: seed of all draws.
    """

    grasp_type: str = "tripod"
    object_label: str = "box_medium"
    side_axis: str | None = None
    n: int = 10
    seed: int = 0

    def check(self) -> None:
        """Check every value.

        Raises:
            InputError: the first one that cannot be used.
        """
        grasp_type(self.grasp_type)
        obj = grasp_object(self.object_label)
        if self.side_axis is not None:
            obj.side_axis(self.side_axis)
        if not 1 <= self.n <= MAX_GRASPS:
            raise InputError(f"n must be between 1 and {MAX_GRASPS}, got {self.n}")
        if not 0 <= self.seed <= MAX_SEED:
            raise InputError(f"seed must be between 0 and {MAX_SEED}, got {self.seed}")


@dataclass(frozen=True)
class Batch:
    """Hold the grasps on a page and where they come from.

    Attributes:
        grasps: at least one, joints in the order of the hand.
        name: stem of a downloaded file.
        metadata: what a file says of their origin.
        X_world_object: object pose that a file was written for, None where there was none.
    """

    grasps: Grasps
    name: str
    metadata: dict[str, Any] = field(default_factory=dict)
    X_world_object: Pose | None = None


def sample_batch(sampler: GraspSampler, request: SampleRequest) -> Batch:
    """Sample what is asked for.

    Raises:
        InputError: a value that cannot be used.
    """
    request.check()
    asked = (request.grasp_type, request.object_label, request.side_axis)
    grasps = sampler.sample(*asked, n=request.n, seed=request.seed)
    side = "" if request.side_axis is None else f"_{request.side_axis}"
    metadata = sampler.origin(request.grasp_type, request.object_label) | {"asked": asdict(request)}
    return Batch(grasps, f"{grasps.grasp_type[0]}_{grasps.object_label[0]}{side}_seed{request.seed}", metadata)


def file_batch(path: Path, hand: HandModel, trust_pickle: bool = False) -> Batch:
    """Open a grasp file.

    Args:
        path: file of any format that can be read.
        hand: hand whose joints it must have.
        trust_pickle: read pickled files, which run whatever code they carry.

    Raises:
        InputError: it cannot be read, holds no grasps or lacks joints of the hand.
    """
    document = load_executable(path, hand.description, trust_pickle=trust_pickle)
    grasps = document.grasps
    order = [grasps.joint_names.index(name) for name in hand.joint_names]
    ordered = replace(
        grasps, joint_names=hand.joint_names, posture=grasps.posture[:, order], pregrasp=grasps.pregrasp[:, order]
    )
    return Batch(ordered, path.stem, document.metadata, document.X_world_object)


def with_friction(friction: float) -> Protocol:
    """Give the paper protocol at another friction, under a name that says so.

    Raises:
        InputError: a friction outside `FRICTION_RANGE`.
    """
    low, high = FRICTION_RANGE
    if not low <= friction <= high:
        raise InputError(f"friction must be between {low:g} and {high:g}, got {friction:g}")
    if friction == PAPER.friction:
        return PAPER
    return replace(PAPER, name=f"paper, friction {friction:g}", friction=friction)


class Session:
    """Keep the grasps shown, the one looked at, and what became of those tried under the present protocol."""

    def __init__(self, batch: Batch, protocol: Protocol = PAPER) -> None:
        self.batch = batch
        self.protocol = protocol
        self.index = 0
        self.outcomes: dict[int, Outcomes] = {}
        self._recordings: dict[int, Recording] = {}

    def __len__(self) -> int:
        """Count the grasps."""
        return len(self.batch.grasps)

    @property
    def grasp(self) -> Grasps:
        """Give the grasp looked at, a batch of one."""
        return self.batch.grasps[self.index]

    @property
    def outcome(self) -> Outcomes | None:
        """Give what became of the grasp looked at, None untried."""
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
        """Execute the grasp looked at, unless that is done, and give its recording."""
        index = self.index
        if index not in self._recordings:
            with _PHYSICS:
                (found,) = record(self.grasp, self.protocol)
            self._recordings[index] = found
            self.outcomes[index] = found.outcome
        return self._recordings[index]

    def try_some(self, count: int = 16) -> int:
        """Execute the next untried grasps and tell how many are left."""
        untried = [index for index in range(len(self)) if index not in self.outcomes]
        if chosen := untried[:count]:
            with _PHYSICS:
                outcomes = run(self.batch.grasps[chosen], self.protocol)
            self.outcomes |= {index: outcomes[row] for row, index in enumerate(chosen)}
        return len(untried) - len(chosen)

    def frame(self, view: str) -> Frame:
        """Give the grasp looked at in one of `VIEWS`; `settled` executes it if need be.

        Raises:
            InputError: an unknown view, or the trial ended before the hand had closed.
        """
        check_name("view", view, VIEWS)
        grasp = self.grasp
        posture, pose = (grasp.pregrasp if view == "pregrasp" else grasp.posture), grasp.X_hand_object
        if view == "settled":
            outcome = self.recording().outcome if self.outcome is None else self.outcome
            posture, pose = outcome.settled_posture, outcome.X_hand_object_settled
            if not np.isfinite(posture).all():
                raise InputError(f"grasp {self.index} has no settled state: its trial ended as {outcome.verdict[0]}")
        at = Pose(pose.position_m[0], pose.quat_wxyz[0])
        return Frame(str(grasp.object_label[0]), posture[0], at, np.zeros(3))

    def faithful(self, index: int) -> bool:
        """Tell whether a tried grasp held with every digit its type needs."""
        return index in self.outcomes and bool(self.outcomes[index].faithful(self.batch.grasps[index])[0])

    def held(self) -> Interval:
        """Give the rate held among those tried, NaN when none is."""
        return wilson(sum(bool(outcome.held[0]) for outcome in self.outcomes.values()), len(self.outcomes))

    def _forget(self) -> None:
        self.outcomes, self._recordings = {}, {}
