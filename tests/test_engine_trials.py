"""Trials in real physics: every verdict, and that a trial's outcome is its own."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import as_object
from graspcascade.core.outcomes import VERDICTS, Outcomes
from graspcascade.core.poses import Pose, as_rotation
from graspcascade.core.protocols import PAPER, Carry, Close, Conditions, Protocol, Shake
from graspcascade.core.tasks import Task, Tasks
from graspcascade.core.taxonomy import AREAS, DIGITS
from graspcascade.engines import run_trials
from graspcascade.engines.mujoco import runner
from graspcascade.engines.mujoco.creep import FAST_FORWARD, CreepProjection
from graspcascade.engines.mujoco.idle import IdleFinder
from graspcascade.engines.mujoco.runner import CHECK_STEPS
from graspcascade.hands import Hand, load_hand
from graspcascade.worlds import world as world_module

HAND = load_hand("shadow")
CLOSING, STEP_S = 175, 0.004
STILL = Protocol("still", (Close(), Carry(0.4)))


def assert_same(a: Outcomes, b: Outcomes) -> None:
    """Compare every column bit for bit."""
    theirs = b.columns()
    for name, column in a.columns().items():
        np.testing.assert_array_equal(column, theirs[name], err_msg=name)


def assert_areas_fit_contacts(outcomes: Outcomes) -> None:
    """Every digit that touches does so on some area, and no other digit has one."""
    np.testing.assert_array_equal(outcomes.areas_closed != 0, outcomes.touching_closed[:, :-1])
    np.testing.assert_array_equal(outcomes.areas_end != 0, outcomes.touching_end[:, :-1])


SPOTS = [
    ("thdistal", HAND.places["thumb_pad"].point_m, HAND.places["thumb_pad"].normal, "thumb", "distal_pad"),
    ("thdistal", HAND.places["thumb_end"].point_m, HAND.places["thumb_end"].normal, "thumb", "distal_end"),
    ("thproximal", (0.0, -0.0105, 0.02), (0.0, -1.0, 0.0), "thumb", "proximal_radial"),
    ("ffdistal", HAND.places["index_end"].point_m, HAND.places["index_end"].normal, "index", "distal_end"),
    ("ffmiddle", (0.009, 0.0, 0.0125), (1.0, 0.0, 0.0), "index", "middle_radial"),
    ("mfdistal", HAND.places["middle_side"].point_m, HAND.places["middle_side"].normal, "middle", "distal_radial"),
    ("rfproximal", (0.0, 0.009, 0.025), (0.0, 1.0, 0.0), "ring", "proximal_back"),
    ("lfmiddle", (-0.009, 0.0, 0.0125), (-1.0, 0.0, 0.0), "little", "middle_ulnar"),
]
"""Points on the surface of bodies of the hand, outward normals there, and the digit and its area that they are on."""
BALL = as_object("sphere:5mm")


def spots_of_open_hand() -> tuple[np.ndarray, np.ndarray]:
    """Locate `SPOTS`, points and normals ``(n, 3)``, in the hand frame."""
    frames = {name: (turn[0], at[0]) for name, (turn, at) in HAND.frames(HAND.pregrasp[None]).items()}
    points = [frames[body][1] + frames[body][0] @ point for body, point, *_ in SPOTS]
    return np.array(points), np.array([frames[body][0] @ normal for body, _, normal, *_ in SPOTS])


def mask_of_spot(number: int) -> list[int]:
    """List the masks of areas of the five digits when one of `SPOTS` is touched."""
    *_, touched, area = SPOTS[number]
    return [1 << AREAS.index(area) if digit == touched else 0 for digit in DIGITS]


def with_object_at(grasps: Grasps, position_m: Any) -> Grasps:
    position = np.broadcast_to(np.asarray(position_m, dtype=float), (len(grasps), 3)).copy()
    return replace(grasps, X_hand_object=Pose(position, grasps.X_hand_object.quat_wxyz))


# Where digits touch


@pytest.mark.parametrize("reduced", [True, False])
def test_a_contact_is_recorded_by_the_area_of_the_digit_that_it_is_on(drawn: Grasps, reduced: bool) -> None:
    points, normals = spots_of_open_hand()
    some = drawn[: len(SPOTS)]
    still = replace(some, tasks=Tasks.repeat(Task.of("tip_pinch", BALL, "x"), len(SPOTS)), posture=some.pregrasp)
    pressed = with_object_at(still, points + 0.002 * normals)  # half a millimetre deep
    outcomes = run_trials(pressed, Protocol("one step", (Close(STEP_S, 0.0), Carry(0.1))), reduced=reduced)
    assert outcomes.areas_closed.tolist() == [mask_of_spot(number) for number in range(len(SPOTS))]


def test_each_digit_that_touches_has_an_area_and_no_other(drawn: Grasps, outcomes: Outcomes, short: Protocol) -> None:
    assert outcomes.touching_end.any(axis=0)[:3].all()
    assert_areas_fit_contacts(outcomes)
    assert_areas_fit_contacts(run_trials(drawn[::3], short, reduced=False))


def test_areas_are_those_of_an_object_as_large_as_it_is_in_its_trial(drawn: Grasps, short: Protocol) -> None:
    some = drawn[::3]
    conditions = Conditions.of(short.physics, len(some), size_error_m=0.001)
    outcomes = run_trials(some, short, conditions=conditions)
    assert outcomes.held.any()
    assert_areas_fit_contacts(outcomes)


# Verdicts


def test_a_far_object_is_missed(drawn: Grasps, short: Protocol) -> None:
    outcomes = run_trials(with_object_at(drawn[:6], [0.0, -0.5, 0.1]), short)
    assert set(outcomes.verdict) == {"missed"}
    assert not outcomes.touching_closed.any()
    np.testing.assert_array_equal(outcomes.X_hand_object_settled.position_m, [[0.0, -0.5, 0.1]] * 6)
    np.testing.assert_allclose(outcomes.duration_s, CLOSING * STEP_S)


def test_an_object_in_the_palm_is_in_overlap_before_anything_moves(drawn: Grasps, short: Protocol) -> None:
    outcomes = run_trials(with_object_at(drawn[:6], [0.011, 0.0, 0.04]), short)
    assert set(outcomes.verdict) == {"overlap"}
    assert not outcomes.duration_s.any()
    assert np.isnan(outcomes.settled_posture).all()
    assert np.isnan(outcomes.object_size_m).all()


@pytest.mark.parametrize(("depth_m", "overlaps"), [(0.0, False), (0.0009, False), (0.0011, True), (0.005, True)])
def test_overlap_is_deeper_than_a_millimetre(drawn: Grasps, short: Protocol, depth_m: float, overlaps: bool) -> None:
    sphere = drawn[drawn.object_name == "sphere_medium"][:1]
    back_of_the_palm_m, radius_m = 0.0117, 0.0225
    outcomes = run_trials(with_object_at(sphere, [0.011, back_of_the_palm_m + radius_m - depth_m, 0.04]), short)
    assert (outcomes.verdict[0] == "overlap") == overlaps


def test_an_object_that_only_touches_the_palm_is_missed(hand: Hand, drawn: Grasps, short: Protocol) -> None:
    sphere = drawn[drawn.object_name == "sphere_medium"][:1]
    resting = with_object_at(replace(sphere, posture=sphere.pregrasp), [-0.002, -0.0118 - 0.0225, 0.04])
    assert run_trials(resting, short).verdict[0] == "missed"


def test_the_prior_draws_grasps_that_hold(outcomes: Outcomes) -> None:
    assert outcomes.held.sum() > 15


def glue_the_object(monkeypatch: pytest.MonkeyPatch, pose: Pose) -> None:
    """Weld the object to the palm at a pose in every world built from here on."""
    add_object = world_module._add_object

    def add_glued_object(spec: Any, *rest: Any, **options: Any) -> None:
        add_object(spec, *rest, **options)
        if spec.body("palm") is None:  # an object that is compiled alone
            return
        weld = spec.add_equality(
            type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name1="palm", name2="object"
        )
        weld.data[:11] = [0, 0, 0, *pose.position_m, *pose.quat_wxyz, 1]
        # Stiffer than the fingers that push.
        weld.solref[:] = [0.01, 1.0]

    monkeypatch.setattr(world_module, "_add_object", add_glued_object)


@pytest.mark.parametrize("verdict", ["shaken_out", "dropped"])
def test_an_object_glued_in_the_hand_is_held_though_it_falls_without_glue(
    monkeypatch: pytest.MonkeyPatch, hand: Hand, drawn: Grasps, outcomes: Outcomes, verdict: str
) -> None:
    row = np.flatnonzero(outcomes.verdict == verdict)[:1]
    pose = outcomes.X_hand_object_settled
    grasp = drawn[row]
    glue_the_object(monkeypatch, Pose(pose.position_m[row[0]], pose.quat_wxyz[row[0]]))
    # Worlds are remembered by hand, so a glued one needs a name of its own.
    glued = run_trials(grasp, hand=replace(hand, name=f"glue_{verdict}"))
    assert glued.verdict[0] == "held"
    assert glued.displacement_m[0] < 0.005


def test_an_object_that_no_digit_touches_is_not_held_even_if_it_is_glued(
    monkeypatch: pytest.MonkeyPatch, hand: Hand, drawn: Grasps, short: Protocol
) -> None:
    far = with_object_at(drawn[:1], [0.0, -0.3, 0.1])
    glue_the_object(monkeypatch, Pose(far.X_hand_object.position_m[0], far.X_hand_object.quat_wxyz[0]))
    assert run_trials(far, short, hand=replace(hand, name="glue_far")).verdict[0] == "missed"


def test_an_object_heavier_than_the_fingers_can_hold_is_not_held(
    drawn: Grasps, outcomes: Outcomes, short: Protocol
) -> None:
    heavy = run_trials(drawn[outcomes.held], short.with_physics("heavy", density_factor=100.0))
    assert not heavy.held.any()


@pytest.mark.parametrize("creep", [None, FAST_FORWARD])
def test_without_a_shake_the_object_carries_its_weight_all_the_same(
    drawn: Grasps, outcomes: Outcomes, short: Protocol, creep: CreepProjection | None
) -> None:
    some = drawn[outcomes.held][:8]
    assert run_trials(some, STILL, creep=creep).held.sum() >= 6
    heavy = run_trials(some, STILL.with_physics("heavy", density_factor=100.0), creep=creep)
    assert set(heavy.verdict) <= {"dropped", "missed"}
    assert "dropped" in heavy.verdict


def test_without_a_shake_trials_that_go_on_with_all_digits_carry_weight_too(
    drawn: Grasps, outcomes: Outcomes, short: Protocol
) -> None:
    """As if every object came near the digits left out, trials are taken up again from where closing left them."""
    still, some = STILL.with_physics("heavy", density_factor=100.0), drawn[outcomes.held][:4]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(IdleFinder, "find", lambda *_: None)
        whole = run_trials(some, still)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(IdleFinder, "slack", lambda *_: 0.0)
        patch.setattr(runner, "object_moved", lambda _, a, b, radius_m: np.full(len(a), np.inf))
        again = run_trials(some, still)
    assert "dropped" in again.verdict
    assert "held" not in again.verdict
    assert_same(whole, again)


def test_hardly_any_grasp_holds_without_friction(drawn: Grasps, outcomes: Outcomes, short: Protocol) -> None:
    slippery = run_trials(drawn[outcomes.held], short.with_physics("slippery", friction=0.02))
    assert slippery.held.mean() < 0.2


def test_without_the_shake_a_heavy_object_is_dropped_under_its_weight(
    drawn: Grasps, outcomes: Outcomes, short: Protocol
) -> None:
    still = Protocol("still", (Close(), Shake(amplitude_m=0.0), Carry(0.4)))
    still = still.with_physics("still and heavy", density_factor=100.0)
    weighed = run_trials(drawn[outcomes.held], still)
    assert set(weighed.verdict) <= {"dropped", "missed", "held"}
    assert (weighed.verdict == "dropped").mean() > 0.5
    assert (weighed.duration_s[weighed.verdict == "dropped"] > 2.7).all()


@pytest.mark.parametrize("broken", ["posture", "position", "far position"])
def test_a_trial_that_breaks_is_unstable_and_its_companions_do_not_notice(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    drawn: Grasps,
    outcomes: Outcomes,
    short: Protocol,
    broken: str,
) -> None:
    monkeypatch.chdir(tmp_path)  # where the engine would write what it warns of
    some = drawn[:6]
    posture, position = some.posture.copy(), some.X_hand_object.position_m.copy()
    if broken == "posture":
        posture[2] = np.nan
    else:
        position[2] = np.nan if broken == "position" else 1e12
    bad = replace(with_object_at(some, position), posture=posture)
    monkeypatch.setattr(runner, "check_trials", lambda *_: None)  # which refuses such grasps
    tried = run_trials(bad, short, n_slots=1)
    assert tried.verdict[2] == "unstable"
    assert not tried.held[2]
    others = np.array([0, 1, 3, 4, 5])
    assert_same(tried[others], outcomes[others])
    assert capfd.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


# What an outcome says


def test_outcomes_agree_with_their_verdicts(outcomes: Outcomes, short: Protocol) -> None:
    assert set(outcomes.verdict) <= set(VERDICTS)
    closing, shaken = 0.7, 2.7
    full = short.schedule.total_steps * STEP_S
    closed = ~np.isin(outcomes.verdict, ["overlap", "unstable"])
    opposed_closed = outcomes.touching_closed[:, 0] & outcomes.touching_closed[:, 1:5].any(axis=1)
    opposed_end = outcomes.touching_end[:, 0] & outcomes.touching_end[:, 1:5].any(axis=1)
    assert outcomes.digits[0] == "thumb"
    np.testing.assert_array_equal(opposed_closed[closed], outcomes.verdict[closed] != "missed")
    np.testing.assert_array_equal(opposed_end, outcomes.held)
    assert not outcomes.touching_end[~outcomes.held].any()
    duration = outcomes.duration_s
    np.testing.assert_allclose(duration[outcomes.verdict == "missed"], closing)
    np.testing.assert_allclose(duration[outcomes.held], full)
    gone = outcomes.verdict == "shaken_out"
    assert ((duration[gone] > closing) & (duration[gone] <= shaken + 1e-9)).all()
    assert (outcomes.displacement_m[gone] > short.displacement_m).all()
    assert (outcomes.displacement_m[outcomes.held] <= short.displacement_m).all()
    assert (duration[outcomes.verdict == "dropped"] > shaken).all()
    for column in (outcomes.settled_posture, outcomes.X_hand_object_settled.position_m):
        assert np.isfinite(column[closed]).all()
    np.testing.assert_array_equal(np.isfinite(outcomes.displacement_m), closed)
    norms = np.linalg.norm(outcomes.X_hand_object_settled.quat_wxyz[closed], axis=1)
    np.testing.assert_allclose(norms, 1)


def test_the_turn_of_an_object_is_that_of_its_pose_since_closing(drawn: Grasps, short: Protocol) -> None:
    last: dict[int, np.ndarray] = {}

    def see(rows: np.ndarray, step: np.ndarray, posture: np.ndarray, pose: np.ndarray) -> None:
        last.update(zip(rows.tolist(), pose[:, 3:].copy(), strict=True))

    outcomes = run_trials(drawn[:12], short, observe=see)
    settled = outcomes.X_hand_object_settled.quat_wxyz
    for row in np.flatnonzero(outcomes.held):
        turn = (as_rotation(settled[row]).inv() * as_rotation(last[int(row)])).magnitude()
        assert outcomes.turn_rad[row] == pytest.approx(turn, abs=1e-7)
    assert (np.isnan(outcomes.turn_rad) == np.isnan(outcomes.displacement_m)).all()
    assert outcomes.held.any()


def test_a_held_object_that_turned_far_is_not_held_steadily(outcomes: Outcomes) -> None:
    turned = replace(outcomes, turn_rad=np.where(outcomes.held, np.radians(15.1), 0.0))
    still = replace(outcomes, turn_rad=np.where(outcomes.held, np.radians(14.9), np.nan))
    assert not turned.steady.any()
    np.testing.assert_array_equal(still.steady, outcomes.held)


def test_object_size_is_the_tip_distance_of_the_settled_posture(hand: Hand, outcomes: Outcomes) -> None:
    closed = np.isfinite(outcomes.object_size_m)
    expected = hand.tip_distance(outcomes.settled_posture[closed])
    np.testing.assert_array_equal(outcomes.object_size_m[closed], expected)


def test_a_held_object_keeps_the_fingers_wider_than_they_meant_to_close(drawn: Grasps, outcomes: Outcomes) -> None:
    held = outcomes.held
    wider = outcomes.object_size_m[held] > drawn.grasp_size_m[held]
    assert wider.mean() > 0.8


# A trial is its own


@pytest.mark.parametrize("n_slots", [1, 3, 64])
@pytest.mark.parametrize("n_threads", [1, 2])
def test_outcomes_do_not_depend_on_threads_or_slots(
    drawn: Grasps, outcomes: Outcomes, short: Protocol, n_threads: int, n_slots: int
) -> None:
    rows = np.arange(0, len(drawn), 6)
    assert_same(run_trials(drawn[rows], short, n_threads=n_threads, n_slots=n_slots), outcomes[rows])


def test_outcomes_do_not_depend_on_order(drawn: Grasps, outcomes: Outcomes, short: Protocol) -> None:
    order = np.random.default_rng(0).permutation(len(drawn))
    assert_same(run_trials(drawn[order], short, n_slots=7), outcomes[order])


def test_outcomes_do_not_depend_on_companions(drawn: Grasps, outcomes: Outcomes, short: Protocol) -> None:
    for row in np.flatnonzero(outcomes.held)[:2]:
        assert_same(run_trials(drawn[row], short), outcomes[row])


def test_joints_are_matched_by_name(drawn: Grasps, outcomes: Outcomes, short: Protocol) -> None:
    order = np.random.default_rng(1).permutation(len(drawn.joint_names))
    shuffled = replace(
        drawn,
        joint_names=tuple(drawn.joint_names[i] for i in order),
        posture=drawn.posture[:, order],
        pregrasp=drawn.pregrasp[:, order],
    )
    tried = run_trials(shuffled[:9], short)
    # Outcomes speak of joints in the order of their grasps.
    assert_same(replace(tried, settled_posture=tried.settled_posture[:, np.argsort(order)]), outcomes[:9])


def test_an_observer_sees_every_trial_from_its_start_to_its_verdict(
    drawn: Grasps, outcomes: Outcomes, short: Protocol
) -> None:
    seen: dict[int, list[int]] = {row: [] for row in range(6)}
    places: dict[int, np.ndarray] = {}

    def look(rows: np.ndarray, steps: np.ndarray, postures: np.ndarray, poses: np.ndarray) -> None:
        assert postures.shape == (len(rows), len(drawn.joint_names))
        for row, step, pose in zip(rows, steps, poses, strict=True):
            seen[int(row)].append(int(step))
            if step == CLOSING:
                places[int(row)] = pose[:3].copy()

    observed = run_trials(drawn[:6], short, n_slots=4, observe=look)
    # Who observes sees all digits; else those that touch nothing are left out, which changes rounding.
    np.testing.assert_array_equal(observed.verdict, outcomes.verdict[:6])
    np.testing.assert_array_equal(observed.settled_posture, outcomes.settled_posture[:6])
    np.testing.assert_allclose(observed.displacement_m, outcomes.displacement_m[:6], atol=1e-4)
    for row, steps in seen.items():
        assert steps == list(range(CHECK_STEPS, steps[-1] + 1, CHECK_STEPS))
        assert steps[-1] * STEP_S == pytest.approx(outcomes.duration_s[row])
        np.testing.assert_array_equal(places[row], outcomes.X_hand_object_settled.position_m[row])


def test_grasps_that_lack_joints_of_the_hand_are_refused(drawn: Grasps, short: Protocol) -> None:
    fewer = replace(
        drawn, joint_names=drawn.joint_names[2:], posture=drawn.posture[:, 2:], pregrasp=drawn.pregrasp[:, 2:]
    )
    with pytest.raises(InputError, match="lack joints of shadow_hand_right: FFJ4, FFJ3"):
        run_trials(fewer, short)


def test_no_grasps_give_no_outcomes(drawn: Grasps) -> None:
    assert len(run_trials(drawn[:0])) == 0


def test_progress_counts_every_trial_once(drawn: Grasps, short: Protocol) -> None:
    some = Grasps.concatenate([drawn[:6], with_object_at(drawn[:3], [0.011, 0.0, 0.04])])
    counted: list[int] = []
    run_trials(some, short, n_slots=2, progress=counted.append)
    assert sum(counted) == len(some)


def test_the_reduced_scene_judges_like_the_whole_hand(drawn: Grasps, outcomes: Outcomes, short: Protocol) -> None:
    rows = np.arange(0, len(drawn), 3)
    whole = run_trials(drawn[rows], short, reduced=False)
    assert np.mean(whole.held == outcomes.held[rows]) >= 0.9


@pytest.mark.parametrize("time_step_s", [0.003, 0.0035])
def test_every_phase_is_judged_whatever_the_time_step(
    drawn: Grasps, outcomes: Outcomes, short: Protocol, time_step_s: float
) -> None:
    varied = short.with_physics("varied", time_step_s=time_step_s)
    closing, shaken, total = varied.schedule.ends
    assert closing % CHECK_STEPS or shaken % CHECK_STEPS
    rows = np.arange(0, len(drawn), 3)
    tried = run_trials(drawn[rows], varied)
    assert np.isfinite(tried.settled_posture).all()
    np.testing.assert_allclose(tried.duration_s[tried.held], total * time_step_s)
    np.testing.assert_allclose(tried.duration_s[tried.verdict == "missed"], closing * time_step_s)
    assert np.mean(tried.held == outcomes.held[rows]) >= 0.8


def test_the_paper_protocol_runs_to_its_end(drawn: Grasps, outcomes: Outcomes) -> None:
    rows = np.flatnonzero(outcomes.held)[:4]
    full = run_trials(drawn[rows], PAPER)
    assert full.held.any()
    np.testing.assert_allclose(full.duration_s[full.held], 7.7)
    np.testing.assert_array_equal(full.settled_posture, outcomes.settled_posture[rows])


def test_the_objects_of_a_batch_do_not_mix(drawn: Grasps, outcomes: Outcomes) -> None:
    """A held object is as wide between the tips as its own side allows, not as another object's."""
    opposed = outcomes.held & np.isin(drawn.grasp_type, ["tripod", "writing_tripod", "lateral_tripod"])
    assert (0.6 * drawn.side_m < outcomes.object_size_m)[opposed].all()
    assert (outcomes.object_size_m < drawn.side_m + 0.03)[opposed].all()
