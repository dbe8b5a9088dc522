"""The experiments that the contact settings of `hold` were chosen by, in real physics."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.physics.contacts import LIMITS, Settings, gripped_mm, measure, sliding_error, turned_deg, variants
from graspcascade.core.protocols import HOLD, PAPER, Physics

PUBLISHED = Path(__file__).parents[2] / "docs" / "results" / "contacts.json"


def settings_of(physics: Physics) -> Settings:
    return Settings(physics.impratio, physics.noslip_iterations, time_step_s=physics.time_step_s)


def test_hold_keeps_every_limit() -> None:
    errors = measure(settings_of(HOLD.physics))
    assert set(errors) == set(LIMITS)
    assert {name for name, limit in LIMITS.items() if not errors[name] <= limit} == set()


def test_paper_creeps_and_turns_in_the_grip() -> None:
    paper = settings_of(PAPER.physics)
    assert gripped_mm(paper) > 100 * LIMITS["gripped_mm"]
    assert turned_deg(paper) > 100 * LIMITS["turned_deg"]


@pytest.mark.parametrize("impratio", [10.0, 100.0])
def test_creep_is_inverse_to_the_ratio_of_impedances_and_blind_to_the_time_step(impratio: float) -> None:
    creeping = gripped_mm(Settings(impratio))
    assert gripped_mm(Settings(10 * impratio)) == pytest.approx(creeping / 10, rel=0.01)
    assert gripped_mm(Settings(impratio, time_step_s=0.002)) == pytest.approx(creeping, rel=0.01)


def test_what_is_gripped_too_weakly_turns_and_what_is_too_steep_slides() -> None:
    hold = settings_of(HOLD.physics)
    assert turned_deg(hold, share=1.05, seconds=0.5) > 10.0
    assert sliding_error(replace(hold, time_step_s=0.001)) < 0.002


def test_hold_has_the_cheapest_settings_that_keep_the_limits() -> None:
    published = json.loads(PUBLISHED.read_text(encoding="utf-8"))
    assert published["limits"] == LIMITS
    assert len(published["rows"]) == len(set(variants()))
    best = published["cheapest_that_passes"]
    assert Settings(**{name: best[name] for name in vars(Settings())}) == settings_of(HOLD.physics)
    assert replace(PAPER, name="hold", physics=replace(PAPER.physics, noslip_iterations=3)) == HOLD
