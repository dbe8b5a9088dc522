"""Trials with other hands: two, three and four digits cut out of the Shadow Hand, and other models of it."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import as_object
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.poses import Pose
from graspcascade.core.protocols import Protocol
from graspcascade.core.tasks import Task, Tasks, draw_tasks
from graspcascade.core.taxonomy import DIGITS
from graspcascade.engines import run_trials
from graspcascade.engines.mujoco.creep import FAST_FORWARD
from graspcascade.engines.mujoco.idle import idle_sets
from graspcascade.hands import Hand, load_hand
from graspcascade.proposals.heuristic import Heuristic, Screened
from graspcascade.studies.dataset import to_columns
from hand_files import (
    SHADOW_MJCF,
    actuator_line,
    cut_grasps,
    edited,
    shadow_entries,
    write_hand,
)
from test_engine_trials import assert_areas_fit_contacts, assert_same

OBJECTS = [as_object(name) for name in ("box:24x33x52mm", "cylinder:27x80mm", "sphere_medium")]
each_hand = pytest.mark.parametrize("n_digits", [2, 3, 4])


@pytest.fixture(scope="module")
def proposed(cut_hands: Mapping[int, Hand], prior: Any) -> dict[int, Grasps]:
    """Draw three grasps of every type that each smaller hand can make, for each of three objects."""
    made = {}
    for n, hand in cut_hands.items():
        cells = [(obj, kind) for obj in OBJECTS for kind in hand.grasp_types]
        rng = np.random.default_rng(n)
        tasks = draw_tasks(cells, 3, hand.reach_m, rng)
        made[n] = Screened(Heuristic(hand, prior), 50).propose(tasks, rng)
    return made


@pytest.fixture(scope="module")
def tried(cut_hands: Mapping[int, Hand], proposed: dict[int, Grasps], short: Protocol) -> dict[int, Outcomes]:
    return {n: run_trials(grasps, short, hand=cut_hands[n]) for n, grasps in proposed.items()}


@each_hand
def test_a_smaller_hand_is_read_with_its_digits_joints_and_actuators(
    cut_hands: Mapping[int, Hand], n_digits: int
) -> None:
    hand = cut_hands[n_digits]
    assert tuple(hand.digits) == DIGITS[:n_digits]
    assert len(hand.joint_names) == {2: 9, 3: 13, 4: 17}[n_digits]
    assert [c.joints for c in hand.couplings] == [
        (f"{finger}J2", f"{finger}J1") for finger in ("FF", "MF", "RF")[: n_digits - 1]
    ]
    assert len(hand.actuators) == len(hand.joint_names) - (n_digits - 1) + len(hand.wrist_joints)


@each_hand
def test_a_smaller_hand_holds_what_it_can(tried: dict[int, Outcomes], n_digits: int) -> None:
    assert tried[n_digits].held.mean() > 0.2
    assert "unstable" not in tried[n_digits].verdict


@each_hand
def test_contacts_are_those_of_the_digits_the_hand_has(
    cut_hands: Mapping[int, Hand], proposed: dict[int, Grasps], tried: dict[int, Outcomes], n_digits: int
) -> None:
    outcomes = tried[n_digits]
    digits = DIGITS[:n_digits]
    assert outcomes.touch_columns == (*digits, "palm")
    assert outcomes.touching_end.shape == (len(outcomes), n_digits + 1)
    assert outcomes.touching_end[outcomes.held, 0].all()
    assert outcomes.faithful(proposed[n_digits]).any()
    assert_areas_fit_contacts(outcomes)
    columns = to_columns(proposed[n_digits], outcomes)
    assert [name for name in columns if name.startswith("touch_end_")] == [
        f"touch_end_{name}" for name in outcomes.touch_columns
    ]
    assert [name for name in columns if name.startswith("posture_")] == [
        f"posture_{name}" for name in cut_hands[n_digits].joint_names
    ]


@each_hand
def test_types_that_a_hand_cannot_make_are_refused_with_those_it_can(
    cut_hands: Mapping[int, Hand], prior: Any, n_digits: int
) -> None:
    hand = cut_hands[n_digits]
    heuristic = Heuristic(hand, prior)
    task = Tasks.repeat(Task.of("tripod", "sphere_small", "x"), 2)
    if n_digits > 2:
        assert len(heuristic.propose(task, np.random.default_rng(0))) == 2
        return
    with pytest.raises(InputError, match=r"cannot make a tripod.*Possible types: palmar_pinch, tip_pinch\.$") as caught:
        heuristic.propose(task, np.random.default_rng(0))
    assert "\n" not in str(caught.value)


@each_hand
def test_outcomes_of_a_smaller_hand_do_not_depend_on_threads_slots_or_order(
    cut_hands: Mapping[int, Hand],
    proposed: dict[int, Grasps],
    tried: dict[int, Outcomes],
    short: Protocol,
    n_digits: int,
) -> None:
    order = np.random.default_rng(0).permutation(len(proposed[n_digits]))
    shuffled = run_trials(proposed[n_digits][order], short, hand=cut_hands[n_digits], n_threads=2, n_slots=5)
    assert_same(shuffled, tried[n_digits][order])


@each_hand
def test_abridged_trials_of_a_smaller_hand_end_like_those_in_full(
    cut_hands: Mapping[int, Hand], proposed: dict[int, Grasps], n_digits: int
) -> None:
    some = proposed[n_digits][::3]
    full = run_trials(some, hand=cut_hands[n_digits])
    abridged = run_trials(some, hand=cut_hands[n_digits], creep=FAST_FORWARD)
    assert (full.held != abridged.held).sum() <= 1


def test_digits_that_may_be_left_out_are_those_of_the_hand(cut_hands: Mapping[int, Hand], hand: Hand) -> None:
    assert idle_sets(hand) == [("middle", "ring", "little"), ("ring", "little")]
    assert [idle_sets(cut_hands[n]) for n in (4, 3, 2)] == [[("middle", "ring"), ("ring",)], [("middle",)], []]


def test_without_a_digit_that_never_touched_a_grasp_ends_as_with_it(
    cut_hands: Mapping[int, Hand], drawn: Grasps, outcomes: Outcomes, short: Protocol
) -> None:
    untouched = ~(outcomes.touching_closed | outcomes.touching_end)[:, [DIGITS.index("little"), len(DIGITS)]].any(
        axis=1
    )
    rows = np.flatnonzero(untouched & (outcomes.verdict != "overlap"))
    assert len(rows) > 20
    four = run_trials(cut_grasps(drawn, cut_hands[4], rows), short, hand=cut_hands[4])
    assert np.mean(four.verdict == outcomes.verdict[rows]) > 0.9
    assert np.mean(four.touching_closed[:, :4] == outcomes.touching_closed[rows][:, :4]) > 0.95


def test_an_observer_sees_the_joints_of_a_smaller_hand(
    cut_hands: Mapping[int, Hand], proposed: dict[int, Grasps], tried: dict[int, Outcomes], short: Protocol
) -> None:
    seen: list[tuple[int, ...]] = []
    observed = run_trials(
        proposed[2][:4],
        short,
        hand=cut_hands[2],
        observe=lambda rows, _steps, angles, _poses: seen.append(angles.shape[1:]),
    )
    assert set(seen) == {(9,)}
    np.testing.assert_array_equal(observed.verdict, tried[2].verdict[:4])


def test_grasps_of_another_hand_are_refused_with_the_joints_that_differ(
    cut_hands: Mapping[int, Hand], proposed: dict[int, Grasps], drawn: Grasps, short: Protocol
) -> None:
    with pytest.raises(InputError, match="hand_of_2 has no joints MFJ4, "):
        run_trials(drawn[:2], short, hand=cut_hands[2])
    with pytest.raises(InputError, match="the grasps lack joints of shadow_hand_right: MFJ4, "):
        run_trials(proposed[2][:2], short, hand="shadow")
    with pytest.raises(InputError, match="hand 'hand_of_2' is not shipped; give its file"):
        run_trials(proposed[2][:2], short)


# -- other models of the same hand


def test_a_model_with_prefixed_names_judges_bit_for_bit_the_same(
    tmp_path: Path, drawn: Grasps, outcomes: Outcomes, short: Protocol
) -> None:
    text = re.sub(r'\b(name|joint|joint1|tendon|body1|body2)="([A-Za-z]\w*)"', r'\1="rh_\2"', SHADOW_MJCF.read_text())
    prefixed = load_hand(write_hand(tmp_path, text, name="prefixed", prefix="rh_"))
    assert_same(run_trials(drawn[::4], short, hand=prefixed), outcomes[::4])


def in_free_air(grasps: Grasps) -> Grasps:
    far = np.tile([0.0, -0.5, 0.1], (len(grasps), 1))
    return replace(grasps, X_hand_object=Pose(far, grasps.X_hand_object.quat_wxyz))


COUPLINGS = {name: pair for name, pair in shadow_entries()["couplings"].items() if name != "FFJ0"}
TENDON = '<fixed name="FFJ0"><joint joint="FFJ2" coef="1"/><joint joint="FFJ1" coef="1"/></fixed>'
TIE = '</tendon><equality><joint name="tie" joint1="FFJ1" joint2="FFJ2" polycoef="0.1 0.5 0 0 0"/></equality>'
MODELS = {
    "as it is": ([], {}),
    "weighted tendon": ([('"FFJ1" coef="1"', '"FFJ1" coef="0.5"')], {}),
    "tied joint": (
        [
            (TENDON, ""),
            (actuator_line("FFJ0"), '<position name="FFJ2" joint="FFJ2" kp="1" inheritrange="1"/>'),
            ("</tendon>", TIE),
        ],
        {"couplings": COUPLINGS},
    ),
    "no range": ([(actuator_line("FFJ3"), '<position name="FFJ3" joint="FFJ3" kp="1"/>')], {}),
}


@pytest.mark.parametrize("model", MODELS)
def test_touching_nothing_the_index_finger_ends_where_the_hand_says_it_is_executed(
    tmp_path: Path, drawn: Grasps, short: Protocol, model: str
) -> None:
    changes, entries = MODELS[model]
    hand = load_hand(write_hand(tmp_path, edited(*changes), name=model, **entries))
    bent = in_free_air(drawn[:3])
    index = [hand.joint_names.index(name) for name in ("FFJ4", "FFJ3", "FFJ2", "FFJ1")]
    posture = np.tile(hand.pregrasp, (3, 1))
    posture[:, index] = [[0.1, 0.2, 0.3, 0.5], [-0.1, 0.5, 0.6, 0.2], [0.0, 0.8, 0.9, 0.9]]
    tried = run_trials(replace(bent, posture=posture), short, hand=hand)
    assert set(tried.verdict) == {"missed"}
    expected = hand.executed(posture)
    np.testing.assert_allclose(tried.settled_posture[:, index], expected[:, index], atol=0.03)
