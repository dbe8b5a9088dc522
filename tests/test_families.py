"""Families: objects of random size that a hand can hold, by names that spell their sizes."""

import re
from dataclasses import astuple
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspcascade.core.errors import InputError
from graspcascade.core.families import FAMILIES, ObjectFamily, read_objects
from graspcascade.core.objects import CATALOGUE, Box, Cylinder, Sphere, as_object

seeds = st.integers(0, 2**32 - 1)
each_family = pytest.mark.parametrize("family", FAMILIES.values(), ids=list(FAMILIES))


def test_the_families_are_all_boxes_cylinders_and_spheres_that_the_default_hand_can_hold() -> None:
    ranges_mm = {name: [(a * 1000, b * 1000) for a, b in family.ranges_m] for name, family in FAMILIES.items()}
    assert ranges_mm == {
        "any:box": [(15, 90), (15, 90), (15, 90)],
        "any:cylinder": [(15, 65), (20, 120)],
        "any:sphere": [(20, 65)],
    }
    assert {family.widest_m for family in FAMILIES.values()} == {0.065}


@each_family
@settings(max_examples=10)
@given(seed=seeds, reach_m=st.sampled_from([np.inf, 0.065, 0.0412]))
def test_sizes_are_within_their_ranges_and_one_side_can_be_held(
    family: ObjectFamily, seed: int, reach_m: float
) -> None:
    drawn = family.draw(200, np.random.default_rng(seed), reach_m)
    low, high = np.array(family.ranges_m).T
    sizes = np.array([astuple(obj.shape) for obj in drawn])
    assert ((sizes >= low) & (sizes <= high)).all()
    assert all(obj.sites(min(reach_m, family.widest_m)) for obj in drawn)


@each_family
@given(seed=seeds)
def test_names_spell_the_sizes_to_a_tenth_of_a_millimetre(family: ObjectFamily, seed: int) -> None:
    for obj in family.draw(20, np.random.default_rng(seed)):
        assert re.fullmatch(rf"{family.shape.kind}:\d+(\.\d)?(x\d+(\.\d)?)*mm", obj.name)
        assert as_object(obj.name) == obj


@pytest.mark.parametrize("name", ["any:cylinder", "any:sphere"])
def test_each_size_is_drawn_evenly_from_its_range(name: str) -> None:
    n, family = 5000, FAMILIES[name]
    sizes = np.array([astuple(obj.shape) for obj in family.draw(n, np.random.default_rng(0))])
    for column, between in zip(sizes.T, family.ranges_m, strict=True):
        counts, _ = np.histogram(column, bins=10, range=between)
        assert ((counts - n / 10) ** 2 / (n / 10)).sum() < 34, "9 degrees of freedom: one draw in 10,000 exceeds this"


def test_boxes_that_cannot_be_held_are_drawn_again_and_no_others() -> None:
    # Of even extents a share of 1 / 27 has no side within 65 mm, and the others are even over what is left.
    n = 20_000
    extents = np.array([obj.extents_m for obj in FAMILIES["any:box"].draw(n, np.random.default_rng(1))])
    left = 1 - (25 / 75) ** 3
    for column in extents.T:
        share = (column > 0.065).mean()
        assert share == pytest.approx((25 / 75 - (25 / 75) ** 3) / left, abs=4 * np.sqrt(0.3 * 0.7 / n))


@each_family
def test_the_same_generator_draws_the_same_objects(family: ObjectFamily) -> None:
    one, same, other = (family.draw(5, np.random.default_rng(seed)) for seed in (3, 3, 4))
    assert one == same
    assert one != other
    assert family.draw(0, np.random.default_rng(0)) == []


@pytest.mark.parametrize("reach_m", [0.01, 0.0149])
@each_family
def test_a_hand_that_can_hold_none_of_them_is_told(family: ObjectFamily, reach_m: float) -> None:
    with pytest.raises(InputError, match=f"{family.name} has no size of which a side is within the reach of 1"):
        family.draw(1, np.random.default_rng(0), reach_m)


def test_a_reach_between_tenths_of_a_millimetre_ends() -> None:
    pins = ObjectFamily("pins", Sphere, ((0.03337, 0.03337),))
    with pytest.raises(InputError, match="pins has no size"):
        pins.draw(1, np.random.default_rng(0), 0.03337)
    assert pins.draw(1, np.random.default_rng(0))[0].name == "sphere:33.4mm"


@pytest.mark.parametrize(
    ("shape", "ranges_m"),
    [
        (Sphere, ()),
        (Box, ((0.02, 0.03), (0.02, 0.03))),
        (Sphere, ((0.03, 0.02),)),
        (Sphere, ((20.0, 30.0),)),
        (Cylinder, ((0.0, 0.02), (0.02, 0.03))),
        (Sphere, ((np.nan, 0.02),)),
    ],
    ids=["none", "too few", "reversed", "millimetres", "zero", "no number"],
)
def test_ranges_that_are_none_are_refused(shape: Any, ranges_m: Any) -> None:
    with pytest.raises(InputError, match=r"pins needs a range for each of .*_m, within 0\.001 to 1 m, got"):
        ObjectFamily("pins", shape, ranges_m)


def test_a_study_reads_objects_sizes_and_families() -> None:
    own = ObjectFamily("pins", Cylinder, ((0.005, 0.01), (0.03, 0.06)))
    for given_one, read in (
        ("any", tuple(FAMILIES.values())),
        (" Any:Box ", (FAMILIES["any:box"],)),
        ("box_small", (CATALOGUE["box_small"],)),
        ("sphere:31mm", (as_object("sphere:31mm"),)),
        (CATALOGUE["box_small"], (CATALOGUE["box_small"],)),
        (own, (own,)),
    ):
        assert read_objects(given_one) == read


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("any:bxo", "unknown family of objects 'any:bxo'. Did you mean 'any:box'? Valid: any:box, any:cylinder,"),
        ("any:", "unknown family of objects 'any:'"),
        ("anything", "unknown object 'anything'"),
        ("box:1x2mm", "a box has 3 sizes, got 2"),
    ],
)
def test_what_a_study_cannot_read_is_refused(name: str, says: str) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(says)}"):
        read_objects(name)


@pytest.mark.parametrize("name", ["any", "ANY:box", "any:nothing"])
def test_where_one_object_is_needed_a_family_is_refused(name: str) -> None:
    with pytest.raises(InputError, match=rf"^'{name}' means objects of random size.*; give one object: box_small, .*$"):
        as_object(name)
