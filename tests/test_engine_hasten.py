"""Trials under weight that are hastened: what is changed meanwhile, and that they end like those in full."""

from dataclasses import replace

import numpy as np
import pytest

from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import as_object
from graspcascade.core.protocols import HOLD, PAPER, SIX_DIRECTIONS, VARIED, Carry, Close, Shake
from graspcascade.engines import run_trials
from graspcascade.engines.mujoco.creep import FAST_FORWARD
from graspcascade.engines.mujoco.hasten import HASTENED, Hastener
from graspcascade.engines.mujoco.runner import MujocoEngine
from graspcascade.hands import load_hand
from graspcascade.worlds.world import build_world
from test_engine_trials import assert_same

HAND = load_hand("shadow")
WORLD = build_world(HAND, as_object("box_medium"), HOLD.physics)
DT, STRIDE, FIRST, LAST = 0.004, 5, 675, 1925
BEGIN = FIRST + round(HASTENED.begin_s / DT)
END = BEGIN + 80  # a fifteenth of the 1,200 steps that are left


@pytest.fixture
def hastener() -> tuple[Hastener, np.ndarray]:
    damping = np.tile(WORLD.model.dof_damping, (2, 1))
    times = {"time_step_s": DT, "stride": STRIDE, "first_step": FIRST, "last_step": LAST}
    made = Hastener(HASTENED, WORLD, HAND, damping, **times)
    made.start(np.arange(2))
    return made, damping


def test_only_joints_that_share_a_tendon_are_freed_and_only_for_a_while(
    hastener: tuple[Hastener, np.ndarray],
) -> None:
    made, damping = hastener
    slots, own = np.arange(2), WORLD.model.dof_damping
    joints = [WORLD.model.joint(int(joint)).name for joint in WORLD.model.dof_jntid]
    coupled = np.array([name in {joint for c in HAND.couplings for joint in c.joints} for name in joints])
    assert coupled.sum() == 8
    made.stretch(slots, np.array([BEGIN - STRIDE, BEGIN]))
    np.testing.assert_array_equal(damping[0], own)
    np.testing.assert_allclose(damping[1], np.where(coupled, own / HASTENED.factor, own))
    made.stretch(slots, np.array([END, END - STRIDE]))
    np.testing.assert_array_equal(damping[0], own)
    assert (damping[1] < own).sum() == 8
    made.start(slots)
    np.testing.assert_array_equal(damping[1], own)


def test_stretches_end_where_something_changes(hastener: tuple[Hastener, np.ndarray]) -> None:
    steps = np.array([FIRST, BEGIN - 5, BEGIN, END - 5, END, END + 35, END + 40, LAST - 5])
    left = hastener[0].stretch(np.zeros(len(steps), dtype=np.int64), steps)
    np.testing.assert_array_equal(left, [50, 5, 80, 5, 40, 5, 40, 5])


def test_a_trial_is_over_once_its_object_is_still(hastener: tuple[Hastener, np.ndarray]) -> None:
    made, slots, qpos = hastener[0], np.arange(2), np.zeros((2, WORLD.model.nq))
    height = WORLD.object_qpos + 2
    step = np.array([END, END])
    np.testing.assert_array_equal(made.advance(slots, step, qpos), [0, 0])  # nothing to compare with yet
    qpos[:, height] = [0.00001, 0.001]
    step += 40
    np.testing.assert_array_equal(made.advance(slots, step, qpos), [LAST - STRIDE - step[0], 0])
    np.testing.assert_array_equal(made.advance(slots[1:], step[1:] + 40, qpos), [LAST - STRIDE - step[1] - 40])


def test_contacts_that_creep_are_projected_and_others_are_hastened() -> None:
    for protocol, expected in ((PAPER, FAST_FORWARD), (HOLD, HASTENED), (VARIED, HASTENED)):
        assert MujocoEngine().abridging(protocol).creep == expected


def test_hastened_trials_end_like_those_in_full(drawn: Grasps) -> None:
    full, hastened = run_trials(drawn, HOLD), run_trials(drawn, HOLD, creep=HASTENED)
    assert full.held.sum() > 15
    assert (full.held != hastened.held).sum() <= 1
    both = full.held & hastened.held
    np.testing.assert_array_equal(full.settled_posture[both], hastened.settled_posture[both])
    np.testing.assert_allclose(full.duration_s[both], hastened.duration_s[both])
    # Where objects end is found as well: without it their carrying would be far from full length.
    brief = run_trials(drawn, replace(HOLD, name="brief", phases=(Close(), Shake(), Carry(0.6))))
    apart, cut = (np.abs(full.displacement_m - other.displacement_m)[both] for other in (hastened, brief))
    assert apart.mean() < 0.5 * cut.mean()
    early = np.isin(full.verdict, ["overlap", "missed", "shaken_out"])
    assert_same(full[early], hastened[early])


@pytest.mark.parametrize(("n_threads", "n_slots"), [(1, 3), (2, 64)])
def test_hastened_outcomes_do_not_depend_on_threads_or_slots(drawn: Grasps, n_threads: int, n_slots: int) -> None:
    some, conditions = drawn[::9], VARIED.conditions(6, 1)
    assert len(some) == 6
    expected = run_trials(some, VARIED, conditions=conditions, creep=HASTENED)
    assert expected.held.any()
    options = {"n_threads": n_threads, "n_slots": n_slots}
    assert_same(run_trials(some, VARIED, conditions=conditions, creep=HASTENED, **options), expected)


@pytest.mark.parametrize("carry_s", [0.1, 0.3, 5.0])
def test_hastening_fits_any_time_step_and_duration(drawn: Grasps, carry_s: float) -> None:
    protocol = replace(HOLD, name="other", phases=(Close(), Carry(carry_s))).with_physics("other", time_step_s=0.0035)
    tried = run_trials(drawn[::9], protocol, creep=HASTENED)
    assert tried.held.any()
    np.testing.assert_allclose(tried.duration_s[tried.held], protocol.schedule.total_steps * 0.0035)


def test_protocols_that_end_without_weight_are_not_abridged() -> None:
    assert MujocoEngine().abridging(SIX_DIRECTIONS) == MujocoEngine()
