"""``graspcascade report`` and ``graspcascade sample --picture``."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from graspcascade.cli import main
from graspcascade.evaluation import Cell, Evaluation
from graspcascade.objects import CATALOGUE
from graspcascade.report.figures import heat_maps
from graspcascade.taxonomy import GRASP_TYPES
from graspcascade.trials import PAPER, VERDICTS
from test_pictures import MAX_BYTES, needs_drawing


@pytest.fixture
def evaluation() -> Evaluation:
    cells = tuple(
        Cell(dict.fromkeys(VERDICTS, 0) | {"held": n, "missed": 9 - n}, n // 2, kind, label)
        for n, label in enumerate(CATALOGUE)
        for kind in GRASP_TYPES
    )
    return Evaluation(PAPER, "heuristic", "a hand", cells, 0, 9, {"graspcascade": "0"}, {})


@pytest.fixture
def results(evaluation: Evaluation, tmp_path: Path) -> Path:
    folder = tmp_path / "results"
    evaluation.save(folder / "heuristic.json")
    replace(evaluation, model="model3").save(folder / "model3.json")
    (folder / "speed.json").write_text('{"grasps per second": 1000}')
    return folder


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    capsys.readouterr()
    assert main([str(a) for a in arguments]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    return said


def test_report_writes_the_page(results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "results.md"
    assert main(["report", "--results", str(results), "--out", str(page), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"written": [str(page)]}
    text = page.read_text()
    assert text.startswith("# Results")
    assert "model3" in text
    assert main(["report", "--results", str(results), "--out", str(page)]) == 0
    assert page.read_text() == text


@needs_drawing
def test_every_evaluation_gets_a_heat_map(results: Path, tmp_path: Path) -> None:
    written = heat_maps(results, tmp_path / "figures")
    assert [path.name for path in written] == ["success_heuristic.png", "success_model3.png"]
    assert all(0 < path.stat().st_size < MAX_BYTES for path in written)
    assert sorted((tmp_path / "figures").iterdir()) == written


@needs_drawing
def test_report_draws_every_figure(
    results: Path, evaluation: Evaluation, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    replace(evaluation, model="model2").save(results / "paper" / "model2.json")
    page, figures = tmp_path / "results.md", tmp_path / "figures"
    assert main(["report", "--results", str(results), "--out", str(page), "--figures", str(figures)]) == 0
    names = [
        "success_heuristic", "success_model3", "success_paper_model2", "grasp_types", "objects", "pose_frames",
    ]  # fmt: skip
    assert capsys.readouterr().out.splitlines() == [f"wrote {page}", *(f"wrote {figures / n}.png" for n in names)]
    assert all((figures / f"{name}.png").stat().st_size < MAX_BYTES for name in names)
    text = page.read_text()
    assert all(f"](figures/{name}.png)" in text for name in names if name not in ("grasp_types", "objects"))


def test_report_says_what_it_cannot_use(results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    assert "no evaluation" in refused(capsys, "report", "--results", tmp_path / "empty", "--out", tmp_path / "a.md")
    assert "no folder" in refused(capsys, "report", "--results", tmp_path / "none", "--out", tmp_path / "a.md")
    assert ".md file" in refused(capsys, "report", "--results", results, "--out", tmp_path / "a.txt")


def test_figures_without_matplotlib_are_refused_before_the_page(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("graspcascade.pictures.paper.find_spec", lambda _: None)
    page = tmp_path / "results.md"
    said = refused(capsys, "report", "--results", results, "--out", page, "--figures", tmp_path / "figures")
    assert "graspcascade[view]" in said
    assert not page.exists()


@needs_drawing
def test_sample_draws_its_first_grasps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "grasps.png"
    assert main(["sample", "tip_pinch", "sphere_small", "--n", "1", "--picture", str(picture)]) == 0
    assert f"drew 1 of 1 grasps in {picture}" in capsys.readouterr().out
    assert 0 < picture.stat().st_size < MAX_BYTES


def test_sample_refuses_a_picture_of_another_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ".png" in refused(capsys, "sample", "tripod", "box_medium", "--picture", tmp_path / "grasps.gif")
