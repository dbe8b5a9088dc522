"""Median, least and greatest of repeated measurements."""

from __future__ import annotations

import statistics
from collections.abc import Iterable
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Spread:
    """Sum up repeated measurements of one quantity, in its own unit."""

    median: float
    min: float
    max: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Spread:
        """Sum up at least one value."""
        found = list(values)
        return cls(statistics.median(found), min(found), max(found))

    def to_json(self) -> dict[str, float]:
        """Give the three numbers by name."""
        return asdict(self)
