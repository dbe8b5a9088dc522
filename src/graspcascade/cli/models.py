"""Which sampler a `--model` argument means."""

from __future__ import annotations

import os
from pathlib import Path

from ..cascade import GraspSampler


def load_sampler(model: str) -> GraspSampler:
    """Load a shipped cascade by name, or a user's own by its folder.

    A folder that has the name of a shipped cascade is given as ``./name``.

    Raises:
        InputError: no such model, or files that are truncated or foreign.
    """
    if model == "default" or (os.sep not in model and not Path(model).exists()):
        return GraspSampler.pretrained(model)
    return GraspSampler.load(model)
