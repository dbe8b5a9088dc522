"""Evaluation: success rates of every object and type with 95 % intervals, in runs that go on where they stopped."""

from ..intervals import Difference, Interval, newcombe, wilson
from .record import Cell, Evaluation, Tally
from .runs import ROUND_PER_CELL, evaluate
from .sources import HEURISTIC, RowSampler, Source, heuristic_metadata, heuristic_source, model_source

__all__ = [
    "HEURISTIC",
    "ROUND_PER_CELL",
    "Cell",
    "Difference",
    "Evaluation",
    "Interval",
    "RowSampler",
    "Source",
    "Tally",
    "evaluate",
    "heuristic_metadata",
    "heuristic_source",
    "model_source",
    "newcombe",
    "wilson",
]
