"""Digits left out of a trial while nothing comes near them."""

import mujoco
import numpy as np
import pytest

from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import as_object
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.protocols import PAPER, Protocol
from graspcascade.engines import run_trials
from graspcascade.engines.mujoco import runner as module
from graspcascade.engines.mujoco.idle import IdleFinder, idle_sets, object_moved
from graspcascade.engines.mujoco.slots import SlotGroup
from graspcascade.hands import load_hand
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.worlds.world import shared_world

HAND = load_hand("shadow")
JOINTS = list(HAND.joint_names)
SPHERE = as_object("sphere_small")
WHOLE = shared_world(HAND, SPHERE, PAPER.physics, True)
IDLE_SETS = idle_sets(HAND)
RADIUS_M = np.array([0.015])


def state(object_at: tuple[float, float, float], **angles: float) -> np.ndarray:
    """Make a state of the whole world: the hand flat but for some joints, the object somewhere."""
    qpos = mujoco.MjData(WHOLE.model).qpos.copy()
    for name, angle in angles.items():
        qpos[WHOLE.joint_qpos[JOINTS.index(name)]] = angle
    qpos[WHOLE.object_qpos : WHOLE.object_qpos + 3] = object_at
    return qpos


def addresses(place: int) -> np.ndarray:
    """Locate where the state of a world without a set of digits stands in that of the whole world."""
    part = shared_world(HAND, SPHERE, PAPER.physics, True, IDLE_SETS[place])
    names = [part.model.joint(i).name for i in range(part.model.njnt)]
    places = np.empty(part.model.nq, dtype=np.intp)
    for name in names:
        mine, theirs = part.model.joint(name), WHOLE.model.joint(name)
        width = 7 if name == "object" else 1
        places[mine.qposadr[0] : mine.qposadr[0] + width] = np.arange(theirs.qposadr[0], theirs.qposadr[0] + width)
    return places


@pytest.mark.parametrize("without", IDLE_SETS)
def test_a_world_without_digits_has_all_the_rest(without: tuple[str, ...]) -> None:
    part = shared_world(HAND, SPHERE, PAPER.physics, True, without)
    prefixes = {"middle": "MF", "ring": "RF", "little": "LF"}
    gone = tuple(prefixes[digit] for digit in without)
    # The joint of the little finger's metacarpal moves a part of the palm and stays.
    kept = [name for name in JOINTS if not name.startswith(gone) or name == "LFJ5"]
    assert [JOINTS[place] for place in part.joints] == kept
    assert {part.model.joint(i).name for i in range(part.model.njnt)} == {*kept, "object"}
    for name in kept:
        np.testing.assert_array_equal(part.model.joint(name).range, WHOLE.model.joint(name).range)
    actuators = {WHOLE.model.actuator(i).name for i in range(WHOLE.model.nu)}
    assert {part.model.actuator(i).name for i in range(part.model.nu)} == {
        name for name in actuators if not name.startswith(gone) or name == "LFJ5"
    }
    assert part.model.npair < WHOLE.model.npair


def test_fingers_far_from_the_object_are_idle() -> None:
    finder = IdleFinder(WHOLE, HAND)
    far = finder.find(state((0.033, -0.2, 0.1), FFJ4=-0.3, RFJ4=-0.3, LFJ4=-0.3))
    assert far is not None
    assert IDLE_SETS[far.place] == ("middle", "ring", "little")
    assert far.slack_m > 0.01


def test_a_finger_beside_the_object_is_not_idle() -> None:
    finder = IdleFinder(WHOLE, HAND)
    middle_tip = (0.011, -0.026, 0.18)
    beside = finder.find(state(middle_tip, FFJ4=-0.3, RFJ4=-0.3, LFJ4=-0.3))
    assert beside is None or "middle" not in IDLE_SETS[beside.place]


def test_a_finger_that_would_tip_onto_the_object_is_not_idle() -> None:
    # Straight but for its outer joint, the middle finger passes the ball; its tendon would also let it bend halfway.
    spread = {"FFJ4": -0.3, "RFJ4": -0.3, "LFJ4": -0.3}
    beside = (0.011, -0.045, 0.166)
    finder = IdleFinder(WHOLE, HAND)
    straight = finder.find(state(beside, **spread))
    assert straight is not None
    assert "middle" in IDLE_SETS[straight.place]
    bent = finder.find(state(beside, MFJ1=0.8, **spread))
    assert bent is None or "middle" not in IDLE_SETS[bent.place]


def test_a_digit_that_tips_under_weight_onto_the_object_is_there_to_touch_it() -> None:
    # The outer joints of the ring finger share a tendon; hanging, it tips by half a radian and meets this box.
    grasps = GraspSampler.pretrained().sample("writing_tripod", "box_large", "x", n=40)[[8, 13, 16]]
    tried, watched = run_trials(grasps, "hold"), run_trials(grasps, "hold", observe=lambda *_: None)
    ring = tried.touch_columns.index("ring")
    assert not tried.touching_closed[:, ring].any()
    assert tried.touching_end[:, ring].all()
    np.testing.assert_array_equal(tried.touching_end, watched.touching_end)
    np.testing.assert_allclose(tried.displacement_m, watched.displacement_m, rtol=0, atol=1e-5)


def test_slack_falls_as_the_object_comes_nearer() -> None:
    finder = IdleFinder(WHOLE, HAND)
    idle = finder.find(state((0.033, -0.2, 0.1), FFJ4=-0.3, RFJ4=-0.3, LFJ4=-0.3))
    assert idle is not None
    where = addresses(idle.place)
    slacks = []
    for y in (-0.045, -0.035, -0.028, -0.022):
        whole = state((0.011, y, 0.15), FFJ4=-0.3, RFJ4=-0.3, LFJ4=-0.3)
        slacks.append(finder.slack(idle, whole[where], where))
    assert slacks == sorted(slacks, reverse=True)
    assert slacks[0] > 0.0 > slacks[-1]


def test_movement_of_the_object_is_bounded_by_shift_and_turn() -> None:
    a = state((0.0, -0.2, 0.1))[None]
    b = a.copy()
    b[:, WHOLE.object_qpos] += 0.002
    assert object_moved(WHOLE, a, b, RADIUS_M) == pytest.approx(0.002)
    turned = a.copy()
    angle = 0.1
    turned[:, WHOLE.object_qpos + 3 : WHOLE.object_qpos + 7] = [np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0]
    assert 0.06 * angle <= object_moved(WHOLE, a, turned, RADIUS_M)[0] <= 0.06 * angle * 1.6
    assert object_moved(WHOLE, a, turned, np.array([0.2]))[0] >= 0.2 * angle, "a longer object sweeps farther"
    other_sign = turned.copy()
    other_sign[:, WHOLE.object_qpos + 3 : WHOLE.object_qpos + 7] *= -1.0
    assert object_moved(WHOLE, turned, other_sign, RADIUS_M) == pytest.approx(0.0)


def test_leaving_digits_out_changes_no_verdict(drawn: Grasps, outcomes: Outcomes, short: Protocol) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(IdleFinder, "find", lambda *_: None)
        whole = run_trials(drawn, short)
    assert np.mean(whole.verdict == outcomes.verdict) > 0.98
    assert np.mean(whole.touching_end == outcomes.touching_end) > 0.99
    assert np.nanmax(np.abs(whole.settled_posture - outcomes.settled_posture)) == 0.0


def test_most_held_trials_leave_digits_out(drawn: Grasps, outcomes: Outcomes, short: Protocol) -> None:
    received: list[int] = []
    with pytest.MonkeyPatch.context() as patch:
        original = SlotGroup.receive

        def receive(self: SlotGroup, slots: np.ndarray, *rest: object) -> None:
            received.append(len(slots))
            original(self, slots, *rest)

        patch.setattr(SlotGroup, "receive", receive)
        run_trials(drawn, short)
    assert sum(received) > 0.7 * outcomes.held.sum()


def test_a_trial_in_which_the_object_comes_near_is_run_again_with_all_digits(
    drawn: Grasps, outcomes: Outcomes, short: Protocol
) -> None:
    """As if every object came near at once, all trials end as they do with all digits."""
    rows = np.flatnonzero(outcomes.held)[:6]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(IdleFinder, "find", lambda *_: None)
        whole = run_trials(drawn[rows], short)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(IdleFinder, "slack", lambda *_: 0.0)
        patch.setattr(module, "object_moved", lambda _, a, b, radius_m: np.full(len(a), np.inf))
        again = run_trials(drawn[rows], short)
    for name, column in whole.columns().items():
        np.testing.assert_array_equal(column, again.columns()[name], err_msg=name)


def test_an_object_that_leaves_the_hand_is_followed_to_the_same_verdict(drawn: Grasps, short: Protocol) -> None:
    slippery = short.with_physics("slippery", friction=0.02)
    some = drawn[::3]
    tried = run_trials(some, slippery)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(IdleFinder, "find", lambda *_: None)
        whole = run_trials(some, slippery)
    assert set(tried.verdict) & {"shaken_out", "dropped"}
    assert np.mean(tried.verdict == whole.verdict) > 0.9
