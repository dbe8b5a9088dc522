"""The six grasp types and the rule that makes a grasp faithful to its type."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from graspcascade.core.errors import InputError
from graspcascade.core.taxonomy import (
    AREAS,
    DIGITS,
    FEIX_TYPES,
    GRASP_TYPES,
    PAPER_TYPES,
    TAXONOMIES,
    Contact,
    GraspType,
    as_type,
    taxonomy_of,
)

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
    if any(set(contact.digits) <= lacking for contact in kind.contacts):
        assert not faithful.any(), "a digit must touch that the hand does not have"
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
    assert [contact.digits for contact in kind.contacts[:2]] == [("thumb",), ("index",)]


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
        GRASP_TYPES["tripod"].contacts = ()  # type: ignore[misc]


# Types that ask where a digit touches

TOUCH_TYPES = list(FEIX_TYPES.values())
SHORT, LONG = 0.03, 0.10


def masks(**areas: str) -> np.ndarray:
    """Bit masks of the five digits, from the names of the areas that each touches, set apart by spaces."""
    return np.array([sum(1 << AREAS.index(area) for area in areas.get(digit, "").split()) for digit in DIGITS])


def is_faithful(name: str, areas: np.ndarray, length_m: float = SHORT, digits: tuple[str, ...] = DIGITS) -> bool:
    return bool(FEIX_TYPES[name].is_faithful(areas != 0, digits, areas, length_m))


GOOD = {
    "tripod": {"thumb": "distal_pad", "index": "distal_end", "middle": "distal_pad"},
    "palmar_pinch": {"thumb": "distal_pad", "index": "distal_pad"},
    "parallel_extension": {"thumb": "distal_pad", "index": "middle_pad", "middle": "distal_pad"},
    "writing_tripod": {"thumb": "distal_end", "index": "distal_radial", "middle": "distal_radial"},
    "lateral_tripod": {"thumb": "distal_pad", "index": "distal_pad", "middle": "middle_radial"},
    "tip_pinch": {"thumb": "distal_end", "index": "distal_end"},
}


@pytest.mark.parametrize("name", FEIX_TYPES)
def test_the_right_areas_make_a_grasp_faithful_and_one_missing_spoils_it(name: str) -> None:
    assert is_faithful(name, masks(**GOOD[name]))
    for digit in GOOD[name]:
        assert not is_faithful(name, masks(**GOOD[name] | {digit: ""}))
        assert not is_faithful(name, masks(**GOOD[name] | {digit: "proximal_back distal_back middle_ulnar"}))


@pytest.mark.parametrize(
    ("name", "digit", "area"),
    [
        ("tripod", "middle", "distal_radial"),
        ("palmar_pinch", "index", "middle_pad"),
        ("palmar_pinch", "thumb", "distal_end"),
        ("parallel_extension", "index", "proximal_pad"),
        ("writing_tripod", "middle", "distal_pad"),
        ("writing_tripod", "middle", "middle_radial"),
        ("lateral_tripod", "middle", "distal_pad"),
        ("lateral_tripod", "thumb", "distal_radial"),
        ("tip_pinch", "index", "distal_pad"),
    ],
)
def test_a_contact_on_another_part_of_the_digit_does_not_count(name: str, digit: str, area: str) -> None:
    assert not is_faithful(name, masks(**GOOD[name] | {digit: area}))
    assert is_faithful(name, masks(**GOOD[name] | {digit: f"{area} {GOOD[name][digit]}"})), "one right area is enough"


def test_a_long_object_asks_for_more_fingers() -> None:
    three, name = masks(**GOOD["parallel_extension"]), "parallel_extension"
    four = three | masks(ring="middle_pad")
    five = four | masks(little="distal_pad")
    assert [is_faithful(name, three, length) for length in (0.0599, 0.06, 0.1)] == [True, False, False]
    assert [is_faithful(name, four, length) for length in (0.06, 0.0849, 0.085)] == [True, True, False]
    assert is_faithful(name, five, LONG)
    assert not is_faithful(name, four | masks(little="distal_radial"), LONG)


def test_a_hand_is_not_asked_for_fingers_that_only_long_objects_need() -> None:
    areas = masks(**GOOD["parallel_extension"])[:3]
    assert is_faithful("parallel_extension", areas, LONG, DIGITS[:3])
    assert not is_faithful("parallel_extension", areas[:2], SHORT, DIGITS[:2]), "the middle finger is always asked for"


@pytest.mark.parametrize("kind", TOUCH_TYPES, ids=list(FEIX_TYPES))
@given(areas=hnp.arrays(np.uint16, (3, 5), elements=st.integers(0, 2 ** len(AREAS) - 1)), length=st.floats(0.02, 0.12))
def test_one_more_area_never_spoils_a_faithful_grasp(kind: GraspType, areas: np.ndarray, length: float) -> None:
    faithful = kind.is_faithful(areas != 0, DIGITS, areas, length)
    assert faithful.tolist() == [kind.is_faithful(row != 0, DIGITS, row, length) for row in areas]
    for bit in range(len(AREAS)):
        assert (kind.is_faithful(areas != 0, DIGITS, areas | 1 << bit, length) >= faithful).all()


@pytest.mark.parametrize("kind", TOUCH_TYPES, ids=list(FEIX_TYPES))
def test_without_recorded_areas_nothing_is_faithful_to_a_type_that_asks_for_them(kind: GraspType) -> None:
    assert not kind.is_faithful(np.ones(5, dtype=bool), DIGITS, length_m=SHORT)


@pytest.mark.parametrize("kind", GRASP_TYPES.values(), ids=list(GRASP_TYPES))
@given(touching=hnp.arrays(bool, 5), areas=hnp.arrays(np.uint16, 5), length=st.floats(0.02, 0.12))
def test_the_papers_types_ask_neither_where_nor_how_long(
    kind: GraspType, touching: np.ndarray, areas: np.ndarray, length: float
) -> None:
    assert kind.is_faithful(touching, DIGITS, areas, length) == kind.is_faithful(touching)


def test_both_taxonomies_have_the_same_types_by_other_rules() -> None:
    assert list(PAPER_TYPES) == list(FEIX_TYPES)
    for name, kind in FEIX_TYPES.items():
        assert kind.feix_number == PAPER_TYPES[name].feix_number
        assert kind != PAPER_TYPES[name]
        assert as_type(name, FEIX_TYPES) is kind
    assert {name: {kind.taxonomy for kind in types.values()} for name, types in TAXONOMIES.items()} == {
        "paper": {"paper"},
        "feix": {"feix"},
    }
    assert GRASP_TYPES is PAPER_TYPES


def test_types_of_two_taxonomies_are_not_mixed() -> None:
    assert taxonomy_of(FEIX_TYPES.values()) == "feix"
    assert taxonomy_of([]) == "paper"
    with pytest.raises(InputError, match="of paper and feix have the same names and other rules"):
        taxonomy_of([PAPER_TYPES["tripod"], FEIX_TYPES["tripod"]])


@pytest.mark.parametrize(
    ("digits", "areas", "says"),
    [
        (("thum",), (), "unknown digit 'thum'. Did you mean 'thumb'"),
        (("thumb",), ("distal_pads",), "unknown area of a digit 'distal_pads'. Did you mean 'distal_pad'"),
    ],
)
def test_a_contact_with_an_unknown_name_is_refused(digits: tuple, areas: tuple, says: str) -> None:
    with pytest.raises(InputError) as caught:
        Contact(digits, areas)
    assert says in str(caught.value)


@pytest.mark.parametrize("kind", TOUCH_TYPES, ids=list(FEIX_TYPES))
def test_the_page_on_the_protocol_says_where_each_digit_must_touch(kind: GraspType) -> None:
    said = []
    for contact in kind.contacts:
        length = f" from {contact.from_length_m * 1000:g} mm" if contact.from_length_m else ""
        said.append(f"{' or '.join(contact.digits)}{length}: {', '.join(f'`{area}`' for area in contact.areas)}")
    page = (Path(__file__).parents[1] / "docs/protocol.md").read_text(encoding="utf-8")
    assert f"| `{kind.name}` | {'; '.join(said)} |" in page.splitlines()
