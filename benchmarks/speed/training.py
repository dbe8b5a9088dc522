"""Seconds to train a whole cascade, against the bare matrix products of the same networks (needs torch)."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from graspcascade.core.errors import InputError
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.protocols import PAPER
from graspcascade.core.tasks import draw_tasks
from graspcascade.hands import Hand
from graspcascade.nets import EpochRecord, TrainingSpec, VaeSpec
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.cascade.stages import Factorization, factorization
from graspcascade.studies.dataset import Dataset, load_dataset
from graspcascade.studies.executor import run_jobs
from graspcascade.studies.learn import CascadeTraining, StageJob, fit_cascade, prepare
from graspcascade.studies.rounds import CELLS

FACTORIZATION = "model3"
_YARDSTICK_STEPS = 200
_FORWARD_AND_BACKWARD = 3
"""Products of a training step for each layer: the forward one, and the gradients of its weights and of its inputs."""

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Timed:
    """Hold what training took.

    Attributes:
        seconds: elapsed, from the rows to the trained cascade.
        epochs: of each stage.
        epoch_s: seconds of one epoch by stage, the mean of all but the first, which warms up.
    """

    seconds: float
    epochs: int
    epoch_s: dict[str, float]

    def extrapolated(self, epochs: int, workers: int) -> float:
        """Extend linearly to the seconds of so many epochs; what is not epochs happens once."""

        def trained(n: int) -> float:
            return makespan([n * seconds for seconds in self.epoch_s.values()], workers)

        return self.seconds + trained(epochs) - trained(self.epochs)


def makespan(jobs: Iterable[float], workers: int) -> float:
    """Compute the seconds until jobs of given seconds are done, the longest begun first by whoever is free."""
    busy = [0.0] * workers
    for job in sorted(jobs, reverse=True):
        heapq.heapreplace(busy, busy[0] + job)
    return max(busy)


def training_rows(data: Path | None, rows: int, seed: int) -> tuple[Dataset, str]:
    """Gather as many type-faithful grasps as asked, every one a success.

    Args:
        data: folder of a dataset whose successes are drawn with replacement; None draws from the shipped cascade,
            all cells evenly, and takes what it gives for held.
        rows: how many.
        seed: seed of the draws.

    Returns:
        The rows and, in words, where they are from.

    Raises:
        InputError: the dataset has no type-faithful grasps.
    """
    rng = np.random.default_rng(seed)
    if data is not None:
        dataset = load_dataset(data)
        good = np.flatnonzero(dataset.outcomes.faithful(dataset.grasps))
        if not good.size:
            raise InputError(f"{data} holds no type-faithful grasps to train on")
        chosen = rng.choice(good, rows)
        source = f"type-faithful grasps of a dataset, drawn with replacement from {len(good)}"
        return Dataset(dataset.grasps[chosen], dataset.outcomes[chosen], dataset.metadata), source
    sampler = GraspSampler.pretrained()
    each = -(-rows // len(CELLS))
    order = np.arange(each * len(CELLS)).reshape(len(CELLS), each).T.ravel()[:rows]
    grasps = sampler.propose(draw_tasks(CELLS, each, sampler.hand.reach_m, rng)[order], rng)
    blank = Outcomes.blank(rows, len(grasps.joint_names), tuple(sampler.hand.digits))
    outcomes = replace(
        blank,
        verdict=np.full(rows, "held"),
        touching_closed=np.ones_like(blank.touching_closed),
        touching_end=np.ones_like(blank.touching_end),
        settled_posture=grasps.posture,
        X_hand_object_settled=grasps.X_hand_object,
        object_size_m=grasps.object_size_m,
    )
    return Dataset(grasps, outcomes, {"protocol": {"name": PAPER.name}}), "samples of the shipped cascade"


def training(
    hand: Hand,
    dataset: Dataset,
    *,
    epochs_measured: int = 3,
    full: bool = False,
    workers: int = 1,
    tell: Tell = lambda _: None,
) -> dict[str, Any]:
    """Time the training of a cascade on rows that are all successes.

    Unless `full`, only `epochs_measured` epochs are trained, and the others are taken to last as long each.

    Args:
        hand: the hand that the rows are of.
        dataset: the rows.
        epochs_measured: epochs to train, at least 2.
        full: train to the end instead.
        workers: processes; more than there are stages have nothing to do.
        tell: hears how far it is.
    """
    config, chosen = CascadeTraining(), factorization(FACTORIZATION)
    # The yardstick is shared among those who train, not among all who could.
    workers = min(workers, len(chosen.stages))
    specs = stage_specs(hand, dataset, chosen, config)
    epochs, batches = planned_epochs(config.training, len(dataset.grasps))
    full = full or epochs <= epochs_measured

    def yardstick() -> float:
        return products_seconds(specs, config.training, workers) * batches * epochs

    tell("yardstick")
    before = yardstick()
    loop = config.training if full else replace(config.training, epochs=epochs_measured, max_steps=0)
    run = _fit(hand, dataset, chosen, replace(config, training=loop), workers, tell)
    tell("yardstick")
    products = (before + yardstick()) / 2
    seconds = run.seconds if full else run.extrapolated(epochs, workers)
    return {
        "factorization": chosen.name,
        "rows": len(dataset.grasps),
        "batch_size": config.training.batch_size,
        "workers": workers,
        "threads_per_worker": config.training.threads,
        "epochs": epochs,
        "epochs_measured": run.epochs,
        "measured_s": run.seconds,
        "epoch_s": run.epoch_s,
        "extrapolated": not full,
        "s": seconds,
        "yardstick": "matrix products of all stages' networks, forward and backward (three times the forward ones), "
        "same batches, threads and steps, shared evenly among the workers",
        "yardstick_s": products,
        "ratio": seconds / products,
    }


def planned_epochs(training: TrainingSpec, rows: int) -> tuple[int, int]:
    """Count a full training's epochs, and the batches of each, on so many rows."""
    kept = rows - round(training.validation_fraction * rows)
    batches = kept // min(training.batch_size, kept)
    return training.epochs_of(batches), batches


def stage_specs(hand: Hand, dataset: Dataset, chosen: Factorization, config: CascadeTraining) -> list[VaeSpec]:
    """Describe the network of each stage, as fitting builds it."""
    few = slice(0, min(len(dataset.grasps), 200))
    part = Dataset(dataset.grasps[few], dataset.outcomes[few], dataset.metadata)
    prepared = prepare(hand, part, chosen, config)
    return [StageJob.of(prepared, stage, config).spec for stage in chosen.stages]


@dataclass(frozen=True)
class ProductsJob:
    """Time the matrix products of networks' training steps; picklable, so that every worker can do it at once."""

    specs: tuple[VaeSpec, ...]
    training: TrainingSpec
    steps: int

    def __call__(self, _: Callable[[Any], None]) -> float:
        """Measure the seconds of one step of every network, the median of all steps."""
        import torch  # an optional extra

        threads = torch.get_num_threads()
        torch.set_num_threads(self.training.threads)
        try:
            with torch.no_grad():
                return self._measure()
        finally:
            torch.set_num_threads(threads)

    def _measure(self) -> float:
        import torch

        widths = [w for spec in self.specs for w in (spec.encoder_widths, spec.decoder_widths)]
        layers = [torch.randn(pair) for w in widths for pair in pairwise(w)]
        inputs = [torch.randn(self.training.batch_size, layer.shape[0]) for layer in layers]
        outputs = [torch.empty(self.training.batch_size, layer.shape[1]) for layer in layers]
        seconds = []
        for _ in range(self.steps):
            begun = time.perf_counter()
            for _ in range(_FORWARD_AND_BACKWARD):
                for given, layer, out in zip(inputs, layers, outputs, strict=True):
                    torch.mm(given, layer, out=out)
            seconds.append(time.perf_counter() - begun)
        return float(np.median(seconds))


def products_seconds(specs: list[VaeSpec], training: TrainingSpec, workers: int) -> float:
    """Time the products of one step of every stage, with all workers busy, and share them among the workers."""
    jobs = [ProductsJob(tuple(specs), training, _YARDSTICK_STEPS)] * workers
    return float(np.mean(run_jobs(jobs, workers))) / workers


def _fit(
    hand: Hand, dataset: Dataset, chosen: Factorization, config: CascadeTraining, workers: int, tell: Tell
) -> Timed:
    records: dict[str, list[EpochRecord]] = {}

    def progress(stage: str, record: EpochRecord) -> None:
        records.setdefault(stage, []).append(record)
        tell(f"{sum(map(len, records.values()))} of {len(chosen.stages) * record.epochs} epochs")

    begun = time.perf_counter()
    fit_cascade(hand, dataset, chosen, config, progress, workers)
    seconds = time.perf_counter() - begun
    each = {stage: (of[-1].seconds - of[0].seconds) / max(len(of) - 1, 1) for stage, of in records.items()}
    return Timed(seconds, len(records[chosen.stages[0].name]), each)
