"""Errors that name what was given, what is allowed and the nearest match."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspcascade.core.errors import FileFormatError, InputError, check_whole, unknown

NAMES = ("tripod", "palmar_pinch", "tip_pinch")


@given(st.text(max_size=30))
def test_every_unknown_name_gets_one_message_with_the_name_and_all_valid_ones(name: str) -> None:
    message = str(unknown("grasp type", name, NAMES))
    assert message.startswith(f"unknown grasp type {name!r}.")
    assert message.endswith("Valid: tripod, palmar_pinch, tip_pinch.")
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize(
    ("given_name", "nearest"),
    [("tripodd", "tripod"), ("Tip Pinch!", "tip_pinch"), ("palmar", "palmar_pinch"), ("TRIPO", "tripod")],
)
def test_a_misspelt_name_is_answered_with_the_nearest_one(given_name: str, nearest: str) -> None:
    assert f"Did you mean {nearest!r}?" in str(unknown("grasp type", given_name, NAMES))


def test_a_name_like_none_of_the_valid_ones_gets_no_guess() -> None:
    assert "Did you mean" not in str(unknown("grasp type", "xyzzy", NAMES))


def test_a_value_that_is_no_string_is_reported_as_given() -> None:
    assert str(unknown("count", 3, ("one", "two"))) == "unknown count 3. Valid: one, two."


@pytest.mark.parametrize("given", ["x" * 100_000, ["x"] * 100_000, {"a": "b" * 1000}])
def test_what_was_given_is_shortened_in_the_message(given: object) -> None:
    message = str(unknown("grasp type", given, NAMES))
    assert len(message) < 150
    assert "..." in message
    assert message.endswith("Valid: tripod, palmar_pinch, tip_pinch.")


def test_valid_names_may_come_from_any_iterable() -> None:
    assert "Valid: a, b." in str(unknown("letter", "q", iter(["a", "b"])))


def test_input_errors_are_value_errors_and_file_errors_are_input_errors() -> None:
    assert issubclass(InputError, ValueError)
    assert issubclass(FileFormatError, InputError)
    assert isinstance(unknown("letter", "q", "ab"), InputError)


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (2.5, "n must be a whole number, got 2.5"),
        ("3", "n must be a whole number, got '3'"),
        (None, "n must be a whole number, got None"),
        (0, "n must be at least 1, got 0"),
        (101, "n must be at most 100, got 101"),
        (10**400, "n must be at most 100, got 1000"),
    ],
)
def test_a_count_is_a_whole_number_within_bounds(number: object, said: str) -> None:
    with pytest.raises(InputError, match=re.escape(said)) as raised:
        check_whole("n", number, 1, 100)
    assert len(str(raised.value)) < 100
    check_whole("n", np.int64(100), 1, 100)
