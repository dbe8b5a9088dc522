"""The scorer of grasps: what it sees, what it learns, its file, and the proposals that ask it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspcascade.core.errors import FileFormatError, InputError
from graspcascade.core.families import FAMILIES
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import as_object
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.poses import Pose, canonical_quat, quat_multiply, rotation_angle
from graspcascade.core.protocols import HOLD, VARIED, Conditions
from graspcascade.core.tasks import Tasks, draw_tasks
from graspcascade.core.taxonomy import GRASP_TYPES
from graspcascade.hands import load_hand
from graspcascade.nets import TrainingSpec, load_decoders, save_decoders
from graspcascade.proposals import Proposal
from graspcascade.proposals.heuristic import Heuristic
from graspcascade.proposals.ranked import Disturbed, Ranked
from graspcascade.proposals.scorer import Scorer, Sight, View
from graspcascade.studies.dataset import Dataset
from graspcascade.studies.scoring import FittedScorer, Judgement, ScorerTraining, fit_scorer, without_errors

HAND = load_hand("shadow")
KINDS = [GRASP_TYPES["tripod"], GRASP_TYPES["tip_pinch"]]
VIEW = View.of(HAND, [kind.name for kind in KINDS])
BRIEF = ScorerTraining(
    Sight(closings=(1.0, 0.5)), (64,), TrainingSpec(epochs=30, batch_size=128, validation_fraction=0.0)
)


def drawn(n: int, seed: int = 0) -> Grasps:
    """Draw n grasps of each family and type."""
    rng = np.random.default_rng(seed)
    tasks = draw_tasks([(family, kind) for family in FAMILIES.values() for kind in KINDS], n, HAND.reach_m, rng)
    return Heuristic.pretrained().propose(tasks, rng)


def plain(n: int) -> Conditions:
    return Conditions.of(HOLD.physics, n)


@pytest.fixture(scope="module")
def fitted() -> FittedScorer:
    """Train on trials in which a grasp holds, most often, if the middle finger's pad comes near the object."""
    grasps = drawn(500)
    n, rng = len(grasps), np.random.default_rng(1)
    near = VIEW.encode(HAND, grasps, plain(n), is_exact=True)[:, list(HAND.places).index("middle_pad")]
    tripod, score = grasps.grasp_type == "tripod", np.empty(n)
    for rows in (tripod, ~tripod):
        score[rows] = (np.median(near[rows]) - near[rows]) / (0.4 * near[rows].std())
    held = rng.uniform(size=n) < 1 / (1 + np.exp(-score))
    outcomes = Outcomes.blank(n, len(HAND.joint_names), tuple(HAND.digits))
    outcomes.verdict[:] = np.where(held, "held", "dropped")
    outcomes.touching_end[:] = held[:, None]
    conditions = VARIED.conditions(n)
    return fit_scorer(HAND, [Dataset(grasps, outcomes, {"shards": []}, conditions)], BRIEF)


# What it sees


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_sphere_looks_the_same_however_it_is_turned(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tasks = draw_tasks([(as_object("sphere:40mm"), KINDS[0])], 4, HAND.reach_m, rng)
    grasps = Heuristic.pretrained().propose(tasks, rng)
    turned = canonical_quat(rng.standard_normal((4, 4)))
    other = replace(grasps, X_hand_object=Pose(grasps.X_hand_object.position_m, turned))
    seen, again = (VIEW.encode(HAND, each, plain(4), is_exact=True) for each in (grasps, other))
    np.testing.assert_allclose(again, seen, atol=2e-4)


def test_errors_are_seen_as_an_object_that_is_elsewhere() -> None:
    grasps, conditions = drawn(8), VARIED.conditions(48)
    assert conditions is not None
    unsized = replace(conditions, size_error_m=np.zeros(48))
    moved = Pose(
        grasps.X_hand_object.position_m + conditions.position_error_m,
        quat_multiply(conditions.rotation_error_quat_wxyz, grasps.X_hand_object.quat_wxyz),
    )
    seen = VIEW.encode(HAND, grasps, unsized, is_exact=True)
    there = VIEW.encode(HAND, replace(grasps, X_hand_object=moved), without_errors(unsized), is_exact=True)
    np.testing.assert_allclose(seen, there, atol=2e-4)


def test_a_larger_object_is_nearer_by_half_of_what_it_is_larger() -> None:
    grasps = drawn(4)
    n, points = len(grasps), len(VIEW.points)
    seen, larger = (
        VIEW.encode(HAND, grasps, Conditions.of(HOLD.physics, n, size_error_m=error), is_exact=True)
        for error in (0.0, 0.002)
    )
    np.testing.assert_allclose(seen[:, :points] - larger[:, :points], 0.001, atol=1e-6)


def test_friction_mass_gains_and_certainty_are_seen() -> None:
    grasps = drawn(2)
    n = len(grasps)
    base = VIEW.encode(HAND, grasps, plain(n), is_exact=False)
    for place, name in enumerate(("friction", "density_factor", "gain_factor")):
        about = Conditions.of(HOLD.physics, n, **{name: getattr(HOLD.physics, name) * 1.5})
        changed = (VIEW.encode(HAND, grasps, about, is_exact=False) != base).any(axis=0)
        assert np.flatnonzero(changed).tolist() == [VIEW.width(HAND) - 4 + place]
    certain = (VIEW.encode(HAND, grasps, plain(n), is_exact=True) != base).any(axis=0)
    assert np.flatnonzero(certain).tolist() == [VIEW.width(HAND) - 1]
    assert base.shape == (n, VIEW.width(HAND))


@pytest.mark.parametrize("sight", [Sight("shape"), Sight(gradients=False), Sight(conditions=False)])
def test_every_sight_has_the_width_that_it_says(sight: Sight) -> None:
    view, grasps = replace(VIEW, sight=sight), drawn(2)
    seen, lighter = (
        view.encode(HAND, grasps, Conditions.of(HOLD.physics, len(grasps), density_factor=factor), is_exact=True)
        for factor in (1.0, 0.5)
    )
    assert seen.shape == (len(grasps), view.width(HAND))
    assert (seen == lighter).all() == (not sight.conditions)


@pytest.mark.parametrize("closings", [(), (1.2,), (0.5, -0.1)])
def test_a_closing_is_a_share_of_the_way(closings: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="closings from 0 to 1"):
        Sight(closings=closings)


# What it learns


def test_it_learns_which_grasps_hold_and_how_sure_that_is(fitted: FittedScorer) -> None:
    for name, judged in fitted.judged.items():
        assert judged.n > 100, name
        assert judged.auc > 0.8, name
        assert judged.calibration_error < 0.1, name
        assert judged.rate_of_best_quarter > judged.rate + 0.2, name


def test_the_same_trials_train_the_same_scorer(fitted: FittedScorer) -> None:
    grasps = drawn(40)
    outcomes = Outcomes.blank(len(grasps), len(HAND.joint_names), tuple(HAND.digits))
    outcomes.verdict[::2] = "held"
    data = Dataset(grasps, outcomes, {"shards": []}, None)
    quick = replace(BRIEF, training=replace(BRIEF.training, epochs=1))
    first, second = (fit_scorer(HAND, [data], quick).scorer.fingerprint() for _ in range(2))
    assert first == second != fitted.scorer.fingerprint()


def test_a_perfect_and_a_blind_scorer_are_told_apart() -> None:
    happened = np.random.default_rng(0).uniform(size=3000) < 0.3
    perfect, blind = Judgement.of(happened.astype(float), happened), Judgement.of(np.full(3000, 0.3), happened)
    assert (perfect.auc, perfect.calibration_error, perfect.rate_of_best_quarter) == (1.0, 0.0, 1.0)
    assert blind.auc == pytest.approx(0.5)


# Its file


def test_a_scorer_survives_its_file(fitted: FittedScorer, tmp_path: Path) -> None:
    fitted.scorer.save(tmp_path)
    loaded, grasps = Scorer.load(tmp_path), drawn(3)
    assert loaded.view == fitted.scorer.view
    assert loaded.fingerprint() == fitted.scorer.fingerprint()
    for event in ("held", "faithful"):
        np.testing.assert_array_equal(
            getattr(loaded.chances(grasps), event), getattr(fitted.scorer.chances(grasps), event)
        )


@pytest.mark.parametrize(
    "change",
    [
        {"kind": "cascade"},
        {"view": {}},
        {"view": None},
        {"hand": {}},
        {"training": 3},
    ],
)
def test_a_doctored_scorer_is_refused_in_one_line(fitted: FittedScorer, tmp_path: Path, change: dict[str, Any]) -> None:
    fitted.scorer.save(tmp_path)
    file = tmp_path / "scorer.safetensors"
    stored = load_decoders(file)
    save_decoders(file, stored.decoders, {**stored.metadata, **change})
    with pytest.raises(FileFormatError) as caught:
        Scorer.load(file)
    assert len(str(caught.value).splitlines()) == 1


def test_a_view_that_the_weights_do_not_fit_is_refused(fitted: FittedScorer, tmp_path: Path) -> None:
    narrower = replace(fitted.scorer, view=replace(fitted.scorer.view, sight=Sight(closings=(1.0,))))
    narrower.save(tmp_path)
    with pytest.raises(FileFormatError, match="weights do not fit"):
        Scorer.load(tmp_path)


def test_types_and_joints_that_it_does_not_know_are_refused(fitted: FittedScorer) -> None:
    foreign = Heuristic.pretrained().sample("palmar_pinch", "box_small", "x", n=2)
    with pytest.raises(InputError, match="seen no grasps of type palmar_pinch; it knows tripod, tip_pinch"):
        fitted.scorer.chances(foreign)
    some = drawn(1)
    renamed = replace(some, joint_names=some.joint_names[::-1])
    with pytest.raises(InputError, match="the grasps are of others"):
        fitted.scorer.chances(renamed)
    assert not len(fitted.scorer.chances(drawn(1)[:0]).held)


# Ranked and disturbed proposals


@pytest.fixture(scope="module")
def ranked(fitted: FittedScorer) -> Ranked:
    return Ranked(Heuristic.pretrained(), fitted.scorer, good_enough=0.8)


class Recorded(Proposal):
    """The heuristic, remembering what was drawn."""

    def __init__(self) -> None:
        self.name, self.hand, self._heuristic = "recorded", HAND, Heuristic.pretrained()
        self.drawn: list[Grasps] = []

    def propose(self, tasks: Tasks, rng: np.random.Generator) -> Grasps:
        self.drawn.append(self._heuristic.propose(tasks, rng))
        return self.drawn[-1]


def test_ranked_grasps_are_good_enough_or_the_best_of_their_draws(ranked: Ranked) -> None:
    plain_ones = ranked.proposal.sample("tripod", "sphere:40mm", "x", n=300, seed=5)
    likely = ranked.sample("tripod", "sphere:40mm", "x", n=300, seed=5)
    before = ranked.chances(plain_ones)
    assert (likely.probability >= before).all()
    kept = before >= ranked.good_enough
    np.testing.assert_array_equal(likely.posture[kept], plain_ones.posture[kept])
    assert (likely.probability >= ranked.good_enough).mean() > kept.mean()


def test_of_a_hard_task_the_likeliest_of_all_draws_are_kept(ranked: Ranked) -> None:
    recorded = Recorded()
    hard = replace(ranked, proposal=recorded, good_enough=1.0, most_draws=3)
    kept = hard.sample("tripod", "sphere:40mm", "x", n=100).probability
    chances = np.concatenate([ranked.chances(grasps) for grasps in recorded.drawn])
    assert len(chances) == 300
    np.testing.assert_allclose(np.sort(kept), np.sort(chances)[-100:], atol=1e-6)


def test_of_several_tasks_each_keeps_the_likeliest_of_its_own_draws(ranked: Ranked) -> None:
    recorded, rng = Recorded(), np.random.default_rng(3)
    tasks = draw_tasks([(family, kind) for family in FAMILIES.values() for kind in KINDS], 4, HAND.reach_m, rng)
    kept = replace(ranked, proposal=recorded, good_enough=1.0).propose(tasks, rng)
    drawn = Grasps.concatenate(recorded.drawn)
    chances = ranked.chances(drawn)
    assert len(drawn) == ranked.most_draws * len(tasks)
    for row, task in enumerate(tasks):
        own = np.array([other == task for other in drawn.tasks])
        assert kept.probability[row] == pytest.approx(chances[own].max(), abs=1e-6)


def test_no_more_is_drawn_than_is_good_for(ranked: Ranked) -> None:
    easy, half = Recorded(), Recorded()
    replace(ranked, proposal=easy, good_enough=0.0).sample("tripod", "sphere:40mm", "x", n=200)
    assert sum(map(len, easy.drawn)) == 200
    before = np.sort(ranked.chances(easy.drawn[0]))
    replace(ranked, proposal=half, good_enough=float(before[100])).sample("tripod", "sphere:40mm", "x", n=200)
    assert 360 < sum(map(len, half.drawn)) < 520


def test_no_draw_is_kept_twice(ranked: Ranked) -> None:
    likely = ranked.sample("tripod", "sphere:40mm", "x", n=300)
    assert len(np.unique(likely.posture, axis=0)) == 300


def test_ranked_grasps_are_spread_as_the_draws_that_are_good_enough(ranked: Ranked) -> None:
    chance = ranked.chances(ranked.proposal.sample("tripod", "sphere:40mm", "x", n=4000, seed=1))
    bar = float(np.median(chance))
    kept = replace(ranked, good_enough=bar).sample("tripod", "sphere:40mm", "x", n=2000, seed=2).probability
    assert (kept >= bar).all()
    wanted = chance[chance >= bar]
    # Means of so many draws differ by chance by less than 5 standard errors.
    assert abs(kept.mean() - wanted.mean()) < 5 * wanted.std() * np.sqrt(1 / len(wanted) + 1 / len(kept))


def test_the_probability_that_comes_along_is_the_scorers(ranked: Ranked) -> None:
    likely = ranked.sample("tip_pinch", "box:20x30x40mm", n=50)
    np.testing.assert_allclose(ranked.chances(likely), likely.probability, atol=1e-6)


def test_ranking_keeps_every_task_in_its_row(ranked: Ranked) -> None:
    rng = np.random.default_rng(3)
    tasks = draw_tasks([(family, kind) for family in FAMILIES.values() for kind in KINDS], 5, HAND.reach_m, rng)
    assert ranked.propose(tasks, rng).tasks.same_as(tasks)


def test_one_draw_is_the_proposal_with_probabilities(ranked: Ranked) -> None:
    single = replace(ranked, most_draws=1).sample("tripod", "box_medium", "x", n=20)
    bare = ranked.proposal.sample("tripod", "box_medium", "x", n=20)
    assert np.isfinite(single.probability).all()
    np.testing.assert_array_equal(single.posture, bare.posture)


@pytest.mark.parametrize("change", [{"good_enough": 1.2}, {"most_draws": 0}, {"friction": -1.0}, {"gain_factor": 0.0}])
def test_a_ranking_out_of_range_is_refused(ranked: Ranked, change: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        replace(ranked, **change)


def test_disturbed_grasps_lie_about_those_of_the_proposal() -> None:
    disturbed = Disturbed(Heuristic.pretrained())
    near, bare = (each.sample("tripod", "sphere:40mm", "x", n=500, seed=2) for each in (disturbed, disturbed.proposal))
    moved = near.X_hand_object.position_m - bare.X_hand_object.position_m
    np.testing.assert_allclose(moved.std(axis=0), disturbed.position_sd_m, rtol=0.15)
    turned = rotation_angle(near.X_hand_object.quat_wxyz, bare.X_hand_object.quat_wxyz)
    np.testing.assert_allclose(np.sqrt((turned**2).mean() / 3), disturbed.rotation_sd_rad, rtol=0.15)
    assert 0.3 < (near.posture - bare.posture).std() / disturbed.posture_sd_rad < 1.1
    np.testing.assert_allclose(near.grasp_size_m, HAND.grasp_size(near.posture), atol=1e-9)
    assert disturbed.describe()["noise"]["position_sd_m"] == 0.003
