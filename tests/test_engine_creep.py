"""Skips along the creep under weight: what they do to a state, and that verdicts stay what they are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.protocols import Carry, Close, Protocol, Shake
from graspcascade.engines import run_trials
from graspcascade.engines.mujoco.creep import FAST_FORWARD, CreepSkipper
from test_engine_trials import assert_same

DT, STRIDE, FIRST, LAST = 0.004, 5, 675, 1925
JOINTS, OBJECT_AT = 3, 1
"""States of these tests: one joint, the object's seven numbers, two more joints."""
SPEEDS = hnp.arrays(float, (6 + JOINTS,), elements=st.floats(-0.02, 0.02))


def moved(qpos: np.ndarray, rate: np.ndarray, seconds: float) -> np.ndarray:
    """Move a state ``(10,)`` at a constant rate: object's place, its turn about its own axes, joints."""
    after = qpos.copy()
    after[1:4] += rate[:3] * seconds
    turned = Rotation.from_quat(qpos[4:8], scalar_first=True) * Rotation.from_rotvec(rate[3:6] * seconds)
    after[4:8] = turned.as_quat(scalar_first=True)
    after[[0, 8, 9]] += rate[6:] * seconds
    return after


def skipper() -> CreepSkipper:
    made = CreepSkipper(
        FAST_FORWARD,
        time_step_s=DT,
        stride=STRIDE,
        n_slots=1,
        first_step=FIRST,
        last_step=LAST,
        object_qpos=OBJECT_AT,
        n_qpos=7 + JOINTS,
    )
    made.start(np.array([0]))
    return made


def course(rate: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[tuple[int, int]]]:
    """Let a state creep at a constant rate to the end; tell its start, its end, and when and how far it skipped."""
    one, slot = skipper(), np.array([0])
    start = np.array([[0.3, 0.1, -0.2, 0.05, 1.0, 0.0, 0.0, 0.0, -0.4, 0.8]])
    qpos, step, skips = start.copy(), np.array([FIRST]), []
    while step[0] < LAST:
        ahead = one.stretch(slot, step)
        assert ahead[0] > 0
        qpos[0] = moved(qpos[0], rate, int(ahead[0]) * DT)
        step = step + ahead
        skipped = int(one.advance(slot, step, qpos)[0])
        if skipped:
            skips.append((int(step[0]), skipped))
        step = step + skipped
    assert step[0] == LAST
    return start[0], qpos[0], skips


@settings(max_examples=50)
@given(SPEEDS)
def test_a_constant_creep_is_carried_on_exactly(rate: np.ndarray) -> None:
    start, end, skips = course(rate)
    assert skips
    np.testing.assert_allclose(end, moved(start, rate, (LAST - FIRST) * DT), atol=1e-9)


@settings(max_examples=50)
@given(SPEEDS)
def test_a_skip_keeps_its_bounds(rate: np.ndarray) -> None:
    for step, skipped in course(rate)[2]:
        assert skipped % STRIDE == 0
        assert skipped * DT <= FAST_FORWARD.longest_skip_s + 1e-9
        assert np.linalg.norm(rate[:3]) * skipped * DT <= FAST_FORWARD.most_movement_m + 1e-9
        assert FAST_FORWARD.joint_lever_m * np.abs(rate[6:]).max() * skipped * DT <= FAST_FORWARD.most_movement_m + 1e-9
        assert step >= FIRST + FAST_FORWARD.begin_s / DT
        assert step + skipped <= LAST - FAST_FORWARD.end_s / DT


def test_what_stands_still_skips_farther_and_farther() -> None:
    skips = [skipped for _, skipped in course(np.zeros(6 + JOINTS))[2]]
    assert skips[0] == round(FAST_FORWARD.first_skip_s / DT)
    assert skips[1] == pytest.approx(3 * skips[0], abs=STRIDE)
    assert sum(skips) > (LAST - FIRST) / 2


def test_what_falls_does_not_skip() -> None:
    fast = np.zeros(6 + JOINTS)
    fast[2] = -1.0
    assert not course(fast)[2]


# In physics


def test_abridged_trials_end_like_those_in_full(drawn: Grasps) -> None:
    full, abridged = run_trials(drawn), run_trials(drawn, creep=FAST_FORWARD)
    assert full.held.sum() > 15
    assert (full.held != abridged.held).sum() <= 1
    both = full.held & abridged.held
    np.testing.assert_array_equal(full.settled_posture[both], abridged.settled_posture[both])
    np.testing.assert_allclose(full.duration_s[both], abridged.duration_s[both])
    # The creep itself is found again, not only the verdict.
    apart = np.abs(full.displacement_m - abridged.displacement_m)[both]
    assert np.median(apart) < 0.0005
    early = np.isin(full.verdict, ["overlap", "missed", "shaken_out"])
    assert_same(full[early], abridged[early])


@pytest.mark.parametrize(("n_threads", "n_slots"), [(1, 3), (2, 1), (2, 64)])
def test_abridged_outcomes_do_not_depend_on_threads_or_slots(drawn: Grasps, n_threads: int, n_slots: int) -> None:
    some = drawn[::9]
    expected = run_trials(some, creep=FAST_FORWARD)
    assert expected.held.any()
    assert_same(run_trials(some, creep=FAST_FORWARD, n_threads=n_threads, n_slots=n_slots), expected)


def test_an_abridged_trial_cannot_be_observed(drawn: Grasps) -> None:
    with pytest.raises(InputError, match="abridged trial cannot be observed"):
        run_trials(drawn[:1], creep=FAST_FORWARD, observe=lambda *_: None)


@pytest.mark.parametrize("time_step_s", [0.002, 0.0035])
def test_stretches_fit_any_time_step(drawn: Grasps, time_step_s: float) -> None:
    longer = Protocol("longer", (Close(), Shake(), Carry(1.4))).with_physics("varied", time_step_s=time_step_s)
    tried = run_trials(drawn[::9], longer, creep=FAST_FORWARD)
    assert tried.held.any()
    np.testing.assert_allclose(tried.duration_s[tried.held], longer.schedule.total_steps * time_step_s)
