"""The whole chain from nothing: seeds, prior, rounds of trials with what they teach, and a measured model."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InputError, check_whole, shortened
from ..core.families import FAMILIES
from ..core.files import holds_nothing, read_json, sole_writer, write_folder_staged, write_json, write_text
from ..core.protocols import HOLD, VARIED, Protocol
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
from .record import Evaluation, Tally
from .rounds import Pair, cell_name
from .scoring import ScorerTraining, fit_scorer, without_errors
from .seeds import FEIX_SEEDS, SeedSpec, make_seeds, seedable

SEEDS_FILE, PRIOR_FILE, MODEL_FOLDER = "seeds.csv", "prior.safetensors", "model"
BUILD_FILE, CARD_FILE = "build.json", "README.md"
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
    least_chance: float = 0.85
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
        check_whole("evaluation_per_cell", self.evaluation_per_cell, 1, 10**7)
        if not 0.0 <= self.least_chance < 1.0:
            raise InputError(f"least_chance must be 0 to 1, 1 excluded, got {self.least_chance}")


@dataclass(frozen=True)
class Measured:
    """Hold what was measured of the grasps of a round's model, drawn "raw" or "ranked"."""

    round: int
    grasps: str
    evaluation: Evaluation

    def to_json(self) -> dict[str, Any]:
        """Describe it as plain data."""
        return {"round": self.round, "grasps": self.grasps, "evaluation": self.evaluation.to_json()}


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
        kinds = seedable(self.hand, self.spec.seeds.taxonomy)
        return tuple((family, kind) for family in FAMILIES.values() for kind in kinds)

    def run(self) -> tuple[GraspSampler, Scorer]:
        """Do all that is missing, evaluations included, and return the cascade and scorer of the last round.

        Raises:
            InputError: the folder holds another build or something else, or the hand can make no type or has joints of
                which no human statistics are known (see `seeds.seedable`).
        """
        trained = self.trained()
        self.measured()
        return trained

    def trained(self) -> tuple[GraspSampler, Scorer]:
        """Do all that is missing but for evaluations; errors are those of `run`."""
        with sole_writer(self.folder):
            self._claim()
            return self._trained()

    def _trained(self) -> tuple[GraspSampler, Scorer]:
        proposal: Proposal = Heuristic(self.hand, self.prior(), self.spec.placement)
        data: list[Dataset] = []
        for number in range(1, len(self.spec.trials_per_cell) + 1):
            data.append(self.collected(proposal, number))
            cascade, scorer = self.learned(data, number)
            # What has no chance at all teaches little; which that is, a scorer of the round before can say.
            proposal = Ranked(Disturbed(cascade), scorer, good_enough=0.3, most_draws=4, name="explored")
        return cascade, scorer

    def _claim(self) -> None:
        """Keep the arguments in the folder, or compare them with those kept there."""
        about = {"hand": self.hand.name, "cells": [cell_name(cell) for cell in self.cells]}
        own = json.loads(json.dumps(about | asdict(self.spec)))
        path = self.folder / BUILD_FILE
        if not path.is_file():
            # What Python code did step by step is gone on with; postures of other making are not.
            if not holds_nothing(self.folder) and not (self.folder / "round-1").is_dir():
                raise InputError(f"{self.folder} holds something else; give a new or empty folder")
            write_json(path, own)
        kept = read_json(path)
        kept = kept if isinstance(kept, dict) else {}
        if differing := [name for name, value in own.items() if kept.get(name) != value]:
            was = ", ".join(f"{name} {shortened(str(kept.get(name)))}" for name in differing)
            raise InputError(f"{self.folder} holds another build, with {was}; give its arguments or another folder")

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
            total = self.spec.seeds.per_type * len(seedable(self.hand, self.spec.seeds.taxonomy))

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
                write_json(path / BUILD_FILE, {"build": asdict(self.spec)})

            write_folder_staged(folder, write)
        return GraspSampler.load(folder), Scorer.load(folder)

    def measured(self) -> tuple[Measured, ...]:
        """Evaluate what every round taught, as far as that is missing, and write a card of each model."""
        done: list[Measured] = []
        for number, grasps, protocol in self._tries():
            cascade, scorer = GraspSampler.load(self.model(number)), Scorer.load(self.model(number))
            step = f"{grasps} grasps of round {number} under {protocol.name}"
            evaluation = evaluate(
                cascade if grasps == "raw" else Ranked(cascade, scorer),
                protocol=protocol,
                hand=self.hand,
                per_cell=self.spec.evaluation_per_cell,
                cells=self.cells,
                seed=self.spec.seed + 1,
                engine=self.engine,
                out=self.folder / f"evaluation-{number}-{grasps}-{protocol.name}",
                progress=lambda done, total, step=step: self.report(step, done, total),  # type: ignore[misc]
            )
            done.append(Measured(number, grasps, evaluation))
        for number in range(1, len(self.spec.trials_per_cell) + 1):
            card = model_card(Ranked.load(self.model(number)), self.spec, [one for one in done if one.round <= number])
            write_text(self.model(number) / CARD_FILE, card)
        return tuple(done)

    def _tries(self) -> Iterator[tuple[int, str, Protocol]]:
        """List round, grasps and protocol of every evaluation."""
        for number in range(1, len(self.spec.trials_per_cell) + 1):
            yield number, "raw", HOLD
            yield number, "ranked", HOLD
        yield number, "ranked", VARIED


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


# The model card

_CARD = """\
# Grasps of any size for {hand}

Asked for a grasp type and a box, cylinder or sphere, a cascade of three networks draws joint angles and the
object's pose in the hand. A scorer estimates the chance that each grasp holds as its type asks, for a friction and
a mass; of up to {most_draws} times as many draws those with at least {good_enough:g} are given, and the likeliest
of the others where these are too few. Name its folder to use it:

    graspcascade types box:32x41x60mm --model FOLDER
    graspcascade sample tripod box:32x41x60mm --model FOLDER

{facts}

## What was measured

Trials in simulation ({engine}), {per_cell} of each kind of object and type, each with an object of its own, of random
size. *Held*: after closing, a shake and five seconds of weight the object is still between thumb and fingers.
*Type-faithful*: the digits also touch it where the type asks. Both in percent, with 95 % intervals. Raw grasps are as
the cascade draws them.

{rounds}

{parts}
## What it does not do

- Nothing was tried on hardware: all rates are of one simulator, with rigid objects of even density.
- It knows boxes, cylinders and spheres, held through their centre by one of their sides, and no table and no arm.
- A chance is an estimate, of an object whose place and size are a little off, as under protocol `varied`. With
  friction and masses beyond those above it is a guess.
"""


def model_card(model: Ranked, spec: BuildSpec, measured: Sequence[Measured]) -> str:
    """Describe a model and what was measured of it, as Markdown.

    Args:
        model: cascade and scorer.
        spec: how they were made.
        measured: evaluations of models of earlier rounds, and last those of this one.
    """
    number, last = measured[-1].round, measured[-1].evaluation
    cascade, scorer = model.describe(), model.scorer.metadata
    judged, seen = scorer["judged"]["faithful, uncertain"], model.scorer.seen
    ranges = {
        family.shape.kind: " x ".join(f"{1000 * low:g}-{1000 * high:g}" for low, high in family.ranges_m)
        for family in FAMILIES.values()
    }
    facts = {
        "hand": last.hand,
        "grasp types": f"{', '.join(last.by_type)} (taxonomy `{last.taxonomy}`)",
        "sizes learned from, mm": ", ".join(f"{kind} {sizes}" for kind, sizes in ranges.items()),
        "trials learned from": f"{scorer['trials']} under protocol `{VARIED.name}`; rounds: {number}",
        "the cascade from": f"{cascade['learned_from']} of them, type-faithful, chance from {spec.least_chance:g}",
        **{f"{name.replace('_', ' in ')} in them": f"{low:g} to {high:g}" for name, (low, high) in seen.items()},
        "calibration error of chances": f"{judged['calibration_error']:.3f} ({judged['n']} trials of other objects)",
        "seeds": f"trials {spec.seed}, evaluations {last.seed}",
        "weights": f"cascade {cascade['weights']}, scorer {cascade['scorer']}",
        "made with": ", ".join(f"{name} {each}" for name, each in {**scorer["versions"], **last.versions}.items()),
    }
    parts = [
        f"Ranked grasps of round {number} under protocol `{run.protocol.name}`:\n\n{_by_part(run)}\n"
        for run in (each.evaluation for each in measured if each.round == number and each.grasps == "ranked")
    ]
    rounds = [
        [str(each.round), each.grasps, f"`{each.evaluation.protocol.name}`", *_rates(each.evaluation.total)]
        for each in measured
    ]
    return _CARD.format(
        hand=last.hand,
        good_enough=model.good_enough,
        most_draws=model.most_draws,
        facts=_table(["fact", "value"], facts.items()),
        engine=last.engine,
        per_cell=last.per_cell,
        rounds=_table(["round", "grasps", "protocol", "trials", "held", "type-faithful"], rounds),
        parts="\n".join(parts),
    )


def _by_part(evaluation: Evaluation) -> str:
    parts = {**evaluation.by_type, **evaluation.by_object}
    return _table(["of", "trials", "held", "type-faithful"], ([name, *_rates(part)] for name, part in parts.items()))


def _rates(tally: Tally) -> list[str]:
    rates = tally.held_rate, tally.faithful_rate
    return [str(tally.n), *(f"{100 * rate.rate:.1f} [{100 * rate.low:.1f}, {100 * rate.high:.1f}]" for rate in rates)]


def _table(titles: list[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in (titles, ["---"] * len(titles), *rows))
