"""What the paper reports: the rows and rates of its Tables I to III, and the orderings it draws from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from graspcascade.proposals.heuristic import HEURISTIC

FULL_MODEL = "model3"
"""The paper's own model: Model 3 of Table I, the von Mises-Fisher row of Table II, variant 1 of Table III."""


@dataclass(frozen=True)
class PaperRow:
    """One row of a table: the paper's name, the model here that stands for it, the paper's rate of success."""

    label: str
    model: str
    success_percent: float


@dataclass(frozen=True)
class PaperTable:
    """One table: its Roman number, what its rows are compared for, and in what they differ.

    They differ in the "stages" the distribution is divided into, in the "head" that draws the rotation, or in what the
    position and rotation stages are "given".
    """

    number: str
    question: str
    contrast: Literal["stages", "head", "given"]
    rows: tuple[PaperRow, ...]


@dataclass(frozen=True)
class Ordering:
    """One comparison that the paper draws from a table: one model's rate is above the other's."""

    table: str
    better: str
    worse: str


@dataclass(frozen=True)
class Statement:
    """What the paper concludes, and the comparisons it takes."""

    words: str
    orderings: tuple[Ordering, ...]


_MODELS = (
    PaperRow("Model 1", "model1", 76.89),
    PaperRow("Model 2", "model2", 79.41),
    PaperRow("Model 3", "model3", 90.90),
    PaperRow("Heuristic", HEURISTIC, 58.10),
)
_OUTPUTS = (PaperRow("Model with NN", "plain_rotation", 86.57), PaperRow("Model with vMF", "model3", 90.90))
_VARIANTS = (
    PaperRow("Variant 1", "model3", 90.90),
    PaperRow("Variant 2", "variant2", 90.57),
    PaperRow("Variant 3", "variant3", 90.36),
    PaperRow("Variant 4", "variant4", 91.54),
    PaperRow("Variant 5", "variant5", 81.68),
    PaperRow("Variant 6", "variant6", 90.78),
    PaperRow("Variant 7", "variant7", 71.77),
)
TABLES = (
    PaperTable("I", "one, two or three networks", "stages", _MODELS),
    PaperTable("II", "how the rotation is drawn", "head", _OUTPUTS),
    PaperTable("III", "what the position and rotation networks are given", "given", _VARIANTS),
)
"""The paper's section V, each rate over 27,000 grasps: 500 for each of nine objects and six types."""

SUCCESS_PERCENT = {row.model: row.success_percent for table in TABLES for row in table.rows}
"""The paper's rate of each model."""
PAPER_MODELS = (HEURISTIC, *(name for name in SUCCESS_PERCENT if name != HEURISTIC))
"""The heuristic and the ten models, in the tables' order."""
MAIN_MODELS = tuple(name for name in PAPER_MODELS if name in {row.model for row in TABLES[0].rows})
"""The heuristic and the ways of dividing the distribution, Table I."""

_INFORMED = ("model3", "variant2", "variant3", "variant4", "variant6")
STATEMENTS: tuple[Statement, ...] = (
    Statement("three networks hold more than two", (Ordering("I", "model3", "model2"),)),
    Statement("two networks hold more than one", (Ordering("I", "model2", "model1"),)),
    Statement("even one network holds more than the heuristic", (Ordering("I", "model1", HEURISTIC),)),
    Statement(
        "a von Mises-Fisher distribution on rotations holds more than a plain output",
        (Ordering("II", "model3", "plain_rotation"),),
    ),
    Statement(
        "without any size (variant 5) less holds", tuple(Ordering("III", name, "variant5") for name in _INFORMED)
    ),
    Statement(
        "without the object's type (variant 7) least holds",
        tuple(Ordering("III", name, "variant7") for name in (*_INFORMED, "variant5")),
    ),
    Statement(
        "without the grasp's size (variant 4) most holds",
        tuple(Ordering("III", "variant4", name) for name in _INFORMED if name != "variant4"),
    ),
)
"""What section V concludes."""
ORDERINGS = tuple(ordering for statement in STATEMENTS for ordering in statement.orderings)
"""All that is compared for it."""
