"""Report: the results page with the paper's tables, its figures and the model card, made from committed JSON."""

from .results_page import write_report

__all__ = ["write_report"]
