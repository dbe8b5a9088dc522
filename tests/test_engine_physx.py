"""Trials in PhysX: the hand converted from MuJoCo's moves alike, and verdicts come to the same."""

import json
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from graspcascade.cli import main
from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.objects import as_object
from graspcascade.core.outcomes import Outcomes
from graspcascade.core.protocols import (
    HOLD,
    PAPER,
    PROTOCOLS,
    SIX_DIRECTIONS,
    VARIED,
    Carry,
    Close,
    Conditions,
    Protocol,
    Push,
    Shake,
)
from graspcascade.engines import as_engine, run_trials
from graspcascade.engines.physx.scene import Scene, load_sapien
from graspcascade.formats import save_grasps
from graspcascade.hands import Hand, load_hand
from graspcascade.proposals.heuristic import Heuristic
from graspcascade.studies.evaluate import evaluate
from graspcascade.studies.rounds import try_round
from graspcascade.worlds.world import OBJECT, World, build_world, object_fields
from hand_files import actuator_line, cut_grasps, edited, shadow_entries, write_hand
from test_engine_hands import MODELS
from test_engine_trials import (
    BALL,
    SPOTS,
    assert_areas_fit_contacts,
    assert_same,
    mask_of_spot,
    spots_of_open_hand,
    with_object_at,
)
from test_hands import MESH_HAND, with_mesh_hand

try:
    load_sapien()
except InputError as error:
    pytest.skip(str(error), allow_module_level=True)

PHYSICS = HOLD.physics
BRIEF = Protocol("brief", (Close(), Shake(cycles=1), Carry(0.4)), physics=PHYSICS)
STILL = np.zeros(3)
AWAY = [0.0, -0.5, 0.1]


def world_of(hand: Hand) -> World:
    return build_world(hand, as_object("box_medium"), PHYSICS)


def scene_of(hand: Hand, world: World | None = None, obj: str = "box_medium", **changes: Any) -> Scene:
    fields = object_fields(as_object(obj), 1.0)
    return Scene(world or world_of(hand), hand, PHYSICS, fields, **({"friction": 0.8} | changes))


def hand_with(folder: Path, *changes: tuple[str, str], **entries: Any) -> Hand:
    return load_hand(write_hand(folder, edited(*changes), name="changed", **entries))


def in_mujoco(world: World, start: np.ndarray, posture: np.ndarray, steps: int) -> np.ndarray:
    """Step the hand alone to a posture; return joint angles after each step ``(steps, J)``."""
    model, data = world.model, mujoco.MjData(world.model)
    data.qpos[world.joint_qpos] = start
    data.qpos[world.object_qpos : world.object_qpos + 3] = AWAY
    data.ctrl[:] = np.clip(posture @ world.control_map, *world.control_range.T)
    angles = []
    for _ in range(steps):
        mujoco.mj_step(model, data)
        angles.append(data.qpos[world.joint_qpos].copy())
    return np.array(angles)


def in_physx(scene: Scene, world: World, start: np.ndarray, posture: np.ndarray, steps: int) -> np.ndarray:
    scene.place(start, AWAY, [1.0, 0.0, 0.0, 0.0])
    target, angles = np.clip(posture @ world.control_map, *world.control_range.T), []
    for _ in range(steps):
        scene.step(target, STILL)
        angles.append(scene.angles)
    return np.array(angles)


# -- the hand


@pytest.mark.parametrize("n_digits", [5, 3])
def test_bodies_are_where_mujoco_has_them_in_any_posture(
    hand: Hand, cut_hands: Mapping[int, Hand], n_digits: int
) -> None:
    which = hand if n_digits == 5 else cut_hands[n_digits]
    world = world_of(which)
    scene, data, rng = scene_of(which, world), mujoco.MjData(world.model), np.random.default_rng(0)
    for _ in range(30):
        posture = rng.uniform(which.lower_rad, which.upper_rad)
        scene.place(posture, AWAY, [1.0, 0.0, 0.0, 0.0])
        np.testing.assert_allclose(scene.angles, posture, atol=1e-6)
        data.qpos[world.joint_qpos] = posture
        mujoco.mj_kinematics(world.model, data)
        assert set(scene.links) == {world.model.body(b).name for b in range(1, world.model.nbody)} - {OBJECT}
        for name, link in scene.links.items():
            np.testing.assert_allclose(link.entity.pose.p, data.body(name).xpos, atol=1e-6)


@pytest.mark.parametrize("n_digits", [5, 2])
def test_the_hand_moves_to_a_posture_as_in_mujoco(hand: Hand, cut_hands: Mapping[int, Hand], n_digits: int) -> None:
    which = hand if n_digits == 5 else cut_hands[n_digits]
    world, span = world_of(which), which.upper_rad - which.lower_rad
    # Away from joint limits, which are soft in MuJoCo, and with fingers side by side and clear of the thumb.
    sideways = np.array([name.endswith("J4") and not name.startswith("TH") for name in which.joint_names])
    start = which.lower_rad + np.where(sideways, 0.5, 0.2) * span
    posture = start + np.where(sideways, 0.02, 0.15) * span
    expected = in_mujoco(world, start, posture, 200)
    moved = in_physx(scene_of(which, world), world, start, posture, 200)
    assert np.abs(expected - start).max() > 0.1
    np.testing.assert_allclose(moved, expected, atol=1e-4)


def test_a_speed_gain_damps_as_in_mujoco(tmp_path: Path) -> None:
    line = actuator_line("FFJ3")
    damped = hand_with(tmp_path, (line, line.replace('kp="1"', 'kp="1" kv="0.1"')))
    world = world_of(damped)
    start = damped.pregrasp.copy()
    start[[damped.joint_names.index(name) for name in ("FFJ2", "FFJ1")]] = 0.3  # away from their limits
    posture = start.copy()
    posture[damped.joint_names.index("FFJ3")] = 0.25  # not so far that the force is at its limit
    expected = in_mujoco(world, start, posture, 150)
    np.testing.assert_allclose(in_physx(scene_of(damped, world), world, start, posture, 150), expected, atol=1e-3)
    plain = in_physx(scene_of(load_hand("shadow")), world, start, posture, 150)
    assert np.abs(plain - expected).max() > 0.1


def test_the_tendon_of_a_free_finger_bends_both_joints_by_half(hand: Hand) -> None:
    world, posture = world_of(hand), hand.pregrasp.copy()
    index = [hand.joint_names.index(name) for name in ("FFJ2", "FFJ1")]
    posture[index] = 1.0, 0.4
    ended = in_physx(scene_of(hand, world), world, hand.pregrasp, posture, 250)[-1]
    np.testing.assert_allclose(ended[index], 0.7, atol=1e-3)
    np.testing.assert_allclose(ended, hand.executed(posture[None])[0], atol=1e-3)


def test_a_tied_joint_follows_and_gives_under_load_as_in_mujoco(tmp_path: Path) -> None:
    changes, entries = MODELS["tied joint"]
    tied = hand_with(tmp_path, *changes, **entries)
    world, posture = world_of(tied), tied.pregrasp.copy()
    posture[tied.joint_names.index("FFJ2")] = 0.8
    follower = tied.joint_names.index("FFJ1")
    ended = in_physx(scene_of(tied, world), world, tied.pregrasp, posture, 250)[-1]
    np.testing.assert_allclose(ended, in_mujoco(world, tied.pregrasp, posture, 250)[-1], atol=1e-3)
    assert ended[follower] == pytest.approx(0.1 + 0.5 * 0.8, abs=1e-3)


def test_fingers_that_cross_meet(hand: Hand) -> None:
    world, posture = world_of(hand), hand.pregrasp.copy()
    names = hand.joint_names
    posture[[names.index("FFJ4"), names.index("MFJ4")]] = -0.349, 0.349  # towards each other
    crossed = in_physx(scene_of(hand, world), world, hand.pregrasp, posture, 200)[-1]
    expected = in_mujoco(world, hand.pregrasp, posture, 200)[-1]
    assert np.abs(expected - posture).max() > 0.05
    np.testing.assert_allclose(crossed, expected, atol=0.03)


def test_meshes_and_round_shapes_of_a_hand_become_convex_hulls(tmp_path: Path) -> None:
    box = '<geom name="palm_centre" type="box" size="0.0175 0.009 0.046" pos="-0.002 -0.003 0.038"/>'
    corners = " ".join(f"{x} {y} {z}" for x in (-0.0175, 0.0175) for y in (-0.009, 0.009) for z in (-0.046, 0.046))
    mesh = box.replace('type="box" size="0.0175 0.009 0.046"', 'type="mesh" mesh="block"')
    asset = ("<worldbody>", f'<asset><mesh name="block" vertex="{corners}"/></asset>\n<worldbody>')
    (tmp_path / "mesh").mkdir()
    rest = {}
    for name, which in {
        "box": load_hand("shadow"),
        "mesh": hand_with(tmp_path / "mesh", (box, mesh), asset),
        "ellipsoid": hand_with(tmp_path, (box, box.replace('type="box"', 'type="ellipsoid"'))),
        "cylinder": hand_with(tmp_path, (box, box.replace('"box" size="0.0175 0.009', '"cylinder" size="0.009'))),
    }.items():
        scene = scene_of(which, obj="sphere_small")
        scene.place(which.pregrasp, [-0.002, -0.0325, 0.03], [1.0, 0.0, 0.0, 0.0])
        still = which.pregrasp @ world_of(which).control_map
        for _ in range(100):
            scene.step(still, np.array([0.0, 9.81, 0.0]))  # towards the palm
        touching, areas = scene.touching()
        assert touching.tolist() == [False] * 5 + [True]
        assert not areas.any()
        rest[name] = scene.object_pose[1]
    # The ball rests on the surface at y = -0.012; 8 mm along the ellipsoid it lies lower.
    assert rest["box"] == pytest.approx(-0.027, abs=2e-4)
    assert rest["mesh"] == pytest.approx(rest["box"], abs=1e-5)
    assert rest["cylinder"] == pytest.approx(rest["box"], abs=2e-4)
    assert -0.027 < rest["ellipsoid"] < -0.026


def test_a_ball_pressed_on_a_digit_touches_the_area_that_it_is_on(hand: Hand) -> None:
    still = hand.pregrasp @ world_of(hand).control_map
    for number, (point, normal) in enumerate(zip(*spots_of_open_hand(), strict=True)):
        scene = scene_of(hand, obj=BALL.name)
        scene.place(hand.pregrasp, point + 0.0025 * normal, [1.0, 0.0, 0.0, 0.0])
        for _ in range(5):
            scene.step(still, -9.81 * normal)
        touching, areas = scene.touching()
        assert areas.tolist() == mask_of_spot(number), SPOTS[number]
        assert touching[:-1].tolist() == (areas != 0).tolist()


def test_joints_listed_in_another_order_move_all_the_same(tmp_path: Path, hand: Hand) -> None:
    fingers = shadow_entries()["joints"]
    turned = load_hand(write_hand(tmp_path, joints=[finger[::-1] for finger in fingers[::-1]]))
    order = [hand.joint_names.index(name) for name in turned.joint_names]
    start, posture = hand.lower_rad, 0.7 * hand.lower_rad + 0.3 * hand.upper_rad
    moved = in_physx(scene_of(turned), world_of(turned), start[order], posture[order], 50)
    expected = in_physx(scene_of(hand), world_of(hand), start, posture, 50)
    np.testing.assert_allclose(moved, expected[:, order], atol=1e-6)


@with_mesh_hand
def test_a_hand_of_meshes_holds_what_it_holds_in_mujoco(tmp_path: Path, drawn: Grasps) -> None:
    meshes = load_hand(write_hand(tmp_path, name="meshes", mjcf=MESH_HAND, prefix="rh_"))
    some = drawn[drawn.object_name == "box_medium"]
    mine, theirs = (run_trials(some, BRIEF, hand=meshes, engine=engine) for engine in ("physx", "mujoco"))
    assert theirs.held.any()
    assert (mine.held == theirs.held).sum() >= len(some) - 1


def test_a_part_without_counterpart_is_refused_in_one_line(tmp_path: Path, drawn: Grasps) -> None:
    sprung = hand_with(tmp_path, ('<joint name="FFJ3"', '<joint stiffness="0.1" name="FFJ3"'))
    with pytest.raises(
        InputError, match=r"^engine physx has no counterpart to springs or torque limits of joints; .*mujoco$"
    ):
        run_trials(drawn[:1], BRIEF, hand=sprung, engine="physx")


# -- trials


@pytest.fixture(scope="module")
def some(drawn: Grasps) -> Grasps:
    return drawn[::4]


@pytest.fixture(scope="module")
def mine(some: Grasps) -> Outcomes:
    return run_trials(some, BRIEF, engine="physx")


@pytest.fixture(scope="module")
def theirs(some: Grasps) -> Outcomes:
    return run_trials(some, BRIEF)


def test_most_grasps_end_as_in_mujoco(mine: Outcomes, theirs: Outcomes) -> None:
    assert (mine.held == theirs.held).mean() > 0.85
    both = mine.held & theirs.held
    assert both.sum() >= 4
    assert (mine.touching_end == theirs.touching_end)[both].mean() > 0.9
    apart = np.abs(mine.settled_posture - theirs.settled_posture)[both].max(axis=1)
    moved = np.linalg.norm(mine.X_hand_object_settled.position_m - theirs.X_hand_object_settled.position_m, axis=1)[
        both
    ]
    assert np.median(apart) < 0.03
    assert np.median(moved) < 0.002
    assert (mine.duration_s[mine.held] == theirs.duration_s[mine.held]).mean() > 0.8


def test_contacts_are_recorded_by_area_as_in_mujoco(mine: Outcomes, theirs: Outcomes) -> None:
    assert_areas_fit_contacts(mine)
    both = (mine.touching_end & theirs.touching_end)[:, :-1]
    assert both.sum() > 10
    assert (mine.areas_end & theirs.areas_end != 0)[both].mean() > 0.8


def test_a_far_object_is_missed_and_one_in_the_palm_in_overlap(some: Grasps) -> None:
    missed = run_trials(with_object_at(some[:2], AWAY), BRIEF, engine="physx")
    assert list(missed.verdict) == ["missed"] * 2
    assert not missed.touching_closed.any()
    np.testing.assert_allclose(missed.duration_s, 0.7)
    np.testing.assert_allclose(missed.X_hand_object_settled.position_m, [AWAY] * 2, atol=1e-6)
    overlapping = run_trials(with_object_at(some[:2], [0.011, 0.0, 0.04]), BRIEF, engine="physx")
    assert list(overlapping.verdict) == ["overlap"] * 2
    assert np.isnan(overlapping.settled_posture).all()


def test_each_trial_has_its_own_friction_weight_gains_and_errors(some: Grasps, mine: Outcomes) -> None:
    held = some[mine.held][:2]
    conditions = Conditions.of(PHYSICS, 4, friction=[0.8, 0.8, 0.05, 0.05], size_error_m=[0.0, 0.001, 0.0, 0.0])
    tried = run_trials(held[[0, 0, 0, 1]], BRIEF, conditions=conditions, engine="physx")
    assert list(tried.held) == [True, True, False, False]
    assert_same(tried[:1], mine[mine.held][:1])
    slippery = run_trials(held, BRIEF.with_physics("slippery", friction=0.05), engine="physx")
    assert_same(slippery, tried[2:])
    # A larger object keeps the fingers farther apart.
    assert tried.object_size_m[1] > tried.object_size_m[0] + 2e-4
    heavy = Conditions.of(PHYSICS, 2, density_factor=100.0, gain_factor=[3.0, 0.5])
    assert not run_trials(held, BRIEF, conditions=heavy, engine="physx").held.any()


def test_contacts_resist_turning(some: Grasps, mine: Outcomes) -> None:
    held = np.flatnonzero(mine.held)
    smooth = BRIEF.with_physics("no torsional friction", torsional_friction_m=0.0)
    turning = run_trials(some[held], smooth, engine="physx")
    assert mine.turn_rad[held].max() < 0.3
    assert turning.turn_rad.max() > 1.0


def test_outcomes_depend_on_neither_order_companions_nor_processes(some: Grasps, mine: Outcomes) -> None:
    rows = np.array([9, 2, 5, 2])
    assert_same(run_trials(some[rows], BRIEF, engine="physx"), mine[rows])
    engine = as_engine("physx").on_one_thread()
    conditions = BRIEF.conditions(4)
    apart = try_round(some[rows], _Drawn(some, rows), load_hand("shadow"), BRIEF, engine, conditions, workers=2)
    assert_same(apart, mine[rows])


class _Drawn:
    def __init__(self, grasps: Grasps, rows: np.ndarray) -> None:
        self._grasps, self._rows = grasps, rows

    def __call__(self) -> Grasps:
        return self._grasps[self._rows]


def test_joints_are_matched_by_name(some: Grasps, mine: Outcomes) -> None:
    order = np.random.default_rng(1).permutation(len(some.joint_names))
    names = tuple(some.joint_names[i] for i in order)
    shuffled = replace(some, joint_names=names, posture=some.posture[:, order], pregrasp=some.pregrasp[:, order])
    tried = run_trials(shuffled[:2], BRIEF, engine="physx")
    assert_same(replace(tried, settled_posture=tried.settled_posture[:, np.argsort(order)]), mine[:2])


def test_an_observer_sees_a_trial_and_progress_counts_it(some: Grasps, mine: Outcomes) -> None:
    row, seen, counted = int(np.flatnonzero(mine.held)[0]), [], []

    def look(rows: np.ndarray, steps: np.ndarray, postures: np.ndarray, poses: np.ndarray) -> None:
        assert (rows.tolist(), postures.shape, poses.shape) == ([0], (1, len(some.joint_names)), (1, 7))
        seen.append((int(steps[0]), postures[0], poses[0, :3]))

    observed = run_trials(some[row], BRIEF, engine="physx", observe=look, progress=counted.append)
    assert_same(observed, mine[row])
    assert counted == [1]
    assert [step for step, _, _ in seen] == list(range(seen[0][0], seen[-1][0] + 1, seen[0][0]))
    closed = next(posture for step, posture, _ in seen if step == BRIEF.schedule.closing_steps)
    np.testing.assert_array_equal(closed, mine.settled_posture[row])


def test_a_smaller_hand_is_tried_too(cut_hands: Mapping[int, Hand], some: Grasps) -> None:
    pinching = np.flatnonzero(np.isin(some.grasp_type, ["palmar_pinch", "tip_pinch"]))[:3]
    grasps = cut_grasps(some, cut_hands[2], pinching)
    tried = run_trials(grasps, BRIEF, hand=cut_hands[2], engine="physx")
    assert tried.touch_columns == ("thumb", "index", "palm")
    assert "unstable" not in tried.verdict


# -- what is refused


def test_a_protocol_that_varies_needs_conditions(some: Grasps, hand: Hand) -> None:
    with pytest.raises(InputError, match="protocol varied varies: give the conditions"):
        as_engine("physx").run(hand, some, VARIED)


def test_several_threads_are_refused() -> None:
    with pytest.raises(InputError, match="engine physx has one thread, got 2"):
        as_engine("physx", n_threads=2)


def test_records_of_the_two_engines_are_told_apart() -> None:
    assert as_engine("physx").versions.keys() == {"sapien"}
    assert as_engine("mujoco").versions == {}


# -- on the command line


def test_the_command_tries_and_evaluates_in_physx_and_says_so(
    some: Grasps, mine: Outcomes, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(PROTOCOLS, "paper", BRIEF)
    save_grasps(tmp_path / "grasps.json", some[:2], metadata={})
    assert main(["trial", str(tmp_path / "grasps.json"), "--engine", "physx", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["engine"] == "physx"
    assert [row["verdict"] for row in report["grasps"]] == mine.verdict[:2].tolist()
    assert (
        main(["verify", str(tmp_path / "grasps.json"), "--engine", "physx", "--protocol", "paper", "--draws", "1"]) == 0
    )
    assert "engine physx, 2 grasps" in capsys.readouterr().out


def test_an_evaluation_goes_on_only_in_the_engine_it_began_in(tmp_path: Path) -> None:
    heuristic = Heuristic.pretrained()
    settings = {"per_cell": 1, "seed": 0, "protocol": BRIEF, "cells": [("box_small", "tripod")], "out": tmp_path}
    assert evaluate(heuristic, engine=as_engine("physx"), **settings).versions["sapien"] == version("sapien")
    with pytest.raises(InputError, match="versions"):
        evaluate(heuristic, engine=as_engine("mujoco"), **settings)


def test_protocols_that_physx_cannot_follow_are_refused_in_one_line(some: Grasps) -> None:
    rubbing = PAPER.with_physics("rubbing", joint_friction_nm=0.01)
    for protocol in (SIX_DIRECTIONS, rubbing):
        with pytest.raises(InputError, match=f"engine physx cannot do what protocol {protocol.name} asks for"):
            run_trials(some[:1], protocol, engine="physx")


def test_pushes_of_an_own_protocol_are_refused(some: Grasps) -> None:
    pushed = replace(HOLD, name="pushed", phases=(Close(), Push("+z", 1.0, 0.5)))
    with pytest.raises(InputError, match="engine physx cannot do what protocol pushed asks for: pushes; try"):
        run_trials(some[:1], pushed, engine="physx")
