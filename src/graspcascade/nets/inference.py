"""Sampling from trained decoders with numpy alone: no torch where grasps are wanted in milliseconds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError, unknown
from . import vmf
from .fitted import Array, Array32, Fitted, Standardisation
from .heads import HeadSpec, concentration, normalised
from .specs import VaeSpec

Mode = Literal["sample", "mean"]


@dataclass(frozen=True, eq=False)
class Layer:
    """Hold one linear layer: `matrix` ``(inputs, outputs)``, contiguous, and `bias` ``(outputs,)``, float32."""

    matrix: Array32
    bias: Array32


@dataclass(frozen=True, eq=False)
class NumpyDecoder:
    """Sample p(x|c) of a trained conditional VAE."""

    spec: VaeSpec
    standardisation: Standardisation
    layers: tuple[Layer, ...]

    @classmethod
    def from_fitted(cls, fitted: Fitted) -> NumpyDecoder:
        """Take the decoder of a trained model."""
        return cls.from_arrays(fitted.spec, fitted.standardisation, fitted.weights)

    @classmethod
    def from_arrays(
        cls, spec: VaeSpec, standardisation: Standardisation, weights: Mapping[str, NDArray[np.generic]]
    ) -> NumpyDecoder:
        """Build a decoder from arrays by torch's names ("decoder.0.weight", "decoder.0.bias", "decoder.2.weight", ...).

        Raises:
            InputError: an array is missing, has another shape than the spec asks, or is not finite.
        """
        widths = spec.decoder_widths
        layers = []
        for index, (inputs, outputs) in enumerate(pairwise(widths)):
            matrix = _array(weights, _name(index, "weight"), (outputs, inputs))
            bias = _array(weights, _name(index, "bias"), (outputs,))
            layers.append(Layer(np.ascontiguousarray(matrix.T), bias))
        return cls(spec, standardisation, tuple(layers))

    def arrays(self) -> dict[str, Array32]:
        """Give the weights by torch's names, the inverse of `from_arrays`."""
        named: dict[str, Array32] = {}
        for index, layer in enumerate(self.layers):
            named[_name(index, "weight")] = np.ascontiguousarray(layer.matrix.T)
            named[_name(index, "bias")] = layer.bias
        return named

    def decode(self, z: ArrayLike, c: ArrayLike) -> Array32:
        """Give the raw outputs ``(n, output_dim)`` that the heads read, still standardised.

        Args:
            z: ``(n, latent_dim)`` latent vectors.
            c: ``(n, condition_dim)`` conditions in natural units.

        Raises:
            InputError: a shape does not fit.
        """
        z, c = np.asarray(z, dtype=np.float32), np.asarray(c)
        if z.ndim != 2 or z.shape[1] != self.spec.latent_dim:
            raise InputError(f"z must have shape (n, {self.spec.latent_dim}), got {z.shape}")
        if c.shape != (len(z), self.spec.condition_dim):
            raise InputError(f"c must have shape ({len(z)}, {self.spec.condition_dim}), got {c.shape}")
        hidden = np.concatenate([z, self.standardisation.standardise_c(c)], axis=1)
        for layer in self.layers[:-1]:
            hidden = hidden @ layer.matrix
            hidden += layer.bias
            np.maximum(hidden, 0.0, out=hidden)
        output: Array32 = hidden @ self.layers[-1].matrix
        output += self.layers[-1].bias
        return output

    def sample(
        self, c: ArrayLike, rng: np.random.Generator, *, temperature: float = 1.0, mode: Mode = "sample"
    ) -> Array:
        """Draw one target per condition row, z ~ N(0, temperature^2 I).

        Args:
            c: ``(n, condition_dim)`` conditions in natural units.
            rng: source of all randomness.
            temperature: scale of the latent noise; 0 gives the decoder's centre.
            mode: whether vmf heads draw a rotation about their mean or give the mean; other heads always give theirs.

        Returns:
            ``(n, target_dim)`` in natural units; quaternions are unit, of either sign.

        Raises:
            InputError: the shape of `c` does not fit, the temperature is negative or the mode unknown.
        """
        if mode not in get_args(Mode):
            raise unknown("sampling mode", mode, get_args(Mode))
        if not 0.0 <= temperature < np.inf:
            raise InputError(f"temperature must be finite and not negative, got {temperature}")
        c = np.asarray(c)
        if c.ndim != 2:
            raise InputError(f"c must have shape (n, {self.spec.condition_dim}), got {c.shape}")
        z = rng.standard_normal((len(c), self.spec.latent_dim), dtype=np.float32) * np.float32(temperature)
        output = self.decode(z, c)
        x = np.empty((len(c), self.spec.target_dim))
        for block in self.spec.blocks:
            x[:, block.target] = _read(block.head, output[:, block.output], rng, mode)
        return self.standardisation.restore_x(x)


def _read(head: HeadSpec, raw: Array32, rng: np.random.Generator, mode: Mode) -> ArrayLike:
    """Turn one head's raw outputs ``(n, outputs)`` into its block of the target ``(n, dim)``."""
    if head.kind == "gaussian":
        return raw
    direction = normalised(raw[:, :4])
    if head.kind == "unit" or mode == "mean":
        return direction
    return vmf.sample(direction, concentration(raw[:, 4]), rng)


def _name(layer: int, part: str) -> str:
    """Name an array as torch does, whose even modules are linear and odd ones ReLU."""
    return f"decoder.{2 * layer}.{part}"


def _array(weights: Mapping[str, NDArray[np.generic]], name: str, shape: tuple[int, ...]) -> Array32:
    if name not in weights:
        raise InputError(f"the array {name!r} is missing")
    array = np.asarray(weights[name], dtype=np.float32)
    if array.shape != shape:
        raise InputError(f"the array {name!r} has shape {array.shape}, its spec asks {shape}")
    if not np.isfinite(array).all():
        raise InputError(f"the array {name!r} holds values that are not finite")
    return array
