"""Confidence intervals of success rates and of their differences, 95 % two-sided."""

from __future__ import annotations

import math
from dataclasses import dataclass

Z_95 = 1.959963984540054
"""Normal quantile of 0.975."""


@dataclass(frozen=True)
class Interval:
    """Hold a rate and its 95 % confidence interval, all in [0, 1]; the rate of no trials is NaN."""

    rate: float
    low: float
    high: float

    def to_json(self) -> dict[str, float | None]:
        """Give the three numbers by name, NaN as null."""
        return {"rate": None if math.isnan(self.rate) else self.rate, "low": self.low, "high": self.high}


@dataclass(frozen=True)
class Difference:
    """Hold a difference of two rates and its 95 % confidence interval, all in [-1, 1]."""

    difference: float
    low: float
    high: float


def wilson(successes: int, n: int) -> Interval:
    """Compute a rate with its Wilson score interval (DOI 10.1080/01621459.1927.10502953).

    Args:
        successes: trials that succeeded.
        n: trials; 0 gives a NaN rate in [0, 1].

    Raises:
        ValueError: successes are not between 0 and n.
    """
    if not 0 <= successes <= n:
        raise ValueError(f"successes must be between 0 and n = {n}, got {successes}")
    if n == 0:
        return Interval(math.nan, 0.0, 1.0)
    rate, z2 = successes / n, Z_95**2
    centre = (rate + z2 / (2 * n)) / (1 + z2 / n)
    half = Z_95 / (1 + z2 / n) * math.sqrt(rate * (1 - rate) / n + z2 / (4 * n * n))
    # At 0 and n successes one bound is the rate itself, which rounding would miss.
    low = 0.0 if successes == 0 else max(0.0, centre - half)
    high = 1.0 if successes == n else min(1.0, centre + half)
    return Interval(rate, low, high)


def newcombe(successes: int, n: int, base_successes: int, base_n: int) -> Difference:
    """Compute the difference of two independent rates with Newcombe's hybrid score interval.

    Method 10 of DOI 10.1002/(SICI)1097-0258(19980430)17:8<873::AID-SIM779>3.0.CO;2-I, no continuity correction.

    Args:
        successes: trials of the first sample that succeeded.
        n: trials of the first sample.
        base_successes: the same of the sample that is subtracted.
        base_n: trials of the sample that is subtracted.

    Returns:
        First rate minus second; NaN in [-1, 1] where a sample is empty.

    Raises:
        ValueError: successes are not between 0 and the number of trials.
    """
    one, two = wilson(successes, n), wilson(base_successes, base_n)
    if n == 0 or base_n == 0:
        return Difference(math.nan, -1.0, 1.0)
    difference = one.rate - two.rate
    return Difference(
        difference,
        difference - math.hypot(one.rate - one.low, two.high - two.rate),
        difference + math.hypot(one.high - one.rate, two.rate - two.low),
    )
