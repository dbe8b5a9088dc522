"""``graspcascade collect``: a dataset of trials."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from ..cells import cell_name
from ..dataset import CollectionSpec, collect
from ..dataset.collect import CollectionState
from ..hands import shadow_hand
from ..objects import CATALOGUE
from ..postures import PosturePrior
from ..taxonomy import GRASP_TYPES
from ..trials import COLLECTION
from .console import at_least, bar, percent, print_json
from .needs import need


@dataclass(frozen=True)
class Collect:
    """Collect trials of the heuristic's candidates; run again with the same arguments to go on."""

    out: Path
    """Folder of the dataset."""
    spec: CollectionSpec = field(default_factory=CollectionSpec)
    """How much."""
    prior: Path | None = None
    """Posture prior (.safetensors); the shipped one without it."""
    full: bool = False
    """Compute every step instead of leaping along the slow creep under weight."""
    threads: int = 0
    """Simulation threads, 0 for all processors."""
    json: bool = False
    """Print JSON."""

    def run(self) -> None:
        """Collect, then say how much there is."""
        need("pyarrow")
        at_least("threads", self.threads, 0)
        prior = PosturePrior.pretrained() if self.prior is None else PosturePrior.load(self.prior)
        told: set[str] = set()
        latest, in_round = CollectionState.of(()), 0

        def tell(words: str) -> None:
            if words not in told:
                told.add(words)
                print(f"graspcascade collect: {words}", file=sys.stderr)

        with bar(self._goal[0], self._target) as progress:

            def report(state: CollectionState) -> None:
                nonlocal latest, in_round
                latest, in_round = state, 0
                if state.lost and not told:
                    tell(f"missing or changed shards are collected again: {', '.join(state.lost)}")
                for cell in state.rare(self.spec):
                    tell(f"{cell_name(cell)} hardly ever holds; --most-trials-per-cell gives such cells up")
                progress.show(self._done(state), note=f"held {_rate(state)}")

            def tick(decided: int) -> None:
                nonlocal in_round
                in_round += decided
                # Decided trials are not all of what is counted: some are more than a cell needs, or do not hold.
                done = min(self._done(latest) + in_round, self._done_after_a_round(latest))
                progress.show(done, note=f"held {_rate(latest)}, {in_round} trials into the round")

            state = collect(
                shadow_hand(),
                prior,
                self.spec,
                self.out,
                creep=None if self.full else COLLECTION,
                n_threads=self.threads,
                progress=report,
                tick=tick,
            )
        trials, held, faithful = (int(counts.sum()) for counts in (state.trials, state.held, state.faithful))
        if self.json:
            counts = {"rounds": state.rounds, "trials": trials, "held": held, "faithful": faithful}
            counts["cells_given_up"] = len(state.short(self.spec))
            print_json({"out": str(self.out), "protocol": "paper", **counts, "collection": asdict(self.spec)})
        else:
            print(
                f"{self.out}: {trials} screened trials under protocol paper, {held} held ({_rate(state)}), "
                f"{faithful} type-faithful"
            )
            given_up = [f"{cell_name(cell)} ({state.trials[cell]} trials)" for cell in state.short(self.spec)]
            if given_up:
                print(f"given up: {', '.join(given_up)}")

    @property
    def _goal(self) -> tuple[str, int]:
        """Give what is counted and how many of it each cell needs."""
        trials, held = self.spec.trials_per_cell, self.spec.successes_per_cell
        return ("trials", trials) if trials >= held else ("held", held)

    @property
    def _target(self) -> int:
        return self._goal[1] * len(CATALOGUE) * len(GRASP_TYPES)

    def _done(self, state: CollectionState) -> int:
        what, per_cell = self._goal
        return int(np.minimum(getattr(state, what), per_cell).sum())

    def _done_after_a_round(self, state: CollectionState) -> int:
        """Give how many will surely count after one more round of all cells; who holds is not known before its end."""
        what, per_cell = self._goal
        if what == "held":
            return self._done(state)
        return int(np.minimum(state.trials + self.spec.round_per_cell, per_cell).sum())


def _rate(state: CollectionState) -> str:
    trials = int(state.trials.sum())
    return percent(int(state.held.sum()) / trials if trials else None)
