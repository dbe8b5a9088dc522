"""Intervals of rates and of their differences: as published, and as scipy has them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from graspcascade.core.intervals import newcombe, share, wilson, wilson_bounds


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_gives_the_intervals_published_by_newcombe(successes: int, n: int, low: float, high: float) -> None:
    # DOI 10.1002/(SICI)1097-0258(19980430)17:8<857::AID-SIM777>3.0.CO;2-E, table I, method 3.
    interval = wilson(successes, n)
    assert (interval.low, interval.high) == pytest.approx((low, high), abs=5e-5)


@pytest.mark.parametrize(
    ("one", "two", "low", "high"),
    [
        ((56, 70), (48, 80), 0.0524, 0.3339),
        ((9, 10), (3, 10), 0.1705, 0.8090),
        ((6, 7), (2, 7), 0.0582, 0.8062),
        ((5, 56), (0, 29), -0.0381, 0.1926),
        ((0, 10), (0, 20), -0.1611, 0.2775),
        ((10, 10), (0, 10), 0.6075, 1.0),
    ],
)
def test_newcombe_gives_the_published_intervals(
    one: tuple[int, int], two: tuple[int, int], low: float, high: float
) -> None:
    # DOI 10.1002/(SICI)1097-0258(19980430)17:8<873::AID-SIM779>3.0.CO;2-I, table II, method 10.
    interval = newcombe(*one, *two)
    assert (interval.low, interval.high) == pytest.approx((low, high), abs=5e-5)


counts = st.integers(1, 30_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))


@given(counts)
def test_wilson_agrees_with_scipy(count: tuple[int, int]) -> None:
    theirs = binomtest(*count).proportion_ci(0.95, method="wilson")
    interval = wilson(*count)
    assert (interval.low, interval.high) == pytest.approx((theirs.low, theirs.high), abs=1e-9)


@given(counts)
def test_a_rate_lies_in_its_interval_and_the_interval_in_the_unit_interval(count: tuple[int, int]) -> None:
    interval = wilson(*count)
    assert 0.0 <= interval.low <= interval.rate <= interval.high <= 1.0


@given(counts)
def test_counting_failures_mirrors_the_interval(count: tuple[int, int]) -> None:
    successes, n = count
    interval, mirror = wilson(successes, n), wilson(n - successes, n)
    assert (interval.low, interval.high) == pytest.approx((1 - mirror.high, 1 - mirror.low), abs=1e-12)


@given(counts, st.integers(2, 10))
def test_more_trials_at_the_same_rate_narrow_the_interval(count: tuple[int, int], times: int) -> None:
    few, many = wilson(*count), wilson(count[0] * times, count[1] * times)
    assert many.high - many.low < few.high - few.low


@given(counts, counts)
def test_a_difference_turns_its_sign_with_the_order(one: tuple[int, int], two: tuple[int, int]) -> None:
    interval, turned = newcombe(*one, *two), newcombe(*two, *one)
    assert -1.0 - 1e-12 <= interval.low <= interval.difference <= interval.high <= 1.0 + 1e-12
    assert (interval.low, interval.high) == pytest.approx((-turned.high, -turned.low), abs=1e-12)


def test_no_trials_tell_nothing() -> None:
    interval = wilson(0, 0)
    assert math.isnan(interval.rate)
    assert (interval.low, interval.high) == (0.0, 1.0)
    assert interval.to_json()["rate"] is None
    assert math.isnan(newcombe(0, 0, 1, 2).difference)


@pytest.mark.parametrize(("successes", "n"), [(-1, 3), (4, 3), (0, -1)])
def test_impossible_counts_are_refused(successes: int, n: int) -> None:
    with pytest.raises(ValueError, match="between 0 and n"):
        wilson(successes, n)


@given(st.lists(counts | st.just((0, 0)), min_size=1, max_size=20))
def test_bounds_of_many_rates_are_those_of_each(tallies: list[tuple[int, int]]) -> None:
    successes, n = np.array(tallies).T
    low, high = wilson_bounds(successes, n)
    each = [wilson(*count) for count in tallies]
    np.testing.assert_array_equal(low, [interval.low for interval in each])
    np.testing.assert_array_equal(high, [interval.high for interval in each])


def test_one_impossible_count_among_many_is_refused() -> None:
    with pytest.raises(ValueError, match="between 0 and n"):
        wilson_bounds([1, 4], [2, 3])


@given(st.lists(st.booleans(), max_size=30))
def test_a_share_is_the_rate_of_set_flags(flags: list[bool]) -> None:
    interval = share(np.array(flags, dtype=bool))
    assert repr(interval) == repr(wilson(sum(flags), len(flags)))
