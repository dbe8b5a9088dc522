"""The whole chain from nothing: seeds, prior, rounds of trials with what they teach, and a measured model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError, check_whole
from ..core.families import FAMILIES
from ..core.files import write_folder_staged, write_json
from ..core.protocols import HOLD, VARIED
from ..core.taxonomy import TAXONOMIES
from ..engines import Engine, as_engine
from ..hands import Hand
from ..nets import TrainingSpec
from ..proposals import Proposal
from ..proposals.cascade.sampler import GraspSampler
from ..proposals.cascade.stages import FACTORIZATIONS
from ..proposals.heuristic import SPREAD, Heuristic, Placement
from ..proposals.prior import PosturePrior
from ..proposals.ranked import Disturbed, Ranked
from ..proposals.scorer import Scorer
from .collect import CollectionSpec, CollectionState, collect
from .dataset import Dataset, join, load_dataset
from .evaluate import evaluate
from .learn import PRIOR_TRAINING, CascadeTraining, case_of, fit_cascade, fit_prior
from .postures import LabelledPostures, export_postures, import_postures
from .rounds import Pair
from .scoring import ScorerTraining, fit_scorer, without_errors
from .seeds import FEIX_SEEDS, SeedSpec, make_seeds

SEEDS_FILE, PRIOR_FILE, MODEL_FOLDER = "seeds.csv", "prior.safetensors", "model"
Report = Callable[[str, int, int], None]
"""Called with the step under way, how much of it is done, and how much there is."""


@dataclass(frozen=True)
class BuildSpec:
    """Say how much of everything to make.

    Raises:
        InputError: a number out of range.
    """

    seeds: SeedSpec = FEIX_SEEDS
    """Seed postures."""
    prior: TrainingSpec = PRIOR_TRAINING
    """Training of the prior."""
    placement: Placement = SPREAD
    """How far the heuristic's candidates are placed from where the paper's puts them."""
    trials_per_cell: tuple[int, ...] = (3000, 3000, 3000)
    """Trials of each kind of object and type in each round: the first of the heuristic, the others of what the round
    before taught."""
    cascade: CascadeTraining = field(default_factory=CascadeTraining)
    """Training of the cascade after each round."""
    scorer: ScorerTraining = field(default_factory=ScorerTraining)
    """Training of the scorer after each round."""
    least_chance: float = 0.7
    """The cascade learns from successes to which the scorer gives at least this chance: those that were not luck."""
    evaluation_per_cell: int = 600
    """Trials of each kind of object and type in an evaluation."""
    seed: int = 0
    """Seed of the collections and evaluations."""

    def __post_init__(self) -> None:
        if not self.trials_per_cell:
            raise InputError("a model needs at least one round of trials")
        for trials in self.trials_per_cell:
            check_whole("trials_per_cell", trials, 1, 10**7)
        if not 0.0 <= self.least_chance < 1.0:
            raise InputError(f"least_chance must be 0 to 1, 1 excluded, got {self.least_chance}")
        check_whole("evaluation_per_cell", self.evaluation_per_cell, 1, 10**7)


@dataclass(frozen=True)
class Build:
    """Make a model for a hand in a folder, going on where an earlier call with the same arguments was cut off.

    Attributes:
        hand: the hand.
        folder: holds everything that is made; a step whose product is there is not done again.
        spec: how much of everything.
        engine: what tries grasps.
        workers: processes to train stages in, 0 for as many as processors.
        report: hears how far it is.
    """

    hand: Hand
    folder: Path
    spec: BuildSpec = field(default_factory=BuildSpec)
    engine: Engine = field(default_factory=as_engine)
    workers: int = 0
    report: Report = lambda step, done, total: None

    @property
    def cells(self) -> tuple[Pair, ...]:
        """Every kind of object with every type that the hand can make."""
        kinds = self.hand.possible(TAXONOMIES[self.spec.seeds.taxonomy].values())
        return tuple((family, kind) for family in FAMILIES.values() for kind in kinds)

    def run(self) -> tuple[GraspSampler, Scorer]:
        """Do all that is missing, evaluations included, and return the cascade and scorer of the last round."""
        trained = self.trained()
        self.measured()
        return trained

    def trained(self) -> tuple[GraspSampler, Scorer]:
        """Do all that is missing but for evaluations."""
        self.folder.mkdir(parents=True, exist_ok=True)
        proposal: Proposal = Heuristic(self.hand, self.prior(), self.spec.placement)
        data: list[Dataset] = []
        for number in range(1, len(self.spec.trials_per_cell) + 1):
            data.append(self.collected(proposal, number))
            cascade, scorer = self.learned(data, number)
            # What has no chance at all teaches little; which that is, a scorer of the round before can say.
            proposal = Ranked(Disturbed(cascade), scorer, good_enough=0.3, most_draws=4, name="explored")
        return cascade, scorer

    def model(self, number: int) -> Path:
        """Name the folder of what a round and all before it taught."""
        return self.folder / f"{MODEL_FOLDER}-{number}"

    def prior(self) -> PosturePrior:
        """Make seeds and train the prior on them."""
        path = self.folder / PRIOR_FILE
        if not path.is_file():
            prior = fit_prior(
                self.hand, self.seeds(), self.spec.prior, lambda r: self.report("prior", r.epoch, r.epochs)
            )
            prior.save(path)
        return PosturePrior.load(path)

    def seeds(self) -> LabelledPostures:
        """Make seed postures."""
        path, made = self.folder / SEEDS_FILE, 0
        if not path.is_file():
            kinds = self.hand.possible(TAXONOMIES[self.spec.seeds.taxonomy].values())
            total = self.spec.seeds.per_type * len(kinds)

            def tell(n: int) -> None:
                nonlocal made
                made += n
                self.report("seeds", made, total)

            export_postures(path, make_seeds(self.hand, self.spec.seeds, tell))
        return replace(import_postures(path, self.hand), taxonomy=self.spec.seeds.taxonomy)

    def collected(self, proposal: Proposal, number: int) -> Dataset:
        """Collect a round of trials under `varied`."""
        folder, per_cell = self.folder / f"round-{number}", self.spec.trials_per_cell[number - 1]
        total, state = per_cell * len(self.cells), CollectionState.of((), n_cells=len(self.cells))
        tried = 0

        def begin(reached: CollectionState) -> None:
            nonlocal state, tried
            state, tried = reached, 0
            self.report(f"trials of round {number}", int(state.trials.sum()), total)

        def tell(decided: int) -> None:
            nonlocal tried
            tried += decided
            self.report(f"trials of round {number}", int(state.trials.sum()) + tried, total)

        spec = CollectionSpec(per_cell, round_per_cell=min(per_cell, 200), seed=self.spec.seed)
        about: dict[str, Any] = {"protocol": VARIED, "hand": self.hand, "cells": self.cells}
        collect(proposal, spec, folder, engine=self.engine.abridging(VARIED), progress=begin, tick=tell, **about)
        return load_dataset(folder)

    def learned(self, data: list[Dataset], number: int) -> tuple[GraspSampler, Scorer]:
        """Train cascade and scorer on all rounds so far."""
        folder = self.model(number)
        if not folder.is_dir():
            stages, latest = FACTORIZATIONS["any_size"], dict[str, tuple[int, int]]()

            def tell(stage: str, record: Any) -> None:
                latest[stage] = record.epoch, record.epochs
                done = sum(epoch for epoch, _ in latest.values())
                self.report(f"cascade after round {number}", done, record.epochs * len(stages.stages))

            step = f"scorer after round {number}"
            scorer = fit_scorer(self.hand, data, self.spec.scorer, lambda r: self.report(step, r.epoch, r.epochs))
            likely = [likely_successes(each, scorer.scorer, self.spec.least_chance) for each in data]
            cascade = fit_cascade(self.hand, join(likely), stages, self.spec.cascade, tell, self.workers)

            def write(path: Path) -> None:
                cascade.save(path)
                scorer.scorer.save(path)
                write_json(path / "build.json", {"build": asdict(self.spec)})

            write_folder_staged(folder, write)
        return GraspSampler.load(folder), Scorer.load(folder)

    def measured(self) -> None:
        """Evaluate what every round taught, as drawn and ranked, under `hold` and `varied`."""
        for number in range(1, len(self.spec.trials_per_cell) + 1):
            cascade, scorer = GraspSampler.load(self.model(number)), Scorer.load(self.model(number))
            ranked = Ranked(cascade, scorer)
            tries: list[tuple[str, Proposal, Any]] = [("raw-hold", cascade, HOLD), ("ranked-hold", ranked, HOLD)]
            if number == len(self.spec.trials_per_cell):
                tries.append(("ranked-varied", ranked, VARIED))
            for name, proposal, protocol in tries:
                step = f"evaluation {name} after round {number}"
                evaluate(
                    proposal,
                    protocol=protocol,
                    hand=self.hand,
                    per_cell=self.spec.evaluation_per_cell,
                    cells=self.cells,
                    seed=self.spec.seed + 1,
                    engine=self.engine,
                    out=self.folder / f"evaluation-{number}-{name}",
                    progress=lambda done, total, step=step: self.report(step, done, total),  # type: ignore[misc]
                )


def likely_successes(data: Dataset, scorer: Scorer, least_chance: float) -> Dataset:
    """Select the type-faithful trials of a dataset to which a scorer, not knowing their errors, gives a chance.

    Of cases (see `learn.case_of`) whose successes have less, the likelier half is selected.
    """
    about = data.conditions
    chance = scorer.chances(data.grasps, None if about is None else without_errors(about)).faithful
    good = data.outcomes.faithful(data.grasps)
    case = np.unique(data.grasps.tasks.column(lambda task: case_of(task, "site"), str), return_inverse=True)[1]
    for number in range(case.max(initial=-1) + 1):
        rows = good & (case == number)
        if rows.any():
            good[rows] = chance[rows] >= min(least_chance, float(np.median(chance[rows])))
    rows = np.flatnonzero(good)
    return replace(
        data,
        grasps=data.grasps[rows],
        outcomes=data.outcomes[rows],
        conditions=None if about is None else about[rows],
    )
