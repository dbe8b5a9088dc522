"""Errors that name what was given, what is allowed and the nearest match."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspcascade.core.errors import FileFormatError, InputError, unknown

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
