"""What a model is and how it is trained, as data, and what training leaves behind (numpy only).

A model's target is the concatenation of its heads' blocks, for instance posture (22), position (3), rotation (4).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.errors import InputError, check_name, check_whole

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
HeadKind = Literal["gaussian", "vmf", "vmf_mixture", "unit", "chance"]
MIXTURE_COMPONENTS = 4
"""Components of a vmf_mixture head."""

# Keeps the density proper and its gradient alive where the network asks for no concentration at all.
KAPPA_FLOOR = 1e-3
# About 1 degree of rotation: finer than any grasp needs, and without a bound a decoder that reconstructs its
# training rotations exactly would raise its likelihood for ever.
KAPPA_MAX = 1e4
LOG_KAPPA_MAX = math.log(KAPPA_MAX)


@dataclass(frozen=True)
class HeadSpec:
    """Describe one block of the target.

    Raises:
        InputError: an unknown kind, a dimension the kind cannot have, or a weight that is not positive.
    """

    kind: HeadKind
    """gaussian: mean of standardised columns; vmf: von Mises-Fisher rotation; vmf_mixture: a mixture of these; unit:
    plain unit vector; chance: probabilities of events that happened (1) or not (0)."""
    dim: int
    """Columns of the target: any for gaussian and chance, 4 (a wxyz quaternion) for rotations."""
    weight: float = 1.0
    """Factor on this block's loss."""

    def __post_init__(self) -> None:
        check_name("head kind", self.kind, get_args(HeadKind))
        if self.dim < 1 or (self.is_rotation and self.dim != 4):
            raise InputError(f"a {self.kind} head has dim {'4' if self.is_rotation else '>= 1'}, got {self.dim}")
        if not 0.0 < self.weight < np.inf:
            raise InputError(f"a head's weight must be positive and finite, got {self.weight}")

    @property
    def is_rotation(self) -> bool:
        """Tell whether the block is a quaternion."""
        return self.kind not in ("gaussian", "chance")

    @property
    def outputs(self) -> int:
        """Count the decoder outputs.

        One per column, and the concentration of a vmf head; a mixture has as many of each component, then the logits of
        their weights.
        """
        if self.kind == "vmf_mixture":
            return MIXTURE_COMPONENTS * (self.dim + 2)
        return self.dim + (self.kind == "vmf")


@dataclass(frozen=True)
class Block:
    """Place one head in the target's columns and in the decoder's outputs."""

    head: HeadSpec
    target: slice
    output: slice


def layout(heads: Iterable[HeadSpec]) -> tuple[Block, ...]:
    """Place heads one after the other."""
    blocks: list[Block] = []
    column, output = 0, 0
    for head in heads:
        blocks.append(Block(head, slice(column, column + head.dim), slice(output, output + head.outputs)))
        column, output = column + head.dim, output + head.outputs
    return tuple(blocks)


def concentration(raw: ArrayLike) -> Array:
    """Map raw decoder outputs of any shape to concentrations between KAPPA_FLOOR and KAPPA_FLOOR + KAPPA_MAX.

    Exponential far below the bound and bending smoothly into it: concentrations differ by orders of magnitude, which
    a network reaches in few steps on a log scale only, and a hard bound would hold whatever once ran into it.
    """
    shifted = np.asarray(raw, dtype=np.float64) - LOG_KAPPA_MAX
    kappa: Array = KAPPA_FLOOR + KAPPA_MAX * np.exp(-np.logaddexp(0.0, -shifted))
    return kappa


def components(raw: Any) -> tuple[Any, Any]:
    """Divide the raw outputs ``(n, outputs)`` of a mixture, an array or a tensor.

    Returns:
        Each component's direction and raw concentration ``(n, MIXTURE_COMPONENTS, 5)``, and the logits of their weights
        ``(n, MIXTURE_COMPONENTS)``.
    """
    split = 5 * MIXTURE_COMPONENTS
    return raw[:, :split].reshape(len(raw), MIXTURE_COMPONENTS, 5), raw[:, split:]


def normalised(vectors: ArrayLike) -> Array:
    """Scale ``(n, 4)`` vectors to unit length."""
    vectors = np.asarray(vectors, dtype=np.float64)
    norm = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))[:, None]
    unit: Array = vectors / np.maximum(norm, 1e-12)
    return unit


_MAX_SEED = 2**64 - 1
"""Largest seed that torch takes."""


@dataclass(frozen=True)
class VaeSpec:
    """Describe a conditional variational autoencoder.

    Raises:
        InputError: no heads, or a size or weight out of range.
    """

    condition_dim: int
    """Columns of the condition c."""
    heads: tuple[HeadSpec, ...]
    """Blocks of the target x, in order."""
    latent_dim: int = 8
    """Length of the latent vector z; with 0 the target is a function of the condition, as chances are."""
    hidden: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of the encoder and of the decoder."""
    kl_weight: float = 0.05
    """Weight of the divergence of q(z|x,c) from N(0, I), against errors summed over the target's columns."""

    def __post_init__(self) -> None:
        if not self.heads:
            raise InputError("a model needs at least one head")
        if self.condition_dim < 0 or self.latent_dim < 0 or any(width < 1 for width in self.hidden):
            raise InputError(
                f"a model needs condition_dim >= 0, latent_dim >= 0 and positive hidden widths, "
                f"got {self.condition_dim}, {self.latent_dim}, {self.hidden}"
            )
        if not 0.0 <= self.kl_weight < float("inf"):
            raise InputError(f"kl_weight must be finite and not negative, got {self.kl_weight}")

    @property
    def target_dim(self) -> int:
        """Count the columns of the target x."""
        return sum(head.dim for head in self.heads)

    @property
    def output_dim(self) -> int:
        """Count the raw outputs of the decoder."""
        return sum(head.outputs for head in self.heads)

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Place each head in the target and in the outputs."""
        return layout(self.heads)

    @property
    def decoder_widths(self) -> tuple[int, ...]:
        """List the decoder's layer widths, from its input (z, c) to its raw outputs."""
        return (self.latent_dim + self.condition_dim, *self.hidden, self.output_dim)

    @property
    def encoder_widths(self) -> tuple[int, ...]:
        """List the encoder's layer widths, from its input (x, c) to the mean and log variance of z."""
        return (self.target_dim + self.condition_dim, *self.hidden, 2 * self.latent_dim)


@dataclass(frozen=True)
class TrainingSpec:
    """Describe one training run.

    Raises:
        InputError: a value out of range.
    """

    epochs: int = 100
    """Passes over the training rows, unless they make fewer steps than `min_steps` or more than `max_steps`."""
    min_steps: int = 0
    """Fewest optimiser steps to take, in whole passes: few rows are passed over more often."""
    max_steps: int = 0
    """Most optimiser steps to take, in whole passes and at least one; 0 for no maximum."""
    batch_size: int = 4096
    """Rows per step; a last partial batch is left for the next shuffle."""
    learning_rate: float = 2e-3
    """Learning rate of AdamW at the start."""
    final_learning_rate: float = 2e-5
    """Learning rate at the end, reached along a cosine."""
    weight_decay: float = 1e-4
    """Decoupled weight decay of AdamW."""
    max_gradient_norm: float = 100.0
    """Norm to which larger gradients are shortened; one far rotation under a sharp head would upset the rest."""
    kl_warmup_fraction: float = 0.1
    """Share of the run over which the divergence's weight rises from zero, so that the latent is put to use."""
    metric_weight: float = 0.0
    """Weight of the squared metric error (fingertips moved by joint errors, for instance); 0 ignores the metric."""
    averaging_fraction: float = 0.02
    """Share of the run over which the final weights are averaged, exponentially."""
    validation_fraction: float = 0.05
    """Share of the rows held out to measure the loss on; 0 trains on all."""
    seed: int = 0
    """Seed of initial weights, shuffles, latent noise and the held-out rows."""
    threads: int = 1
    """Threads to compute with; another count rounds differently. On a busy machine more than one is far slower."""

    def __post_init__(self) -> None:
        for name in ("epochs", "batch_size", "threads"):
            check_whole(name, getattr(self, name), 1)
        for name in ("min_steps", "max_steps"):
            check_whole(name, getattr(self, name), most=10**9)
        check_whole("seed", self.seed, most=_MAX_SEED)
        for name in ("learning_rate", "final_learning_rate", "max_gradient_norm"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("weight_decay", "metric_weight"):
            if not getattr(self, name) >= 0.0:
                raise InputError(f"{name} must not be negative, got {getattr(self, name)}")
        if 0 < self.max_steps < self.min_steps:
            raise InputError(f"max_steps must be at least min_steps, got {self.max_steps} and {self.min_steps}")
        for name in ("kl_warmup_fraction", "averaging_fraction", "validation_fraction"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise InputError(f"{name} must be in [0, 1), got {getattr(self, name)}")

    def epochs_of(self, batches: int) -> int:
        """Count the passes over rows that make so many batches."""
        passes = max(self.epochs, -(-self.min_steps // batches))
        return min(passes, max(1, self.max_steps // batches)) if self.max_steps else passes


# A column that varies less is constant: in metres or radians this is far below anything measured.
STD_FLOOR = 1e-6


@dataclass(frozen=True, eq=False)
class Standardisation:
    """Map targets x and conditions c between natural units and zero mean, unit deviation per column.

    Attributes:
        x_mean, x_std: ``(target_dim,)``; 0 and 1 outside gaussian blocks: quaternions and chances stay what they are.
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
            if block.head.kind != "gaussian":
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
