"""Grasps and verdicts are those recorded: all columns of 3,240 grasps, and what becomes of some of them."""

import numpy as np
import pytest

from benchmarks.paper import digest
from graspcascade.core.grasps import Grasps
from graspcascade.core.taxonomy import GRASP_TYPES

RECORD = digest.recorded()


@pytest.fixture(scope="module", params=digest.SETS)
def drawn(request: pytest.FixtureRequest) -> tuple[str, Grasps, int | None]:
    grasps, skipped = digest.draw(request.param)
    return request.param, grasps, skipped


def test_grasps_are_drawn_as_recorded(drawn: tuple[str, Grasps, int | None]) -> None:
    """Bit for bit where they were recorded; elsewhere rounding may differ, and in rare rows what follows from it."""
    name, grasps, skipped = drawn
    record, columns = RECORD[name], digest.grasp_columns(grasps)
    assert len(grasps) == record["n"]
    assert set(columns) == set(record["grasps"])
    assert not {"grasp_type", "object"} & set(digest.differing(columns, record["grasps"]))
    for column, means in record["grasp_means"].items():
        ours = np.atleast_1d(columns[column].mean(axis=0))
        np.testing.assert_allclose(ours, means, rtol=0, atol=5e-3, err_msg=column)
    if not digest.other_machine(RECORD):
        assert digest.differing(columns, record["grasps"]) == []
        assert skipped == record.get("skipped")


def test_some_grasps_end_as_recorded(drawn: tuple[str, Grasps, int | None]) -> None:
    name, grasps, _ = drawn
    rows = np.arange(0, len(grasps), 47)
    assert set(grasps.grasp_type[rows]) == set(GRASP_TYPES)
    ours = digest.letters(digest.try_grasps(name, grasps[rows]))
    theirs = [RECORD[name]["verdicts"][row] for row in rows]
    agree = np.mean([a == b for a, b in zip(ours, theirs, strict=True)])
    assert agree == 1 if not digest.other_machine(RECORD) else agree >= 0.9


def test_a_difference_is_named_by_its_column(drawn: tuple[str, Grasps, int | None]) -> None:
    columns = digest.grasp_columns(drawn[1])
    changed = columns["posture"].copy()
    changed[5, 3] = np.nextafter(changed[5, 3], np.inf)
    assert "posture" in digest.differing(columns | {"posture": changed}, digest.digests(columns))
    assert digest.differing(columns, digest.digests(columns) | {"side_m": "0" * 16}) == ["side_m"]


def test_another_processor_or_version_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    same = RECORD["versions"] | {name: RECORD[name] for name in ("cpu", "cpu_features")}
    monkeypatch.setattr(digest, "machine", lambda: same | {"graspcascade": "9.9"})
    assert digest.other_machine(RECORD) == []
    monkeypatch.setattr(digest, "machine", lambda: same | {"numpy": "1.0"})
    assert digest.other_machine(RECORD) == [f"numpy was {same['numpy']}, is 1.0"]
