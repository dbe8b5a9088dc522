"""Evaluation: success matrices with 95 % intervals, resumable runs, and the results page made from committed JSON."""

from ..intervals import Difference, Interval, newcombe, wilson
from .record import Cell, Evaluation, Tally
from .results_page import report
from .runs import ROUND_PER_CELL, evaluate
from .sources import RowSampler, Source, heuristic_source, model_source

__all__ = [
    "ROUND_PER_CELL",
    "Cell",
    "Difference",
    "Evaluation",
    "Interval",
    "RowSampler",
    "Source",
    "Tally",
    "evaluate",
    "heuristic_source",
    "model_source",
    "newcombe",
    "report",
    "wilson",
]
