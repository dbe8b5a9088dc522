"""What several tests need: made-up evaluations, and whether this machine can draw."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from graspcascade.core.errors import InputError
from graspcascade.core.intervals import Interval
from graspcascade.core.outcomes import VERDICTS
from graspcascade.core.protocols import PAPER
from graspcascade.studies.record import Cell, Evaluation
from graspcascade.studies.rounds import CELLS
from graspcascade.viewer.pictures import need_renderer

MAX_BYTES = 300_000
"""Largest picture that the documentation carries."""


def evaluation(
    model: str = "heuristic", seed: int = 0, per_cell: int = 20, held_share: float = 0.5, **changes: Any
) -> Evaluation:
    rng = np.random.default_rng(seed)
    cells = []
    for obj, kind in CELLS:
        held = int(rng.binomial(per_cell, held_share))
        rest = rng.multinomial(per_cell - held, [0.2] * 5).tolist()
        cells.append(
            Cell(dict(zip(VERDICTS, [held, *rest], strict=True)), int(rng.integers(held + 1)), kind.name, obj.name)
        )
    made_up = Evaluation(PAPER, model, "shadow_hand_right", tuple(cells), seed, per_cell, {"mujoco": "3.17.0"}, {})
    return replace(made_up, **changes)


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
