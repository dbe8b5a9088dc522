"""Errors of placement: none for the heuristic, and those that objects were displaced by."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.paper.placement_errors import (
    displaced,
    likeness,
    off_centre_mm,
    off_size_mm,
    tilt_deg,
    turn_rad,
    variety,
)
from graspcascade.core.grasps import Grasps
from graspcascade.core.poses import Pose, as_quat, as_rotation
from graspcascade.hands import Hand
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.proposals.heuristic import opposition_points


def test_the_heuristic_puts_every_object_in_the_middle_and_straight(drawn: Grasps, hand: Hand) -> None:
    assert off_centre_mm(hand, drawn) == pytest.approx(0.0, abs=1e-3)
    assert tilt_deg(hand, drawn) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("shift_mm", [0.0, 3.0, 12.0])
def test_a_shift_is_how_far_an_object_is_off(drawn: Grasps, hand: Hand, shift_mm: float) -> None:
    moved = displaced(drawn, shift_mm, 0.0, np.random.default_rng(1))
    assert off_centre_mm(hand, moved) == pytest.approx(shift_mm, abs=1e-3)
    assert tilt_deg(hand, moved) == pytest.approx(0.0, abs=1e-3)


def test_a_turn_tilts_by_no_more_than_itself_and_spheres_not_at_all(drawn: Grasps, hand: Hand) -> None:
    turned = displaced(drawn, 0.0, 20.0, np.random.default_rng(1))
    tilt, spheres = tilt_deg(hand, turned), np.char.startswith(drawn.object_name, "sphere")
    assert off_centre_mm(hand, turned) == pytest.approx(0.0, abs=1e-3)
    assert (tilt[spheres] == 0.0).all()
    assert (tilt < 20.0 + 1e-6).all()
    assert tilt[~spheres].max() > 15.0


def test_the_size_asked_for_is_the_one_of_the_rule(hand: Hand) -> None:
    sampler = GraspSampler.pretrained()
    grasps = sampler.sample("tripod", "box_medium", n=200)
    assert np.median(off_size_mm(sampler, grasps)) < 1.0
    wider = GraspSampler.pretrained().sample("tripod", "box_medium", n=200)
    wider.grasp_size_m[:] += 0.010
    assert np.median(off_size_mm(sampler, wider)) == pytest.approx(10.0, abs=1.0)


def test_turns_are_counted_about_the_line_between_the_digits(drawn: Grasps, hand: Hand) -> None:
    turns = turn_rad(hand, drawn)
    thumb, other = opposition_points(hand, drawn.posture, drawn.tasks)
    line = (other - thumb) / np.linalg.norm(other - thumb, axis=1, keepdims=True)
    about = Rotation.from_rotvec(0.3 * line) * as_rotation(drawn.X_hand_object.quat_wxyz)
    turned = replace(drawn, X_hand_object=Pose(drawn.X_hand_object.position_m, as_quat(about)))
    moved = (turn_rad(hand, turned) - turns)[~np.isnan(turns)] % np.pi
    assert moved == pytest.approx(0.3, abs=1e-6)
    assert np.isnan(turns[np.char.startswith(drawn.object_name, "sphere")]).all()
    assert not np.isnan(turns[np.char.startswith(drawn.object_name, "box")]).any()


def test_likeness_is_one_for_the_same_turn_and_zero_for_all() -> None:
    assert likeness(np.array([0.3, 0.3, 0.3 + np.pi, np.nan])) == 1.0
    assert likeness(np.linspace(0.0, np.pi, 100, endpoint=False)) == 0.0


def test_variety_is_within_type_object_and_side(drawn: Grasps, hand: Hand) -> None:
    twice = Grasps.concatenate([drawn, drawn])
    twice.grasp_size_m[: len(drawn)] += 0.004
    keys = {*zip(drawn.grasp_type.tolist(), drawn.object_name.tolist(), drawn.side_axis.tolist(), strict=True)}
    values = [
        twice.grasp_size_m[(twice.grasp_type == t) & (twice.object_name == o) & (twice.side_axis == s)]
        for t, o, s in keys
    ]
    squares = sum(float(((group - group.mean()) ** 2).sum()) for group in values)
    expected = 1000.0 * np.sqrt(squares / (len(twice) - len(keys)))
    assert variety(hand, "all", twice)["grasp size sd mm"] == pytest.approx(expected, abs=0.01)
