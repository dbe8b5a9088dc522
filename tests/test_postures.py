"""Seed postures that stay human, the human figures they follow, the contact metric, and the shipped prior."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.taxonomy import FEIX_TYPES, GRASP_TYPES
from graspcascade.hands import Hand
from graspcascade.nets import load_decoders, save_decoders
from graspcascade.proposals.prior import PosturePrior, type_codes
from graspcascade.studies.learn import PRIOR_TRAINING, contact_metric, fit_prior
from graspcascade.studies.postures import LabelledPostures
from graspcascade.studies.seeds import FEIX_SEEDS, SeedSpec, human_statistics, make_seeds, nearest_human_type

PER_TYPE = 24
SPEC = SeedSpec(per_type=PER_TYPE)
LETTERS = {"thumb": "TH", "index": "FF", "middle": "MF", "ring": "RF", "little": "LF"}
every_type = pytest.mark.parametrize("name", GRASP_TYPES)


@pytest.fixture(scope="module")
def seeds(hand: Hand) -> LabelledPostures:
    return make_seeds(hand, SPEC)


def postures_of(seeds: LabelledPostures, name: str) -> np.ndarray:
    return np.asarray(seeds.posture[seeds.grasp_type == name])


# Seeds


def test_every_type_gets_its_count(hand: Hand, seeds: LabelledPostures) -> None:
    assert seeds.joint_names == hand.joint_names
    assert len(seeds) == PER_TYPE * len(GRASP_TYPES)
    assert {name: (seeds.grasp_type == name).sum() for name in GRASP_TYPES} == dict.fromkeys(GRASP_TYPES, PER_TYPE)


@every_type
def test_seeds_reach_their_apertures_from_10_to_65_mm(hand: Hand, seeds: LabelledPostures, name: str) -> None:
    thumb, other = hand.opposition(postures_of(seeds, name), GRASP_TYPES[name])
    aperture = np.linalg.norm(other - thumb, axis=1)
    wanted = 0.010 + 0.055 * np.linspace(0, 1, PER_TYPE) ** SPEC.aperture_skew
    np.testing.assert_allclose(aperture, wanted, atol=0.0005)


@every_type
def test_supporting_places_lie_in_the_contact_plane_beside_the_index(
    hand: Hand, seeds: LabelledPostures, name: str
) -> None:
    kind, postures = GRASP_TYPES[name], postures_of(seeds, name)
    thumb, other = hand.opposition(postures, kind)
    axis = (other - thumb) / np.linalg.norm(other - thumb, axis=1, keepdims=True)
    places = hand.place_points(hand.executed(postures), list(kind.support))
    for rank, support in enumerate(kind.support):
        offset = places[support].point_m - other
        out_of_plane = (offset * axis).sum(axis=1)
        assert np.abs(out_of_plane).max() < 0.001, support
        beside = np.linalg.norm(offset - out_of_plane[:, None] * axis, axis=1)
        assert np.median(beside) < SPEC.support_reach_m * (1 + rank) + 0.003, support


@every_type
def test_opposing_pads_face_each_other(hand: Hand, seeds: LabelledPostures, name: str) -> None:
    kind, postures = GRASP_TYPES[name], postures_of(seeds, name)
    thumb, other = (
        hand.place_points(hand.executed(postures), list(kind.opposition))[place] for place in kind.opposition
    )
    line = other.point_m - thumb.point_m
    axis = line / np.linalg.norm(line, axis=1, keepdims=True)
    assert np.median((thumb.normal * axis).sum(axis=1)) > 0.7
    assert np.median((other.normal * -axis).sum(axis=1)) > 0.7


def test_seeds_are_inside_the_limits(hand: Hand, seeds: LabelledPostures) -> None:
    np.testing.assert_array_equal(hand.clip(seeds.posture), seeds.posture)
    assert seeds.n_clipped == 0


@every_type
def test_seeds_are_human_like(hand: Hand, seeds: LabelledPostures, name: str) -> None:
    """Compare means joint by joint: within one human standard deviation for 80 % of the joints of holding digits."""
    kind, human = GRASP_TYPES[name], human_statistics(name, hand.joint_names)
    letters = tuple(LETTERS[digit] for digit in kind.digits)
    holding = human.recorded & np.array([joint.startswith(letters) for joint in hand.joint_names])
    away = np.abs(postures_of(seeds, name).mean(axis=0) - human.mean) / human.sd
    assert (away[holding] < 1).mean() >= 0.8


# Seeds of Feix's types


@pytest.fixture(scope="module")
def feix_seeds(hand: Hand) -> LabelledPostures:
    return make_seeds(hand, replace(FEIX_SEEDS, per_type=PER_TYPE))


@every_type
def test_feix_seeds_reach_their_apertures_from_8_to_65_mm(hand: Hand, feix_seeds: LabelledPostures, name: str) -> None:
    thumb, other = hand.opposition(postures_of(feix_seeds, name), FEIX_TYPES[name])
    aperture = np.linalg.norm(other - thumb, axis=1)
    wanted = 0.008 + 0.057 * np.linspace(0, 1, PER_TYPE) ** FEIX_SEEDS.aperture_skew
    np.testing.assert_allclose(aperture, wanted, atol=0.0005)


@every_type
def test_all_fingers_of_a_feix_seed_meet_one_plane_with_the_part_that_the_type_names(
    hand: Hand, feix_seeds: LabelledPostures, name: str
) -> None:
    kind, postures = FEIX_TYPES[name], postures_of(feix_seeds, name)
    thumb, other = hand.opposition(postures, kind)
    axis = (other - thumb) / np.linalg.norm(other - thumb, axis=1, keepdims=True)
    places = hand.place_points(hand.executed(postures), [*kind.opposition[1:], *kind.support])
    for place in places.values():
        assert np.abs(((place.point_m - other) * axis).sum(axis=1)).max() < 0.002
        assert np.median((place.normal * -axis).sum(axis=1)) > 0.6


@every_type
def test_a_recorded_human_would_call_feix_seeds_by_their_type(
    hand: Hand, feix_seeds: LabelledPostures, name: str
) -> None:
    called = nearest_human_type(hand.executed(postures_of(feix_seeds, name)), hand.joint_names)
    assert (called == name).mean() >= 0.95


def test_human_means_are_called_by_their_own_type(hand: Hand) -> None:
    means = np.array([human_statistics(name, hand.joint_names).mean for name in GRASP_TYPES])
    assert nearest_human_type(means, hand.joint_names).tolist() == list(GRASP_TYPES)


def test_the_same_seed_makes_the_same_postures(hand: Hand) -> None:
    first, second, other = (make_seeds(hand, SeedSpec(per_type=2, seed=seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.posture, second.posture)
    assert not np.array_equal(first.posture, other.posture)


def test_progress_counts_every_seed(hand: Hand) -> None:
    counted: list[int] = []
    made = make_seeds(hand, SeedSpec(per_type=1), counted.append)
    assert sum(counted) == len(made) == 6


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"per_type": 0}, "per_type must be at least 1, got 0"),
        ({"seed": -1}, "seed must not be negative, got -1"),
        ({"aperture_min_m": -0.01}, "aperture_min_m -0.01 and"),
        ({"aperture_min_m": 0.07}, "the smallest no larger than the largest"),
        ({"aperture_max_m": np.inf}, "aperture_max_m inf"),
        ({"aperture_skew": -1.0}, "aperture_skew must be finite and not negative, got -1.0"),
        ({"human_weight": np.nan}, "human_weight must be finite"),
        ({"most_draws": 0}, "most_draws must be at least 1, got 0"),
        ({"taxonomy": "fiex"}, "feix"),
        *(
            ({f"{aim}_tolerance_m": value}, f"{aim}_tolerance_m must be at least 1e-09, got {value}")
            for aim in ("aperture", "support_plane", "support_reach")
            for value in (0.0, -0.001, np.nan)
        ),
    ],
)
def test_seed_settings_that_cannot_be_used_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        SeedSpec(**change)


@pytest.mark.parametrize(
    "change",
    [
        {"aperture_tolerance_m": 1e-9, "support_plane_tolerance_m": 1e-9, "support_reach_tolerance_m": 1e-9},
        {"aperture_min_m": 0.0, "aperture_max_m": 0.0, "aperture_skew": 0.0, "support_reach_m": 0.0},
        {"human_weight": 0.0, "normal_weight": 0.0, "draw_spread": 0.0, "seed": 2**63 - 1},
    ],
)
def test_seed_settings_at_the_end_of_their_range_can_be_used(hand: Hand, change: dict[str, Any]) -> None:
    assert np.isfinite(make_seeds(hand, SeedSpec(per_type=1, **change)).posture).all()


# Human figures


def test_human_figures_are_the_recorded_ones_in_radians(hand: Hand) -> None:
    tripod = human_statistics("tripod", hand.joint_names)
    assert tripod.n_grasps == 83
    column = hand.joint_names.index("FFJ1")
    figures = [np.degrees(getattr(tripod, name)[column]) for name in ("mean", "sd")]
    np.testing.assert_allclose(figures, [43.5, 12.9])
    writing = human_statistics("writing_tripod", hand.joint_names)
    assert writing.n_grasps == 13
    assert np.degrees(writing.mean[hand.joint_names.index("THJ5")]) == pytest.approx(19.6)


def test_376_grasps_were_recorded(hand: Hand) -> None:
    assert sum(human_statistics(name, hand.joint_names).n_grasps for name in GRASP_TYPES) == 376


def test_only_the_metacarpal_was_not_recorded_and_stays_near_zero(hand: Hand) -> None:
    human = human_statistics("tripod", hand.joint_names)
    unrecorded = [name for name, seen in zip(hand.joint_names, human.recorded, strict=True) if not seen]
    assert unrecorded == ["LFJ5"]
    assert human.mean[~human.recorded] == 0
    assert np.degrees(human.sd[~human.recorded]) == pytest.approx(5)


def test_figures_follow_the_joint_order_asked_for() -> None:
    forward, backward = (human_statistics("tip_pinch", names) for names in (("FFJ1", "THJ4"), ("THJ4", "FFJ1")))
    np.testing.assert_array_equal(forward.mean, backward.mean[::-1])


@every_type
def test_every_joint_has_a_spread(hand: Hand, name: str) -> None:
    assert (human_statistics(name, hand.joint_names).sd > 0).all()


# Contact metric


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(list(GRASP_TYPES)))
def test_the_metric_predicts_how_a_small_change_moves_the_contacts(hand: Hand, seed: int, name: str) -> None:
    kind, rng = GRASP_TYPES[name], np.random.default_rng(seed)
    inner = 0.1 * (hand.upper_rad - hand.lower_rad)
    posture = rng.uniform(hand.lower_rad + inner, hand.upper_rad - inner)[None]
    change = 1e-4 * rng.standard_normal(posture.shape)
    metric = contact_metric(hand, posture, np.array([name]))[0]

    def contacts(at: np.ndarray) -> np.ndarray:
        thumb, other = hand.opposition(at, kind)
        places = hand.place_points(hand.executed(at), list(kind.support))
        return np.concatenate([other - thumb, *(places[support].point_m - other for support in kind.support)], axis=1)[
            0
        ]

    moved = contacts(posture + change) - contacts(posture - change)
    predicted = metric @ (2 * change[0])
    np.testing.assert_allclose(predicted[: len(moved)], moved, atol=3e-9)
    assert not metric[len(moved) :].any(), "rows without a supporting place are zero"


def test_the_metric_knows_a_slope_at_the_limits(hand: Hand) -> None:
    metric = contact_metric(hand, hand.lower_rad[None], np.array(["tripod"]))[0]
    assert np.abs(metric[:3, hand.joint_names.index("FFJ2")]).max() > 0.01


def test_the_metric_of_a_mixed_batch_is_that_of_each_row(hand: Hand, seeds: LabelledPostures) -> None:
    rows = np.arange(0, len(seeds), 13)
    together = contact_metric(hand, seeds.posture[rows], seeds.grasp_type[rows])
    for place, row in enumerate(rows):
        alone = contact_metric(hand, seeds.posture[[row]], seeds.grasp_type[[row]])
        np.testing.assert_allclose(together[place], alone[0], atol=1e-7)


# Prior


def test_a_hand_without_a_little_finger_has_seeds_and_a_metric_of_all_its_types(cut_hands: Mapping[int, Hand]) -> None:
    hand = cut_hands[4]
    seeds = make_seeds(hand, SeedSpec(per_type=1))
    assert seeds.grasp_type.tolist() == [kind.name for kind in hand.grasp_types] == list(GRASP_TYPES)
    metric = contact_metric(hand, seeds.posture, seeds.grasp_type)
    n_rows = (np.abs(metric).max(axis=2) > 0).sum(axis=1)
    assert n_rows[list(GRASP_TYPES).index("parallel_extension")] == 9  # opposition, middle, ring


def test_a_prior_is_asked_only_for_types_that_it_was_trained_on(
    prior: PosturePrior, hand: Hand, seeds: LabelledPostures, tmp_path: Path
) -> None:
    assert prior.grasp_types == tuple(GRASP_TYPES)
    fewer = replace(
        seeds, posture=seeds.posture[seeds.grasp_type == "tripod"], grasp_type=np.array(["tripod"] * PER_TYPE)
    )
    fit_prior(hand, fewer, replace(PRIOR_TRAINING, epochs=1, min_steps=0)).save(tmp_path / "one.safetensors")
    one = PosturePrior.load(tmp_path / "one.safetensors")
    assert one.sample(["tripod"], np.random.default_rng(0)).shape == (1, 22)
    with pytest.raises(InputError, match="no postures of tip_pinch; it knows tripod"):
        one.sample(["tripod", "tip_pinch"], np.random.default_rng(0))


@pytest.mark.parametrize("change", [{"joint_names": ["a"]}, {"joint_names": None}, {"grasp_types": ["grab"]}])
def test_a_doctored_prior_is_refused(prior: PosturePrior, tmp_path: Path, change: dict[str, Any]) -> None:
    prior.save(tmp_path / "p.safetensors")
    stored = load_decoders(tmp_path / "p.safetensors")
    save_decoders(tmp_path / "p.safetensors", stored.decoders, {**stored.metadata, **change})
    with pytest.raises(FileFormatError, match=r"p\.safetensors"):
        PosturePrior.load(tmp_path / "p.safetensors")


def test_a_prior_is_not_trained_on_postures_of_other_joints(hand: Hand, seeds: LabelledPostures) -> None:
    training = replace(PRIOR_TRAINING, epochs=1, min_steps=0)
    turned = replace(seeds, joint_names=seeds.joint_names[::-1], posture=seeds.posture[:, ::-1])
    fewer = replace(seeds, joint_names=seeds.joint_names[1:], posture=seeds.posture[:, 1:])
    for other in (turned, fewer):
        with pytest.raises(InputError, match=f"labelled postures are of the joints {other.joint_names[0]}, "):
            fit_prior(hand, other, training)
    assert fit_prior(hand, seeds, training).joint_names == hand.joint_names


def test_a_few_recordings_get_the_steps_that_the_default_seeds_get() -> None:
    assert PRIOR_TRAINING.epochs_of(1200 // PRIOR_TRAINING.batch_size) == PRIOR_TRAINING.epochs
    assert PRIOR_TRAINING.epochs_of(376 // PRIOR_TRAINING.batch_size) >= 2000


def test_the_shipped_prior_fits_the_hand(hand: Hand, prior: PosturePrior) -> None:
    assert prior.joint_names == hand.joint_names
    assert prior.metadata["hand"] == hand.name
    assert prior.metadata["n_postures"] >= 84 * len(GRASP_TYPES)


@every_type
def test_the_prior_draws_varied_postures_of_its_type(hand: Hand, prior: PosturePrior, name: str) -> None:
    drawn = prior.sample(np.full(400, name), np.random.default_rng(0))
    assert drawn.shape == (400, len(hand.joint_names))
    assert np.isfinite(drawn).all()
    assert np.abs(drawn - hand.clip(drawn)).max() < 0.6
    thumb, other = hand.opposition(drawn, GRASP_TYPES[name])
    aperture = np.linalg.norm(other - thumb, axis=1)
    assert np.percentile(aperture, 90) - np.percentile(aperture, 10) > 0.02
    assert aperture.min() > 0
    assert np.percentile(aperture, 99) < 0.08


@given(seed=st.integers(0, 2**32 - 1))
def test_the_prior_repeats_itself(prior: PosturePrior, seed: int) -> None:
    types = list(GRASP_TYPES)
    first, second = (prior.sample(types, np.random.default_rng(seed)) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_a_fingerprint_names_the_weights(prior: PosturePrior, tmp_path: Path) -> None:
    assert len(prior.fingerprint()) == 16
    assert PosturePrior.pretrained().fingerprint() == prior.fingerprint()
    prior.save(tmp_path / "copy.safetensors")
    copy = PosturePrior.load(tmp_path / "copy.safetensors")
    assert copy.fingerprint() == prior.fingerprint()
    assert copy.joint_names == prior.joint_names
    assert copy.metadata == prior.metadata
    types = list(GRASP_TYPES)
    np.testing.assert_array_equal(
        copy.sample(types, np.random.default_rng(0)), prior.sample(types, np.random.default_rng(0))
    )


def test_type_codes_are_one_hot_in_the_order_of_the_known_types() -> None:
    known = ("tip_pinch", "tripod")
    np.testing.assert_array_equal(type_codes(["Tip pinch", "tripod", "tip_pinch"], known), np.eye(2)[[0, 1, 0]])
    with pytest.raises(InputError, match=r"Did you mean 'tripod'"):
        type_codes(["tripodd"], known)


def test_a_truncated_or_foreign_prior_is_refused(prior: PosturePrior, tmp_path: Path) -> None:
    prior.save(tmp_path / "whole.safetensors")
    cut = tmp_path / "cut.safetensors"
    cut.write_bytes((tmp_path / "whole.safetensors").read_bytes()[:1000])
    foreign = tmp_path / "foreign.safetensors"
    save_decoders(foreign, {"posture": prior.decoder}, {"joint_names": list(prior.joint_names)})
    nameless = tmp_path / "nameless.safetensors"
    save_decoders(nameless, {"prior": prior.decoder}, {})
    for path in (cut, foreign, nameless):
        with pytest.raises(FileFormatError, match=path.name):
            PosturePrior.load(path)
    with pytest.raises(InputError, match="no file"):
        PosturePrior.load(tmp_path / "absent.safetensors")
