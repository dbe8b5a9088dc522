"""Training rows held in memory: checked, standardised, gathered by index (torch)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from ..errors import InputError
from .fitted import Array32, Standardisation
from .specs import VaeSpec
from .vae import ConditionalVae, Losses


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
    _check_rotations(spec, targets)
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


def _check_rotations(spec: VaeSpec, targets: Array32) -> None:
    for block in spec.blocks:
        norms = np.linalg.norm(targets[:, block.target], axis=1)
        if block.head.is_rotation and np.abs(norms - 1.0).max() > 1e-3:
            first, last = block.target.start, block.target.stop - 1
            raise InputError(f"columns {first} to {last} of x must be unit quaternions")


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
