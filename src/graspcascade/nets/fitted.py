"""What training leaves behind: standardisation, weights and history, as numpy records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .heads import layout
from .specs import TrainingSpec, VaeSpec

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

# A column that varies less is constant: in metres or radians this is far below anything measured.
STD_FLOOR = 1e-6


@dataclass(frozen=True, eq=False)
class Standardisation:
    """Map targets x and conditions c between natural units and zero mean, unit deviation per column.

    Attributes:
        x_mean, x_std: ``(target_dim,)``; 0 and 1 in rotation blocks, which stay quaternions.
        c_mean, c_std: ``(condition_dim,)``.
    """

    x_mean: Array
    x_std: Array
    c_mean: Array
    c_std: Array

    @classmethod
    def of(cls, spec: VaeSpec, x: ArrayLike, c: ArrayLike) -> Standardisation:
        """Measure the columns of targets ``(n, target_dim)`` and conditions ``(n, condition_dim)``."""
        x, c = np.asarray(x), np.asarray(c)
        x_mean, x_std = x.mean(axis=0, dtype=np.float64), x.std(axis=0, dtype=np.float64)
        for block in layout(spec.heads):
            if block.head.is_rotation:
                x_mean[block.target], x_std[block.target] = 0.0, 1.0
        c_mean, c_std = c.mean(axis=0, dtype=np.float64), c.std(axis=0, dtype=np.float64)
        # A constant condition says nothing: unit scale keeps a new value of it from swamping the others.
        return cls(x_mean, np.maximum(x_std, STD_FLOOR), c_mean, np.where(c_std < STD_FLOOR, 1.0, c_std))

    def standardise_x(self, x: ArrayLike) -> Array32:
        """Bring targets ``(n, target_dim)`` from natural units to the network's."""
        return ((np.asarray(x) - self.x_mean) / self.x_std).astype(np.float32)

    def standardise_c(self, c: ArrayLike) -> Array32:
        """Bring conditions ``(n, condition_dim)`` from natural units to the network's."""
        return ((np.asarray(c) - self.c_mean) / self.c_std).astype(np.float32)

    def restore_x(self, x: ArrayLike) -> Array:
        """Bring targets ``(n, target_dim)`` from the network's units back to natural ones."""
        return np.asarray(x, dtype=np.float64) * self.x_std + self.x_mean


@dataclass(frozen=True)
class EpochRecord:
    """Report one epoch: means per row, the divergence at its full weight in `validation_loss`.

    Attributes:
        epoch: counted from 1.
        epochs: how many there will be.
        train_loss, train_reconstruction, train_kl: over the epoch's batches, as optimised (divergence warming up).
        validation_loss: of the averaged weights on the held-out rows; None without held-out rows.
        seconds: since training began.
    """

    epoch: int
    epochs: int
    learning_rate: float
    train_loss: float
    train_reconstruction: float
    train_kl: float
    validation_loss: float | None
    seconds: float


@dataclass(frozen=True, eq=False)
class Fitted:
    """Hold a trained model.

    Attributes:
        weights: averaged float32 arrays by torch's names ("encoder.0.weight", "decoder.2.bias", ...).
        history: one record per epoch.
    """

    spec: VaeSpec
    training: TrainingSpec
    standardisation: Standardisation
    weights: Mapping[str, Array32]
    history: tuple[EpochRecord, ...]
