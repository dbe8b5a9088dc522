"""``graspcascade seeds``, ``prior``, ``collect``, ``train`` and ``build``: the chain behind a cascade."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import arg

from ..core.errors import MAX_SEED, InputError, check_whole
from ..core.files import write_folder_staged
from ..core.objects import CATALOGUE
from ..core.protocols import as_protocol
from ..core.taxonomy import GRASP_TYPES
from ..engines import as_engine
from ..hands import Hand, load_hand
from ..nets import EpochRecord, TrainingSpec
from ..proposals.cascade.stages import factorization
from ..proposals.heuristic import CENTRED, SPREAD, Heuristic
from ..studies import build as studies_build
from ..studies.build import BuildSpec
from ..studies.collect import CollectionSpec, CollectionState, collect
from ..studies.dataset import load_dataset
from ..studies.learn import PRIOR_TRAINING, CascadeTraining, fit_cascade, fit_prior
from ..studies.postures import LabelledPostures, Unit, export_postures, import_postures
from ..studies.rounds import Pair, as_cells, cell_name
from ..studies.seeds import Likeness, SeedSpec, human_likeness, make_seeds
from . import console
from .console import Bar, EngineName, Flag, HandName, Json, Objects, PriorFile, ProtocolName, Threads, Workers, percent

_WORST_JOINTS = 3
"""How many of the joints whose angles were clipped are named."""


@dataclass(frozen=True)
class Seeds:
    """Make labelled seed postures and print how human they are."""

    spec: Annotated[SeedSpec, arg(name="inverse kinematics")] = field(default_factory=SeedSpec)
    """What the search for seed postures aims at; an error as large as its tolerance counts the same in every aim."""
    hand: HandName = "shadow"
    out: Path | None = None
    """File to write, .csv, as `graspcascade prior --postures` reads it."""
    json: Json = False

    def run(self) -> None:
        """Make the seeds, write them, print the table."""
        if self.out is not None:
            console.check_out(self.out, ".csv", "a file of postures")
        hand = load_hand(self.hand)
        seeds = _make_seeds(hand, self.spec)
        if self.out is not None:
            export_postures(self.out, seeds)
        made = human_likeness(seeds)
        # One tendon moves both outer joints of a finger, so what the hand does of a seed differs from it.
        moved = human_likeness(replace(seeds, posture=hand.executed(seeds.posture)))
        if self.json:
            console.print_json({"n": len(seeds), "types": [_facts(*pair) for pair in zip(made, moved, strict=True)]})
            return
        print("joints of the digits that hold the object whose mean is within one human standard deviation:")
        console.print_table(
            ["type", "seeds", "human\ngrasps", "joints", "within", "within as\nexecuted", "outside\n(human sd)"],
            [_row(*pair) for pair in zip(made, moved, strict=True)],
            left=(0, 6),
        )
        print(f"{len(seeds)} seed postures" + (f" written to {self.out}" if self.out is not None else ""))


@dataclass(frozen=True)
class Prior:
    """Train the posture prior on seed postures, or on your own recordings."""

    postures: Path | None = None
    """Recorded postures (.csv): a grasp_type column, and joints as <JOINT>_deg or <JOINT>_rad. Seeds without it."""
    unit: Unit | None = None
    """Unit of joint columns that name none."""
    hand: HandName = "shadow"
    out: Path = Path("prior.safetensors")
    """File to write, .safetensors."""
    training: TrainingSpec = PRIOR_TRAINING
    """The training loop."""
    json: Json = False

    def run(self) -> None:
        """Train and write."""
        console.need("torch")
        console.check_out(self.out, ".safetensors", "a prior")
        hand = load_hand(self.hand)
        given = self.postures
        seeds = _make_seeds(hand, SeedSpec()) if given is None else import_postures(given, hand, unit=self.unit)
        absent = [name for name in GRASP_TYPES if name not in seeds.grasp_type]
        with console.bar("training") as progress:
            prior = fit_prior(hand, seeds, self.training, partial(shows_epochs(progress, 1), "prior"))
        prior.save(self.out)
        if self.json:
            counts = {name: int((seeds.grasp_type == name).sum()) for name in GRASP_TYPES}
            facts = {"out": str(self.out), "n": len(seeds), "n_clipped": seeds.n_clipped, "per_type": counts}
            console.print_json(facts | {"clipped": seeds.clipped, "fingerprint": prior.fingerprint()})
            return
        angles = f"{seeds.n_clipped} of {seeds.posture.size} angles were beyond limits and clipped"
        worst = sorted(seeds.clipped.items(), key=lambda joint: -joint[1])[:_WORST_JOINTS]
        joints = f", most often of {', '.join(f'{name} ({count})' for name, count in worst)}" if worst else ""
        print(f"prior of {len(seeds)} postures written to {self.out}; {angles}{joints}")
        if absent:
            print(f"no postures of {', '.join(absent)}: this prior refuses to draw them")


def _facts(seeds: Likeness, moved: Likeness) -> dict[str, object]:
    own = {"share_within": seeds.share_within, "outliers": seeds.outliers}
    return vars(seeds) | own | {"share_within_executed": moved.share_within, "outliers_executed": moved.outliers}


def _row(seeds: Likeness, moved: Likeness) -> list[str]:
    counts = [str(seeds.n_postures), str(seeds.n_human), str(len(seeds.deviation_sd))]
    outside = ", ".join(f"{name} {value:+.1f}" for name, value in seeds.outliers.items()) or "none"
    return [seeds.grasp_type, *counts, percent(seeds.share_within), percent(moved.share_within), outside]


def _make_seeds(hand: Hand, spec: SeedSpec) -> LabelledPostures:
    with console.bar("seed postures", spec.per_type * len(hand.grasp_types)) as progress:
        return make_seeds(hand, spec, progress.advance)


def _rate(state: CollectionState) -> str:
    return percent(state.held.sum() / trials if (trials := state.trials.sum()) else None)


@dataclass(frozen=True)
class Collect:
    """Collect trials of the heuristic's candidates; run again with the same arguments to go on."""

    out: Path
    """Folder of the dataset."""
    spec: Annotated[CollectionSpec, arg(name="size")] = field(default_factory=CollectionSpec)
    """How much to collect. A cell is a pair of object and grasp type; with the catalogue's objects there are 54."""
    objects: Objects = ()
    spread: Flag = False
    """Also place objects off centre, by up to a third of their other extents, and tilted, by up to 15 degrees."""
    hand: HandName = "shadow"
    prior: PriorFile = None
    protocol: ProtocolName = "paper"
    engine: EngineName = "mujoco"
    full: Flag = False
    """Compute every step instead of skipping along the slow creep under weight."""
    threads: Threads = 0
    workers: Workers = 1
    json: Json = False

    def run(self) -> None:
        """Collect, then say how much there is."""
        console.need("pyarrow")
        console.check_threads(threads=self.threads, workers=self.workers)
        placement = SPREAD if self.spread else CENTRED
        proposal = Heuristic(load_hand(self.hand), console.load_prior(self.prior), placement)
        console.possible_cells(proposal, proposal.hand, "collect")
        protocol, engine = as_protocol(self.protocol), as_engine(self.engine, n_threads=self.threads)
        cells = as_cells((obj, kind) for obj in self.objects or CATALOGUE for kind in proposal.prior.types.values())
        with console.bar("trials") as progress:
            watch = _Watch(progress, self.spec, cells, {kind.name for kind in proposal.grasp_types})
            state = collect(
                proposal,
                self.spec,
                self.out,
                protocol=protocol,
                engine=engine if self.full else engine.abridging(protocol),
                cells=cells,
                workers=self.workers,
                progress=watch.round,
                tick=watch.trials,
            )
        trials, held, faithful = (int(counts.sum()) for counts in (state.trials, state.held, state.faithful))
        short = [cell for cell in state.short(self.spec).tolist() if cells[cell][1] in proposal.grasp_types]
        if self.json:
            counts = {"trials": trials, "held": held, "faithful": faithful, "cells_given_up": len(short)}
            facts = {"out": str(self.out), "protocol": protocol.name, "rounds": state.rounds, **counts}
            console.print_json(facts | {"collection": asdict(self.spec)})
            return
        counted = f"{trials} screened trials under protocol {protocol.name}, {held} held ({_rate(state)})"
        print(f"{self.out}: {counted}, {faithful} type-faithful")
        if short:
            given_up = [f"{cell_name(cells[cell])} ({state.trials[cell]} trials)" for cell in short]
            print(f"given up: {', '.join(given_up)}")


class _Watch:
    """Show how far a collection is, and say once what its user should know."""

    def __init__(self, progress: Bar, spec: CollectionSpec, cells: Sequence[Pair], possible: Collection[str]) -> None:
        self._progress, self._spec, self._cells, self._possible = progress, spec, cells, possible
        self._state, self._in_round, self._said = CollectionState.of((), n_cells=len(cells)), 0, set[str]()

    def round(self, state: CollectionState) -> None:
        """Take what is written into account."""
        self._state, self._in_round = state, 0
        if state.lost and not self._said:
            self._say(f"missing or changed shards are collected again: {', '.join(state.lost)}")
        for cell in state.rare(self._spec):
            self._say(f"{cell_name(self._cells[cell])} hardly ever holds; --most-trials-per-cell gives such cells up")
        self.trials(0)

    def trials(self, decided: int) -> None:
        """Take trials of the round under way into account."""
        self._in_round += decided
        done = int(self._state.trials.sum())
        self._progress.show(done + self._in_round, done + self._to_come(), f"held {_rate(self._state)}")

    def _say(self, words: str) -> None:
        if words not in self._said:
            self._said.add(words)
            console.say("collect", words)

    def _to_come(self) -> int:
        """Count the trials that whole rounds will still execute; of held grasps, as far as the rates so far tell."""
        spec, state = self._spec, self._state
        cells = [cell for cell in state.unfinished(spec).tolist() if self._cells[cell][1].name in self._possible]
        trials, held = state.trials[cells], state.held[cells]
        missing = np.maximum(spec.successes_per_cell - held, 0) * (trials + 2) / (held + 1)
        missing = np.maximum(missing, spec.trials_per_cell - trials)
        if spec.most_trials_per_cell:
            missing = np.minimum(missing, spec.most_trials_per_cell - trials)
        return int(np.ceil(missing / spec.round_per_cell).sum()) * spec.round_per_cell


@dataclass(frozen=True)
class Train:
    """Train a cascade on the successes of a dataset."""

    data: Path
    """Folder of the dataset."""
    out: Path
    """Folder for the trained cascade and its training curves; new or empty."""
    factorization: str = "model3"
    """Which stages: model1, model2, model3, plain_rotation or variant2 to variant7 of the paper, or any_size."""
    hand: HandName = "shadow"
    training: Annotated[CascadeTraining, arg(name="")] = field(default_factory=CascadeTraining)
    """What to learn from and how long."""
    workers: int = 0
    """Processes to train stages side by side in, 0 for as many as processors; the weights are the same."""
    json: Json = False

    def run(self) -> None:
        """Train and write."""
        console.need("pyarrow")
        console.need("torch")
        console.check_threads(workers=self.workers)
        chosen, out = factorization(self.factorization), _replaceable(self.out)
        hand, dataset = load_hand(self.hand), load_dataset(self.data)
        out.parent.mkdir(parents=True, exist_ok=True)
        with console.bar("training") as progress:
            show = shows_epochs(progress, len(chosen.stages))
            fitted = fit_cascade(hand, dataset, chosen, self.training, show, self.workers)
        write_folder_staged(out, fitted.save)
        losses = {name: records[-1].train_loss for name, records in fitted.history.items()}
        if self.json:
            console.print_json({"out": str(self.out), "factorization": chosen.name, "final_loss": losses})
        else:
            stages = ", ".join(f"{name} {loss:.3f}" for name, loss in losses.items())
            print(f"{chosen.name} trained on {self.data}, written to {self.out}; final loss: {stages}")


@dataclass(frozen=True)
class Build:
    """Make a model for boxes, cylinders and spheres of any size from nothing: seeds, prior, trials, cascade and scorer.

    Each round tries grasps of what the round before taught, and what all rounds taught is measured. Run again with the
    same arguments to go on.
    """

    out: Path
    """Folder for all that is made; the model is model-N in it, N the number of rounds."""
    hand: HandName = "shadow"
    trials: tuple[int, ...] = BuildSpec().trials_per_cell
    """Trials of each kind of object and type in each round."""
    evaluation: int = BuildSpec().evaluation_per_cell
    """Trials of each kind of object and type in an evaluation."""
    seed: int = 0
    """Seed of trials and evaluations."""
    threads: Threads = 0
    workers: int = 0
    """Processes to train stages side by side in, 0 for as many as processors; the weights are the same."""
    json: Json = False

    def run(self) -> None:
        """Build, then print what was measured."""
        console.need("pyarrow")
        console.need("torch")
        console.check_threads(threads=self.threads, workers=self.workers)
        check_whole("seed", self.seed, most=MAX_SEED - 1)
        spec = BuildSpec(trials_per_cell=self.trials, evaluation_per_cell=self.evaluation, seed=self.seed)
        hand, engine = load_hand(self.hand), as_engine(n_threads=self.threads)
        with ExitStack() as bars:
            shown: dict[str, Bar] = {}

            def report(step: str, done: int, total: int) -> None:
                if step not in shown:
                    bars.close()
                    shown[step] = bars.enter_context(console.bar(step))
                shown[step].show(done, total)

            build = studies_build.Build(hand, self.out, spec, engine, self.workers, report)
            possible = {kind.name for _, kind in build.cells}
            if left_out := [name for name in GRASP_TYPES if name not in possible]:
                console.say("build", f"left out {', '.join(left_out)}: {hand.name} lacks digits or places for them")
            build.trained()
            measured = build.measured()
        model = build.model(len(spec.trials_per_cell))
        if self.json:
            console.print_json({"model": str(model), "measured": [each.to_json() for each in measured]})
            return
        rows = [
            [str(each.round), each.grasps, each.evaluation.protocol.name, str(each.evaluation.n)]
            + [console.interval(rate.to_json()) for rate in (each.evaluation.held, each.evaluation.faithful)]
            for each in measured
        ]
        console.print_table(["round", "grasps", "protocol", "trials", "held", "type-faithful"], rows, left=(1, 2))
        print(f"the model is {model}; what it is and does not do: {model / studies_build.CARD_FILE}")


def shows_epochs(progress: Bar, stages: int) -> Callable[[str, EpochRecord], None]:
    """Return a callback that sums the epochs of stages trained in parallel on one progress bar."""
    latest: dict[str, EpochRecord] = {}

    def show(stage: str, record: EpochRecord) -> None:
        latest[stage] = record
        # The stage just heard of stays, so that something is shown when it ends.
        going = {name: r for name, r in latest.items() if name == stage or r.epoch < r.epochs}
        loss = {name: r.train_loss if r.validation_loss is None else r.validation_loss for name, r in going.items()}
        losses = ", ".join(f"{name} {value:.3f}" for name, value in loss.items())
        progress.show(sum(r.epoch for r in latest.values()), stages * record.epochs, f"loss: {losses}")

    return show


def _replaceable(folder: Path) -> Path:
    """Resolve the folder to write, which is moved into place when it is done: what would not go is refused before."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} is not empty; give a new or empty folder")
    folder = folder.resolve()
    stays = folder.is_dir() and (folder.is_mount() or folder.samefile(Path.cwd()))
    if stays or (folder.parent.is_dir() and not os.access(folder.parent, os.W_OK)):
        raise InputError(
            f"{folder} cannot be put in place when it is done, being the working directory, a mount point or in a "
            "folder that is read-only; give a folder inside it or elsewhere"
        )
    return folder
