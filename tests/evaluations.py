"""Made-up evaluations, for tests of what is computed from them."""

from dataclasses import replace
from typing import Any

import numpy as np

from graspcascade.core.outcomes import VERDICTS
from graspcascade.core.protocols import PAPER
from graspcascade.studies.record import Cell, Evaluation
from graspcascade.studies.rounds import CELLS


def evaluation(
    model: str = "heuristic", seed: int = 0, per_cell: int = 20, held_share: float = 0.5, **changes: Any
) -> Evaluation:
    """Make up an evaluation of all 54 cells."""
    rng = np.random.default_rng(seed)
    cells = []
    for obj, kind in CELLS:
        held = int(rng.binomial(per_cell, held_share))
        rest = rng.multinomial(per_cell - held, [1 / 7] * 7).tolist()
        cells.append(
            Cell(dict(zip(VERDICTS, [held, *rest], strict=True)), int(rng.integers(held + 1)), kind.name, obj.name)
        )
    made = Evaluation(PAPER, model, "shadow_hand_right", tuple(cells), seed, per_cell, {"mujoco": "3.17.0"}, {})
    return replace(made, **changes)
