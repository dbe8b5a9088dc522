"""The geometric heuristic: where it puts an object, and what it may draw."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspcascade.candidates import candidates, cannot_touch, draw_sides
from graspcascade.errors import InputError
from graspcascade.grasps import Grasps
from graspcascade.hands import SHADOW_HAND, HandModel
from graspcascade.objects import AXES, CATALOGUE, grasp_object
from graspcascade.poses import rotate, rotation_angle
from graspcascade.postures import PosturePrior
from graspcascade.taxonomy import GRASP_TYPES, GraspType, grasp_type

N = 40
seeds = st.integers(0, 2**32 - 1)


def draw(hand: HandModel, prior: PosturePrior, seed: int, **options: Any) -> Grasps:
    rng = np.random.default_rng(seed)
    types, labels = rng.choice(list(GRASP_TYPES), N), rng.choice(list(CATALOGUE), N)
    postures, axes = prior.sample(types, rng), draw_sides(labels, rng)
    return candidates(hand, postures, types, labels, axes, rng, **options)


def pairs(hand: HandModel, grasps: Grasps) -> tuple[np.ndarray, np.ndarray]:
    """Locate each grasp's opposition pair, one at a time."""
    found = [hand.opposition(g.posture, grasp_type(str(g.grasp_type[0]))) for g in grasps]
    return np.concatenate([thumb for thumb, _ in found]), np.concatenate([other for _, other in found])


def body_axes(grasps: Grasps) -> np.ndarray:
    return np.eye(3)[[AXES.index(str(axis)) for axis in grasps.side_axis]]


@settings(max_examples=15)
@given(seed=seeds, free_angle=st.sampled_from(["uniform", "minimal"]))
def test_the_centre_is_in_the_middle_and_the_side_along_the_opposition(
    hand: HandModel, prior: PosturePrior, seed: int, free_angle: str
) -> None:
    grasps = draw(hand, prior, seed, free_angle=free_angle)
    thumb, other = pairs(hand, grasps)
    np.testing.assert_allclose(grasps.X_hand_object.position_m, (thumb + other) / 2, atol=1e-12)
    line = (other - thumb) / np.linalg.norm(other - thumb, axis=1, keepdims=True)
    along = rotate(grasps.X_hand_object.quat_wxyz, body_axes(grasps))
    np.testing.assert_allclose(np.abs((along * line).sum(axis=1)), 1, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(grasps.X_hand_object.quat_wxyz, axis=1), 1)
    assert (grasps.X_hand_object.quat_wxyz[:, 0] >= 0).all()


@settings(max_examples=15)
@given(seed=seeds)
def test_the_minimal_rotation_turns_no_farther_than_any_uniform_one(
    hand: HandModel, prior: PosturePrior, seed: int
) -> None:
    minimal, uniform = (draw(hand, prior, seed, free_angle=choice) for choice in ("minimal", "uniform"))
    np.testing.assert_array_equal(minimal.posture, uniform.posture)
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    least, other = (rotation_angle(g.X_hand_object.quat_wxyz, upright) for g in (minimal, uniform))
    assert (least <= other + 1e-9).all()
    thumb, index = pairs(hand, minimal)
    line = (index - thumb) / np.linalg.norm(index - thumb, axis=1, keepdims=True)
    between = np.arccos(np.clip(np.abs((line * body_axes(minimal)).sum(axis=1)), 0, 1))
    np.testing.assert_allclose(least, between, atol=1e-7)


def test_the_free_angle_is_uniform(hand: HandModel, prior: PosturePrior) -> None:
    n = 4000
    rng = np.random.default_rng(0)
    posture = np.repeat(prior.sample(["tripod"], rng), n, axis=0)
    kinds, labels, axes = np.full(n, "tripod"), np.full(n, "box_small"), np.full(n, "x")
    turned = candidates(hand, posture, kinds, labels, axes, rng)
    least = candidates(hand, posture[:1], kinds[:1], labels[:1], axes[:1], rng, free_angle="minimal")
    reference = rotate(least.X_hand_object.quat_wxyz, np.array([0.0, 1.0, 0.0]))[0]
    across = rotate(turned.X_hand_object.quat_wxyz, np.array([0.0, 1.0, 0.0]))
    line = rotate(least.X_hand_object.quat_wxyz, np.array([1.0, 0.0, 0.0]))[0]
    angle = np.arctan2(across @ np.cross(line, reference), across @ reference)
    counts, _ = np.histogram(angle, bins=16, range=(-np.pi, np.pi))
    chi_square = ((counts - n / 16) ** 2 / (n / 16)).sum()
    assert chi_square < 45, "15 degrees of freedom: one draw in 10,000 exceeds this"


@settings(max_examples=15)
@given(seed=seeds)
def test_columns_say_what_was_placed(hand: HandModel, prior: PosturePrior, seed: int) -> None:
    grasps = draw(hand, prior, seed)
    assert grasps.joint_names == hand.joint_names
    np.testing.assert_array_equal(grasps.posture, hand.executed(grasps.posture))
    np.testing.assert_array_equal(grasps.pregrasp, np.tile(hand.pregrasp, (N, 1)))
    np.testing.assert_array_equal(grasps.grasp_size_m, hand.grasp_size(grasps.posture))
    sides = [grasp_object(o).sides_m[a] for o, a in zip(grasps.object_label, grasps.side_axis, strict=True)]
    np.testing.assert_array_equal(grasps.side_m, sides)
    assert np.isnan(grasps.probability).all()
    assert np.isnan(grasps.object_size_m).all()


@settings(max_examples=15)
@given(seed=seeds)
def test_grasps_that_cannot_touch_are_those_wider_than_their_side(
    hand: HandModel, prior: PosturePrior, seed: int
) -> None:
    grasps = draw(hand, prior, seed)
    thumb, other = pairs(hand, grasps)
    np.testing.assert_array_equal(cannot_touch(hand, grasps), np.linalg.norm(other - thumb, axis=1) > grasps.side_m)


@settings(max_examples=5)
@given(seed=seeds)
def test_the_same_generator_draws_the_same_candidates(hand: HandModel, prior: PosturePrior, seed: int) -> None:
    first, second, other = (draw(hand, prior, s) for s in (seed, seed, seed + 1))
    for name, column in first.columns().items():
        np.testing.assert_array_equal(column, second.columns()[name], err_msg=name)
    assert not np.array_equal(first.X_hand_object.quat_wxyz, other.X_hand_object.quat_wxyz)


# Sides


@pytest.mark.parametrize("label", CATALOGUE)
def test_sides_are_drawn_uniformly_and_only_graspable_ones(label: str) -> None:
    n = 6000
    options = list(grasp_object(label).graspable_sides_m)
    drawn = draw_sides(np.full(n, label), np.random.default_rng(0))
    counts = np.array([(drawn == axis).sum() for axis in options])
    assert counts.sum() == n
    expected = n / len(options)
    assert ((counts - expected) ** 2 / expected).sum() < 20, "two degrees of freedom at most: once in 20,000 draws"


def test_sides_are_drawn_for_each_object_of_a_mixed_batch() -> None:
    labels = np.random.default_rng(1).choice(list(CATALOGUE), 500)
    for label, axis in zip(labels, draw_sides(labels, np.random.default_rng(2)), strict=True):
        assert axis in grasp_object(label).graspable_sides_m


def test_equivalent_axes_become_the_one_that_names_the_side(hand: HandModel) -> None:
    posture = hand.pregrasp[None].repeat(3, axis=0)
    labels, axes = ["cylinder_small", "sphere_small", "box_small"], ["y", "z", "y"]
    grasps = candidates(hand, posture, ["tripod"] * 3, labels, axes, np.random.default_rng(0))
    assert grasps.side_axis.tolist() == ["x", "x", "y"]


# Input


def place(hand: HandModel, kind: str = "tripod", label: str = "box_small", axis: str = "x", **options: Any) -> Grasps:
    return candidates(hand, hand.pregrasp[None], [kind], [label], [axis], np.random.default_rng(0), **options)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"kind": "tripodd"}, "unknown grasp type 'tripodd'. Did you mean 'tripod'"),
        ({"label": "box_smal"}, "unknown object 'box_smal'. Did you mean 'box_small'"),
        ({"axis": "w"}, "unknown side axis 'w'"),
        ({"label": "box_large", "axis": "z"}, "beyond the hand's reach"),
        ({"free_angle": "minimum"}, "unknown free angle 'minimum'. Did you mean 'minimal'"),
    ],
)
def test_what_cannot_be_placed_is_refused(hand: HandModel, wrong: dict[str, str], message: str) -> None:
    with pytest.raises(InputError) as caught:
        place(hand, **wrong)
    assert message in str(caught.value)


@pytest.mark.parametrize("kind", GRASP_TYPES.values(), ids=lambda kind: kind.name)
def test_a_hand_without_a_place_that_a_type_opposes_is_refused(hand: HandModel, kind: GraspType) -> None:
    for missing in kind.opposition:
        places = {name: place for name, place in SHADOW_HAND.places.items() if name != missing}
        lacking = replace(hand, description=replace(SHADOW_HAND, name="three_fingers", places=places))
        with pytest.raises(InputError) as caught:
            place(lacking, kind=kind.name)
        said = str(caught.value)
        assert f"hand three_fingers has no contact place {missing!r}, needed by " in said
        assert kind.name in said
        with pytest.raises(InputError, match=missing):
            lacking.closure(hand.pregrasp[None], [kind], np.zeros(1, dtype=np.intp))


def test_a_hand_needs_only_the_places_of_the_types_it_is_asked_for(hand: HandModel) -> None:
    pinch = grasp_type("tip_pinch")
    places = {name: SHADOW_HAND.places[name] for name in pinch.opposition}
    two_fingers = replace(hand, description=replace(SHADOW_HAND, places=places))
    np.testing.assert_array_equal(
        place(two_fingers, kind="tip_pinch").X_hand_object.position_m,
        place(hand, kind="tip_pinch").X_hand_object.position_m,
    )


def test_names_are_kept_as_the_tables_spell_them(hand: HandModel) -> None:
    grasps = place(hand, kind="Tip pinch", label="Box-Small")
    assert grasps.grasp_type.tolist() == ["tip_pinch"]
    assert grasps.object_label.tolist() == ["box_small"]


def test_columns_of_different_length_are_refused(hand: HandModel) -> None:
    with pytest.raises(InputError, match="got 1 postures, 2 types, 1 objects and 1 side axes"):
        candidates(hand, hand.pregrasp[None], ["tripod"] * 2, ["box_small"], ["x"], np.random.default_rng(0))
