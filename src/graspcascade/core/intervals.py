"""Confidence intervals of success rates and of their differences, 95 % two-sided."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Z_95 = 1.959963984540054
"""Normal quantile of 0.975."""


@dataclass(frozen=True)
class Interval:
    """A rate and its 95 % confidence interval, all in [0, 1]; the rate of no trials is NaN."""

    rate: float
    low: float
    high: float

    def to_json(self) -> dict[str, float | None]:
        """Write the three numbers by name, NaN as null."""
        return {"rate": None if math.isnan(self.rate) else self.rate, "low": self.low, "high": self.high}


@dataclass(frozen=True)
class Difference:
    """A difference of two rates and its 95 % confidence interval, all in [-1, 1]."""

    difference: float
    low: float
    high: float


def wilson_bounds(successes: ArrayLike, n: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute lower and upper bounds ``(...)`` of Wilson score intervals (DOI 10.1080/01621459.1927.10502953).

    Args:
        successes: ``(...)`` trials that succeeded.
        n: ``(...)`` all trials; none gives bounds 0 and 1.

    Raises:
        ValueError: successes are not between 0 and n.
    """
    k, trials = np.asarray(successes, dtype=np.float64), np.asarray(n, dtype=np.float64)
    if not np.all((k >= 0) & (k <= trials)):
        raise ValueError(f"successes must be between 0 and n = {n!r}, got {successes!r}")
    m, z2 = np.maximum(trials, 1), Z_95**2
    rate = k / m
    centre = (rate + z2 / (2 * m)) / (1 + z2 / m)
    half = Z_95 / (1 + z2 / m) * np.sqrt(rate * (1 - rate) / m + z2 / (4 * m * m))
    # At 0 and n successes one bound is the rate itself, which rounding would miss.
    low = np.where(k == 0, 0.0, np.maximum(0.0, centre - half))
    high = np.where(k == trials, 1.0, np.minimum(1.0, centre + half))
    return low, high


def wilson(successes: float, n: int) -> Interval:
    """Compute the rate of successes in n trials with its Wilson score interval; see `wilson_bounds`.

    Of trials that are not independent, such as several of one grasp, give the sum of the grasps' shares and how many.
    """
    low, high = wilson_bounds(successes, n)
    return Interval(successes / n if n else math.nan, float(low), float(high))


def share(flags: NDArray[np.bool_]) -> Interval:
    """Compute the share of flags that are set, with its interval (see `wilson`)."""
    return wilson(int(np.count_nonzero(flags)), len(flags))


def newcombe(successes: int, n: int, base_successes: int, base_n: int) -> Difference:
    """Compute the difference of two independent rates with Newcombe's hybrid score interval.

    Method 10 of DOI 10.1002/(SICI)1097-0258(19980430)17:8<873::AID-SIM779>3.0.CO;2-I, no continuity correction.

    It is the first rate minus that of the base, NaN in [-1, 1] where a sample is empty; successes are checked as in
    `wilson_bounds`.
    """
    one, two = wilson(successes, n), wilson(base_successes, base_n)
    if n == 0 or base_n == 0:
        return Difference(math.nan, -1.0, 1.0)
    difference = one.rate - two.rate
    below, above = (
        math.hypot(one.rate - one.low, two.high - two.rate),
        math.hypot(one.high - one.rate, two.rate - two.low),
    )
    return Difference(difference, difference - below, difference + above)
