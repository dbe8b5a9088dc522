"""Trials that push the object in six directions: their physics, their criterion, and that every attempt starts anew."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import as_object
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.poses import rotate
from graspcascade.core.protocols import (
    DIRECTIONS,
    HOLD,
    SIX_DIRECTIONS,
    Carry,
    Close,
    Conditions,
    Protocol,
    Push,
    Squeeze,
)
from graspcascade.engines import as_engine, run_trials
from graspcascade.engines.mujoco.creep import FAST_FORWARD
from graspcascade.hands import Hand
from graspcascade.worlds.world import build_world
from test_engine_trials import assert_areas_fit_contacts, assert_same, with_object_at

ROWS = [1, 3, 4, 9, 12, 16, 18, 35, 37, 46, 49, 52]
"""Grasps of every type, of which some hold, some miss and some fail by either limit."""
STEP_S, ATTEMPT_S = 0.004, 2.8
FAR = [0.0, -0.5, 0.1]
BRIEF = replace(
    SIX_DIRECTIONS,
    name="brief",
    phases=tuple(phase for way in ("-x", "+z") for phase in (Close(0.4, 0.0), Squeeze(0.4), Push(way, 1.0, 0.3))),
)


@pytest.fixture(scope="module")
def some(drawn: Grasps) -> Grasps:
    return drawn[ROWS]


@pytest.fixture(scope="module")
def pushed(some: Grasps) -> Outcomes:
    return run_trials(some, SIX_DIRECTIONS)


@pytest.fixture(scope="module")
def briefly(some: Grasps) -> Outcomes:
    return run_trials(some, BRIEF)


def alone(direction: str) -> Protocol:
    place = 3 * list(DIRECTIONS).index(direction)
    return replace(SIX_DIRECTIONS, name=direction, phases=SIX_DIRECTIONS.phases[place : place + 3])


# -- the criterion


def test_some_hold_in_all_directions_and_the_others_say_which_limit_they_exceeded(pushed: Outcomes) -> None:
    assert set(pushed.verdict) == {"held", "missed", "pushed_out", "turned"}
    away, turned = pushed.displacement_m, pushed.turn_rad
    for verdict, beyond in (("held", (False, False)), ("turned", (False, True))):
        rows = pushed.verdict == verdict
        assert ((away[rows] > 0.050) == beyond[0]).all()
        assert ((turned[rows] > np.radians(15.0)) == beyond[1]).all()
    assert (away[pushed.verdict == "pushed_out"] > 0.050).all()
    np.testing.assert_allclose(pushed.duration_s[pushed.held], 6 * ATTEMPT_S)
    assert (pushed.duration_s[~pushed.held] < 6 * ATTEMPT_S).all()
    assert pushed.touching_end[pushed.held].any(axis=1).all()
    assert not pushed.touching_end[~pushed.held].any()
    np.testing.assert_array_equal(pushed.steady, pushed.held)


def test_each_digit_that_touches_has_an_area_and_no_other(pushed: Outcomes) -> None:
    assert pushed.touching_closed.any()
    assert pushed.touching_end.any()
    assert_areas_fit_contacts(pushed)


def test_a_looser_limit_lets_what_had_turned_go_on(some: Grasps, pushed: Outcomes) -> None:
    rows = np.flatnonzero(pushed.verdict == "turned")
    loose = replace(SIX_DIRECTIONS, name="loose", turn_rad=3.1)
    assert (run_trials(some[rows], loose).duration_s > pushed.duration_s[rows]).all()
    tight = replace(SIX_DIRECTIONS, name="tight", displacement_m=0.001)
    assert set(run_trials(some[rows], tight).verdict) == {"pushed_out"}


@pytest.mark.parametrize(("depth_m", "overlaps"), [(0.009, False), (0.011, True)])
def test_a_hand_may_start_ten_millimetres_deep(drawn: Grasps, depth_m: float, overlaps: bool) -> None:
    sphere = drawn[drawn.object_name == "sphere_medium"][:1]
    back_of_the_palm_m, radius_m = 0.0117, 0.0225
    behind = with_object_at(sphere, [0.011, back_of_the_palm_m + radius_m - depth_m, 0.04])
    outcomes = run_trials(behind, SIX_DIRECTIONS)
    assert (outcomes.verdict[0] == "overlap") == overlaps


# -- how a trial starts


def test_contact_is_where_closing_under_hold_ends(some: Grasps, pushed: Outcomes) -> None:
    closed = run_trials(some, HOLD)
    np.testing.assert_array_equal(pushed.verdict == "missed", closed.verdict == "missed")
    for name in ("settled_posture", "touching_closed", "object_size_m"):
        np.testing.assert_array_equal(getattr(pushed, name), getattr(closed, name))
    missed = pushed.verdict == "missed"
    assert not pushed.duration_s[missed].any()
    theirs = closed.X_hand_object_settled
    np.testing.assert_array_equal(pushed.X_hand_object_settled.position_m, theirs.position_m)
    np.testing.assert_array_equal(pushed.X_hand_object_settled.quat_wxyz, theirs.quat_wxyz)


def test_every_direction_goes_as_in_a_trial_of_its_own(some: Grasps, pushed: Outcomes) -> None:
    single = {name: run_trials(some, alone(name)) for name in DIRECTIONS}
    held = np.stack([outcomes.held for outcomes in single.values()])
    np.testing.assert_array_equal(pushed.held, held.all(axis=0))
    for row in np.flatnonzero(pushed.held):
        for name in ("displacement_m", "turn_rad"):
            assert getattr(pushed, name)[row] == max(getattr(outcomes, name)[row] for outcomes in single.values())
        np.testing.assert_array_equal(pushed.touching_end[row], single["+z"].touching_end[row])
    for row in np.flatnonzero(~pushed.held & (pushed.verdict != "missed")):
        first = int(np.argmin(held[:, row]))
        outcomes = single[list(DIRECTIONS)[first]]
        assert pushed.verdict[row] == outcomes.verdict[row]
        assert pushed.duration_s[row] == pytest.approx(first * ATTEMPT_S + outcomes.duration_s[row])


def test_every_attempt_starts_with_the_open_hand_and_the_object_back(some: Grasps, pushed: Outcomes) -> None:
    seen: dict[int, Any] = {}

    def observe(rows: Any, steps: Any, posture: Any, pose: Any) -> None:
        for row, step, joints, place in zip(rows.tolist(), steps.tolist(), posture, pose, strict=True):
            seen[row, step] = joints.copy(), place.copy()

    row = int(np.flatnonzero(pushed.held)[0])
    assert_same(run_trials(some, SIX_DIRECTIONS, observe=observe), pushed)
    # The observer comes by every five steps; the attempts differ only once the push begins, 200 steps on.
    for step in range(5, 205, 5):
        for attempt in range(1, 6):
            for now, first in zip(seen[row, step + 700 * attempt], seen[row, step], strict=True):
                np.testing.assert_array_equal(now, first)
    assert not np.array_equal(seen[row, 700][1], seen[row, 1400][1])


# -- the pushes


@pytest.mark.parametrize("direction", list(DIRECTIONS))
def test_a_free_object_of_any_size_is_pushed_by_one_newton_at_its_centre(drawn: Grasps, direction: str) -> None:
    free, poses, n = with_object_at(drawn[[0, 2, 3, 6]], FAR), np.zeros((4, 7)), 50
    start = replace(SIX_DIRECTIONS, name="free", contact_by=None, phases=(Close(0.004, 0.0), Push(direction, 1.0, 0.2)))

    def observe(rows: Any, _steps: Any, _posture: Any, pose: Any) -> None:
        poses[rows] = pose

    outcomes = run_trials(free, replace(start, displacement_m=1.0), observe=observe)
    way_m = 1.0 / 0.100 * STEP_S**2 * n * (n + 1) / 2
    pushed = rotate(free.X_hand_object.quat_wxyz, np.array(DIRECTIONS[direction])) * way_m
    np.testing.assert_allclose(poses[:, :3] - np.array(FAR), pushed, atol=1e-9)
    np.testing.assert_allclose(outcomes.displacement_m, way_m)
    np.testing.assert_allclose(outcomes.turn_rad, 0.0, atol=1e-7)


def test_a_push_ends_with_its_phase(drawn: Grasps) -> None:
    free, n = with_object_at(drawn[:1], FAR), 25
    pushed = (Close(0.004, 0.0), Push("+x", 1.0, n * STEP_S))
    protocol = replace(SIX_DIRECTIONS, name="free", contact_by=None, displacement_m=1.0, phases=pushed)
    coasting = replace(protocol, phases=(*pushed, Carry(n * STEP_S, 0.0)))
    ways_m = [run_trials(free, each).displacement_m[0] for each in (protocol, coasting)]
    np.testing.assert_allclose(ways_m, STEP_S**2 * 10.0 * np.array([n * (n + 1) / 2, n * (n + 1) / 2 + n * n]))


def test_an_object_weighs_as_much_as_its_trial_says(drawn: Grasps) -> None:
    free = with_object_at(drawn[[0, 2, 3, 6]], FAR)
    protocol = replace(SIX_DIRECTIONS, contact_by=None, phases=(Close(0.004, 0.0), Push("+x", 1.0, 0.2)))
    conditions = Conditions.of(protocol.physics, 4, density_factor=[1.0, 2.0, 4.0, 1.0], size_error_m=[0, 0, 0, 0.001])
    way_m = run_trials(free, replace(protocol, displacement_m=1.0), conditions=conditions).displacement_m
    np.testing.assert_allclose(way_m / way_m[0], [1.0, 0.5, 0.25, 1.0])


# -- physics and conditions


@pytest.mark.parametrize("name", ["box_small", "sphere_large", "cylinder:12x140mm"])
def test_mass_gains_force_limits_and_joint_friction_are_the_protocols(hand: Hand, name: str) -> None:
    model = build_world(hand, as_object(name), SIX_DIRECTIONS.physics).model
    assert model.body("object").mass[0] == pytest.approx(0.100)
    assert (model.actuator_gainprm[:, 0] == 5.0).all()
    assert (model.actuator_biasprm[:, 1] == -5.0).all()
    assert model.actuator_forcelimited.all()
    np.testing.assert_array_equal(model.actuator_forcerange, [[-3.0, 3.0]] * model.nu)
    hinges = model.jnt_dofadr[model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE]
    assert (model.dof_frictionloss[hinges] == 0.01).all()
    assert model.dof_frictionloss.sum() == pytest.approx(0.01 * len(hinges))


def test_conditions_of_one_trial_are_the_physics_of_a_batch(some: Grasps, briefly: Outcomes) -> None:
    own = BRIEF.physics
    assert_same(run_trials(some, BRIEF, conditions=Conditions.of(own, len(some))), briefly)
    harder = {"friction": 0.4, "density_factor": 2.0, "gain_factor": 0.5}
    batch = run_trials(some[::2], BRIEF.with_physics("harder", **harder))
    mixed = Conditions.of(own, len(some), **{k: np.tile([v, getattr(own, k)], 6) for k, v in harder.items()})
    tried = run_trials(some, BRIEF, conditions=mixed)
    assert_same(tried[::2], batch)
    assert_same(tried[1::2], briefly[1::2])


def test_errors_of_the_pose_count_once(some: Grasps, briefly: Outcomes) -> None:
    shift = np.array([0.002, 0.0, -0.001])
    moved = with_object_at(some, some.X_hand_object.position_m + shift)
    conditions = Conditions.of(BRIEF.physics, len(some), position_error_m=shift)
    by_error, by_place = run_trials(some, BRIEF, conditions=conditions), run_trials(moved, BRIEF)
    assert_same(by_error, by_place)
    assert not np.array_equal(by_place.settled_posture, briefly.settled_posture)


# -- batches


def test_outcomes_depend_on_neither_slots_nor_threads_nor_order_nor_abridging(some: Grasps, briefly: Outcomes) -> None:
    for options in ({"n_slots": 5, "n_threads": 1}, {"n_threads": 3}, {"creep": FAST_FORWARD}):
        assert_same(run_trials(some[::-1], BRIEF, **options)[::-1], briefly)


def test_progress_counts_every_trial_once(hand: Hand, some: Grasps) -> None:
    counts: list[int] = []
    as_engine(n_slots=4).run(hand, some, BRIEF, progress=counts.append)
    assert sum(counts) == len(some)
    assert len(counts) > 2
