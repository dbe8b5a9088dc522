"""Say how good a built model is: rates by type, shape and size, and whether its chances are kept.

Reads what ``graspcascade build`` left in its folder. Example::

    python -m benchmarks.default.report --build build --out docs/results/any_size.json
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import command, publish
from graspcascade.core.intervals import wilson
from graspcascade.core.tasks import Task
from graspcascade.proposals.scorer import Scorer
from graspcascade.studies.dataset import Dataset, load_dataset
from graspcascade.studies.scoring import Judgement, without_errors

TERCILES = ("narrow", "middle", "wide")


@dataclass(frozen=True)
class Arguments:
    """Read the evaluations of a build."""

    build: Path
    """Folder of the build."""
    out: Path | None = None
    """JSON file to write."""


def shape_of(task: Task) -> str:
    """Name the shape as it is held: a cylinder across or along its axis."""
    kind = task.object.shape.kind
    along = " along" if task.site.name == "z" else " across"
    return kind + along * (kind == "cylinder")


def parts(data: Dataset) -> Iterator[tuple[str, str, NDArray[np.bool_]]]:
    """Divide the trials by type, by shape, and by shape and tercile of the width held."""
    tasks = data.grasps.tasks
    kinds, shapes = tasks.grasp_type, tasks.column(shape_of, str)
    yield "all", "all", np.ones(len(tasks), dtype=bool)
    for kind in dict.fromkeys(kinds.tolist()):
        yield "type", kind, kinds == kind
    for shape in np.unique(shapes).tolist():
        rows = shapes == shape
        yield "shape", shape, rows
        bounds = np.quantile(tasks.side_m[rows], [1 / 3, 2 / 3])
        tercile = np.searchsorted(bounds, tasks.side_m, side="right")
        for number, name in enumerate(TERCILES):
            yield "shape and width", f"{shape}, {name}", rows & (tercile == number)


def rates(data: Dataset) -> list[dict[str, Any]]:
    """Count what held, and held as its type asks, in every part."""
    held, faithful = data.outcomes.held, data.outcomes.faithful(data.grasps)
    counted = []
    for by, name, rows in parts(data):
        n = int(rows.sum())
        both = {
            event: wilson(int(flags[rows].sum()), n).to_json()
            for event, flags in (("held", held), ("faithful", faithful))
        }
        counted.append({"by": by, "part": name, "n": n} | both)
    return counted


def kept(data: Dataset, scorer: Scorer) -> dict[str, Any]:
    """Judge the scorer's chances of grasps by what became of them."""
    conditions = data.conditions
    exact = conditions is None
    about = None if conditions is None else without_errors(conditions)
    chances = scorer.chances(data.grasps, about, is_exact=exact)
    held = Judgement.of(chances.held, data.outcomes.held)
    faithful = Judgement.of(chances.faithful, data.outcomes.faithful(data.grasps))
    return {"held": asdict(held), "faithful": asdict(faithful)}


def main(arguments: Arguments) -> None:
    """Read every evaluation."""
    evaluations = []
    for folder in sorted(arguments.build.glob("evaluation-*")):
        _, number, grasps, protocol = folder.name.split("-", 3)
        data = load_dataset(folder)
        scorer = Scorer.load(arguments.build / f"model-{number}")
        about = {"round": int(number), "grasps": grasps, "protocol": protocol, "n": len(data.grasps)}
        evaluations.append(about | {"rates": rates(data), "chances": kept(data, scorer)})
    rounds = []
    for folder in sorted(arguments.build.glob("round-*")):
        data = load_dataset(folder)
        flags = {"held": data.outcomes.held, "faithful": data.outcomes.faithful(data.grasps)}
        each = {name: wilson(int(flag.sum()), len(flag)).to_json() for name, flag in flags.items()}
        rounds.append({"round": int(folder.name.split("-")[1]), "trials": len(data.grasps)} | each)
    publish(
        {
            "title": "A model of any size",
            "description": "Grasps of objects of random size, never seen, by random sides: how many held under a "
            "protocol, and how many held and touched as their type asks. Terciles are of the width held, of a shape.",
            "collected under varied": rounds,
            "evaluations": evaluations,
        },
        arguments.out,
    )


if __name__ == "__main__":
    sys.exit(command("benchmarks.default.report", Arguments, main))
