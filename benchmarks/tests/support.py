"""What several tests need: made-up evaluations, and whether this machine can draw."""

from __future__ import annotations

import importlib.util
from typing import Any

import pytest

from graspcascade.core.errors import InputError
from graspcascade.core.intervals import Interval
from graspcascade.studies.record import Evaluation
from graspcascade.viewer.pictures import need_renderer
from tests.evaluations import evaluation

MAX_BYTES = 300_000
"""Largest picture that the documentation carries."""


def trained(model: str, training_seed: int, held_share: float, seed: int = 0, **changes: Any) -> Evaluation:
    metadata = {"config": {"training": {"epochs": 80, "seed": training_seed}}, "learned_from": 40_000}
    return evaluation(model, seed, 40, held_share, model_metadata=metadata, **changes)


def drawable() -> bool:
    try:
        need_renderer()
    except InputError:
        return False
    return importlib.util.find_spec("matplotlib") is not None


needs_drawing = pytest.mark.skipif(not drawable(), reason="needs libosmesa6 and matplotlib")


def words(interval: Interval) -> str:
    return f"{100 * interval.rate:.1f} % [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"
