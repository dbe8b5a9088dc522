"""The one training loop (torch)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor
from torch.optim.swa_utils import get_ema_multi_avg_fn

from ..core.errors import InputError
from .specs import Array32, EpochRecord, Fitted, Standardisation, TrainingSpec, VaeSpec
from .vae import ConditionalVae, Losses


def fit(
    spec: VaeSpec,
    training: TrainingSpec,
    x: ArrayLike,
    c: ArrayLike,
    metric: ArrayLike | None = None,
    progress: Callable[[EpochRecord], None] | None = None,
) -> Fitted:
    """Train a conditional VAE on rows held in memory, repeatably: equal arguments give equal weights on a machine.

    Args:
        spec: the model.
        training: the run.
        x: ``(n, target_dim)`` targets in natural units, rotation blocks as unit quaternions.
        c: ``(n, condition_dim)`` conditions in natural units.
        metric: ``(n, k, d)`` matrices acting on natural-unit errors of the first head (dim d), weighted by
            ``training.metric_weight``.
        progress: called after each epoch.

    Raises:
        InputError: a shape does not fit the spec, a value is not finite, or too few rows are left to train on.
        FloatingPointError: the loss stopped being finite.
    """
    rows, standardisation = standardised_rows(spec, x, c, metric if training.metric_weight > 0.0 else None)
    with _own_torch(training):
        run = _Run.start(spec, training, rows)
        history = tuple(run.epochs(progress))
    weights = {name: tensor.numpy().copy() for name, tensor in run.averaged.state_dict().items()}
    return Fitted(spec, training, standardisation, weights, history)


@contextmanager
def _own_torch(training: TrainingSpec) -> Iterator[None]:
    """Seed torch and set its threads, leaving the caller's random state and thread count as they were."""
    threads = torch.get_num_threads()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(training.seed)
        torch.set_num_threads(training.threads)
        try:
            yield
        finally:
            torch.set_num_threads(threads)


@dataclass
class _Run:
    """Hold the moving parts of one training run."""

    training: TrainingSpec
    rows: Rows
    model: ConditionalVae
    averaged: ConditionalVae
    optimiser: torch.optim.AdamW
    train_rows: Tensor
    validation_rows: Tensor
    batch_size: int
    step: int = 0

    @classmethod
    def start(cls, spec: VaeSpec, training: TrainingSpec, rows: Rows) -> _Run:
        model, averaged = ConditionalVae(spec), ConditionalVae(spec)
        averaged.load_state_dict(model.state_dict())
        averaged.requires_grad_(False)
        shuffled = torch.randperm(len(rows))
        held_out = round(training.validation_fraction * len(shuffled))
        if len(shuffled) - held_out < 1:
            raise InputError(f"no rows are left to train on: {len(shuffled)} given, {held_out} held out")
        rate, decay = training.learning_rate, training.weight_decay
        optimiser = torch.optim.AdamW(model.parameters(), lr=rate, weight_decay=decay, fused=True)
        batch_size = min(training.batch_size, len(shuffled) - held_out)
        return cls(
            training, rows, model, averaged, optimiser, shuffled[held_out:], shuffled[:held_out], batch_size=batch_size
        )

    @property
    def batches(self) -> int:
        return len(self.train_rows) // self.batch_size

    @property
    def n_epochs(self) -> int:
        return self.training.epochs_of(self.batches)

    @property
    def steps(self) -> int:
        return self.n_epochs * self.batches

    def epochs(self, progress: Callable[[EpochRecord], None] | None) -> Iterator[EpochRecord]:
        begun = time.perf_counter()
        for epoch in range(1, self.n_epochs + 1):
            total, reconstruction, kl = self.train_epoch()
            if not math.isfinite(total):
                raise FloatingPointError(f"training diverged in epoch {epoch}: loss {total}; lower the learning rate")
            record = EpochRecord(
                epoch=epoch,
                epochs=self.n_epochs,
                learning_rate=self.optimiser.param_groups[0]["lr"],
                train_loss=total,
                train_reconstruction=reconstruction,
                train_kl=kl,
                validation_loss=self.validate() if len(self.validation_rows) else None,
                seconds=time.perf_counter() - begun,
            )
            if progress is not None:
                progress(record)
            yield record

    def train_epoch(self) -> tuple[float, float, float]:
        order = self.train_rows[torch.randperm(len(self.train_rows))]
        sums = torch.zeros(3)
        for batch in range(self.batches):
            sums += self.train_step(order[batch * self.batch_size : (batch + 1) * self.batch_size])
        total, reconstruction, kl = (sums / self.batches).tolist()
        return total, reconstruction, kl

    def train_step(self, chosen: Tensor) -> Tensor:
        spec, done = self.training, self.step / max(self.steps - 1, 1)
        cosine = 0.5 * (1.0 + math.cos(math.pi * done))
        rate = spec.final_learning_rate + (spec.learning_rate - spec.final_learning_rate) * cosine
        self.optimiser.param_groups[0]["lr"] = rate
        kl_scale = min(1.0, done / spec.kl_warmup_fraction) if spec.kl_warmup_fraction else 1.0
        losses = self.rows.loss(self.model, chosen, spec.metric_weight, kl_scale)
        self.optimiser.zero_grad()
        losses.total.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), spec.max_gradient_norm)
        self.optimiser.step()
        self.average()
        self.step += 1
        return torch.stack(losses).detach()

    def average(self) -> None:
        towards = 1.0 / max(1.0, self.training.averaging_fraction * self.steps)
        average = get_ema_multi_avg_fn(1.0 - towards)  # type: ignore[no-untyped-call]
        average(list(self.averaged.parameters()), list(self.model.parameters()), None)

    @torch.no_grad()
    def validate(self) -> float:
        """Measure the held-out rows, with the same latent noise every epoch so that epochs compare."""
        total = 0.0
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.training.seed)
            for begin in range(0, len(self.validation_rows), self.batch_size):
                chosen = self.validation_rows[begin : begin + self.batch_size]
                losses = self.rows.loss(self.averaged, chosen, self.training.metric_weight)
                total += float(losses.total) * len(chosen)
        return total / len(self.validation_rows)


@dataclass(frozen=True)
class Rows:
    """Hold standardised rows.

    Attributes:
        x, c: ``(n, target_dim)`` and ``(n, condition_dim)``.
        metric: ``(n, k, d)`` for natural-unit errors of the first head, or None.
        unit: ``(d,)`` natural units per standardised one of the first head. It scales the errors and not the metrics,
            which are by far the largest array.
    """

    x: Tensor
    c: Tensor
    metric: Tensor | None
    unit: Tensor

    def __len__(self) -> int:
        return len(self.x)

    def loss(self, model: ConditionalVae, chosen: Tensor, metric_weight: float, kl_scale: float = 1.0) -> Losses:
        """Measure a model on the rows of index `chosen`."""
        x, c = self.x.index_select(0, chosen), self.c.index_select(0, chosen)
        metric = None if self.metric is None else self.metric.index_select(0, chosen)
        return model.loss(x, c, metric, metric_weight, kl_scale, self.unit)


def standardised_rows(
    spec: VaeSpec, x: ArrayLike, c: ArrayLike, metric: ArrayLike | None
) -> tuple[Rows, Standardisation]:
    """Check rows in natural units and standardise them; see `training.fit` for shapes and errors."""
    targets, conditions = _checked("x", x, spec.target_dim), _checked("c", c, spec.condition_dim)
    if len(targets) != len(conditions):
        raise InputError(f"x and c must have as many rows, got {len(targets)} and {len(conditions)}")
    _check_blocks(spec, targets)
    standardisation = Standardisation.of(spec, targets, conditions)
    rows = Rows(
        torch.from_numpy(standardisation.standardise_x(targets)),
        torch.from_numpy(standardisation.standardise_c(conditions)),
        None if metric is None else torch.from_numpy(_checked_metric(spec, metric, len(targets))),
        torch.from_numpy(standardisation.x_std[: spec.heads[0].dim].astype(np.float32)),
    )
    return rows, standardisation


def _checked(name: str, values: ArrayLike, columns: int) -> Array32:
    array = np.asarray(values, dtype=np.float32)
    if array.ndim != 2 or array.shape[1] != columns or not len(array):
        raise InputError(f"{name} must have shape (n, {columns}) with n > 0, got {array.shape}")
    finite = np.isfinite(array).all(axis=0)
    if not finite.all():
        raise InputError(f"column {int(np.argmin(finite))} of {name} holds values that are not finite")
    return array


def _check_blocks(spec: VaeSpec, targets: Array32) -> None:
    for block in spec.blocks:
        norms = np.linalg.norm(targets[:, block.target], axis=1)
        first, last = block.target.start, block.target.stop - 1
        if block.head.is_rotation and np.abs(norms - 1.0).max() > 1e-3:
            raise InputError(f"columns {first} to {last} of x must be unit quaternions")
        if block.head.kind == "chance" and not np.isin(targets[:, block.target], (0.0, 1.0)).all():
            raise InputError(f"columns {first} to {last} of x must be 0 or 1")


def _checked_metric(spec: VaeSpec, metric: ArrayLike, rows: int) -> Array32:
    array: Array32 = np.require(metric, dtype=np.float32, requirements=["C", "W"])
    head = spec.heads[0]
    if head.kind != "gaussian" or array.ndim != 3 or (array.shape[0], array.shape[2]) != (rows, head.dim):
        raise InputError(
            f"a metric needs a gaussian first head and shape ({rows}, k, {head.dim}), "
            f"got {array.shape} on a {head.kind} head"
        )
    if not np.isfinite(array).all():
        raise InputError("the metric holds values that are not finite")
    return array
