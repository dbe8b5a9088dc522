"""Sweeps: how they are typed, what of a protocol they change, and the same grasps at every value."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from graspcascade.cli import main
from graspcascade.core.errors import InputError
from graspcascade.core.objects import as_object
from graspcascade.core.protocols import HOLD, PAPER, VARIED, Carry, Close, Protocol
from graspcascade.core.taxonomy import as_type
from graspcascade.proposals.cascade.sampler import GraspSampler
from graspcascade.studies.dataset import load_dataset
from graspcascade.studies.sweep import CONDITIONS, SWEEP_FILE, Point, Sweep, sweep

CELLS = [(as_object("box_medium"), as_type("tripod")), (as_object("sphere_medium"), as_type("palmar_pinch"))]
BRIEF = replace(HOLD, name="brief", phases=(Close(), Carry(0.3)))


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("friction=0.4:1.2", (0.4, 0.6, 0.8, 1.0, 1.2)),
        ("friction=0.4:1:3", (0.4, 0.7, 1.0)),
        (" Mass=0.5:4:4 ", (0.5, 1.0, 2.0, 4.0)),  # factors by equal ratios
        ("mass_g=100", (100.0,)),
        ("step-ms=4,1,2", (4.0, 1.0, 2.0)),
    ],
)
def test_a_sweep_is_read_as_it_is_typed(text: str, values: tuple[float, ...]) -> None:
    assert Sweep.read(text).values == values


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("frction=1:2", "Did you mean 'friction'"),
        ("friction", "write it like friction=0.4:1.2"),
        ("friction=2:1", "LESS:MORE"),
        ("friction=1:2:2.5", "LESS:MORE"),
        ("friction=1:2:1e9", "2 to 100 values"),
        ("friction=1,2:3", "LESS:MORE"),
        ("friction=a:b", "'a:b' holds something that is no number"),
        ("friction=nan", "friction must be 0 to 10, got nan"),
        ("mass=0:2", "mass must be 0.001 to 1000, got 0"),
        ("size-mm=30", "size-mm must be 0 to 20, got 30"),
        ("friction=0.5,0.5", "each of them once"),
    ],
)
def test_a_sweep_that_makes_no_sense_is_refused_in_one_line(
    text: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", "--per-cell", "1", "--sweep", text]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert len(said.splitlines()) == 1


CHANGES: dict[str, tuple[float, Callable[[Protocol], Any], Any]] = {
    "friction": (0.5, lambda made: made.physics.friction, 0.5),
    "mass": (2.0, lambda made: made.physics.density_factor, 2.0),
    "mass-g": (100.0, lambda made: made.physics.object_mass_kg, 0.1),
    "gain": (0.5, lambda made: made.physics.gain_factor, 1.5),
    "position-mm": (5.0, lambda made: made.variation.position_sd_m, 0.005),
    "rotation-deg": (10.0, lambda made: made.variation.rotation_sd_rad, math.radians(10.0)),
    "size-mm": (3.0, lambda made: made.variation.size_error_m, 0.003),
    "step-ms": (1.0, lambda made: made.physics.time_step_s, 0.001),
}


@pytest.mark.parametrize("condition", CONDITIONS)
def test_a_condition_changes_one_number_of_a_protocol(condition: str) -> None:
    value, number, expected = CHANGES[condition]
    made = Sweep(condition, (value,)).protocol(PAPER, value)
    assert number(made) == pytest.approx(expected)
    assert made.name == f"paper, {condition} {value:g}"
    assert (made.phases, made.displacement_m) == (PAPER.phases, PAPER.displacement_m)
    one, other = made.to_json(), PAPER.to_json()
    differing = {key for key in one if one[key] != other.get(key)}
    assert differing <= {"name", "physics", "variation"}
    assert sum(one["physics"].get(key) != other["physics"].get(key) for key in one["physics"]) <= 1


def test_friction_of_a_protocol_that_varies_it_is_fixed_and_all_else_still_varies() -> None:
    made = Sweep("friction", (0.5,)).protocol(VARIED, 0.5)
    conditions, before = made.conditions(50, 3), VARIED.conditions(50, 3)
    assert conditions is not None
    assert before is not None
    assert set(conditions.friction) == {0.5}
    np.testing.assert_array_equal(conditions.density_factor, before.density_factor)


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Point], Path]:
    out = tmp_path_factory.mktemp("sweep")
    sweeps = [Sweep("friction", (0.1, 0.8)), Sweep("mass-g", (30.0,))]
    points = sweep(GraspSampler.pretrained(), sweeps, per_cell=6, seed=2, protocol=BRIEF, out=out, cells=CELLS)
    return points, out


def test_the_same_grasps_are_tried_at_every_value(swept: tuple[list[Point], Path]) -> None:
    points, out = swept
    tried = [load_dataset(out / f"{point.condition}={point.value:g}").grasps for point in points]
    for grasps in tried[1:]:
        np.testing.assert_array_equal(grasps.posture, tried[0].posture)
        np.testing.assert_array_equal(grasps.X_hand_object.position_m, tried[0].X_hand_object.position_m)
    slippery, usual, _ = points
    assert slippery.evaluation.total.held < usual.evaluation.total.held


def test_a_sweep_keeps_its_numbers_and_goes_on_from_them(swept: tuple[list[Point], Path]) -> None:
    points, out = swept
    written = json.loads((out / SWEEP_FILE).read_text())
    assert [(row["condition"], row["value"], row["n"]) for row in written["points"]] == [
        ("friction", 0.1, 12),
        ("friction", 0.8, 12),
        ("mass-g", 30.0, 12),
    ]
    assert written["points"][1]["held"] == points[1].evaluation.held.to_json()
    assert {"seed", "versions", "engine", "hand", "model", "protocol"} <= written.keys()
    progress: list[tuple[int, int]] = []
    sweeps = [Sweep("friction", (0.1, 0.8)), Sweep("mass-g", (30.0,))]
    asked: dict[str, Any] = {"per_cell": 6, "seed": 2, "protocol": BRIEF, "out": out, "cells": CELLS}
    again = sweep(GraspSampler.pretrained(), sweeps, progress=lambda *told: progress.append(told), **asked)
    assert [point.to_json() for point in again] == [point.to_json() for point in points]
    assert progress == [(12, 36), (24, 36), (36, 36)]  # nothing was tried again


def test_a_condition_is_swept_once() -> None:
    twice = [Sweep("mass", (1.0,)), Sweep("mass", (2.0,))]
    for wrong in (twice, []):
        with pytest.raises(InputError, match="each once"):
            sweep(GraspSampler.pretrained(), wrong, per_cell=1, seed=0)


def test_the_command_draws_curves_beside_their_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["evaluate", "--per-cell", "1", "--protocol", "hold", "--out", str(tmp_path / "out")]
    assert main([*asked, "--sweep", "step-ms=4,8"]) == 0
    said = capsys.readouterr().out
    assert "model3 under protocol hold, 54 trials of each value" in said
    assert said.count("step-ms") == 2
    assert (tmp_path / "out" / "sweep.png").read_bytes()[:4] == b"\x89PNG"


def test_sweep_without_a_condition_or_into_a_file_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("mine")
    for asked in (["--sweep"], ["--sweep", "friction=0.5", "--out", str(tmp_path / "file")]):
        assert main(["evaluate", "--per-cell", "1", *asked]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
    assert (tmp_path / "file").read_text() == "mine"
