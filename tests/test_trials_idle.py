"""Digits left out of a trial while nothing comes near them."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from graspcascade.grasps import Grasps
from graspcascade.hands import SHADOW_HAND
from graspcascade.trials import PAPER, Outcomes, Protocol, run
from graspcascade.trials import runner as module
from graspcascade.trials.idle import IDLE_SETS, IdleFinder, object_moved
from graspcascade.trials.lane import trial_scene

JOINTS = list(SHADOW_HAND.joint_names)
WHOLE = trial_scene(SHADOW_HAND, "sphere_small", PAPER, reduced=True)


def state(object_at: tuple[float, float, float], **angles: float) -> np.ndarray:
    """Make a state of the whole scene: the hand flat but for some joints, the object somewhere."""
    qpos = mujoco.MjData(WHOLE.model).qpos.copy()
    for name, angle in angles.items():
        qpos[WHOLE.joint_qpos[JOINTS.index(name)]] = angle
    qpos[WHOLE.object_qpos : WHOLE.object_qpos + 3] = object_at
    return qpos


def addresses(place: int) -> np.ndarray:
    """Give where the state of a scene without a set of digits stands in that of the whole scene."""
    part = trial_scene(SHADOW_HAND, "sphere_small", PAPER, True, IDLE_SETS[place])
    names = [part.model.joint(i).name for i in range(part.model.njnt)]
    found = np.empty(part.model.nq, dtype=np.intp)
    for name in names:
        mine, theirs = part.model.joint(name), WHOLE.model.joint(name)
        width = 7 if name == "object" else 1
        found[mine.qposadr[0] : mine.qposadr[0] + width] = np.arange(theirs.qposadr[0], theirs.qposadr[0] + width)
    return found


@pytest.mark.parametrize("without", IDLE_SETS)
def test_a_scene_without_digits_has_all_the_rest(without: tuple[str, ...]) -> None:
    part = trial_scene(SHADOW_HAND, "sphere_small", PAPER, True, without)
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
    finder = IdleFinder(WHOLE, SHADOW_HAND)
    far = finder.find(state((0.033, -0.2, 0.1), FFJ4=-0.3, RFJ4=-0.3, LFJ4=-0.3))
    assert far is not None
    assert IDLE_SETS[far.place] == ("middle", "ring", "little")
    assert far.slack_m > 0.01


def test_a_finger_beside_the_object_is_not_idle() -> None:
    finder = IdleFinder(WHOLE, SHADOW_HAND)
    middle_tip = (0.011, -0.026, 0.18)
    beside = finder.find(state(middle_tip, FFJ4=-0.3, RFJ4=-0.3, LFJ4=-0.3))
    assert beside is None or "middle" not in IDLE_SETS[beside.place]


def test_slack_falls_as_the_object_comes_nearer() -> None:
    finder = IdleFinder(WHOLE, SHADOW_HAND)
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
    assert object_moved(WHOLE, a, b) == pytest.approx(0.002)
    turned = a.copy()
    angle = 0.1
    turned[:, WHOLE.object_qpos + 3 : WHOLE.object_qpos + 7] = [np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0]
    assert 0.06 * angle <= object_moved(WHOLE, a, turned)[0] <= 0.06 * angle * 1.6
    other_sign = turned.copy()
    other_sign[:, WHOLE.object_qpos + 3 : WHOLE.object_qpos + 7] *= -1.0
    assert object_moved(WHOLE, turned, other_sign) == pytest.approx(0.0)


def test_leaving_digits_out_changes_no_verdict(drawn: Grasps, outcomes: Outcomes, short: Protocol) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(IdleFinder, "find", lambda *_: None)
        whole = run(drawn, short)
    assert np.mean(whole.verdict == outcomes.verdict) > 0.98
    assert np.mean(whole.touching_end == outcomes.touching_end) > 0.99
    assert np.nanmax(np.abs(whole.settled_posture - outcomes.settled_posture)) == 0.0


def test_most_held_trials_leave_digits_out(drawn: Grasps, outcomes: Outcomes, short: Protocol) -> None:
    received: list[int] = []
    with pytest.MonkeyPatch.context() as patch:
        original = module.Lane.receive

        def receive(self: module.Lane, slots: np.ndarray, *rest: object) -> None:
            received.append(len(slots))
            original(self, slots, *rest)

        patch.setattr(module.Lane, "receive", receive)
        run(drawn, short)
    assert sum(received) > 0.7 * outcomes.held.sum()


def test_a_trial_in_which_the_object_comes_near_is_run_again_with_all_digits(
    drawn: Grasps, outcomes: Outcomes, short: Protocol
) -> None:
    """As if every object came near at once, all trials end as they do with all digits."""
    rows = np.flatnonzero(outcomes.held)[:6]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(IdleFinder, "find", lambda *_: None)
        whole = run(drawn[rows], short)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(IdleFinder, "slack", lambda *_: 0.0)
        patch.setattr(module, "object_moved", lambda _, a, b: np.full(len(a), np.inf))
        again = run(drawn[rows], short)
    for name, column in whole.columns().items():
        np.testing.assert_array_equal(column, again.columns()[name], err_msg=name)


def test_an_object_that_leaves_the_hand_is_followed_to_the_same_verdict(drawn: Grasps, short: Protocol) -> None:
    slippery = replace(short, friction=0.02)
    some = drawn[::3]
    found = run(some, slippery)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(IdleFinder, "find", lambda *_: None)
        whole = run(some, slippery)
    assert set(found.verdict) & {"shaken_out", "dropped"}
    assert np.mean(found.verdict == whole.verdict) > 0.9
