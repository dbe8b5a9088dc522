"""The comparison of engines: what is counted, and what the published numbers keep to."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.paper.markdown import fill_blocks
from benchmarks.physics.engines import compare, differing, page_blocks
from graspcascade.core.grasps import Grasps
from graspcascade.core.outcomes import Outcomes
from graspcascade.studies.dataset import Dataset

PUBLISHED = Path(__file__).parents[2] / "docs" / "results" / "engines.json"


def turned(outcomes: Outcomes, rows: list[int]) -> Outcomes:
    """Turn the verdicts of some trials round."""
    verdict = outcomes.verdict.copy()
    verdict[rows] = np.where(outcomes.held[rows], "dropped", "held")
    return replace(outcomes, verdict=verdict)


def test_agreement_and_what_only_one_engine_holds_are_counted_by_type(drawn: Grasps, outcomes: Outcomes) -> None:
    held, lost = int(np.flatnonzero(outcomes.held)[0]), int(np.flatnonzero(~outcomes.held)[0])
    pair = Dataset(drawn, outcomes, {}), Dataset(drawn, turned(outcomes, [held, lost]), {})
    rows = list(compare("heuristic", "short", [pair, (pair[0], pair[0])]))
    assert [row["type"] for row in rows[:2]] == ["all", "tripod"]
    assert len(rows) == 7
    assert rows[0]["n"] == 2 * len(drawn) == sum(row["n"] for row in rows[1:])
    assert rows[0]["agreement"]["rate"] == pytest.approx(1 - 2 / (2 * len(drawn)))
    assert (rows[0]["only in mujoco"], rows[0]["only in physx"]) == (1, 1)
    trials = list(differing("heuristic", "short", [pair]))
    assert sorted(trial["row"] for trial in trials) == sorted([held, lost])
    assert all(trial["mujoco"]["verdict"] != trial["physx"]["verdict"] for trial in trials)


def test_other_grasps_are_not_compared(drawn: Grasps, outcomes: Outcomes) -> None:
    pair = Dataset(drawn, outcomes, {}), Dataset(drawn[::-1], outcomes, {})
    with pytest.raises(ValueError, match="not the same in both engines"):
        list(compare("heuristic", "short", [pair]))


def test_the_engines_are_published_to_agree() -> None:
    rows = [row for row in json.loads(PUBLISHED.read_text())["comparisons"] if row["type"] == "all"]
    assert len(rows) == 4
    for row in rows:
        assert row["n"] >= 1350
        assert row["agreement"]["rate"] >= 0.93
        assert abs(row["points"]["difference"]) <= 4.0


def test_the_page_of_the_protocol_has_the_published_tables() -> None:
    page = (PUBLISHED.parents[1] / "protocol.md").read_text(encoding="utf-8")
    assert fill_blocks(page, page_blocks(PUBLISHED.parent)) == page
    assert "| tip_pinch |" not in page
    assert "| `tip_pinch` |" in page


def test_what_the_page_says_of_the_trials_that_differ_is_so() -> None:
    data = json.loads(PUBLISHED.read_text())
    rows = {(row["grasps"], row["engine"], row["protocol"]): row for row in data["changed"]}
    for grasps in ("heuristic", "model3"):
        usual = rows[grasps, "physx", "hold"]
        smooth = rows[grasps, "physx", "hold, no torsional friction"]
        assert smooth["as mujoco"]["rate"] < usual["as mujoco"]["rate"] - 0.05
        weak, firm = "held of those in mujoco alone", "held of those in both"
        slippery = rows[grasps, "mujoco", "hold, friction 0.7"]
        assert slippery[weak]["rate"] < 0.6 < 0.97 < slippery[firm]["rate"]
        assert rows[grasps, "physx", "hold, friction 0.9"][weak]["rate"] > 0.45
        assert rows[grasps, "mujoco", "hold, half the time step"]["as mujoco"]["rate"] > 0.99
        assert rows[grasps, "physx", "hold, half the time step"]["as physx"]["rate"] > 0.975
    trials = data["differing"]
    assert sum(trial["type"] in ("lateral_tripod", "tip_pinch") for trial in trials) > len(trials) / 2
    easy = [trial for trial in trials if trial["object"] in ("box_medium", "box_large")]
    assert len(easy) < 0.1 * len(trials)
