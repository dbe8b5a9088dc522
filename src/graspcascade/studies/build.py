"""The whole chain from nothing: seeds, prior, rounds of trials with what they teach, and a measured model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

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
from ..proposals.heuristic import SPREAD, Heuristic
from ..proposals.prior import PosturePrior
from ..proposals.ranked import Disturbed, Ranked
from ..proposals.scorer import Scorer
from .collect import CollectionSpec, CollectionState, collect
from .dataset import Dataset, join, load_dataset
from .evaluate import evaluate
from .learn import PRIOR_TRAINING, CascadeTraining, fit_cascade, fit_prior
from .postures import LabelledPostures, export_postures, import_postures
from .rounds import Pair
from .scoring import ScorerTraining, fit_scorer
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
    trials_per_cell: tuple[int, ...] = (6000, 4000, 4000)
    """Trials of each kind of object and type in each round: the first of the heuristic, the others of what the round
    before taught."""
    cascade: CascadeTraining = field(default_factory=CascadeTraining)
    """Training of the cascade after each round."""
    scorer: ScorerTraining = field(default_factory=ScorerTraining)
    """Training of the scorer after each round."""
    evaluation_per_cell: int = 600
    """Trials of each kind of object and type in an evaluation."""
    seed: int = 0
    """Seed of the collections and evaluations."""

    def __post_init__(self) -> None:
        if not self.trials_per_cell:
            raise InputError("a model needs at least one round of trials")
        for trials in self.trials_per_cell:
            check_whole("trials_per_cell", trials, 1, 10**7)
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

    def run(self) -> GraspSampler:
        """Do all that is missing, and return the cascade of the last round; the scorer lies beside it."""
        self.folder.mkdir(parents=True, exist_ok=True)
        proposal: Proposal = Heuristic(self.hand, self.prior(), SPREAD)
        data: list[Dataset] = []
        for number in range(1, len(self.spec.trials_per_cell) + 1):
            data.append(self.collected(proposal, number))
            cascade, scorer = self.learned(data, number)
            # What has no chance at all teaches little; which that is, a scorer of the round before can say.
            proposal = Ranked(Disturbed(cascade), scorer, good_enough=0.3, most_draws=4, name="explored")
        self.measured()
        return GraspSampler.load(self.model(number))

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

            cascade = fit_cascade(self.hand, join(data), stages, self.spec.cascade, tell, self.workers)
            scorer = fit_scorer(
                self.hand,
                data,
                self.spec.scorer,
                lambda r: self.report(f"scorer after round {number}", r.epoch, r.epochs),
            )

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
