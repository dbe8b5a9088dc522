"""Try the same grasps in MuJoCo and in PhysX, and count how often both come to the same verdict.

Example::

    python -m benchmarks.physics.engines --work runs/engines --out docs/results/engines.json
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import command, publish, shipped_heuristic
from benchmarks.paper.markdown import rate, table
from graspcascade.core.files import read_json
from graspcascade.core.grasps import Grasps
from graspcascade.core.intervals import Interval, newcombe, share
from graspcascade.core.machine import versions
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.protocols import HOLD, VARIED, Protocol
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.engines import Engine, as_engine
from graspcascade.proposals import Proposal
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.studies.dataset import Dataset, load_dataset
from graspcascade.studies.evaluate import evaluate

_PER_ROUND = 5
"""Grasps of a cell in one evaluation, which is all that an interruption can lose."""


CHANGES: tuple[tuple[str, Protocol], ...] = (
    ("mujoco", HOLD),
    ("mujoco", HOLD.with_physics("hold, half the time step", time_step_s=0.002)),
    ("mujoco", HOLD.with_physics("hold, friction 0.7", friction=0.7)),
    ("physx", HOLD),
    ("physx", HOLD.with_physics("hold, half the time step", time_step_s=0.002)),
    ("physx", HOLD.with_physics("hold, friction 0.9", friction=0.9)),
    ("physx", HOLD.with_physics("hold, no torsional friction", torsional_friction_m=0.0)),
)
"""Engines and protocols in which one thing is changed."""


@dataclass(frozen=True)
class Arguments:
    """Execute the same grasps in both engines."""

    work: Path
    """Folder for finished trials; the same command goes on where an earlier one stopped."""
    per_cell: int = 25
    """Grasps for each object and type, of the heuristic (unscreened) and of the shipped cascade; a multiple of 5."""
    workers: int = 1
    """Processes."""
    out: Path | None = None
    """JSON file to write."""


def main(arguments: Arguments) -> None:
    """Execute what is not yet done, and compare."""
    engines: dict[str, Engine] = {"mujoco": as_engine("mujoco", n_threads=1), "physx": as_engine("physx")}
    rounds = [
        (proposal, protocol, seed)
        for seed in range(arguments.per_cell // _PER_ROUND)
        for protocol in (HOLD, VARIED)
        for proposal in (shipped_heuristic(), GraspSampler.pretrained())
    ]
    tried: dict[tuple[str, str], list[tuple[Dataset, Dataset]]] = {}
    for proposal, protocol, seed in rounds:
        folder = arguments.work / proposal.name / protocol.name / str(seed)
        both = [_tried(proposal, protocol, seed, engine, folder / name, arguments) for name, engine in engines.items()]
        tried.setdefault((proposal.name, protocol.name), []).append((both[0], both[1]))
    changed = []
    for proposal in (shipped_heuristic(), GraspSampler.pretrained()):
        first, second = (pair.outcomes.held for pair in tried[proposal.name, HOLD.name][0])
        for name, protocol in CHANGES:
            folder = arguments.work / proposal.name / protocol.name / "0" / name
            held = _tried(proposal, protocol, 0, engines[name], folder, arguments).outcomes.held
            changed.append(
                {
                    "grasps": proposal.name,
                    "engine": name,
                    "protocol": protocol.name,
                    "n": len(held),
                    "held": share(held).to_json(),
                    "as mujoco": share(held == first).to_json(),
                    "as physx": share(held == second).to_json(),
                    "held of those in mujoco alone": share(held[first & ~second]).to_json(),
                    "held of those in both": share(held[first & second]).to_json(),
                }
            )
    publish(
        {
            "title": "The same grasps in MuJoCo and PhysX",
            "description": "The same grasps, with the same draws of what a protocol varies, in both engines. Agreement "
            "is the share of trials with the same answer to whether the grasp held; differences are in points, PhysX "
            "over MuJoCo, with 95 % intervals. *Changed*: some of the grasps once more, one thing being different, "
            "compared with both engines under `hold` as it is.",
            "versions": versions() | engines["physx"].versions,
            "file_only": ["differing"],
            "comparisons": [row for (name, protocol), parts in tried.items() for row in compare(name, protocol, parts)],
            "changed": changed,
            "differing": [row for (name, protocol), parts in tried.items() for row in differing(name, protocol, parts)],
        },
        arguments.out,
    )


def _tried(
    proposal: Proposal, protocol: Protocol, seed: int, engine: Engine, folder: Path, arguments: Arguments
) -> Dataset:
    def show(done: int, of: int) -> None:
        print(f"\r{folder}: {done} of {of} trials ", end="", file=sys.stderr, flush=True)

    settings: Mapping[str, Any] = {"engine": engine, "workers": arguments.workers, "out": folder, "progress": show}
    evaluate(proposal, per_cell=_PER_ROUND, seed=seed, protocol=protocol, **settings)
    print(file=sys.stderr)
    return load_dataset(folder)


def compare(name: str, protocol: str, parts: list[tuple[Dataset, Dataset]]) -> Iterator[dict[str, Any]]:
    """Compare the outcomes of the same grasps, of all types together and of each.

    Raises:
        ValueError: the grasps are not the same.
    """
    for mine, theirs in parts:
        if not np.array_equal(mine.grasps.posture, theirs.grasps.posture):
            raise ValueError(f"the grasps of {name} under {protocol} are not the same in both engines")
    grasps = Grasps.concatenate([mine.grasps for mine, _ in parts])
    first, other = (Outcomes.concatenate([pair[k].outcomes for pair in parts]) for k in (0, 1))
    yield _row(name, protocol, "all", grasps, first, other, np.ones(len(grasps), dtype=bool))
    for kind in GRASP_TYPES:
        yield _row(name, protocol, kind, grasps, first, other, grasps.grasp_type == kind)


def _row(
    name: str, protocol: str, kind: str, grasps: Grasps, first: Outcomes, other: Outcomes, rows: NDArray[np.bool_]
) -> dict[str, Any]:
    n, held, also = int(rows.sum()), first.held[rows], other.held[rows]
    more = newcombe(int(also.sum()), n, int(held.sum()), n)
    columns = {
        "held": (held, also),
        "faithful": (first.faithful(grasps)[rows], other.faithful(grasps)[rows]),
        "steady": (first.steady[rows], other.steady[rows]),
    }
    return {
        "grasps": name,
        "protocol": protocol,
        "type": kind,
        "n": n,
        **{
            f"{what} in {engine}": share(flags).to_json()
            for what, both in columns.items()
            for engine, flags in zip(("mujoco", "physx"), both, strict=True)
        },
        "points": {key: 100 * value for key, value in asdict(more).items()},
        "agreement": share(held == also).to_json(),
        "only in mujoco": int((held & ~also).sum()),
        "only in physx": int((also & ~held).sum()),
    }


def differing(name: str, protocol: str, parts: list[tuple[Dataset, Dataset]]) -> Iterator[dict[str, Any]]:
    """List the trials that held in one engine alone, with what became of them in each."""
    for seed, pair in enumerate(parts):
        grasps, (mine, theirs) = pair[0].grasps, (dataset.outcomes for dataset in pair)
        for row in np.flatnonzero(mine.held != theirs.held).tolist():
            trial = {"grasps": name, "protocol": protocol, "seed": seed, "row": row}
            trial |= {"type": str(grasps.grasp_type[row]), "object": str(grasps.object_name[row])}
            for engine, outcomes in (("mujoco", mine), ("physx", theirs)):
                numbers = {"s": outcomes.duration_s[row], "turned": outcomes.turn_rad[row]}
                rounded = {key: None if np.isnan(value) else round(float(value), 3) for key, value in numbers.items()}
                trial[engine] = {"verdict": str(outcomes.verdict[row]), **rounded}
            yield trial


def page_blocks(folder: Path) -> dict[str, Callable[[], str]]:
    """Name what writes each block of the page of protocols, from the JSON file in a folder of results."""
    data = read_json(folder / "engines.json")
    return {
        "engines": lambda: _rates(data["comparisons"]),
        "engine-types": lambda: _types(data["comparisons"]),
        "engines-changed": lambda: _changes(data["changed"]),
    }


def _rates(rows: Sequence[dict[str, Any]]) -> str:
    header = ("grasps of", "protocol", "trials", "held in MuJoCo, %", "in PhysX, %", "points", "same answer, %")
    return table(
        header,
        [
            (
                row["grasps"],
                f"`{row['protocol']}`",
                str(row["n"]),
                _percent(row["held in mujoco"]),
                _percent(row["held in physx"]),
                "{difference:+.1f} [{low:+.1f}, {high:+.1f}]".format(**row["points"]),
                _percent(row["agreement"]),
            )
            for row in rows
            if row["type"] == "all"
        ],
        text_columns=2,
    )


def _types(rows: Sequence[dict[str, Any]]) -> str:
    kinds: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        if row["type"] != "all":
            kinds.setdefault(row["type"], []).append(row)
    names = [f"{row['grasps']}, `{row['protocol']}`" for row in next(iter(kinds.values()))]
    cells = [
        (f"`{kind}`", *(f"{100 * row['agreement']['rate']:.1f} ({row['points']['difference']:+.1f})" for row in each))
        for kind, each in kinds.items()
    ]
    return table(("type", *names), cells)


def _changes(rows: Sequence[dict[str, Any]]) -> str:
    columns = ("held", "as mujoco", "as physx", "held of those in mujoco alone", "held of those in both")
    header = ["grasps of", "executed in", "protocol", "held, %", "as MuJoCo, %", "as PhysX, %"]
    header += ["held of MuJoCo's alone, %", "of those of both, %"]
    cells = [
        (row["grasps"], row["engine"], row["protocol"], *(_percent(row[name]) for name in columns)) for row in rows
    ]
    return table(header, cells, text_columns=3)


def _percent(of: dict[str, float]) -> str:
    return rate(Interval(of["rate"], of["low"], of["high"])).replace(" %", "")


if __name__ == "__main__":
    sys.exit(command("benchmarks.physics.engines", Arguments, main))
