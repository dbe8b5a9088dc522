"""Cells: the pairs of object and grasp type that collections fill and evaluations count alike."""

from __future__ import annotations

from .objects import CATALOGUE
from .taxonomy import GRASP_TYPES

CELLS: tuple[tuple[str, str], ...] = tuple((label, name) for label in CATALOGUE for name in GRASP_TYPES)
"""Every (object label, grasp type)."""


def cell_name(cell: int) -> str:
    """Name one of `CELLS` by its index."""
    return "/".join(CELLS[cell])
