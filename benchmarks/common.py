"""What the measuring commands share: a command line, grasps to execute, and what they were measured on."""

from __future__ import annotations

import contextlib
import io
import json
import os
import platform
import statistics
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import tyro

from graspcascade.core.errors import InputError
from graspcascade.core.files import write_json
from graspcascade.core.machine import cpu_model, processors, versions

if TYPE_CHECKING:
    from graspcascade.core.grasps import Grasps
    from graspcascade.proposals import Proposal
    from graspcascade.proposals.heuristic import Heuristic
    from graspcascade.studies.rounds import Pair

DONE, BAD_INPUT, INTERRUPTED = 0, 2, 130
_BOX = " -─│╭╮╰╯├┤"
_STREAM = 0xBE7C
"""Keeps these draws apart from those of an evaluation with the same seed."""

Arguments = TypeVar("Arguments")


def command(
    module: str, arguments: type[Arguments], work: Callable[[Arguments], None], argv: Sequence[str] | None = None
) -> int:
    """Run ``python -m module`` with its arguments.

    Returns:
        Exit status: 0 done, 2 input that cannot be used (one line on standard error), 130 interrupted.
    """
    try:
        given = _parse(module, arguments, argv)
        if given is not None:
            work(given)
    except InputError as error:
        print(f"{module}: {' '.join(str(error).split())}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"{module}: interrupted", file=sys.stderr)
        return INTERRUPTED
    return DONE


def _parse(module: str, arguments: type[Arguments], argv: Sequence[str] | None) -> Arguments | None:
    """Let tyro read the arguments; None when it has printed help.

    Raises:
        InputError: what tyro has to say against the arguments, without its box.
    """
    options = (tyro.conf.FlagCreatePairsOff, tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone)
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(arguments, args=argv, prog=f"python -m {module}", config=options)
    except SystemExit as stop:
        if not stop.code:
            return None
    lines = [line.strip(_BOX) for line in complaint.getvalue().splitlines()]
    # The first line is the box's title, the last refers to the help.
    raise InputError(" ".join([*filter(None, lines[1:-2]), f"(see python -m {module} --help)"]))


def publish(result: dict[str, Any], out: Path | None) -> None:
    """Print a result as JSON, and write it to a file if one is named."""
    print(json.dumps(result, indent=1))
    if out is not None:
        write_json(out, result)


def environment(threads: int) -> dict[str, Any]:
    """Describe the machine and the versions of everything that decides about speed.

    Args:
        threads: threads that were measured with.
    """
    present = versions()
    for name in ("pyarrow", "torch"):
        try:
            present[name] = version(name)
        except PackageNotFoundError:
            continue
    return {
        "cpu": cpu_model(),
        "logical_cores": os.cpu_count(),
        "usable_cores": processors(),
        "threads": threads,
        "system": platform.system(),
        "versions": present,
    }


@dataclass(frozen=True)
class Spread:
    """Sum up repeated measurements of one quantity, in its own unit."""

    median: float
    min: float
    max: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Spread:
        """Sum up at least one value."""
        measured = list(values)
        return cls(statistics.median(measured), min(measured), max(measured))

    def to_json(self) -> dict[str, float]:
        """Name the three numbers."""
        return asdict(self)


def shipped_heuristic() -> Heuristic:
    """Make the heuristic of the shipped hand and prior."""
    from graspcascade.proposals.heuristic import Heuristic

    return Heuristic.pretrained()


def collection_grasps(heuristic: Heuristic, per_cell: int, seed: int) -> Grasps:
    """Draw what a collection executes: screened candidates of every object and type."""
    from graspcascade.studies.collect import CollectionSpec, draw_round
    from graspcascade.studies.rounds import CELLS

    spec = CollectionSpec(per_cell, round_per_cell=per_cell, seed=seed)
    return draw_round(heuristic, range(len(CELLS)), 0, spec)[0]


def evaluation_grasps(proposal: Proposal, per_cell: int, seed: int, cells: Sequence[Pair] = ()) -> Grasps:
    """Draw what an evaluation of a proposal executes, of every object and type unless cells are named."""
    import numpy as np

    from graspcascade.core.tasks import draw_tasks
    from graspcascade.studies.rounds import CELLS

    rng = np.random.default_rng([seed, _STREAM])
    return proposal.propose(draw_tasks(cells or CELLS, per_cell, proposal.hand.reach_m, rng), rng)
