"""Trained decoders in one safetensors file, with what is needed to use them as JSON in its header (numpy only)."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ..errors import FileFormatError, InputError
from ..files import write_staged
from .fitted import Standardisation
from .heads import HeadSpec
from .inference import NumpyDecoder
from .specs import VaeSpec

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
    text, tensors = _read(path)
    header = _parsed_header(path, text)
    try:
        decoders = {stage["name"]: _stage_from_json(stage, tensors) for stage in header["stages"]}
        return StoredDecoders(decoders, dict(header["metadata"]))
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise FileFormatError(f"{path}: its description of the decoders is damaged ({error!r})") from error


def _read(path: Path) -> tuple[str | None, dict[str, NDArray[Any]]]:
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
        header = json.loads(text)
    except json.JSONDecodeError as error:
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
