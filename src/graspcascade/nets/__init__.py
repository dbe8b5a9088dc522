"""Conditional VAEs: specs, a training loop, numpy-only sampling and one-file storage.

Importing this room does not import torch; `nets.vae` and `nets.training` do.
"""

from .fitted import EpochRecord, Fitted, Standardisation
from .heads import HeadSpec
from .inference import NumpyDecoder
from .specs import TrainingSpec, VaeSpec
from .store import StoredDecoders, load_decoders, save_decoders

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
