"""The six grasp types and the rule that makes a grasp faithful to its type."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from graspcascade.core.errors import InputError
from graspcascade.core.taxonomy import DIGITS, GRASP_TYPES, GraspType, as_type

THREE = {"thumb", "index", "middle"}
TWO = {"thumb", "index"}
EVERY_CONTACT = [frozenset(itertools.compress(DIGITS, flags)) for flags in itertools.product((False, True), repeat=5)]

every_type = pytest.mark.parametrize("kind", GRASP_TYPES.values(), ids=list(GRASP_TYPES))


def flags(touching: frozenset[str]) -> np.ndarray:
    return np.array([digit in touching for digit in DIGITS])


@every_type
@given(touching=hnp.arrays(bool, st.tuples(st.integers(0, 4), st.integers(1, 3), st.just(5))))
def test_faithfulness_is_judged_grasp_by_grasp(kind: GraspType, touching: np.ndarray) -> None:
    faithful = kind.is_faithful(touching)
    assert faithful.shape == touching.shape[:-1]
    for index in np.ndindex(*faithful.shape):
        assert faithful[index] == kind.is_faithful(touching[index])


@every_type
@given(touching=hnp.arrays(bool, 5), digit=st.integers(0, 4))
def test_one_more_contact_never_spoils_a_faithful_grasp(kind: GraspType, touching: np.ndarray, digit: int) -> None:
    more = touching.copy()
    more[digit] = True
    assert kind.is_faithful(more) or not kind.is_faithful(touching)


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("tripod", lambda touching: touching >= THREE),
        ("palmar_pinch", lambda touching: touching >= TWO),
        ("parallel_extension", lambda touching: touching >= TWO and bool(touching & {"middle", "ring", "little"})),
        ("writing_tripod", lambda touching: touching >= THREE),
        ("lateral_tripod", lambda touching: touching >= THREE),
        ("tip_pinch", lambda touching: touching >= TWO),
    ],
)
def test_the_digits_each_type_needs_are_those_of_the_published_table(name: str, rule) -> None:
    verdicts = GRASP_TYPES[name].is_faithful(np.stack([flags(touching) for touching in EVERY_CONTACT]))
    assert verdicts.tolist() == [rule(touching) for touching in EVERY_CONTACT]


@every_type
@given(touching=hnp.arrays(bool, (3, 5)), lacking=st.sets(st.sampled_from(DIGITS[2:])))
def test_a_hand_without_some_fingers_is_judged_by_those_it_has(
    kind: GraspType, touching: np.ndarray, lacking: set[str]
) -> None:
    digits = [digit for digit in DIGITS if digit not in lacking]
    columns = [DIGITS.index(digit) for digit in digits]
    palm = np.ones((3, 1), dtype=bool)
    faithful = kind.is_faithful(np.concatenate([touching[:, columns], palm], axis=1), digits)
    absent = touching.copy()
    absent[:, [DIGITS.index(digit) for digit in lacking]] = False
    if set(kind.any_of) and set(kind.any_of) <= lacking:
        assert not faithful.any(), "one of several fingers must touch, and the hand has none of them"
    np.testing.assert_array_equal(faithful, kind.is_faithful(absent))


@every_type
def test_faithfulness_does_not_change_the_contacts_it_reads(kind: GraspType) -> None:
    touching = np.ones((3, 5), dtype=bool)
    touching.flags.writeable = False
    assert kind.is_faithful(touching).all()


@every_type
def test_contacts_may_be_given_as_a_plain_list(kind: GraspType) -> None:
    assert kind.is_faithful([True] * 5)
    assert not kind.is_faithful([False] * 5)


def test_the_types_carry_their_numbers_in_the_feix_taxonomy() -> None:
    assert {name: kind.feix_number for name, kind in GRASP_TYPES.items()} == {
        "tripod": 14,
        "palmar_pinch": 9,
        "parallel_extension": 22,
        "writing_tripod": 20,
        "lateral_tripod": 25,
        "tip_pinch": 24,
    }


@every_type
def test_the_thumb_opposes_the_index_finger_and_both_must_touch(kind: GraspType) -> None:
    thumb, index = kind.opposition
    assert thumb.startswith("thumb_")
    assert index.startswith("index_")
    assert set(kind.required) >= TWO
    assert set(kind.required) | set(kind.any_of) <= set(DIGITS)


def test_only_the_types_with_straight_fingers_oppose_the_middle_phalanx() -> None:
    straight = {kind.name for kind in GRASP_TYPES.values() if kind.opposition[1] == "index_phalanx"}
    assert straight == {"palmar_pinch", "parallel_extension"}


@every_type
def test_every_type_is_found_by_its_name_however_it_is_written(kind: GraspType) -> None:
    spaced = kind.name.replace("_", " ")
    for written in (
        kind.name,
        kind.name.upper(),
        spaced,
        spaced.title(),
        kind.name.replace("_", "-"),
        f" {kind.name} ",
    ):
        assert as_type(written) is kind
    assert as_type(kind) is kind


def test_an_unknown_type_is_refused_and_the_nearest_one_named() -> None:
    with pytest.raises(InputError, match=r"unknown grasp type 'tripood'\. Did you mean 'tripod'\? Valid: tripod, "):
        as_type("tripood")


def test_an_endless_type_name_is_shortened_in_the_message() -> None:
    with pytest.raises(InputError) as caught:
        as_type("t" * 100_000)
    assert len(str(caught.value)) < 200


def test_a_type_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        GRASP_TYPES["tripod"].required = ()  # type: ignore[misc]
