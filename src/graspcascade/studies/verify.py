"""Verification: each grasp tried several times, the share that held being its measured chance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..core.errors import MAX_SEED, InputError, check_whole
from ..core.grasps import Grasps
from ..core.protocols import VARIED, Protocol, as_protocol
from ..engines import Engine, as_engine
from ..hands import Hand, executing_hand
from .rounds import try_round

_STREAM = 0xE51F
"""Keeps draws of conditions apart from those of other studies with the same seed."""


@dataclass(frozen=True, eq=False)
class Verification:
    """What became of n grasps that were tried `draws` times each.

    Attributes:
        grasps: the grasps; `probability` is the share of trials that held.
        held: ``(n, draws)`` whether each trial held.
        faithful: ``(n, draws)`` whether each held type-faithfully.
        steady: ``(n, draws)`` whether each held without a turn of 15 degrees.
        protocol: the protocol's name.
        engine: the engine's name.

    Examples:
        >>> from graspcascade import GraspSampler
        >>> grasps = GraspSampler.pretrained().sample("tripod", "box_medium", "x", n=3, seed=1)
        >>> verified = verify(grasps, draws=4)
        >>> verified.held.shape, bool((verified.grasps.probability == verified.held.mean(axis=1)).all())
        ((3, 4), True)
        >>> sure = verified.grasps[verified.grasps.probability >= 0.75]
    """

    grasps: Grasps
    held: NDArray[np.bool_]
    faithful: NDArray[np.bool_]
    steady: NDArray[np.bool_]
    protocol: str
    engine: str


@dataclass(frozen=True)
class _Repeated:
    grasps: Grasps
    draws: int

    def __call__(self) -> Grasps:
        return self.grasps[np.repeat(np.arange(len(self.grasps)), self.draws)]


def verify(
    grasps: Grasps,
    *,
    draws: int = 8,
    seed: int = 0,
    protocol: Protocol | str = VARIED,
    hand: Hand | str | None = None,
    engine: Engine | str = "mujoco",
    workers: int = 1,
    progress: Callable[[int], None] | None = None,
) -> Verification:
    """Try each grasp under several draws of a protocol's conditions.

    Args:
        grasps: at least one.
        draws: trials of each grasp; their mean is uncertain by up to half of ``1 / sqrt(draws)``.
        seed: of the draws; the same seed gives the same numbers whatever the threads or processes.
        protocol: one that varies its conditions, or any with a single draw.
        hand: the hand, a hand file or a shipped hand's name; by default the shipped hand that the grasps are for.
        engine: what tries them, or its name.
        workers: processes to try in, 0 for as many as processors; 1 stays in this one.
        progress: called with the number of trials decided since the last call.

    Raises:
        InputError: no grasps, joints of another hand, or several draws of a protocol that never varies.
    """
    protocol, hand = as_protocol(protocol), executing_hand(grasps.hand, hand)
    check_whole("draws", draws, 1, 10_000)
    check_whole("seed", seed, most=MAX_SEED)
    if not len(grasps):
        raise InputError("there are no grasps to verify")
    if draws > 1 and protocol.variation is None:
        raise InputError(f"every trial of protocol {protocol.name} is the same; give one draw, or protocol varied")
    repeated = _Repeated(grasps, draws)
    tried = repeated()
    conditions = protocol.conditions(len(tried), (seed, _STREAM))
    engine = as_engine(engine)
    outcomes = try_round(tried, repeated, hand, protocol, engine, conditions, workers=workers, progress=progress)
    held, faithful, steady = (
        flags.reshape(len(grasps), draws) for flags in (outcomes.held, outcomes.faithful(tried), outcomes.steady)
    )
    return Verification(
        replace(grasps, probability=held.mean(axis=1)), held, faithful, steady, protocol.name, engine.name
    )
