"""The export verb: from any format into any other, by the command line."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml

from graspcascade.cli import main
from graspcascade.evaluation import Cell, Evaluation
from graspcascade.formats import FORMATS_BY_NAME, load_document, load_grasps, save_grasps
from graspcascade.grasps import Grasps
from graspcascade.objects import CATALOGUE
from graspcascade.taxonomy import GRASP_TYPES
from graspcascade.trials import PAPER, VERDICTS


@dataclass(frozen=True)
class Said:
    status: int
    out: str
    err: str


Export = Callable[..., Said]


@pytest.fixture
def export(capsys: pytest.CaptureFixture[str]) -> Export:
    def run(*arguments: object) -> Said:
        capsys.readouterr()
        status = main(["export", *map(str, arguments)])
        captured = capsys.readouterr()
        return Said(status, captured.out, captured.err)

    return run


@pytest.fixture
def saved(drawn: Grasps, tmp_path: Path) -> Path:
    save_grasps(tmp_path / "grasps.json", drawn[[0, 10, 20]], metadata={"model": "by hand"})
    return tmp_path / "grasps.json"


def test_help_names_every_format(export: Export) -> None:
    said = export("--help")
    assert said.status == 0
    for name in FORMATS_BY_NAME:
        assert name in said.out


@pytest.mark.parametrize(
    ("name", "target"),
    [
        ("parquet", "g.parquet"),
        ("isaac_grasp", "isaac"),
        ("moveit_grasp", "g.yaml"),
        ("dexgraspbench", "bench"),
        ("dexgraspnet", "net"),
    ],
)
def test_there_and_back(export: Export, saved: Path, tmp_path: Path, name: str, target: str) -> None:
    out, back = tmp_path / target, tmp_path / "back.json"
    assert export(saved, "--format", name, "--out", out).status == 0
    trust = ["--trust-pickle"] if FORMATS_BY_NAME[name].pickled else []
    said = export(out, "--out", back, *trust, "--json")
    assert (said.status, said.err) == (0, "")
    assert json.loads(said.out) == {"out": str(back), "n": 3, "without_confidence": 3, "held": None}
    np.testing.assert_array_equal(load_grasps(back).posture, load_grasps(saved).posture)
    assert load_document(back).metadata == {"model": "by hand"}


def test_pickles_need_the_flag(export: Export, saved: Path, tmp_path: Path) -> None:
    export(saved, "--format", "dexgraspbench", "--out", tmp_path / "bench")
    said = export(tmp_path / "bench", "--out", tmp_path / "back.json")
    assert (said.status, said.out) == (2, "")
    assert "--trust-pickle" in said.err
    assert len(said.err.splitlines()) == 1
    assert not (tmp_path / "back.json").exists()


def test_an_evaluation_gives_the_confidence(export: Export, saved: Path, tmp_path: Path) -> None:
    cells = tuple(
        Cell(dict.fromkeys(VERDICTS, 0) | {"held": 3, "dropped": 1}, 0, kind, label)
        for label in CATALOGUE
        for kind in GRASP_TYPES
    )
    Evaluation(PAPER, "m", "h", cells, 0, 4, {}, {}).save(tmp_path / "evaluation.json")
    arguments = [saved, "--format", "moveit_grasp", "--joint-prefix", "rh_"]
    said = export(*arguments, "--out", tmp_path / "known.yaml", "--evaluation", tmp_path / "evaluation.json")
    assert said.status == 0
    assert "--evaluation" not in said.out
    rows = yaml.safe_load((tmp_path / "known.yaml").read_text())["grasps"]
    assert [row["grasp_quality"] for row in rows] == [0.75] * 3
    assert rows[0]["grasp_posture"]["joint_names"][0] == "rh_WRJ2"
    said = export(*arguments, "--out", tmp_path / "unknown.yaml")
    assert "3 of them have no measured confidence" in said.out
    said = export(*arguments, "--out", tmp_path / "x.yaml", "--evaluation", saved)
    assert said.status == 2
    assert "evaluate --json" in said.err


def test_settle_writes_the_contact(export: Export, saved: Path, tmp_path: Path) -> None:
    said = export(saved, "--format", "dexgraspbench", "--out", tmp_path / "bench", "--settle")
    assert said.status == 0
    assert "held in the trial" in said.out
    rows = [np.load(file, allow_pickle=True).item() for file in (tmp_path / "bench").rglob("*.npy")]
    for row in rows:
        moved = not np.array_equal(row["grasp_qpos"], row["squeeze_qpos"])
        assert row["graspcascade"]["grasp"]["contact_measured"] == moved


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--out", "x.yaml"], "isaac_grasp, moveit_grasp"),
        (["--out", "x.json", "--format", "isac_grasp"], "Did you mean 'isaac_grasp'"),
        (["--out", "absent/x.json"], "no folder"),
        (["--out", "x.yaml", "--format", "isaac_grasp"], "one object"),
        (["--out", "x.json", "--object-pose", "0", "0", "0", "1", "1", "0", "0"], "norm 1"),
        (["--out", "x.yaml", "--format", "moveit_grasp", "--parent-link", "elbow"], "elbow"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(
    export: Export, saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], word: str
) -> None:
    monkeypatch.chdir(tmp_path)
    said = export(saved, *arguments)
    assert (said.status, said.out) == (2, "")
    assert word in said.err
    assert len(said.err.splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["grasps.json"]


@pytest.mark.parametrize("name", ["isaac_grasp", "moveit_grasp", "dexgraspbench", "dexgraspnet"])
def test_a_file_that_lacks_a_joint_is_refused_in_one_line(
    export: Export, saved: Path, tmp_path: Path, name: str
) -> None:
    data = json.loads(saved.read_text())
    data["joint_names"].remove("FFJ4")
    for row in data["grasps"]:
        del row["posture"]["FFJ4"], row["pregrasp"]["FFJ4"]
    saved.write_text(json.dumps(data))
    target = "g.yaml" if name == "moveit_grasp" else "folder"
    said = export(saved, "--format", name, "--out", tmp_path / target)
    assert (said.status, said.out) == (2, "")
    assert "lack joints" in said.err
    assert "FFJ4" in said.err
    assert len(said.err.splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == [saved.name]


def test_no_grasps_are_not_exported(export: Export, drawn: Grasps, tmp_path: Path) -> None:
    save_grasps(tmp_path / "none.json", drawn[[]], metadata={})
    said = export(tmp_path / "none.json", "--out", tmp_path / "x.parquet")
    assert said.status == 2
    assert "no grasps" in said.err
