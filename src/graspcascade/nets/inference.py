"""Sampling from trained decoders with numpy alone, and their storage in one safetensors file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ..core.errors import FileFormatError, InputError, check_name
from ..core.files import parse_json, write_staged
from . import vmf
from .specs import Array, Array32, Fitted, HeadSpec, Standardisation, VaeSpec, components, concentration, normalised

Mode = Literal["sample", "mean"]


class Digest(Protocol):
    """Name the one method of a `hashlib` digest that is used."""

    def update(self, data: bytes, /) -> object:
        """Take more bytes into account."""
        ...


_BLOCK = 512
"""Fewest rows to take through the layers at a time: the hidden units of as many stay in cache, and the matrix products
of fewer may round otherwise than those of all rows at once."""


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
        layers = []
        for index, (inputs, outputs) in enumerate(pairwise(spec.decoder_widths)):
            matrix = _array(weights, _name(index, "weight"), (outputs, inputs))
            bias = _array(weights, _name(index, "bias"), (outputs,))
            layers.append(Layer(np.ascontiguousarray(matrix.T), bias))
        return cls(spec, standardisation, tuple(layers))

    def arrays(self) -> dict[str, Array32]:
        """List the weights by torch's names, the inverse of `from_arrays`."""
        named: dict[str, Array32] = {}
        for index, layer in enumerate(self.layers):
            named[_name(index, "weight")] = np.ascontiguousarray(layer.matrix.T)
            named[_name(index, "bias")] = layer.bias
        return named

    def digest_into(self, digest: Digest) -> None:
        """Feed the weights into a digest such as `hashlib.sha256()`."""
        arrays = self.arrays()
        for name in sorted(arrays):
            digest.update(name.encode() + arrays[name].tobytes())

    def decode(self, z: ArrayLike, c: ArrayLike) -> Array32:
        """Compute the raw outputs ``(n, output_dim)`` that the heads read, still standardised.

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
        return self.run(np.concatenate([z, self.standardisation.standardise_c(c)], axis=1))

    def run(self, inputs: Array32) -> Array32:
        """Take inputs of the first layer ``(n, inputs)``, z and c as it knows them, through all layers."""
        n = len(inputs)
        output = np.empty((n, self.spec.output_dim), dtype=np.float32)
        blocks = max(1, n // _BLOCK)
        # One piece of memory for all hidden units: several would be returned to the system and fetched again by every
        # call, which costs more than the additions do.
        room = np.empty((n // blocks + 1) * sum(self.spec.hidden), dtype=np.float32)
        *inner, last = self.layers
        for start, end in pairwise(n * number // blocks for number in range(blocks + 1)):
            hidden, used = inputs[start:end], 0
            for layer, width in zip(inner, self.spec.hidden, strict=True):
                size = (end - start) * width
                space = room[used : used + size].reshape(end - start, width)
                used += size
                hidden = np.matmul(hidden, layer.matrix, out=space)
                hidden += layer.bias
                np.maximum(hidden, 0.0, out=hidden)
            np.matmul(hidden, last.matrix, out=output[start:end])
        output += last.bias
        return output

    def fixing(self, columns: NDArray[np.bool_], values: ArrayLike) -> NumpyDecoder:
        """Make a decoder for rows that share some of their conditions.

        Their part of the first layer is then one row vector, added to its bias once instead of computed in every row.

        Args:
            columns: ``(condition_dim,)`` flags of the columns to fix.
            values: their values in natural units, ``(k,)`` for k flags set.

        Raises:
            InputError: a shape does not fit.
        """
        values = np.asarray(values)
        if columns.shape != (self.spec.condition_dim,) or values.shape != (np.count_nonzero(columns),):
            raise InputError(
                f"fixing conditions needs ({self.spec.condition_dim},) flags and a value for each that is set, "
                f"got flags {columns.shape} and values {values.shape}"
            )
        scaling, first = self.standardisation, self.layers[0]
        fixed, free = np.flatnonzero(columns), np.flatnonzero(~columns)
        standard = ((values - scaling.c_mean[fixed]) / scaling.c_std[fixed]).astype(np.float32)
        z = self.spec.latent_dim
        matrix = np.concatenate([first.matrix[:z], first.matrix[z + free]])
        return NumpyDecoder(
            replace(self.spec, condition_dim=len(free)),
            replace(scaling, c_mean=scaling.c_mean[free], c_std=scaling.c_std[free]),
            (Layer(matrix, first.bias + standard @ first.matrix[z + fixed]), *self.layers[1:]),
        )

    def unscaled(self) -> NumpyDecoder:
        """Make a decoder whose first layer takes conditions in natural units (see `run`): it scales them itself."""
        scaling, first = self.standardisation, self.layers[0]
        z = self.spec.latent_dim
        matrix = first.matrix.astype(np.float64)
        matrix[z:] /= scaling.c_std[:, None]
        bias = first.bias - scaling.c_mean @ matrix[z:]
        layer = Layer(matrix.astype(np.float32), bias.astype(np.float32))
        natural = replace(scaling, c_mean=np.zeros_like(scaling.c_mean), c_std=np.ones_like(scaling.c_std))
        return replace(self, standardisation=natural, layers=(layer, *self.layers[1:]))

    def sample(
        self, c: ArrayLike, rng: np.random.Generator, *, temperature: float = 1.0, mode: Mode = "sample"
    ) -> Array:
        """Draw one target per condition row, z ~ N(0, temperature^2 I).

        Args:
            c: ``(n, condition_dim)`` conditions in natural units.
            rng: source of all randomness.
            temperature: scale of the latent noise; 0 gives the decoder's centre.
            mode: whether vmf heads draw a rotation about their mean or give the mean (a mixture that of its heaviest
                component); other heads always give theirs.

        Returns:
            ``(n, target_dim)`` in natural units; quaternions are unit, of either sign.

        Raises:
            InputError: the shape of `c` does not fit, the temperature is negative or the mode unknown.
        """
        check_name("sampling mode", mode, get_args(Mode))
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
    if head.kind == "chance":
        return logistic(raw)
    if head.kind == "vmf_mixture":
        raw = _chosen_component(raw, rng, mode)
    direction = normalised(raw[:, :4])
    if head.kind == "unit" or mode == "mean":
        return direction
    return vmf.sample(direction, concentration(raw[:, 4]), rng)


def logistic(raw: Array32) -> Array32:
    """Turn raw outputs of a chance head into chances."""
    return np.asarray(np.exp(-np.logaddexp(0.0, -raw)))


def _chosen_component(raw: Array32, rng: np.random.Generator, mode: Mode) -> Array32:
    """Draw a component of each row's mixture by its weight, or take the heaviest, as outputs ``(n, 5)`` of one vmf."""
    parts, logits = components(raw)
    noise = rng.gumbel(size=logits.shape) if mode == "sample" else 0.0
    chosen: Array32 = parts[np.arange(len(raw)), np.argmax(logits + noise, axis=1)]
    return chosen


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


SCHEMA_VERSION = 1
# One key only: safetensors writes several in no fixed order, and the same models should give the same bytes.
HEADER_KEY = "graspcascade_nets"


@dataclass(frozen=True, eq=False)
class StoredDecoders:
    """Hold what a file holds: decoders by stage name, in order, and the caller's own metadata."""

    decoders: Mapping[str, NumpyDecoder]
    metadata: Mapping[str, Any] = field(default_factory=dict)


def save_decoders(
    path: str | os.PathLike[str], decoders: Mapping[str, NumpyDecoder], metadata: Mapping[str, Any] | None = None
) -> None:
    """Write decoders and metadata to one file, which appears under its name only when complete.

    Args:
        path: of the file to write or replace; its folder must exist.
        decoders: by stage name ("posture"); tensors are named "{stage}.decoder.0.weight".
        metadata: anything JSON can hold.

    Raises:
        InputError: the metadata cannot be written as JSON.
    """
    path = Path(path)
    stages = [{"name": name, **_stage_to_json(decoder)} for name, decoder in decoders.items()]
    header = {"schema_version": SCHEMA_VERSION, "stages": stages, "metadata": dict(metadata or {})}
    try:
        text = json.dumps(header, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"metadata that JSON cannot hold: {error}") from error
    tensors = {f"{name}.{part}": array for name, net in decoders.items() for part, array in net.arrays().items()}
    write_staged(path, lambda staged: staged.write_bytes(save(tensors, {HEADER_KEY: text})))


def load_decoders(path: str | os.PathLike[str]) -> StoredDecoders:
    """Read what `save_decoders` wrote.

    Raises:
        FileFormatError: the file is truncated, foreign or of another schema.
        InputError: there is no such file.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"there is no file {path}")
    text, tensors = _read_file(path)
    header = _parsed_header(path, text)
    try:
        decoders = {stage["name"]: _stage_from_json(stage, tensors) for stage in header["stages"]}
        return StoredDecoders(decoders, dict(header["metadata"]))
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise FileFormatError(f"{path}: its description of the decoders is damaged ({error!r})") from error


def _read_file(path: Path) -> tuple[str | None, dict[str, NDArray[Any]]]:
    try:
        with safe_open(path, framework="numpy") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
            return (file.metadata() or {}).get(HEADER_KEY), tensors
    except SafetensorError as error:
        raise FileFormatError(f"{path}: not a complete safetensors file ({error})") from error


def _parsed_header(path: Path, text: str | None) -> dict[str, Any]:
    if text is None:
        raise FileFormatError(f"{path}: a safetensors file, but not one of graspcascade's decoders")
    try:
        header = parse_json(text)
    except FileFormatError as error:
        raise FileFormatError(f"{path}: its header is not JSON ({error})") from error
    version = header.get("schema_version") if isinstance(header, dict) else None
    if version != SCHEMA_VERSION:
        raise FileFormatError(f"{path}: has schema version {version!r}, this package reads {SCHEMA_VERSION}")
    return dict(header)


def _stage_to_json(decoder: NumpyDecoder) -> dict[str, Any]:
    scaling = {name: values.tolist() for name, values in vars(decoder.standardisation).items()}
    return {"spec": asdict(decoder.spec), "standardisation": scaling}


def _stage_from_json(stage: dict[str, Any], tensors: Mapping[str, NDArray[Any]]) -> NumpyDecoder:
    spec_json = dict(stage["spec"])
    heads = tuple(HeadSpec(**head) for head in spec_json.pop("heads"))
    spec = VaeSpec(heads=heads, hidden=tuple(spec_json.pop("hidden")), **spec_json)
    scaling = {name: np.asarray(values, dtype=np.float64) for name, values in stage["standardisation"].items()}
    standardisation = Standardisation(**scaling)
    for name, values in scaling.items():
        columns = spec.target_dim if name.startswith("x") else spec.condition_dim
        if values.shape != (columns,):
            raise InputError(f"{name} of stage {stage['name']!r} has shape {values.shape}, its spec asks ({columns},)")
    prefix = f"{stage['name']}."
    own = {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}
    try:
        return NumpyDecoder.from_arrays(spec, standardisation, own)
    except InputError as error:
        raise InputError(f"stage {stage['name']!r}: {error}") from error
