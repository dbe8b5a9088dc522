"""Output blocks of a decoder as data: what each stretch of the target is and how its error is measured (numpy only).

A model's target is the concatenation of its heads' blocks, for instance posture (22), position (3), rotation (4).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError, check_name

Array = NDArray[np.float64]
HeadKind = Literal["gaussian", "vmf", "vmf_mixture", "unit"]
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
    plain unit vector."""
    dim: int
    """Columns of the target: any for gaussian, 4 (a wxyz quaternion) for rotations."""
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
        """Tell whether the block is a quaternion, which is never standardised."""
        return self.kind != "gaussian"

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
