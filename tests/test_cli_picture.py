"""`graspcascade sample --picture`."""

from pathlib import Path

import pytest

from graspcascade.cli import main
from test_pictures import MAX_BYTES, needs_drawing


@needs_drawing
def test_sample_draws_its_first_grasps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "grasps.png"
    assert main(["sample", "tip_pinch", "sphere_small", "--n", "1", "--picture", str(picture)]) == 0
    assert f"drew 1 of 1 grasps in {picture}" in capsys.readouterr().out
    assert 0 < picture.stat().st_size < MAX_BYTES


def test_sample_refuses_a_picture_of_another_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sample", "tripod", "box_medium", "--picture", str(tmp_path / "grasps.gif")]) == 2
    assert ".png" in capsys.readouterr().err
