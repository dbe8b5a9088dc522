"""Physics engines: each runs grasps of a hand through a protocol and reports outcomes.

`Engine` is all that studies, viewer and command line know of one; `ENGINES` lists those there are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.errors import InputError, check_name
from ..core.grasps import Grasps, check_numbers
from ..core.outcomes import Outcomes
from ..core.protocols import PAPER, Conditions, Protocol, as_protocol
from ..hands import Hand, executing_hand

Progress = Callable[[int], None]
"""Called with the number of trials decided since the last call."""
Observer = Callable[[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]], None]
"""Called every few steps with the rows being simulated ``(k,)``, their step counts ``(k,)``, joint angles ``(k, J)`` in
the order of the grasps' joints, and object poses ``(k, 7)`` (position, wxyz)."""


class Engine(ABC):
    """Run trials; outcomes depend on neither the order of the grasps nor the number of threads.

    Attributes:
        name: what records of trials call it.
    """

    name: ClassVar[str]

    @property
    def abridged(self) -> dict[str, Any] | None:
        """How trials are abridged, as plain data for a record; None where every step is computed."""
        return None

    @property
    def versions(self) -> dict[str, str]:
        """Versions of what outcomes depend on beside `core.machine.versions`."""
        return {}

    def on_one_thread(self) -> Engine:
        """Make the same engine for one of several processes."""
        return self

    def abridging(self, protocol: Protocol) -> Engine:
        """Make the same engine, abridging a protocol's trials where it can, for data with few wrong verdicts."""
        return self

    @abstractmethod
    def run(
        self,
        hand: Hand,
        grasps: Grasps,
        protocol: Protocol,
        conditions: Conditions | None = None,
        *,
        observe: Observer | None = None,
        progress: Progress | None = None,
    ) -> Outcomes:
        """Execute every grasp, joints matched by name; outcomes are in the order of the grasps.

        Conditions are those of each trial, where they differ from the protocol's physics; a protocol that varies them
        needs them.
        """


def _mujoco(**options: Any) -> Engine:
    # Loading an engine takes a moment, and who only names one should not wait for it.
    from .mujoco.runner import MujocoEngine

    return MujocoEngine(**options)


def _physx(**options: Any) -> Engine:
    from .physx.runner import PhysxEngine

    return PhysxEngine(**options)


ENGINES: Mapping[str, Callable[..., Engine]] = {"mujoco": _mujoco, "physx": _physx}
"""Makers of engines by name; each takes the engine's own options."""


def as_engine(given: Engine | str = "mujoco", **options: Any) -> Engine:
    """Make an engine by its name, with options of its own, or take one as it is.

    Raises:
        InputError: the name is not one of `ENGINES`, or there are options for an engine that is made already.
    """
    if isinstance(given, Engine):
        if options:
            raise InputError(f"{', '.join(options)}: options are for an engine given by name, not for one that is made")
        return given
    check_name("engine", given, ENGINES)
    return ENGINES[given](**options)


def run_trials(
    grasps: Grasps,
    protocol: Protocol | str = PAPER,
    *,
    hand: Hand | str | None = None,
    conditions: Conditions | None = None,
    seed: int = 0,
    engine: Engine | str = "mujoco",
    observe: Observer | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Outcomes:
    """Execute every grasp in physics (see `Engine.run`).

    Args:
        grasps: what to execute.
        protocol: a protocol or its name.
        hand: a hand, a hand file or a shipped hand's name; by default the shipped hand that the grasps are for.
        conditions: of each trial, where they differ from the protocol's physics; by default what the protocol draws.
        seed: of the protocol's draws.
        engine: an engine or its name.
        observe: sees every trial as it goes.
        progress: hears how many trials were decided.
        options: of an engine given by name, such as `n_threads` (see `engines.mujoco.runner.MujocoEngine`).

    Raises:
        InputError: an unknown name, or the grasps' joints are not the hand's.

    Examples:
        >>> from graspcascade import GraspSampler, run_trials
        >>> grasps = GraspSampler.pretrained().sample("tripod", "box_medium", "x", n=2)
        >>> outcomes = run_trials(grasps, "paper")
        >>> outcomes.verdict.shape, outcomes.touch_columns
        ((2,), ('thumb', 'index', 'middle', 'ring', 'little', 'palm'))
    """
    trial = as_protocol(protocol)
    chosen = executing_hand(grasps.hand, hand)
    conditions = trial.conditions(len(grasps), seed) if conditions is None else conditions
    return as_engine(engine, **options).run(chosen, grasps, trial, conditions, observe=observe, progress=progress)


def check_trials(grasps: Grasps, hand: Hand, protocol: Protocol, conditions: Conditions | None) -> None:
    """Check that grasps are of a hand's joints, in whatever order, and that they and their conditions can be tried.

    Raises:
        InputError: joints are lacking or foreign, a number is out of range (see `check_numbers`), or conditions are
            lacking though the protocol varies, of another number of trials, or leave nothing of an object.
    """
    if conditions is None and protocol.variation is not None:
        raise InputError(f"protocol {protocol.name} varies: give the conditions, protocol.conditions(n)")
    hand.columns_in(grasps.joint_names)
    foreign = [name for name in grasps.joint_names if name not in hand.joint_names]
    if foreign:
        raise InputError(f"{hand.name} has no joints {', '.join(foreign)}")
    check_numbers(grasps.columns())
    if conditions is None:
        return
    if len(conditions) != len(grasps):
        raise InputError(f"there are conditions of {len(conditions)} trials for {len(grasps)} grasps")
    smallest = grasps.tasks.column(lambda task: min(task.object.extents_m), np.float64)
    for row in np.flatnonzero(smallest + conditions.size_error_m <= 0.0)[:1].tolist():
        error = f"a size error of {conditions.size_error_m[row]:g} m leaves nothing of an extent of {smallest[row]:g} m"
        raise InputError(f"trial {row}: {error} of {grasps.object_name[row]}")


def is_opposed(touching: NDArray[np.bool_], digits: tuple[str, ...]) -> NDArray[np.bool_]:
    """Tell where the thumb and at least one finger touch the object, from contacts ``(n, D + 1)``."""
    fingers = [place for place, name in enumerate(digits) if name != "thumb"]
    return np.asarray(touching[:, digits.index("thumb")] & touching[:, fingers].any(axis=1))
