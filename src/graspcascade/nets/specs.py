"""Configuration of a model and of its training, as data (no torch: command lines and stored files read these)."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import InputError
from .heads import Block, HeadSpec, layout

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
    """Length of the latent vector z."""
    hidden: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of the encoder and of the decoder."""
    kl_weight: float = 0.05
    """Weight of the divergence of q(z|x,c) from N(0, I), against errors summed over the target's columns."""

    def __post_init__(self) -> None:
        if not self.heads:
            raise InputError("a model needs at least one head")
        if self.condition_dim < 0 or self.latent_dim < 1 or any(width < 1 for width in self.hidden):
            raise InputError(
                f"a model needs condition_dim >= 0, latent_dim >= 1 and positive hidden widths, "
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
    """Passes over the training rows; fewer where so many would take more than the maximum of steps."""
    max_steps: int = 0
    """Most optimiser steps to take, whole passes and at least one; 0 for no maximum."""
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
            if not getattr(self, name) >= 1:
                raise InputError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("learning_rate", "final_learning_rate", "max_gradient_norm"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("weight_decay", "metric_weight", "max_steps", "seed"):
            if not getattr(self, name) >= 0.0:
                raise InputError(f"{name} must not be negative, got {getattr(self, name)}")
        if self.seed > _MAX_SEED:
            raise InputError(f"seed must be at most {_MAX_SEED}, got {self.seed}")
        for name in ("kl_warmup_fraction", "averaging_fraction", "validation_fraction"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise InputError(f"{name} must be in [0, 1), got {getattr(self, name)}")

    def epochs_of(self, batches: int) -> int:
        """Count the passes over rows that make so many batches."""
        return min(self.epochs, max(1, self.max_steps // batches)) if self.max_steps else self.epochs
