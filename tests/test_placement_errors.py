"""Errors of placement: none for the heuristic, and those that objects were displaced by."""

import numpy as np
import pytest
from placement_errors import displaced, off_centre_mm, off_size_mm, tilt_deg

from graspcascade.cascade import GraspSampler
from graspcascade.grasps import Grasps
from graspcascade.hands import HandModel


def test_the_heuristic_puts_every_object_in_the_middle_and_straight(drawn: Grasps, hand: HandModel) -> None:
    assert off_centre_mm(hand, drawn) == pytest.approx(0.0, abs=1e-3)
    assert tilt_deg(hand, drawn) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("shift_mm", [0.0, 3.0, 12.0])
def test_a_shift_is_how_far_an_object_is_off(drawn: Grasps, hand: HandModel, shift_mm: float) -> None:
    moved = displaced(drawn, shift_mm, 0.0, np.random.default_rng(1))
    assert off_centre_mm(hand, moved) == pytest.approx(shift_mm, abs=1e-3)
    assert tilt_deg(hand, moved) == pytest.approx(0.0, abs=1e-3)


def test_a_turn_tilts_by_no_more_than_itself_and_spheres_not_at_all(drawn: Grasps, hand: HandModel) -> None:
    turned = displaced(drawn, 0.0, 20.0, np.random.default_rng(1))
    tilt, spheres = tilt_deg(hand, turned), np.char.startswith(drawn.object_label, "sphere")
    assert off_centre_mm(hand, turned) == pytest.approx(0.0, abs=1e-3)
    assert (tilt[spheres] == 0.0).all()
    assert (tilt < 20.0 + 1e-6).all()
    assert tilt[~spheres].max() > 15.0


def test_the_size_asked_for_is_the_one_of_the_rule(hand: HandModel) -> None:
    sampler = GraspSampler.pretrained()
    grasps = sampler.sample("tripod", "box_medium", n=200)
    assert np.median(off_size_mm(sampler, grasps)) < 1.0
    wider = GraspSampler.pretrained().sample("tripod", "box_medium", n=200)
    wider.grasp_size_m[:] += 0.010
    assert np.median(off_size_mm(sampler, wider)) == pytest.approx(10.0, abs=1.0)
