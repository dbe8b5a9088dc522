"""``graspcascade evaluate``: success rates over all objects and types."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..evaluation import (
    HEURISTIC,
    Evaluation,
    Source,
    Tally,
    evaluate,
    heuristic_metadata,
    heuristic_source,
    model_source,
)
from ..trials import protocol
from .console import at_least, bar, interval, print_json, print_table


@dataclass(frozen=True)
class Evaluate:
    """Execute grasps of a model, or of the heuristic, for every object and type and print the rates."""

    model: str = "default"
    """Name of a shipped cascade, the folder of a trained one, or "heuristic"."""
    per_cell: int = 500
    """Trials for each object and grasp type."""
    protocol: str = "paper"
    """Trial protocol; every rate is quoted with its name."""
    prior: Path | None = None
    """Posture prior of the heuristic (.safetensors), refused with a model; the shipped one without it."""
    seed: int = 0
    """Seed of every draw."""
    out: Path | None = None
    """Folder for finished rounds and evaluation.json; the same command goes on where an earlier one stopped."""
    threads: int = 0
    """Simulation threads, 0 for all processors."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        """Evaluate, then print."""
        at_least("per-cell", self.per_cell, 1)
        at_least("seed", self.seed, 0)
        at_least("threads", self.threads, 0)
        if self.prior is not None and self.model != HEURISTIC:
            raise InputError(f"a prior is the heuristic's; give --model {HEURISTIC} with it, got --model {self.model}")
        chosen = protocol(self.protocol)
        name, source, metadata = self._source()
        with bar(f"trials of {name}") as progress:
            found = evaluate(
                name,
                source,
                per_cell=self.per_cell,
                seed=self.seed,
                protocol=chosen,
                out=self.out,
                n_threads=self.threads,
                progress=progress.show,
                metadata=metadata,
            )
        if self.json:
            print_json(found.to_json())
        else:
            # Every user's model has the name of its factorization; the folder tells which it is.
            _print_rates(found, found.model if found.model == self.model else f"{found.model} ({self.model})")

    def _source(self) -> tuple[str, Source, dict[str, Any]]:
        if self.model == HEURISTIC:
            from ..hands import shadow_hand
            from ..postures import PosturePrior

            prior = PosturePrior.pretrained() if self.prior is None else PosturePrior.load(self.prior)
            return HEURISTIC, heuristic_source(shadow_hand(), prior), heuristic_metadata(prior)
        from .models import load_sampler

        sampler = load_sampler(self.model)
        return sampler.name, model_source(sampler), sampler.describe()


def _print_rates(found: Evaluation, title: str) -> None:
    print(
        f"{title} under protocol {found.protocol.name}, {found.per_cell} trials a cell: "
        "% held / % held and type-faithful"
    )
    cells = {(cell.object_label, cell.grasp_type): cell for cell in found.cells}
    rows = [
        [label, *(_pair(cells.get((label, kind))) for kind in found.by_type), _pair(found.by_object[label])]
        for label in found.by_object
    ]
    rows.append(["all objects", *map(_pair, found.by_type.values()), _pair(found.total)])
    headings = [name.replace("_", "\n") for name in found.by_type]
    print_table(["object", *headings, "all\ntypes"], rows)
    print(", ".join(f"{count} {verdict}" for verdict, count in found.total.verdicts.items() if count))
    print(f"protocol {found.protocol.name}, {found.n} trials: held {interval(found.held.to_json())}")
    print(f"held and type-faithful {interval(found.faithful.to_json())}")


def _pair(tally: Tally | None) -> str:
    if tally is None:
        return "-"
    return f"{100 * tally.held_rate.rate:.0f}/{100 * tally.faithful_rate.rate:.0f}"
