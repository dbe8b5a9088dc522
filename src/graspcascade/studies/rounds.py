"""One round of a study: propose, try, keep in order; the same rows whatever the number of processes or threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.errors import InputError
from ..core.families import ObjectFamily, read_objects
from ..core.grasps import Grasps
from ..core.objects import CATALOGUE, GraspObject
from ..core.outcomes import Outcomes
from ..core.protocols import Conditions, Protocol
from ..core.records import taxonomy_to_json
from ..core.taxonomy import GRASP_TYPES, GraspType, as_type, taxonomy_of
from ..engines import Engine
from ..hands import Hand
from .executor import run_jobs, worker_count

Pair = tuple[GraspObject | ObjectFamily, GraspType]
CELLS: tuple[Pair, ...] = tuple((obj, kind) for obj in CATALOGUE.values() for kind in GRASP_TYPES.values())
"""Every catalogue object with every grasp type: what collections fill and evaluations count."""

Draw = Callable[[], Grasps]
"""Draws the grasps of one round: a pure function of its own fields, so that every process draws the same."""


def as_cells(
    pairs: Iterable[tuple[GraspObject | ObjectFamily | str, GraspType | str]],
    read_type: Callable[[GraspType | str], GraspType] = as_type,
) -> tuple[Pair, ...]:
    """Read pairs of an object or family (see `read_objects`) and a type; an InputError tells of an unknown name."""
    return tuple((obj, read_type(kind)) for given, kind in pairs for obj in read_objects(given))


def cell_name(pair: Pair) -> str:
    """Name an object or family and a type for a message."""
    return f"{pair[0].name}/{pair[1].name}"


def objects_of(cells: Sequence[Pair]) -> dict[str, dict[str, Any]]:
    """Describe the objects of cells by name and, where there are any, the families, as metadata carries them.

    Raises:
        InputError: there is no cell, one is there twice, or two different objects have one name.
    """
    named = {obj.name: obj for obj, _ in cells}
    if not cells or len(set(cells)) < len(cells) or any(named[obj.name] != obj for obj, _ in cells):
        raise InputError("at least one cell is needed, each object and type once, and each object with its own name")
    families = {name: obj.to_json() for name, obj in named.items() if isinstance(obj, ObjectFamily)}
    objects = {name: obj.to_json() for name, obj in named.items() if name not in families}
    return {"objects": objects} | ({"families": families} if families else {})


def setting_of(hand: Hand, protocol: Protocol, engine: Engine, cells: Sequence[Pair]) -> dict[str, Any]:
    """Describe hand, protocol, engine and objects, as the metadata of a study carries them.

    Raises:
        InputError: see `objects_of`.
    """
    return {
        "hand": hand.name,
        "hand_fingerprint": hand.fingerprint(),
        "joint_names": list(hand.joint_names),
        "pregrasp_rad": hand.pregrasp.tolist(),
        "digits": list(hand.digits),
        "protocol": protocol.to_json(),
        "engine": engine.name,
        **objects_of(cells),
        **taxonomy_to_json(taxonomy_of(kind for _, kind in cells)),
    }


@dataclass(frozen=True)
class TrialJob:
    """Draw one round and try its grasps ``first::stride``."""

    draw: Draw
    hand: Hand
    protocol: Protocol
    engine: Engine
    first: int
    stride: int
    conditions: Conditions | None = None
    """Of these trials alone."""

    def __call__(self, report: Callable[[int], None]) -> Outcomes:
        """Try the rows; `report` hears the number of trials decided since the last call."""
        grasps = self.draw()[self.first :: self.stride]
        return self.engine.run(self.hand, grasps, self.protocol, self.conditions, progress=report)


def try_round(
    grasps: Grasps,
    draw: Draw,
    hand: Hand,
    protocol: Protocol,
    engine: Engine,
    conditions: Conditions | None = None,
    *,
    workers: int = 1,
    progress: Callable[[int], None] | None = None,
) -> Outcomes:
    """Try all grasps of a round and return what became of each, in the order drawn.

    Args:
        grasps: the round as drawn in this process.
        draw: draws it again in others, which is less work than sending it there.
        hand: to execute with.
        protocol: the trial.
        engine: what tries them; in several processes, each has one thread.
        conditions: of each trial, where the protocol varies them.
        workers: processes, 0 for as many as processors; 1 stays in this one.
        progress: called with the number of trials decided since the last call.
    """
    stride = max(1, min(worker_count(workers), len(grasps)))
    if stride == 1:
        return engine.run(hand, grasps, protocol, conditions, progress=progress)
    each, rows = engine.on_one_thread(), [slice(first, None, stride) for first in range(stride)]
    own = [None if conditions is None else conditions[some] for some in rows]
    jobs = [TrialJob(draw, hand, protocol, each, first, stride, own[first]) for first in range(stride)]
    parts = run_jobs(jobs, stride, None if progress is None else lambda _, decided: progress(decided))
    order = np.argsort(np.concatenate([np.arange(first, len(grasps), stride) for first in range(stride)]))
    return Outcomes.concatenate(parts)[order]
