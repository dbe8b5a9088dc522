"""Conditional VAEs: specs, a training loop, numpy-only sampling and one-file storage.

Importing this room does not import torch; `nets.vae` and `nets.training` do.
"""

from .inference import NumpyDecoder, StoredDecoders, load_decoders, save_decoders
from .specs import EpochRecord, Fitted, HeadSpec, Standardisation, TrainingSpec, VaeSpec

__all__ = [
    "EpochRecord",
    "Fitted",
    "HeadSpec",
    "NumpyDecoder",
    "Standardisation",
    "StoredDecoders",
    "TrainingSpec",
    "VaeSpec",
    "load_decoders",
    "save_decoders",
]
