"""Verification: shares over draws of conditions, and files that keep only what holds."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from graspcascade.cli import main
from graspcascade.core.errors import InputError
from graspcascade.core.grasps import Grasps
from graspcascade.core.intervals import wilson
from graspcascade.core.poses import Pose
from graspcascade.core.protocols import VARIED, Protocol
from graspcascade.engines import run_trials
from graspcascade.formats import load_document, save_grasps
from graspcascade.studies.verify import Verification, verify

DRAWS = 3


@pytest.fixture(scope="module")
def varied(short: Protocol) -> Protocol:
    return replace(short, name="short and varied", variation=VARIED.variation)


@pytest.fixture(scope="module")
def some(drawn: Grasps) -> Grasps:
    return drawn[::5]


@pytest.fixture(scope="module")
def verified(some: Grasps, varied: Protocol) -> Verification:
    return verify(some, draws=DRAWS, seed=5, protocol=varied)


def test_the_chance_of_a_grasp_is_the_share_of_its_trials_that_held(some: Grasps, verified: Verification) -> None:
    assert verified.held.shape == verified.faithful.shape == verified.steady.shape == (len(some), DRAWS)
    np.testing.assert_array_equal(verified.grasps.probability, verified.held.mean(axis=1))
    np.testing.assert_array_equal(verified.grasps.posture, some.posture)
    assert not (verified.faithful & ~verified.held).any()
    assert not (verified.steady & ~verified.held).any()
    assert 0.0 < verified.held.mean() < 1.0


def test_each_trial_is_that_of_its_grasp_under_its_draw(some: Grasps, verified: Verification, varied: Protocol) -> None:
    again = some[np.repeat(np.arange(len(some)), DRAWS)]
    conditions = varied.conditions(len(again), (5, 0xE51F))
    held = run_trials(again, varied, conditions=conditions).held
    np.testing.assert_array_equal(verified.held.ravel(), held)


def test_threads_and_processes_change_no_verdict(some: Grasps, verified: Verification, varied: Protocol) -> None:
    other = verify(some, draws=DRAWS, seed=5, protocol=varied, workers=2)
    np.testing.assert_array_equal(other.held, verified.held)
    assert (verify(some, draws=DRAWS, seed=6, protocol=varied).held != verified.held).any()


def test_progress_counts_every_trial(some: Grasps, varied: Protocol) -> None:
    told: list[int] = []
    verify(some[:2], draws=DRAWS, protocol=varied, progress=told.append)
    assert sum(told) == 2 * DRAWS


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"draws": 0}, "draws must be at least 1, got 0"),
        ({"draws": 2.5}, "draws must be a whole number"),
        ({"protocol": "hold"}, "every trial of protocol hold is the same; give one draw, or protocol varied"),
        ({"protocol": "helt"}, "unknown protocol 'helt'. Did you mean 'hold'"),
        ({"seed": -1}, "seed must not be negative"),
    ],
)
def test_what_cannot_be_verified_is_refused(some: Grasps, options: dict, says: str) -> None:
    with pytest.raises(InputError, match=says):
        verify(some, **options)


def test_no_grasps_cannot_be_verified(some: Grasps) -> None:
    with pytest.raises(InputError, match="there are no grasps to verify"):
        verify(some[:0])


# -- commands


@pytest.fixture
def saved(drawn: Grasps, tmp_path: Path) -> Path:
    """Save three candidates, the last far out of reach."""
    grasps = drawn[[0, 10, 20]]
    place = grasps.X_hand_object.position_m.copy()
    place[2] += [0.3, 0.0, 0.0]
    moved = replace(grasps, X_hand_object=Pose(place, grasps.X_hand_object.quat_wxyz))
    save_grasps(tmp_path / "grasps.json", moved, metadata={"model": "by hand"})
    return tmp_path / "grasps.json"


def test_verified_grasps_are_written_with_their_chance(
    saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "sure.json"
    asked = ["verify", str(saved), "--draws", "2", "--out", str(out), "--keep", "0.5", "--json"]
    assert main(asked) == 0
    report = json.loads(capsys.readouterr().out)
    held = np.array([row["held"] for row in report["grasps"]])
    assert (report["protocol"], report["draws"], report["n"]) == ("varied", 2, 3)
    assert report["held"] == wilson(held.sum() / 2, 3).to_json()
    assert held[2] == 0
    document = load_document(out)
    np.testing.assert_array_equal(document.grasps.probability, held[held >= 1] / 2)
    about = {"protocol": "varied", "engine": "mujoco", "draws": 2, "seed": 0, "kept_from": 0.5, "of": 3}
    assert document.metadata["verified"] == about
    assert document.metadata["model"] == "by hand"


def test_a_table_of_chances_has_their_intervals(saved: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", str(saved), "--draws", "2"]) == 0
    said = capsys.readouterr().out
    assert "0% [0%, 66%]" in said
    assert "protocol varied, engine mujoco, 3 grasps tried 2 times each\nheld " in said


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--keep", "0.9"], "--keep is a share from 0 to 1 and needs --out"),
        (["--keep", "90", "--out", "x.json"], "--keep is a share from 0 to 1"),
        (["--draws", "0"], "draws must be at least 1"),
        (["--protocol", "paper"], "every trial of protocol paper is the same"),
        (["--engine", "phisx"], "unknown engine 'phisx'"),
    ],
)
def test_what_verify_cannot_do_is_one_line(
    saved: Path, options: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["verify", str(saved), *options]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert len(said.splitlines()) == 1


def test_a_trial_writes_the_grasps_that_held(saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["trial", str(saved), "--protocol", "hold", "--held-out", str(tmp_path / "held.json"), "--json"]) == 0
    held = [row["held"] for row in json.loads(capsys.readouterr().out)["grasps"]]
    assert any(held)
    kept = load_document(tmp_path / "held.json")
    np.testing.assert_array_equal(kept.grasps.posture, load_document(saved).grasps.posture[held])
    assert kept.metadata["held"] == {"protocol": "hold", "engine": "mujoco", "seed": 0, "of": 3}


def test_no_file_is_written_where_no_grasp_held(
    drawn: Grasps, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    far = Pose(drawn[:1].X_hand_object.position_m + np.array([0.0, -0.4, 0.0]), drawn[:1].X_hand_object.quat_wxyz)
    save_grasps(tmp_path / "far.json", replace(drawn[:1], X_hand_object=far), metadata={})
    assert main(["trial", str(tmp_path / "far.json"), "--held-out", str(tmp_path / "held.json")]) == 0
    assert "no grasp is kept" in capsys.readouterr().err
    assert not (tmp_path / "held.json").exists()
    refused = ["export", str(tmp_path / "far.json"), "--only-held", "--out", str(tmp_path / "held.parquet")]
    assert main(refused) == 2
    assert "none of the 1 grasps held under protocol paper" in capsys.readouterr().err


def test_an_export_may_be_of_what_held_alone(saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "held.yaml"
    asked = ["export", str(saved), "--only-held", "--protocol", "hold", "--format", "isaac_grasp", "--out", str(out)]
    assert main(asked) == 0
    held = run_trials(load_document(saved).grasps, "hold").held
    assert len(load_document(out).grasps) == held.sum() > 0


@pytest.mark.parametrize(
    "asked",
    [
        ["trial", "{grasps}", "--held-out", "{grasps}"],
        ["trial", "{grasps}", "--out", "{other}", "--held-out", "{other}"],
        ["verify", "{grasps}", "--out", "{grasps}"],
    ],
)
def test_nothing_is_written_over_what_is_read_or_written(
    saved: Path, tmp_path: Path, asked: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    before = saved.read_bytes()
    assert main([part.format(grasps=saved, other=tmp_path / "other.json") for part in asked]) == 2
    assert "give what is written another name" in capsys.readouterr().err
    assert saved.read_bytes() == before
